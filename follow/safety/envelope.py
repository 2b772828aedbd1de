"""The limits on position applied to a desired velocity: view, stand-off, fence, altitude band.  Pure functions.

Each limits the velocity that the ramps then approach, so each must brake early: the speed allowed towards a border
falls with the distance left to it, at half the deceleration that the ramps may use.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

from follow.geometry import heading_to_ned
from follow.messages import Setpoint, VehicleState
from follow.safety.distance import (
    DRIFT_M_S,
    SETTLE_S,
    Sighting,
    Worst,
    approach_speed,
    descent_bounds,
    limit_closing_speed,
    limit_to_last_seen,
    unseen_bounds,
    walking,
)
from follow.safety.heights import greatest_height_m, least_height_m
from follow.safety.limits import Limits

Step = tuple[str, float]
"""The name of a limit, and the downward speed after it, m/s."""

RETURN_M_S = 0.5
"""Maximum speed back from beyond a border: the vehicle drifted there, or FOLLOW began there."""


def border_speed(distance_m: float, accel_m_s2: float) -> float:
    """Speed allowed towards a border `distance_m` away; negative (back, slowly) beyond it."""
    if distance_m < 0:
        return max(distance_m / SETTLE_S, -RETURN_M_S)
    return approach_speed(distance_m, accel_m_s2)


def in_view(forward: float, right: float, limits: Limits) -> tuple[float, float]:
    """Limit the part of the velocity outside the camera's horizontal view to `out_of_view_m_s`.

    The view is a cone about the nose; the part inside is the velocity's projection on the cone, so the result is
    continuous in the velocity's direction.
    """
    half = limits.half_view_rad or 0.0
    angle = math.atan2(right, forward)
    if abs(angle) <= half:
        return forward, right
    edge = math.cos(half), math.copysign(math.sin(half), right)
    inside = max(forward * edge[0] + right * edge[1], 0.0)
    out = forward - inside * edge[0], right - inside * edge[1]
    keep = min(1.0, limits.out_of_view_m_s / max(math.hypot(*out), 1e-9))
    return inside * edge[0] + keep * out[0], inside * edge[1] + keep * out[1]


def limit_to_fence(north: float, east: float, out: tuple[float, float], limits: Limits) -> tuple[float, float]:
    """Limit the velocity to stay inside the fence; `out` is the position (north, east) from the fence's centre."""
    distance = math.hypot(*out)
    if distance == 0:
        return north, east
    n, e = out[0] / distance, out[1] / distance
    excess = max(north * n + east * e - border_speed(limits.fence_m - distance, limits.accel_m_s2), 0.0)
    return north - excess * n, east - excess * e


def altitude_steps(down: float, target: Worst, state: VehicleState, limits: Limits) -> list[Step]:
    """The downward speed after the ceiling, then after the height above the target, then after the floor.

    Drift towards a border is subtracted, up to `DRIFT_M_S`.  If one height is below the floor and another above the
    ceiling, as with a stuck rangefinder, the vehicle neither climbs nor descends.
    """
    drift = min(max(target.drift_down_m_s, -DRIFT_M_S), DRIFT_M_S)
    fastest_down = border_speed(least_height_m(state) - limits.floor_m, limits.climb_accel_m_s2) - max(drift, 0.0)
    fastest_up = border_speed(limits.ceiling_m - greatest_height_m(state), limits.climb_accel_m_s2) + min(drift, 0.0)
    over_target = approach_speed(max(limits.above_target_m - target.above_m, 0.0), limits.climb_accel_m_s2)
    least_down = -min(fastest_up, over_target)
    below_ceiling, beside_target = max(down, -fastest_up), max(down, least_down)
    above_floor = min(beside_target, max(fastest_down, min(least_down, 0.0)))
    return [("ceiling", below_ceiling), ("above target", beside_target), ("floor", above_floor)]


def limit_altitude(down: float, target: Worst, state: VehicleState, limits: Limits) -> float:
    """Limit the downward speed to stay inside the altitude band, and the climb above the target."""
    return altitude_steps(down, target, state, limits)[-1][1]


