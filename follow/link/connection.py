"""A vehicle over UDP, TCP, a serial line or MAVSDK: `follow.link.client` with a transport and a clock.

One thread only reads, so that the times of arrival are right while the loop computes.  The caller's thread decodes and
sends: if it hangs, the stream of setpoints stops and the autopilot's failsafe acts.
"""

import logging
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from types import TracebackType

from typing_extensions import Self

from follow.link import LinkError
from follow.link.arrivals import Arrival, Arrivals
from follow.link.client import MavlinkClient
from follow.link.packets import Message
from follow.link.signing import Signing
from follow.link.tlog import Tlog
from follow.link.transports import Reach, Transport, open_transport
from follow.messages import NEVER, Notify, Setpoint, VehicleState

log = logging.getLogger(__name__)

VEHICLE_S = 0.02  # most time per round for the vehicle's packets: several hundred of them; it sends some 250 a second
OTHERS_S = 0.005  # most time per round for all other packets
READ_S = 0.05  # the reading thread checks this often whether it should end
WAITING_EVERY_S = 5.0  # interval between two reports of what is still missing
HOLD_S = 2.0  # timeout of the last request; PX4 shows a new mode up to 1 s late, and this is twice that
UNSENT_EVERY_S = 10.0  # dropped packets are reported at most this often


