"""Faults of the link: what passes is lost, late, doubled, spoiled, or another's."""

from collections.abc import Callable

from pymavlink.dialects.v20 import common as dialect

from follow.messages import Autopilot
from tests.support.fault_rig import Rig, Way

HEARTBEAT, ATTITUDE, POSITION = 0, 30, 32


def number(packet: bytes) -> int:
    """A MAVLink 2 packet's message id."""
    return int.from_bytes(packet[7:10], "little")


def without(*numbers: int) -> Way:
    """Withhold these messages, or everything when none is named."""
    return lambda packets: [p for p in packets if numbers and number(p) not in numbers]


def deaf(*numbers: int) -> Callable[[Rig], None]:
    def inject(rig: Rig) -> None:
        rig.to_client = without(*numbers)

    return inject


def drop_for(seconds: float) -> Callable[[Rig], None]:
    def inject(rig: Rig) -> None:
        def way(packets: list[bytes]) -> list[bytes]:
            return packets if rig.t_s > rig.fault_t_s + seconds else []

        rig.to_client = rig.to_autopilot = way

    return inject


def uplink_lost_for(seconds: float) -> Callable[[Rig], None]:
    """Nothing that we send arrives; telemetry does."""

    def inject(rig: Rig) -> None:
        rig.to_autopilot = lambda packets: packets if rig.t_s > rig.fault_t_s + seconds else []

    return inject


def lose_a_third(rig: Rig) -> None:
    def way(packets: list[bytes]) -> list[bytes]:
        return [p for p in packets if rig.chance.random() >= 0.3]

    rig.to_client = rig.to_autopilot = way


def shuffle(rig: Rig) -> None:
    """Every packet twice, each late by up to 60 ms, so that they overtake each other."""

    def late() -> Way:
        waiting: list[tuple[float, bytes]] = []

        def way(packets: list[bytes]) -> list[bytes]:
            waiting.extend((rig.t_s + rig.chance.uniform(0.0, 0.06), p) for p in packets for _ in range(2))
            due = [p for t_s, p in waiting if t_s <= rig.t_s]
            waiting[:] = [(t_s, p) for t_s, p in waiting if t_s > rig.t_s]
            return due

        return way

    rig.to_client, rig.to_autopilot = late(), late()


def garble(rig: Rig) -> None:
    """Random datagrams and broken copies of true ones, both ways."""

    def way(packets: list[bytes]) -> list[bytes]:
        out: list[bytes] = []
        for packet in packets:
            broken = bytearray(packet)
            broken[rig.chance.randrange(len(broken))] ^= 1 << rig.chance.randrange(8)
            out += [rig.chance.randbytes(rig.chance.randrange(1, 300)), bytes(broken), packet]
        return out

    rig.to_client = rig.to_autopilot = way


def another_vehicle(rig: Rig) -> None:
    """A second vehicle on the link: landed, disarmed, elsewhere."""
    mav = dialect.MAVLink(None, srcSystem=2, srcComponent=1)
    state = dialect.MAVLink_heartbeat_message(2, 12 if rig.autopilot is Autopilot.PX4 else 3, 0, 0, 3, 3)

    def way(packets: list[bytes]) -> list[bytes]:
        ms = round(rig.t_s * 1e3)
        attitude = dialect.MAVLink_attitude_message(ms, 1.0, 1.0, 1.0, 9.0, 9.0, 9.0)
        place = dialect.MAVLink_local_position_ned_message(ms, 500.0, 500.0, 0.0, 30.0, 30.0, 30.0)
        return packets + [message.pack(mav) for message in (state, attitude, place)]

    rig.to_client = way


def second_sender(rig: Rig) -> None:
    """A ground station streams setpoints over the same link."""
    mav = dialect.MAVLink(None, srcSystem=255, srcComponent=190)
    numbers = 0.0, 0.0, 0.0, 2.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.5

    def way(packets: list[bytes]) -> list[bytes]:
        message = dialect.MAVLink_set_position_target_local_ned_message(0, 1, 1, 8, 0x05C7, *numbers)
        return [*packets, message.pack(mav)]

    rig.to_client = way
