"""The limits on position applied to a desired velocity: view, stand-off, fence, altitude band.  Pure functions.

Each limits the velocity that the ramps then approach, so each must brake early: the speed allowed towards a border
falls with the distance left to it, at half the deceleration that the ramps may use.
"""

import math
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
    limit_closing_speed,
    limit_descent,
    limit_descent_unseen,
    limit_to_last_seen,
    walking,
)
from follow.safety.heights import greatest_height_m, least_height_m
from follow.safety.limits import Limits

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


def limit_altitude(down: float, target: Worst, state: VehicleState, limits: Limits) -> float:
    """Limit the downward speed to stay inside the altitude band, and the climb above the target.

    Drift towards a border is subtracted, up to `DRIFT_M_S`.  If one height is below the floor and another above the
    ceiling, as with a stuck rangefinder, the vehicle neither climbs nor descends.
    """
    drift = min(max(target.drift_down_m_s, -DRIFT_M_S), DRIFT_M_S)
    fastest_down = border_speed(least_height_m(state) - limits.floor_m, limits.climb_accel_m_s2) - max(drift, 0.0)
    fastest_up = border_speed(limits.ceiling_m - greatest_height_m(state), limits.climb_accel_m_s2) + min(drift, 0.0)
    over_target = approach_speed(max(limits.above_target_m - target.above_m, 0.0), limits.climb_accel_m_s2)
    least_down = -min(fastest_up, over_target)
    return min(max(down, least_down), max(fastest_down, min(least_down, 0.0)))


HELD = {
    "speed": "slower: limits.speed_m_s",
    "unseen": "slower: limits.coast_m_s (the target is not seen)",
    "view": "less sideways or back: limits.out_of_view_m_s (the camera does not look there)",
    "last sighting": "slower: to stop before the last sighting (the target is not seen)",
    "stand-off": "slower: limits.min_standoff_m (the target may be near)",
    "below": "climb: limits.min_standoff_m (the target is not seen and may come)",
    "another": "slower: limits.min_standoff_m (another person may be near)",
    "fence": "slower: limits.fence_m (near the border)",
    "altitude": "less climb or descent: limits.floor_m or limits.ceiling_m or limits.above_target_m",
}
"""The note for each limit that changes the desired velocity: its setting, and why it acts; without a comma."""


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


def limit_velocity(
    desired: Setpoint, speed_m_s: float, around: Surroundings, state: VehicleState, limits: Limits
) -> tuple[tuple[float, float, float], tuple[str, ...]]:
    """Apply every limit on position: returns the NED velocity and a note for each limit that acted."""
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
    down = limit_descent(desired.down_m_s, around.target, state, limits)
    if around.another is not None:
        steps.append(("another", limit_closing_speed(*steps[-1][1], around.another, limits)))
        down = limit_descent(down, around.another, state, limits)
    out = state.north_m - around.fence_centre[0], state.east_m - around.fence_centre[1]
    steps.append(("fence", limit_to_fence(*steps[-1][1], out, limits)))
    safe = down if around.last_seen is None else limit_descent_unseen(down, around.last_seen, state, limits)
    limited = limit_altitude(safe, around.target, state, limits)
    acted = [name for (_, before), (name, after) in pairwise(steps) if before != after]
    acted += ["below"] if limited == safe < down else ["altitude"] * (limited != desired.down_m_s or safe < down)
    return (*steps[-1][1], limited), tuple(HELD[name] for name in acted)
