"""What the limits on place leave of a wanted velocity: view, stand-off, fence, altitude band.  Pure functions.

Each works on the velocity that the ramps shall reach, so each brakes early: the speed allowed towards a border falls
with the room left, from half the deceleration that the ramps may use.
"""

import math
from itertools import pairwise

from follow.geometry import heading_to_ned, ned_to_heading
from follow.messages import Estimate, Setpoint, VehicleState
from follow.safety.limits import Limits

SETTLE_S = 1.5
"""Time constant of the last metre before a border: dead time, jerk and the autopilot's own answer together."""

RETURN_M_S = 0.5
"""Beyond a border the vehicle is led back at most this fast: it got there by drift or by where FOLLOW began."""

HEAD_M = 2.0
"""Height of a target's head."""


def approach_speed(room_m: float, accel_m_s2: float) -> float:
    """Speed allowed towards a border `room_m` away, v = sqrt(a d) and v <= d/T; negative (back) beyond it."""
    if room_m < 0:
        return max(room_m / SETTLE_S, -RETURN_M_S)
    return min(math.sqrt(accel_m_s2 * room_m), room_m / SETTLE_S)


def in_view(forward: float, right: float, limits: Limits) -> tuple[float, float]:
    """The velocity with its part outside the camera's horizontal view no faster than `out_of_view_m_s`.

    The view is a cone about the nose; the part inside is the velocity's projection on the cone, so a small turn of
    the desired setpoint never makes a jump.
    """
    half = limits.half_view_rad
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
    """The velocity with its closing speed such that the stand-off can be kept, were the target nearer than believed."""
    above = max(-state.down_m - HEAD_M, 0.0)
    needed = math.sqrt(max(limits.min_standoff_m**2 - above**2, 0.0))
    if needed == 0:
        return forward, right
    room = estimate.range_m - limits.range_sigmas * estimate.range_std_m - needed
    sight = state.yaw_rad + estimate.azimuth_rad
    away, _ = ned_to_heading(estimate.north_m_s, estimate.east_m_s, sight)
    closing, _ = ned_to_heading(forward, right, estimate.azimuth_rad)
    # The gate holds back, it does not push: retreating is the servo's business.
    allowed = max(approach_speed(max(room, 0.0), limits.accel_m_s2) + away, 0.0)
    too_fast = heading_to_ned(max(closing - allowed, 0.0), 0.0, estimate.azimuth_rad)
    return forward - too_fast[0], right - too_fast[1]


def limit_to_fence(north: float, east: float, out: tuple[float, float], limits: Limits) -> tuple[float, float]:
    """The velocity held inside the fence; `out` is the place (north, east) from the fence's centre."""
    distance = math.hypot(*out)
    if distance == 0:
        return north, east
    n, e = out[0] / distance, out[1] / distance
    excess = max(north * n + east * e - approach_speed(limits.fence_m - distance, limits.accel_m_s2), 0.0)
    return north - excess * n, east - excess * e


def limit_altitude(down: float, estimate: Estimate, state: VehicleState, limits: Limits) -> float:
    """The downward speed held inside the altitude band, and above the target's head by the stand-off."""
    height = -state.down_m
    fastest_down = approach_speed(height - limits.floor_m, limits.climb_accel_m_s2)
    overhead = math.sqrt(max(limits.min_standoff_m**2 - estimate.range_m**2, 0.0))
    if overhead > 0:
        room = max(height - HEAD_M - overhead, 0.0)
        fastest_down = min(fastest_down, approach_speed(room, limits.climb_accel_m_s2))
    fastest_up = approach_speed(limits.ceiling_m - height, limits.climb_accel_m_s2)
    return min(max(down, -fastest_up), fastest_down)


def bounded(
    want: Setpoint,
    speed_m_s: float,
    estimate: Estimate,
    state: VehicleState,
    start: tuple[float, float],
    limits: Limits,
) -> tuple[tuple[float, float, float], tuple[str, ...]]:
    """What may be flown of a desired setpoint: NED velocity, and the names of the limits that cut it."""
    steps = [("desired", (want.forward_m_s, want.right_m_s))]
    over = max(math.hypot(*steps[-1][1]) / speed_m_s, 1.0)
    steps.append(("speed", (want.forward_m_s / over, want.right_m_s / over)))
    steps.append(("view", in_view(*steps[-1][1], limits)))
    steps.append(("stand-off", limit_closing_speed(*steps[-1][1], estimate, state, limits)))
    level = heading_to_ned(*steps[-1][1], state.yaw_rad)
    fence = limit_to_fence(*level, (state.north_m - start[0], state.east_m - start[1]), limits)
    down = limit_altitude(want.down_m_s, estimate, state, limits)
    acted = [name for (_, before), (name, after) in pairwise(steps) if before != after]
    acted += ["fence"] * (fence != level) + ["altitude"] * (down != want.down_m_s)
    return (*fence, down), tuple(f"held by the {name} limit" for name in acted)
