"""The minimum distance to the target: how it limits a velocity, and the retreat or climb that it demands.

All ranges and speeds are along the line of sight over the ground.  `Worst` is the target at the nearest range and
height that its uncertainty allows.  Pure functions.
"""

import math
from dataclasses import dataclass, replace

from follow.geometry import heading_to_ned, ned_to_heading
from follow.messages import Estimate, OtherSighting, VehicleState
from follow.safety.limits import Limits

SETTLE_S = 1.5
"""Time constant of the last metre before a border: dead time, jerk limit and the autopilot's response together."""

REACT_S = 1.0
"""From a cause to full deceleration: detection (0.25 s), ramp (a/2J = 0.125 s) and the autopilot's response (0.6 s)."""

HEAD_M = 2.0
"""Height of a target's head unless the estimate puts it higher."""

NEARING_M_S = 0.3
"""A target that moves towards the vehicle faster than this is approaching; less is noise of the estimate."""

FULL_CLIMB_M = 0.5
"""The vehicle climbs at the full limit when it is this much or more below the height that it needs."""


SPRINT_M_S, SPRINT_STANDOFF_M = 6.0, 3.0
"""Speed of a person who suddenly sprints at the vehicle, and the distance that the vehicle must then keep."""

JOG_M_S = 3.0
"""Speed of a person who suddenly jogs at the vehicle, which must then keep `min_standoff_m`."""

NOTICE_S = 1.2
"""From a sudden run to the vehicle's climb: 0.5 s until the estimate shows it, the ramp, the autopilot's response."""

STEADY_CLIMB_M_S = 1.0
"""Maximum climb to the height that a sudden run would demand, while nobody runs: slow, to keep the target in view."""

DRIFT_M_S = 0.5
"""Maximum correction for the autopilot's velocity error: PX4's was measured at 0.2 m/s RMS."""


@dataclass(frozen=True, slots=True)
class Worst:
    """The target at its nearest: NED angle of the line of sight, range along the ground and height above its head, m.

    `approach_m_s` is the target's own speed towards the vehicle.  `spare_m` is the estimated height above the head
    minus the one that `sprint_above_m` demands.  `drift_down_m_s` is how much faster the vehicle's reported position
    sinks than its reported velocity says; `drift_closing_m_s`, never negative, the same towards the target.
    """

    sight_rad: float
    range_m: float
    above_m: float
    approach_m_s: float
    spare_m: float = math.inf
    drift_down_m_s: float = 0.0
    drift_closing_m_s: float = 0.0


@dataclass(frozen=True, slots=True)
class Sighting:
    """The nearest position that the target may have had at `t_s`, local NED, and the NED angle of the sighting.

    `head_down_m` is the highest level, local NED, at which its head may have been, no higher than the vehicle.  It was
    in unbroken view from `since_s` on; `base_down_m` is the vehicle's level when it had been in view for `STEADY_S`, or
    the lowest level since.
    """

    north_m: float
    east_m: float
    sight_rad: float
    t_s: float
    head_down_m: float
    base_down_m: float
    since_s: float


UNKNOWN = Worst(0.0, 0.0, 0.0, 0.0)
"""Stands for the target while there are no fresh data; no limit is computed from it."""


WALK_M_S = 1.4
"""Assumed speed towards the vehicle of an unseen target, and of another person."""

STEADY_S = 3.0
"""After this long in view the limit on climbing starts from the present height: a shorter glimpse may show another
object."""


def worst(estimate: Estimate, state: VehicleState, limits: Limits) -> Worst:
    """The nearest target that the estimate allows: by its own bound or, without one, by `range_sigmas`."""
    near = estimate.range_m - limits.range_sigmas * estimate.range_std_m
    if math.isfinite(estimate.range_near_m):
        near = min(estimate.range_near_m, estimate.range_m)
    below = estimate.ground_below_m - limits.range_sigmas * estimate.ground_std_m
    below = below if math.isfinite(below) else -state.down_m
    top = max(estimate.target_height_m if math.isfinite(estimate.target_height_m) else HEAD_M, HEAD_M)
    sight = state.yaw_rad + estimate.azimuth_rad
    away, _ = ned_to_heading(estimate.north_m_s, estimate.east_m_s, sight)
    spare = estimate.ground_below_m - top - sprint_above_m(estimate.range_m, limits)
    drift = (estimate.drift_north_m_s, estimate.drift_east_m_s, estimate.drift_down_m_s)
    north, east, down = drift if all(map(math.isfinite, drift)) else (0.0, 0.0, 0.0)
    towards, _ = ned_to_heading(north, east, sight)
    closing = min(max(towards, 0.0), DRIFT_M_S)
    return Worst(sight, max(near, 0.0), max(below - top, 0.0), -away, spare, down, closing)