HELD = {
    "speed": "slower: limits.speed_m_s",
    "unseen": "slower: limits.coast_m_s (the target is not seen)",
    "view": "less sideways or back: limits.out_of_view_m_s (the camera does not look there)",
    "last sighting": "slower: to stop before the last sighting (the target is not seen)",
    "stand-off": "slower: limits.min_standoff_m (the target may be near)",
    "another": "slower: limits.min_standoff_m (another person may be near)",
    "fence": "slower: limits.fence_m (near the border)",
    "climb": "less climb or descent: limits.climb_m_s",
    "approach": "less descent: no setting (it does not descend while the target approaches)",
    "head": "less descent or a climb: limits.min_standoff_m (low above the target)",
    "another's approach": "less descent: no setting (it does not descend while another person may be near)",
    "another's head": "less descent or a climb: limits.min_standoff_m (low above another person)",
    "below": "climb: limits.min_standoff_m (the target is not seen and may come)",
    "unseen climb": "less climb: limits.min_standoff_m (climbed that far since the target was in view)",
    "ceiling": "less climb or a descent: limits.ceiling_m (near the greatest height)",
    "above target": "less climb: limits.above_target_m (high above the target)",
    "floor": "less descent or a climb: limits.floor_m (near the least height)",
}
"""The note for each limit that changes the desired velocity: the one setting and why it acts; without a comma."""


@dataclass(frozen=True, slots=True)
class Surroundings:
    """What limits the vehicle besides its own speed: the target at its nearest, the fence, and the last sighting.

    `fence_centre` is local NED north and east, m; `last_seen` is None while the target is seen.  `another` is another
    person, found while the target is lost.
    """

    target: Worst
    fence_centre: tuple[float, float]
    last_seen: Sighting | None = None
    another: Worst | None = None


def vertical_steps(down: float, around: Surroundings, state: VehicleState, limits: Limits) -> list[Step]:
    """The downward speed after each limit in turn."""
    steps = [("desired", down), ("climb", min(max(down, -limits.climb_m_s), limits.climb_m_s))]

    def descend_at_most(name: str, fastest_down: float) -> None:
        steps.append((name, min(steps[-1][1], fastest_down)))

    approach, head = descent_bounds(around.target, state, limits)
    descend_at_most("approach", approach)
    descend_at_most("head", head)
    if around.another is not None:
        approach, head = descent_bounds(around.another, state, limits)
        descend_at_most("another's approach", approach)
        descend_at_most("another's head", head)
    if around.last_seen is not None:
        fastest_down, fastest_up = unseen_bounds(around.last_seen, state, limits)
        descend_at_most("below", fastest_down)
        steps.append(("unseen climb", max(steps[-1][1], -fastest_up)))
    return [*steps, *altitude_steps(steps[-1][1], around.target, state, limits)]


def limit_velocity(
    desired: Setpoint, speed_m_s: float, around: Surroundings, state: VehicleState, limits: Limits
) -> tuple[tuple[float, float, float], tuple[str, ...]]:
    """Apply every limit on position: returns the NED velocity and a note for each limit that acted.

    Vertically one limit decides, the last that changed the speed: only it is noted.
    """
    over = max(math.hypot(desired.forward_m_s, desired.right_m_s) / speed_m_s, 1.0)
    slow = desired.forward_m_s / over, desired.right_m_s / over
    steps = [("desired", heading_to_ned(desired.forward_m_s, desired.right_m_s, state.yaw_rad))]
    steps.append(
        (
            "speed" if speed_m_s >= limits.speed_m_s else "unseen",
            heading_to_ned(*slow, state.yaw_rad) if over > 1.0 else steps[0][1],
        )
    )
    viewed = in_view(*slow, limits)
    steps.append(("view", heading_to_ned(*viewed, state.yaw_rad) if viewed != slow else steps[-1][1]))
    if around.last_seen is not None:
        steps.append(("last sighting", limit_to_last_seen(*steps[-1][1], around.last_seen, state, limits)))
    target = around.target if around.last_seen is None else walking(around.target, around.last_seen, state)
    steps.append(("stand-off", limit_closing_speed(*steps[-1][1], target, limits)))
    if around.another is not None:
        steps.append(("another", limit_closing_speed(*steps[-1][1], around.another, limits)))
    out = state.north_m - around.fence_centre[0], state.east_m - around.fence_centre[1]
    steps.append(("fence", limit_to_fence(*steps[-1][1], out, limits)))
    vertical = vertical_steps(desired.down_m_s, around, state, limits)
    acted = changed(steps) + changed(vertical)[-1:]
    return (*steps[-1][1], vertical[-1][1]), tuple(HELD[name] for name in acted)


def changed(steps: Sequence[tuple[str, object]]) -> list[str]:
    """The names of the steps that changed the value of the one before."""
    return [name for (_, before), (name, after) in pairwise(steps) if before != after]
