"""The minimum distance to the target: what it takes from a velocity, and the retreat and climb that it asks for.

Everything is written along the line of sight over the ground.  `Worst` is the target at its nearest: the range and the
height that its uncertainty leaves possible.  Pure functions.
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
"""Height of a target's head that is not known better."""

NEARING_M_S = 0.3
"""A target that moves towards the vehicle faster than this comes nearer; less is noise of the estimate."""

FULL_CLIMB_M = 0.5
"""The vehicle climbs at the full limit when it is this much or more below the height that it needs."""


SPRINT_M_S, SPRINT_STANDOFF_M = 6.0, 3.0
"""Somebody may start to run at the vehicle this fast at any time, and must not come nearer than this."""

JOG_M_S = 3.0
"""Somebody who starts to run at the vehicle at this speed must not come nearer than `min_standoff_m`."""

NOTICE_S = 1.2
"""From a sudden run to the vehicle's climb: 0.5 s until the estimate shows it, the ramp, the autopilot's response."""

STEADY_CLIMB_M_S = 1.0
"""Fastest climb to the height that a run would need while nobody runs: slow, for the view's sake."""

DRIFT_M_S = 0.5
"""The most that is taken off for the autopilot's velocity error: PX4's was measured at 0.2 m/s RMS."""


@dataclass(frozen=True, slots=True)
class Worst:
    """The target at its nearest: NED angle of the line of sight, range along the ground and height above its head, m.

    `approach_m_s` is the target's own speed towards the vehicle.  `spare_m` is the height by the estimate itself above
    that which `sprint_above_m` needs.  `drift_down_m_s` is how much faster the vehicle's reported position sinks than
    its reported velocity says; `drift_closing_m_s`, never negative, how much faster it moves towards the target.
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
    """The nearest place where the target may have been at `t_s`, local NED, and the NED angle at which it was seen.

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
"""No target: without fresh data nothing is read from it."""


WALK_M_S = 1.4
"""Somebody who is not seen, or of whom only a place is known, is taken to walk towards the vehicle."""

STEADY_S = 3.0
"""Something in view for this long is taken for the target where a climb over it begins: glimpses may be of another."""


def worst(estimate: Estimate, state: VehicleState, limits: Limits) -> Worst:
    """The nearest that the estimate leaves possible, by `range_sigmas` standard deviations where no bound is given."""
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
    """A target that may be anywhere along the ground, its head as high as when it was seen last.

    Unseen for longer than `search_after_s` it is so: the vehicle hovers over whoever comes, and flees from no guess.
    """
    above_m = max(seen.head_down_m - state.down_m, 0.0) if seen is not None else 0.0
    return Worst(0.0, math.inf, above_m, 0.0)


def sighted(before: Sighting | None, target: Worst, t_s: float, state: VehicleState, limits: Limits) -> Sighting:
    """The target as it was seen at `t_s`; `before` is the sighting before it, None for one that nothing leads on."""
    north, east = heading_to_ned(target.range_m, 0.0, target.sight_rad)
    is_on = before is not None and t_s - before.t_s <= limits.coast_after_s
    since_s = before.since_s if before is not None and is_on else t_s
    base_m = state.down_m
    if before is not None and t_s - since_s < STEADY_S:
        base_m = max(before.base_down_m, base_m)
    place = state.north_m + north, state.east_m + east
    return Sighting(*place, target.sight_rad, t_s, state.down_m + target.above_m, base_m, since_s)


def moved(seen: Sighting, state: VehicleState) -> Sighting:
    """A sighting after the autopilot moved its own origin: it moves along."""
    return replace(
        seen,
        north_m=seen.north_m + state.reset_north_m,
        east_m=seen.east_m + state.reset_east_m,
        head_down_m=seen.head_down_m + state.reset_down_m,
        base_down_m=seen.base_down_m + state.reset_down_m,
    )