def gone(seen: Sighting | None, state: VehicleState) -> Worst:
    """A target that may be anywhere, its head as high as when it was last seen.

    It stands for a target unseen for longer than `search_after_s`: the vehicle keeps its height above people, but does
    not retreat from a guessed position.
    """
    above_m = max(seen.head_down_m - state.down_m, 0.0) if seen is not None else 0.0
    return Worst(0.0, math.inf, above_m, 0.0)


def sighted(before: Sighting | None, target: Worst, t_s: float, state: VehicleState, limits: Limits) -> Sighting:
    """The sighting of the target at `t_s`; `before` is the previous one, None to start a new series."""
    north, east = heading_to_ned(target.range_m, 0.0, target.sight_rad)
    is_unbroken = before is not None and t_s - before.t_s <= limits.coast_after_s
    since_s = before.since_s if before is not None and is_unbroken else t_s
    base_m = state.down_m
    if before is not None and t_s - since_s < STEADY_S:
        base_m = max(before.base_down_m, base_m)
    position = state.north_m + north, state.east_m + east
    return Sighting(*position, target.sight_rad, t_s, state.down_m + target.above_m, base_m, since_s)


def moved(seen: Sighting, state: VehicleState) -> Sighting:
    """A sighting shifted with the autopilot's own origin."""
    return replace(
        seen,
        north_m=seen.north_m + state.reset_north_m,
        east_m=seen.east_m + state.reset_east_m,
        head_down_m=seen.head_down_m + state.reset_down_m,
        base_down_m=seen.base_down_m + state.reset_down_m,
    )


def worst_other(other: OtherSighting | None, state: VehicleState) -> Worst | None:
    """Another person at the nearest, assumed to walk towards the vehicle; None if nobody was found."""
    if other is None or not all(map(math.isfinite, (other.azimuth_rad, other.range_m, other.below_m))):
        return None
    above_m = max(other.below_m - HEAD_M / 2, 0.0)
    return Worst(state.yaw_rad + other.azimuth_rad, max(other.range_m, 0.0), above_m, WALK_M_S)


def sprint_above_m(range_m: float, limits: Limits, since_s: float = 0.0) -> float:
    """Height above the head that lets the vehicle evade a runner who started `since_s` ago from `range_m`.

    The runner is below the vehicle after range / speed; by then it must have climbed to SPRINT_STANDOFF_M against a
    sprint and to `min_standoff_m` against a jog.  The retreat is neglected, because it only begins then.
    """
    sprint_m, jog_m = (climbed_m(range_m / speed - since_s - NOTICE_S, limits) for speed in (SPRINT_M_S, JOG_M_S))
    least_m = limits.min_standoff_m
    return max(min(SPRINT_STANDOFF_M, least_m) - sprint_m, least_m - jog_m, 0.0)


def climbed_m(rising_s: float, limits: Limits) -> float:
    """Height gained in `rising_s` from rest, at the limits of acceleration and speed; 0 for a negative time."""
    rising_s = max(rising_s, 0.0)
    ramp_s = min(rising_s, limits.climb_m_s / limits.climb_accel_m_s2)
    return limits.climb_accel_m_s2 * ramp_s**2 / 2 + limits.climb_m_s * (rising_s - ramp_s)


def distance_m(target: Worst) -> float:
    """Distance from the vehicle to the target's head, or to its side if the vehicle is lower."""
    return math.hypot(target.range_m, target.above_m)


def approach_speed(distance_m: float, accel_m_s2: float) -> float:
    """Speed allowed towards a border `distance_m` >= 0 away: v = sqrt(a d), at half the deceleration, and v <= d/T."""
    return min(math.sqrt(accel_m_s2 * distance_m), distance_m / SETTLE_S)


def stopping_speed(distance_m: float, accel_m_s2: float) -> float:
    """Speed from which the vehicle stops within `distance_m` >= 0: v²/2a + v T = d, with T the reaction time."""
    lag = accel_m_s2 * REACT_S
    return math.sqrt(lag * lag + 2 * accel_m_s2 * distance_m) - lag


def closing_speed(target: Worst, limits: Limits) -> float:
    """Speed allowed towards the target; negative: the vehicle must retreat, up to the speed limit.

    Relative to the target, half the deceleration must stop the vehicle before the stand-off.  Over the ground, the
    vehicle must be able to stop before the target's position, because the target may vanish behind a wall there.  Both
    are rates of the reported position; the autopilot flies by its reported velocity, so the drift is subtracted.
    """
    needed = math.sqrt(max(limits.min_standoff_m**2 - target.above_m**2, 0.0))
    allowed = math.inf
    if needed > 0.0:
        room = target.range_m - needed
        keeping = approach_speed(room, limits.accel_m_s2) if room >= 0 else 2 * room / SETTLE_S
        allowed = keeping - target.approach_m_s
    if limits.clear_distance > 0.0:
        allowed = min(allowed, stopping_speed(limits.clear_distance * target.range_m, limits.accel_m_s2))
    return max(allowed - target.drift_closing_m_s, -limits.speed_m_s)


