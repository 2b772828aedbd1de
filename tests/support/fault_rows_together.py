"""Rows of the fault matrix in which two faults meet, or one comes and goes.  See docs/hazards.md."""

import math
from collections.abc import Callable
from dataclasses import replace

from pymavlink.dialects.v20 import common as dialect

from sim.dynamics import Wind
from tests.support.bounds import LANDED_TOLD_S, RUN_M_S, stop
from tests.support.fault_expectations import goes_on, keeps, keeps_off, stops
from tests.support.fault_rig import Rig
from tests.support.fault_rows import Row, nothing
from tests.support.fault_rows_motion import FLOOR_M, HEIGHT_LOST_M, LEAST_M, WALK, away, hill, reset
from tests.support.link_faults import number

EXTENDED_SYS_STATE = 245
ON_GROUND, IN_AIR = 1, 2
Step = tuple[float, Callable[[Rig], None]]


def in_turn(*steps: Step) -> Callable[[Rig], None]:
    """Several faults in the order of their times, seconds after the row's moment."""

    def inject(rig: Rig) -> None:
        left = sorted(steps, key=lambda step: step[0])

        def way(packets: list[bytes]) -> list[bytes]:
            while left and rig.t_s - rig.fault_t_s >= left[0][0]:
                left.pop(0)[1](rig)
            return packets

        rig.to_client = way

    return inject


def hide(rig: Rig) -> None:
    rig.track = lambda track: replace(track, found=False, confidence=0.0)


def show(rig: Rig) -> None:
    rig.track = lambda track: track


def count_a_reset(rig: Rig) -> None:
    """The autopilot says that its estimator was reset; its position goes on as before."""
    rig.system.flight.resets += 1


def creep(speed_m_s: float, seconds: float) -> Callable[[Rig], None]:
    """The position drifts north, which the velocity does not show; then it returns at once."""
    steps = round(10 * seconds)
    ticks = [(0.1 * n, reset(0.1 * speed_m_s, 0.0, 0.0)) for n in range(steps)]
    return in_turn(*ticks, (seconds, reset(-0.1 * steps * speed_m_s, 0.0, 0.0)))


def slip(lower_deg: float) -> Callable[[Rig], None]:
    """The mount gives way."""

    def inject(rig: Rig) -> None:
        assert rig.true_down_rad is not None
        rig.true_down_rad += math.radians(lower_deg)

    return inject


def flap(rig: Rig) -> None:
    """Every second report of the landed state says on the ground."""
    mav = dialect.MAVLink(None, srcSystem=1, srcComponent=1)
    told: list[int] = []

    def other(packet: bytes) -> bytes:
        told.append(IN_AIR if told and told[-1] == ON_GROUND else ON_GROUND)
        mav.seq = packet[4]
        return dialect.MAVLink_extended_sys_state_message(0, told[-1]).pack(mav)

    rig.to_client = lambda packets: [other(p) if number(p) == EXTENDED_SYS_STATE else p for p in packets]


def blow(speed_m_s: float, toward_deg: float) -> Callable[[Rig], None]:
    def inject(rig: Rig) -> None:
        rig.system.flight.vehicle.wind = Wind(speed_m_s, math.radians(toward_deg), 2.0)

    return inject


def up_and_back(speed_m_s: float) -> dict[str, object]:
    """The target walks up a hill for 34 s and then comes straight back down to the vehicle."""
    walked_m = 1.4 * 34.0

    def path(t_s: float) -> tuple[float, float]:
        return 12.0 + min(1.4 * max(t_s - 6.0, 0.0), walked_m) - speed_m_s * max(t_s - 40.0, 0.0), 0.0

    return {"path": path, "ground": hill(0.1), "fault_t_s": 15.0, "end_t_s": 44.0 + walked_m / speed_m_s}


KEEPS_OFF = keeps_off(LEAST_M, FLOOR_M - HEIGHT_LOST_M)

TOGETHER_ROWS = (
    *(
        Row(f"10% uphill, then the target comes back at {speed:g} m/s", nothing, keeps(least), up_and_back(speed))
        for speed, least in ((3.0, 4.0), (6.0, 3.0))
    ),
    *(
        Row(
            f"10% uphill, position jumps {name} while the target is hidden",
            in_turn((0.0, hide), (1.0, reset(*jump)), (2.0, show)),
            KEEPS_OFF,
            {"path": away(1.4), "ground": hill(0.1), "fault_t_s": 25.0, "end_t_s": 45.0},
        )
        for name, jump in (("down by 4 m", (0.0, 0.0, 4.0)), ("east by 8 m", (0.0, 8.0, 0.0)))
    ),
    Row("a reset is counted that did not happen", count_a_reset, goes_on(3.0), WALK),
    Row(
        "position jumps north by 8 m and returns after 3 s",
        in_turn((0.0, reset(8.0, 0.0, 0.0)), (3.0, reset(-8.0, 0.0, 0.0))),
        KEEPS_OFF,
        WALK,
    ),
    Row("position creeps north at 2 m/s for 8 s and returns at once", creep(2.0, 8.0), KEEPS_OFF, WALK),
    *(
        Row(
            f"mount slips by {abs(lower)} degrees {'down' if lower > 0 else 'up'} in flight",
            slip(lower),
            KEEPS_OFF,
            {**WALK, "view": True},
        )
        for lower in (5, -5)
    ),
    Row("landed state flaps", flap, stops(stop(RUN_M_S, LANDED_TOLD_S)), fast=True),
    Row(
        "wind of 8 m/s, and the target is hidden for 3 s",
        in_turn((0.0, blow(8.0, 0.0)), (1.0, hide), (4.0, show)),
        KEEPS_OFF,
        WALK,
    ),
)
