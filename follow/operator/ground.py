"""Ground stations: behind the autopilot on its link, or connected to us directly.

Called in the loop's thread; nothing here waits.  A flood delays neither a setpoint nor anybody's STOP: each round reads
at most READ datagrams from the direct side and processes at most HEEDED of them and of their messages, the newest of
each sender.
"""

from collections import deque
from collections.abc import Callable, Collection
from typing import Protocol, TypeVar

from pymavlink.dialects.v20 import common as dialect

from follow.link.identity import Source
from follow.link.packets import Message, Packets
from follow.link.signing import Signing
from follow.link.transports import Transport
from follow.messages import NEVER, Tick, VehicleState
from follow.operator.consoles import Consoles
from follow.operator.ground_camera import HEARTBEAT_EVERY_S, TEXT_LENGTH, GroundCamera
from follow.operator.told import PilotTexts

ArrivedT = TypeVar("ArrivedT")

READ = 300  # a few microseconds each; 9000 a second
HEEDED = 20  # each costs some 50 microseconds to decode and to answer
OTHERS = 5  # of HEEDED, reserved for new senders: a flood of a known station must not block a new one's STOP
STATIONS = 4  # ground stations that get answers at a time: the first ones, until they fall silent
HEARD_S = 10.0  # timeout of a silent ground station


class CarriesPackets(Protocol):
    """The autopilot's link; `follow.link.connection.MavlinkLink` is one."""

    def write(self, packets: list[bytes]) -> None:
        """Send packets as they are."""
        ...


class LoneVehicle:
    """Stands in for a vehicle without an autopilot, as in `follow sim`: its heartbeat, the pilot's texts and figures.

    A ground station shows a camera only with its vehicle.  This one answers nothing and has no parameters.
    """

    def __init__(self, system_id: int = 1) -> None:
        self.system_id = system_id
        self._vehicle, self._texts = Packets(system_id, 1), Packets(system_id, 191)
        self._beat_t_s = NEVER
        self._out: list[bytes] = []

    def write(self, packets: list[bytes]) -> None:
        """Do nothing: there is no autopilot."""

    def tell(self, text: str, severity: int) -> None:
        """Queue a STATUSTEXT for the pilot."""
        words = text.encode("ascii", "replace")[:TEXT_LENGTH]
        self._out.append(self._texts.write(dialect.MAVLink_statustext_message(severity, words)))

    def tell_value(self, name: str, value: float, t_s: float) -> None:
        """Queue a NAMED_VALUE_FLOAT; `name` has at most 10 letters."""
        boot_ms = round(t_s * 1e3) & 0xFFFFFFFF
        message = dialect.MAVLink_named_value_float_message(boot_ms, name.encode("ascii")[:10], value)
        self._out.append(self._texts.write(message))

    def take(self, state: VehicleState) -> list[bytes]:
        """The packets to send in this round."""
        if state.t_s - self._beat_t_s >= HEARTBEAT_EVERY_S:
            self._beat_t_s = state.t_s
            armed = dialect.MAV_MODE_FLAG_SAFETY_ARMED if state.armed else 0
            generic, active = dialect.MAV_AUTOPILOT_GENERIC, dialect.MAV_STATE_ACTIVE
            beat = dialect.MAVLink_heartbeat_message(dialect.MAV_TYPE_QUADROTOR, generic, armed, 0, active, 3)
            self._out.append(self._vehicle.write(beat))
        out, self._out = self._out, []
        return out