def limit_closing_speed(north: float, east: float, target: Worst, limits: Limits) -> tuple[float, float]:
    """The NED velocity with its part towards the target no faster than allowed, or turned into a retreat."""
    closing, across = ned_to_heading(north, east, target.sight_rad)
    allowed = closing_speed(target, limits)
    return (north, east) if closing <= allowed else heading_to_ned(allowed, across, target.sight_rad)


def limit_to_last_seen(
    north: float, east: float, seen: Sighting, state: VehicleState, limits: Limits
) -> tuple[float, float]:
    """The NED velocity that stops `min_standoff_m` before the last sighting, because there may be a wall."""
    closing, across = ned_to_heading(north, east, seen.sight_rad)
    ahead, _ = ned_to_heading(seen.north_m - state.north_m, seen.east_m - state.east_m, seen.sight_rad)
    allowed = approach_speed(max(ahead - limits.min_standoff_m, 0.0), limits.accel_m_s2)
    return (north, east) if closing <= allowed else heading_to_ned(allowed, across, seen.sight_rad)


def walking(target: Worst, seen: Sighting, state: VehicleState) -> Worst:
    """An unseen target, assumed to walk towards the vehicle from its nearest possible position when last seen.

    A target that may be anywhere is returned unchanged.
    """
    if not math.isfinite(target.range_m):
        return target
    away_m = math.hypot(seen.north_m - state.north_m, seen.east_m - state.east_m)
    walked_m = WALK_M_S * max(state.t_s - seen.t_s, 0.0)
    range_m = min(target.range_m, max(away_m - walked_m, 0.0))
    return replace(target, range_m=range_m, approach_m_s=max(target.approach_m_s, WALK_M_S))


def unseen_bounds(seen: Sighting, state: VehicleState, limits: Limits) -> tuple[float, float]:
    """The fastest descent over an unseen target, negative if it may run under the vehicle, and the fastest climb.

    The target may have started to run at the last sighting, with its head as high as it may have been then.  The height
    needed is `sprint_above_m`, which grows to `min_standoff_m`.  Repeated glimpses of an object level with the vehicle
    must not raise it step by step: it climbs at most `min_standoff_m` above the height at which it last had the target
    steadily in view.
    """
    away_m = math.hypot(seen.north_m - state.north_m, seen.east_m - state.east_m)
    needed_m = sprint_above_m(away_m, limits, max(state.t_s - seen.t_s, 0.0))
    lacking_m = needed_m - (seen.head_down_m - state.down_m)
    fastest_down = -min(lacking_m / FULL_CLIMB_M, 1.0) * limits.climb_m_s if lacking_m > 0.0 else math.inf
    return fastest_down, math.inf if seen.base_down_m - state.down_m < limits.min_standoff_m else 0.0


def needed_above_m(target: Worst, state: VehicleState, limits: Limits) -> float:
    """Height above the target's head that keeps the stand-off at the nearest range that braking leaves.

    Both motions count: at the relative closing speed s the range still falls by s²/2a + s T, where T is the time that
    the climb over the stand-off takes: reaction, ramp to the full speed (v/2a longer than at that speed), h/v.
    """
    own, _ = ned_to_heading(state.north_m_s, state.east_m_s, target.sight_rad)
    closing = max(own + target.drift_closing_m_s + target.approach_m_s, 0.0)
    ramp_s = limits.climb_m_s / (2 * limits.climb_accel_m_s2)
    climb_s = REACT_S + ramp_s + limits.min_standoff_m / limits.climb_m_s
    nearest = max(target.range_m - closing**2 / (2 * limits.accel_m_s2) - closing * climb_s, 0.0)
    return math.sqrt(max(limits.min_standoff_m**2 - nearest**2, 0.0))


def descent_bounds(target: Worst, state: VehicleState, limits: Limits) -> tuple[float, float]:
    """The fastest descent: by the target's approach, and by the height above its head; negative is a climb.

    There is no descent while the target approaches: a fast approach leaves no time to climb again.
    """
    steady = approach_speed(max(target.spare_m, 0.0), limits.climb_accel_m_s2)
    steady = steady if target.spare_m >= 0.0 else max(target.spare_m / SETTLE_S, -STEADY_CLIMB_M_S)
    room = target.above_m - needed_above_m(target, state, limits)
    evading = max(room / FULL_CLIMB_M, -1.0) * limits.climb_m_s
    evading = approach_speed(room, limits.climb_accel_m_s2) if room >= 0.0 else evading
    return 0.0 if target.approach_m_s > NEARING_M_S else math.inf, min(steady, evading)


def limit_descent(down: float, target: Worst, state: VehicleState, limits: Limits) -> float:
    """The downward speed within both bounds of a visible target or another person."""
    return min(down, *descent_bounds(target, state, limits))