class MavlinkLink:
    """A Link over a transport.  Its clock is the machine's monotonic one."""

    def __init__(
        self,
        transport: Transport,
        system_id: int | None = None,
        signing: Signing | None = None,
        tlog: Tlog | None = None,
    ):
        self.client = MavlinkClient(system_id, signing)
        self.unsent = 0  # packets that the transport dropped
        self._unsent_told = (NEVER, 0)  # when it was last reported, and how many by then
        self.listeners: list[
            Callable[[Message, float], object]
        ] = []  # called with each message from the vehicle's address
        self._transport = transport
        self._tlog = tlog
        self._arrived = Arrivals()
        self._ending = threading.Event()
        self._reader = threading.Thread(target=self._read, name="link reader", daemon=True)

    def __enter__(self) -> Self:
        self._reader.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            self._leave()
        finally:
            self._ending.set()
            self._reader.join()
            self._transport.close()
            if self._tlog is not None:
                self._tlog.close()

    @property
    def reach(self) -> Reach:
        """Who else can send on this link: nobody off this machine, nobody off the cable, or anybody on the network."""
        return self._transport.reach()

    @property
    def trouble(self) -> str:
        """Why nothing comes, as far as the transport itself knows; "" if it does not."""
        return self._transport.trouble()

    def state(self) -> VehicleState:
        """The vehicle's state now."""
        self.pump()
        return self.client.state(time.monotonic())

    def send(self, setpoint: Setpoint | None) -> None:
        """Send one setpoint to the autopilot at once, or nothing if None."""
        self.client.send_setpoint(setpoint, time.monotonic())
        self._flush()

    def take_control(self) -> None:
        """Request, once, OFFBOARD or GUIDED; call this only on an operator's explicit order."""
        self.client.take_control()

    def hold(self, *, for_sticks: bool = False) -> None:
        """Request, once, Hold or BRAKE if the vehicle obeys us; with `for_sticks` a mode that obeys the sticks."""
        self.client.hold(for_sticks=for_sticks)

    def pump(self) -> list[Message]:
        """Process the arrivals and send what is due; returns the messages received."""
        messages: list[Message] = []
        for t_s, data, source in self._to_use():
            refused = self.client.packets.refused
            found = self.client.receive(data, t_s, self._transport.datagrams, source)
            self._arrived.set_peer(self.client.peer.address)
            # A vehicle whose signing clock is behind ours is refused until it has received our timestamp: answer it.
            is_unheard = self.client.vehicle_id is None and self.client.packets.refused > refused
            if is_unheard or self.client.peer.address is not None:
                self._transport.answer_to(source if is_unheard else self.client.peer.address)
            if self._tlog is not None:
                unix_s = time.time() - (time.monotonic() - t_s)
                for message in found:
                    self._tlog.write(bytes(message.get_msgbuf()), unix_s)
            messages += found
            if source == self.client.peer.address:  # never packets of a stranger on the network
                for listener in self.listeners:
                    for message in found:
                        listener(message, t_s)
        if lost := self._arrived.flood(time.monotonic()):
            log.warning("the vehicle's port is flooded: %d packets were dropped; look who sends there", lost)
        self.client.step(time.monotonic())
        self._flush()
        return messages

    def _to_use(self) -> Iterator[Arrival]:
        """The arrivals, the vehicle's first, within the time that a round has for them: the rest stays queued."""
        for take, most_s in ((self._arrived.take_vehicles, VEHICLE_S), (self._arrived.take_others, OTHERS_S)):
            end_s = time.monotonic() + most_s
            while time.monotonic() < end_s and (arrival := take()) is not None:
                yield arrival

    def wait_for_vehicle(self, timeout_s: float, report: Notify = log.info) -> None:
        """Wait until heartbeat, attitude and position are known; raises LinkError naming what is missing.

        `report` gets a line about what is missing every WAITING_EVERY_S.
        """
        began_s = time.monotonic()
        said_s, end_s, told = began_s, began_s + timeout_s, ""
        while True:
            state = self.state()
            known = {
                "heartbeat of a PX4 or ArduPilot multirotor": state.heartbeat_t_s,
                "attitude": state.attitude_t_s,
                "local position": state.position_t_s,
            }
            missing = [name for name, t_s in known.items() if t_s == NEVER]
            if not missing:
                return
            if time.monotonic() > end_s:
                why = self.trouble or "look at address, port, baud rate, cable and power; a position needs GPS lock"
                raise LinkError(f"no {' and no '.join(missing)} came within {timeout_s:g} s: {why}")
            if self.trouble not in ("", told):
                told = self.trouble
                report(f"{told}; still trying, for up to {timeout_s:g} s")
            if time.monotonic() > said_s + WAITING_EVERY_S:
                said_s = time.monotonic()
                report(f"waiting: no {' and no '.join(missing)} yet, {said_s - began_s:.0f} of {timeout_s:g} s")
            time.sleep(0.01)

    def listen(self, seconds: float) -> None:
        """Run the link for a while without sending setpoints."""
        end_s = time.monotonic() + seconds
        while time.monotonic() < end_s:
            self.pump()
            time.sleep(0.01)

    def _read(self) -> None:
        while not self._ending.is_set():
            data, source = self._transport.read(READ_S)
            if data:
                self._arrived.put((time.monotonic(), data, source))

    def write(self, packets: Sequence[bytes]) -> None:
        """Send packets of another component of ours, as they are."""
        self._write(packets)

    def _flush(self) -> None:
        self._write(self.client.take())

    def _write(self, packets: Sequence[bytes]) -> None:
        for packet in packets:
            if not self._transport.write(packet) and self.client.vehicle_id is not None:
                self.unsent += 1
            if self._tlog is not None:
                self._tlog.write(packet, time.time())
        told_s, told = self._unsent_told
        if self.unsent > told and time.monotonic() - told_s > UNSENT_EVERY_S:
            lost = self.unsent - told
            count = "1 packet" if lost == 1 else f"{lost} packets"
            log.warning("%s could not be sent: the link is full or broken", count)
            self._unsent_told = time.monotonic(), self.unsent

    def _leave(self) -> None:
        """Leave the vehicle in Hold or BRAKE if it obeyed us, in its own mode if it did not."""
        self.pump()
        if not self.client.hold():
            if self.client.vehicle_id is not None:
                mode = self.client.state(NEVER).mode or "no known mode"
                log.info("leaving: the vehicle is in %s, and no mode is requested", mode)
            return
        end_s = time.monotonic() + HOLD_S
        while self.client.is_asking() and time.monotonic() < end_s:
            self.pump()
            time.sleep(0.01)
        mode, asked = self.client.state(NEVER).mode or "no known mode", self.client.requested_mode
        if asked and not self.client.requested_times:
            log.warning("leaving: %s could not be requested, the vehicle is not heard; it was in %s", asked, mode)
        else:
            log.info("leaving: the vehicle is in %s%s", mode, f"; {asked} was requested" if asked else "")


def connect(
    uri: str,
    system_id: int | None = None,
    signing: Signing | None = None,
    tlog: Tlog | None = None,
    kind: type[MavlinkLink] = MavlinkLink,
) -> MavlinkLink:
    """A link of a kind over `udpin:`, `udpout:`, `tcp:` or `serial:`, or with `mavsdk+` before MAVSDK's own `udpin://...`.

    Raises LinkError if it cannot be opened.
    """
    if uri.startswith("mavsdk+"):
        if signing is not None:
            raise LinkError("MAVSDK cannot sign here: use the link without `mavsdk+`, or no key")
        from follow.link.mavsdk_transport import open_mavsdk  # noqa: PLC0415 (a large library that other links do without)

        return kind(open_mavsdk(uri, system_id), system_id, signing, tlog)
    return kind(open_transport(uri), system_id, signing, tlog)
