"""Rows of the fault matrix about where the vehicle flies: highest speed in every servo mode, hills, resets, AVOID."""

import math
from collections.abc import Callable

from follow.control.servo import ServoConfig, ServoMode
from follow.messages import Autopilot
from follow.safety.gate import Limits
from tests.support.bounds import (
    AVOID_AHEAD_M,
    AVOIDED_S,
    FASTEST_M_S,
    HEIGHT_LOST_M,
    RUN_M_S,
    STALE_FRAME_S,
    STALE_HEARTBEAT_S,
    STALE_POSITION_S,
    STREAM_LOSS_S,
    stop,
)
from tests.support.fault_expectations import keeps_off, lost_link, stands, stops
from tests.support.fault_rig import Rig
from tests.support.fault_rows import Row, nothing, stall
from tests.support.link_faults import HEARTBEAT, POSITION, deaf, drop_for, uplink_lost_for

LEAST_M = Limits().min_standoff_m
FLOOR_M = Limits().floor_m
Path = Callable[[float], tuple[float, float]]


def away(speed_m_s: float) -> Path:
    """A target that stands for 6 s and then runs north."""
    return lambda t_s: (12.0 + speed_m_s * max(t_s - 6.0, 0.0), 0.0)


def speeding(speed_m_s: float) -> Path:
    """A target that stands for 6 s and then gains 0.8 m/s each second, as a camera above it can follow."""

    def path(t_s: float) -> tuple[float, float]:
        gone_s = max(t_s - 6.0, 0.0)
        gaining_s = min(gone_s, speed_m_s / 0.8)
        return 12.0 + 0.4 * gaining_s**2 + speed_m_s * (gone_s - gaining_s), 0.0

    return path


def around(speed_m_s: float) -> Path:
    """A target that circles the vehicle's place at 12 m."""

    def path(t_s: float) -> tuple[float, float]:
        angle = speed_m_s / 12.0 * max(t_s - 6.0, 0.0)
        return 12.0 * math.cos(angle), 12.0 * math.sin(angle)

    return path


def fastest(mode: ServoMode = ServoMode.CHASE) -> dict[str, object]:
    """A flight at the speed limit, or as fast as the mode lets the vehicle fly; the fault comes at 22 s."""
    flight: dict[str, object] = {"fault_t_s": 22.0, "end_t_s": 38.0, "servo": ServoConfig(mode=mode)}
    flight |= {"path": away(FASTEST_M_S - 0.5), "down_rad": 0.3}  # the tilt at that speed adds 0.4 rad
    if mode is ServoMode.SPOTLIGHT:
        return {**flight, "path": around(FASTEST_M_S - 0.5)}
    if mode is ServoMode.TOP_DOWN:
        return {**flight, "down_rad": 0.8, "height_m": 15.0, "path": speeding(6.0)}
    return flight


FAST_LOSS = lost_link(stop(FASTEST_M_S, STREAM_LOSS_S))

SPEED_ROWS = (
    *(
        Row(
            f"camera stalls at the highest speed, servo {mode.value}",
            stall,
            stops(stop(FASTEST_M_S, STALE_FRAME_S)),
            fastest(mode),
            fast=mode is ServoMode.TOP_DOWN,
        )
        for mode in ServoMode
    ),
    Row("telemetry stops at the highest speed", deaf(), stands(stop(FASTEST_M_S, STALE_FRAME_S)), fastest()),
    Row("position stops at the highest speed", deaf(POSITION), stops(stop(FASTEST_M_S, STALE_POSITION_S)), fastest()),
    Row(
        "heartbeat stops at the highest speed", deaf(HEARTBEAT), stands(stop(FASTEST_M_S, STALE_HEARTBEAT_S)), fastest()
    ),
    Row(
        "link drops for 5 s at the highest speed", drop_for(5.0), lost_link(stop(FASTEST_M_S, STREAM_LOSS_S)), fastest()
    ),
    Row(
        "uplink alone lost for 5 s at the highest speed",
        uplink_lost_for(5.0),
        lost_link(stop(FASTEST_M_S, STREAM_LOSS_S)),
        fastest(),
    ),
)


def reset(north_m: float, east_m: float, down_m: float) -> Callable[[Rig], None]:
    """The autopilot's estimator moves its position; the vehicle does not move."""
    return lambda rig: rig.system.flight.reset_estimate(north_m, east_m, down_m)


RESETS = {
    "north by 5 m": (5.0, 0.0, 0.0),
    "south by 10 m": (-10.0, 0.0, 0.0),
    "down by 4 m": (0.0, 0.0, 4.0),
    "up by 4 m": (0.0, 0.0, -4.0),
}

WALK = {"path": away(1.4), "end_t_s": 45.0}

RESET_ROWS = tuple(
    Row(
        f"position jumps {name}",
        reset(*jump),
        keeps_off(LEAST_M, FLOOR_M - HEIGHT_LOST_M),
        WALK,
        fast=name == "up by 4 m",
    )
    for name, jump in RESETS.items()
)


def hill(slope: float) -> Callable[[float, float], float]:
    """Ground that rises northward from the target's first place on; negative: it falls."""
    return lambda north, _east: -slope * max(north - 12.0, 0.0)


def over(slope: float, speed_m_s: float) -> dict[str, object]:
    """115 m over a hill."""
    return {"path": away(speed_m_s), "ground": hill(slope), "end_t_s": 6.0 + 115.0 / speed_m_s}


HILL_ROWS = tuple(
    Row(
        f"{slope:.0%} {'uphill' if sign > 0 else 'downhill'}, target at {speed:g} m/s",
        nothing,
        keeps_off(LEAST_M, FLOOR_M - HEIGHT_LOST_M),
        over(sign * slope, speed),
    )
    for sign in (1, -1)
    for slope, speed in ((0.05, 1.4), (0.10, 1.4), (0.20, 3.0))
)


def avoid(rig: Rig) -> None:
    """ArduPilot's AVOID stops GUIDED 2 m inside its fence, which lies 12 m ahead; the fence itself does nothing."""
    here = math.hypot(rig.motion.north_m, rig.motion.east_m)
    rig.system.flight.parameters.update({"FENCE_RADIUS": here + AVOID_AHEAD_M, "FENCE_ACTION": 0, "AVOID_ENABLE": 3})


AVOID_ROWS = (
    Row(
        "the autopilot's own avoidance stops it",
        avoid,
        stops(stop(RUN_M_S, AVOIDED_S)),
        {"end_t_s": 35.0},
        autopilots=(Autopilot.ARDUPILOT,),
    ),
)

MOTION_ROWS = (*SPEED_ROWS, *RESET_ROWS, *HILL_ROWS, *AVOID_ROWS)
