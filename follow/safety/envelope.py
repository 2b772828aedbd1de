"""The limits on position applied to a desired velocity: view, stand-off, fence, altitude band.  Pure functions.

Each limits the velocity that the ramps then approach, so each must brake early: the speed allowed towards a border
falls with the distance left to it, at half the deceleration that the ramps may use.
"""

import math
from itertools import pairwise

from follow.geometry import heading_to_ned, ned_to_heading
from follow.messages import Estimate, Setpoint, VehicleState
from follow.safety.limits import Limits

SETTLE_S = 1.5
"""Time constant of the last metre before a border: dead time, jerk limit and the autopilot's response together."""

RETURN_M_S = 0.5
"""Maximum speed back from beyond a border: the vehicle drifted there, or FOLLOW began there."""

HEAD_M = 2.0
"""Height of a target's head."""


def approach_speed(distance_m: float, accel_m_s2: float) -> float:
    """Speed allowed towards a border `distance_m` away: v = sqrt(a d), v <= d/T; negative (back) beyond the border."""
    if distance_m < 0:
        return max(distance_m / SETTLE_S, -RETURN_M_S)
    return min(math.sqrt(accel_m_s2 * distance_m), distance_m / SETTLE_S)


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


def limit_closing_speed(
    forward: float, right: float, estimate: Estimate, state: VehicleState, limits: Limits
) -> tuple[float, float]:
    """Limit the closing speed: the stand-off is kept even if the target is `range_sigmas` nearer than estimated."""
    above = max(-state.down_m - HEAD_M, 0.0)
    needed = math.sqrt(max(limits.min_standoff_m**2 - above**2, 0.0))
    if needed == 0:
        return forward, right
    distance = estimate.range_m - limits.range_sigmas * estimate.range_std_m - needed
    sight = state.yaw_rad + estimate.azimuth_rad
    away, _ = ned_to_heading(estimate.north_m_s, estimate.east_m_s, sight)
    closing, _ = ned_to_heading(forward, right, estimate.azimuth_rad)
    # Only closing is limited here; the servo makes the vehicle retreat.
    allowed = max(approach_speed(max(distance, 0.0), limits.accel_m_s2) + away, 0.0)
    too_fast = heading_to_ned(max(closing - allowed, 0.0), 0.0, estimate.azimuth_rad)
    return forward - too_fast[0], right - too_fast[1]


def limit_to_fence(north: float, east: float, out: tuple[float, float], limits: Limits) -> tuple[float, float]:
    """Limit the velocity to stay inside the fence; `out` is the position (north, east) from the fence's centre."""
    distance = math.hypot(*out)
    if distance == 0:
        return north, east
    n, e = out[0] / distance, out[1] / distance
    excess = max(north * n + east * e - approach_speed(limits.fence_m - distance, limits.accel_m_s2), 0.0)
    return north - excess * n, east - excess * e


def limit_altitude(down: float, estimate: Estimate, state: VehicleState, limits: Limits) -> float:
    """Limit the downward speed to stay inside the altitude band, and the stand-off above the target's head."""
    height = -state.down_m
    fastest_down = approach_speed(height - limits.floor_m, limits.climb_accel_m_s2)
    overhead = math.sqrt(max(limits.min_standoff_m**2 - estimate.range_m**2, 0.0))
    if overhead > 0:
        distance = max(height - HEAD_M - overhead, 0.0)
        fastest_down = min(fastest_down, approach_speed(distance, limits.climb_accel_m_s2))
    fastest_up = approach_speed(limits.ceiling_m - height, limits.climb_accel_m_s2)
    return min(max(down, -fastest_up), fastest_down)


def limit_velocity(
    desired: Setpoint,
    speed_m_s: float,
    estimate: Estimate,
    state: VehicleState,
    start: tuple[float, float],
    limits: Limits,
) -> tuple[tuple[float, float, float], tuple[str, ...]]:
    """Apply every limit on position: returns the NED velocity and the names of the limits that reduced it."""
    steps = [("desired", (desired.forward_m_s, desired.right_m_s))]
    over = max(math.hypot(*steps[-1][1]) / speed_m_s, 1.0)
    steps.append(("speed", (desired.forward_m_s / over, desired.right_m_s / over)))
    steps.append(("view", in_view(*steps[-1][1], limits)))
    steps.append(("stand-off", limit_closing_speed(*steps[-1][1], estimate, state, limits)))
    level = heading_to_ned(*steps[-1][1], state.yaw_rad)
    fence = limit_to_fence(*level, (state.north_m - start[0], state.east_m - start[1]), limits)
    down = limit_altitude(desired.down_m_s, estimate, state, limits)
    acted = [name for (_, before), (name, after) in pairwise(steps) if before != after]
    acted += ["fence"] * (fence != level) + ["altitude"] * (down != desired.down_m_s)
    return (*fence, down), tuple(f"held by the {name} limit" for name in acted)
