"""A gate under test: plausible states, and a vehicle that flies what is sent."""

import math
from dataclasses import replace

from follow.messages import HOVER, Autopilot, Estimate, Landed, Order, VehicleState
from follow.safety.gate import Limits, Safety

LIMITS = Limits(half_view_rad=math.radians(35.0), latency_s=0.0)
DT = 1 / 30


def flying(t_s, **changes):
    state = VehicleState(
        t_s=t_s,
        attitude_t_s=t_s,
        position_t_s=t_s,
        heartbeat_t_s=t_s,
        down_m=-20.0,
        autopilot=Autopilot.PX4,
        mode="OFFBOARD" if changes.get("in_control", True) else "HOLD",
        in_control=True,
        armed=True,
        landed_t_s=t_s,
        landed=Landed.IN_AIR,
    )
    return replace(state, **changes)


def seen(t_s):
    return Estimate(t_s, 0.0, 0.4, 12.0, 1.0, seen_t_s=t_s)


def engaged(**changes):
    """A gate that follows, and the time."""
    safety = Safety(LIMITS)
    safety.order(Order.FOLLOW)
    for i in range(3):
        decision = safety.allow(HOVER, seen(i * DT), flying(i * DT, **changes), i * DT)
    assert decision.mode == "follow"
    return safety, 2 * DT


def fly(safety, t_s, seconds, desired, seen_t_s=None, frame_t_s=None, **changes):
    """Rounds with one desired setpoint; returns the decisions."""
    decisions = []
    for i in range(1, round(seconds / DT) + 1):
        now = t_s + i * DT
        estimate = seen(now if seen_t_s is None else seen_t_s)
        state = flying(now, **{**obeyed(safety), **changes})
        decisions.append(safety.allow(desired, estimate, state, now if frame_t_s is None else frame_t_s))
    return decisions


def obeyed(safety):
    """The velocity of a vehicle that flies what was sent."""
    north, east = safety.gate.horizontal.v
    return {"north_m_s": north, "east_m_s": east, "down_m_s": safety.gate.down.v[0]}