def worst_other(other: OtherSighting | None, state: VehicleState) -> Worst | None:
    """Somebody who is not taken for the target, and may walk towards the vehicle; None for nobody."""
    if other is None or not all(map(math.isfinite, (other.azimuth_rad, other.range_m, other.below_m))):
        return None
    above_m = max(other.below_m - HEAD_M / 2, 0.0)
    return Worst(state.yaw_rad + other.azimuth_rad, max(other.range_m, 0.0), above_m, WALK_M_S)


def sprint_above_m(range_m: float, limits: Limits, since_s: float = 0.0) -> float:
    """Height above the head from which the vehicle evades somebody who ran at it `since_s` ago from `range_m`.

    He is below it after range / speed; by then it must have climbed to SPRINT_STANDOFF_M if he sprints, and to
    `min_standoff_m` if he jogs.  The retreat, which only begins by then, is left out.
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
    """From the vehicle to the target's head, or to its side if the vehicle is lower."""
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

    Relative to the target it is what half the deceleration stops before the stand-off.  Over the ground the vehicle
    must be able to stop before the place where the target is, for there it may vanish behind a wall.  Both are speeds
    of its position; the autopilot flies by the velocity that it reports, so the difference is taken off.
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
    """The NED velocity that stops `min_standoff_m` before the wall that may be where the target was last seen."""
    closing, across = ned_to_heading(north, east, seen.sight_rad)
    ahead, _ = ned_to_heading(seen.north_m - state.north_m, seen.east_m - state.east_m, seen.sight_rad)
    allowed = approach_speed(max(ahead - limits.min_standoff_m, 0.0), limits.accel_m_s2)
    return (north, east) if closing <= allowed else heading_to_ned(allowed, across, seen.sight_rad)


def walking(target: Worst, seen: Sighting, state: VehicleState) -> Worst:
    """A target that is not seen, as if it walked towards the vehicle from the nearest place where it was seen last.

    One that may be anywhere stays so.
    """
    if not math.isfinite(target.range_m):
        return target
    away_m = math.hypot(seen.north_m - state.north_m, seen.east_m - state.east_m)
    walked_m = WALK_M_S * max(state.t_s - seen.t_s, 0.0)
    range_m = min(target.range_m, max(away_m - walked_m, 0.0))
    return replace(target, range_m=range_m, approach_m_s=max(target.approach_m_s, WALK_M_S))


def limit_descent_unseen(down: float, seen: Sighting, state: VehicleState, limits: Limits) -> float:
    """The downward speed over a target that is not seen: a climb where it may run under the vehicle.

    It may have begun to run when it was seen last, and its head be as high as it may have been then.  The height is
    that of `sprint_above_m`, `min_standoff_m` in the end.  Glimpses of something level with the vehicle must not lead
    it up step by step: in all it climbs no more than that from where it had the target steadily in view.
    """
    away_m = math.hypot(seen.north_m - state.north_m, seen.east_m - state.east_m)
    needed_m = sprint_above_m(away_m, limits, max(state.t_s - seen.t_s, 0.0))
    lacking_m = needed_m - (seen.head_down_m - state.down_m)
    if lacking_m > 0.0:
        down = min(down, -min(lacking_m / FULL_CLIMB_M, 1.0) * limits.climb_m_s)
    return down if seen.base_down_m - state.down_m < limits.min_standoff_m else max(down, 0.0)


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


def limit_descent(down: float, target: Worst, state: VehicleState, limits: Limits) -> float:
    """The downward speed that keeps the height needed above the target's head; a climb where it is too low.

    While the target comes nearer there is no descent: height is what a fast approach leaves no time to gain.
    """
    if target.approach_m_s > NEARING_M_S:
        down = min(down, 0.0)
    steady = approach_speed(max(target.spare_m, 0.0), limits.climb_accel_m_s2)
    down = min(down, steady if target.spare_m >= 0.0 else max(target.spare_m / SETTLE_S, -STEADY_CLIMB_M_S))
    room = target.above_m - needed_above_m(target, state, limits)
    if room >= 0.0:
        return min(down, approach_speed(room, limits.climb_accel_m_s2))
    return min(down, max(room / FULL_CLIMB_M, -1.0) * limits.climb_m_s)