def heeded(arrived: list[tuple[Source, ArrivedT]], known: Collection[Source]) -> list[tuple[Source, ArrivedT]]:
    """The arrivals to process, in their order: equally many of each sender, the newest ones.

    `known` senders have priority: hundreds of strangers must not displace them.
    """
    if len(arrived) <= HEEDED:
        return arrived
    senders = {source for source, _ in arrived}
    before, others = senders.intersection(known), senders.difference(known)
    newest: list[int] = []
    for group, most in ((before, HEEDED - OTHERS if others else HEEDED), (others, HEEDED)):
        room = dict.fromkeys(group, max((most - len(newest)) // max(len(group), 1), 1))
        for at in reversed(range(len(arrived))):
            source = arrived[at][0]
            if len(newest) < most and room.get(source, 0) > 0:
                room[source] -= 1
                newest.append(at)
    return [arrived[at] for at in sorted(newest)]


class DirectSide:
    """Ground stations connected to us directly, without the autopilot in between."""

    def __init__(self, transport: Transport, signing: Signing | None = None) -> None:
        self._transport = transport
        self._packets = Packets(1, 191, signing)
        self._heard_t_s: dict[Source, float] = {}

    def receive(self, t_s: float) -> list[Message]:
        """The messages that arrived since the last round."""
        heard: list[tuple[Source, Message]] = []
        self._heard_t_s = {source: at for source, at in self._heard_t_s.items() if t_s - at < HEARD_S}
        for source, data in self._waiting():
            found = self._packets.read_datagram(data) if self._transport.datagrams else self._packets.read(data)
            if found and (source in self._heard_t_s or len(self._heard_t_s) < STATIONS):
                self._heard_t_s[source] = t_s
            heard += [(source, message) for message in found]
        return [message for _, message in heeded(heard, self._heard_t_s)]  # a datagram may hold many

    def _waiting(self) -> list[tuple[Source, bytes]]:
        """The datagrams to decode in this round, chosen by `heeded`."""
        arrived: list[tuple[Source, bytes]] = []
        while len(arrived) < READ:
            data, source = self._transport.read(0.0)
            if not data:
                break
            arrived.append((source, data))
        # A stream has one sender, and a gap would break its packets.
        return heeded(arrived, self._heard_t_s) if self._transport.datagrams else arrived

    @property
    def hosts(self) -> tuple[str, ...]:
        """The addresses of the ground stations that are heard now."""
        return tuple(sorted({source[0] for source in self._heard_t_s if source is not None}))

    def write(self, packets: list[bytes]) -> None:
        """Send packets to every ground station that was heard."""
        for source in self._heard_t_s:
            self._transport.answer_to(source)
            for packet in packets:
                self._transport.write(packet)

    def close(self) -> None:
        """Close the transport."""
        self._transport.close()


class GroundSide:
    """The camera in which ground stations select targets, and the pilot's texts; `see` takes each tick.

    `heard` gets the addresses of the directly connected stations each round; `lone` stands in for the vehicle if there
    is no autopilot.
    """

    def __init__(
        self,
        link: CarriesPackets,
        camera: GroundCamera,
        consoles: Consoles,
        texts: PilotTexts,
        direct: DirectSide | None = None,
        heard: Callable[[tuple[str, ...]], object] | None = None,
        lone: LoneVehicle | None = None,
    ) -> None:
        self._link, self._camera, self._consoles, self._texts, self._direct = link, camera, consoles, texts, direct
        self._heard, self._lone = heard, lone
        self._waiting: deque[tuple[Message, float]] = deque(
            maxlen=HEEDED
        )  # drops the oldest, so that a STOP after a flood survives

    def hear(self, message: Message, t_s: float) -> None:
        """Take a message of the autopilot's link; it is answered in the next round."""
        if message.get_type() in ("COMMAND_LONG", "COMMAND_INT"):
            self._waiting.append((message, t_s))

    def see(self, tick: Tick) -> None:
        """Take one round, after the consoles did."""
        t_s = tick.state.t_s
        waiting = list(self._waiting)
        self._waiting.clear()
        if self._direct is not None and t_s > NEVER:
            waiting += [(message, t_s) for message in self._direct.receive(t_s)]
            if self._heard is not None:
                self._heard(self._direct.hosts)
        for message, heard_t_s in waiting:
            self._camera.hear(message, heard_t_s)
        self._camera.step(t_s, self._consoles.status)
        self._texts.see(tick)
        packets = self._camera.take()
        self._link.write(packets)
        if self._direct is not None:
            self._direct.write([*packets, *self._lone.take(tick.state)] if self._lone is not None else packets)

    def close(self) -> None:
        """Close the direct side."""
        if self._direct is not None:
            self._direct.close()
