"""Does the vehicle fly what is sent?  The measured velocity against that of a vehicle that obeys.  Pure functions."""

import math
from dataclasses import dataclass

from follow.messages import Cause, Reason, VehicleState
from follow.safety.limits import Limits

LAG_S = 0.8
"""Time to 63 % of a velocity step: the slower of the two autopilots that were measured (docs/vehicle.md)."""

LEVEL_M_S, CLIMB_M_S = 1.5, 1.0
"""Tolerance for gusts and PX4's drift: more than three times the difference that was measured in Hold."""

FRACTION = 0.4
"""Further tolerance as a fraction of the expected speed: for saturation, and a target that accelerates all the time."""

WALK_M_S, STANDS = 1.0, 0.3
"""A vehicle that should fly at this speed or faster and has less than this fraction of it does not obey.

By the tolerances alone, a vehicle that stands because no setpoint reaches it would pass up to 2.5 m/s."""


@dataclass(frozen=True, slots=True)
class Response:
    """The NED velocity of a vehicle that obeys, m/s, and since when the measured one differs (None: it does not)."""

    expected: tuple[float, float, float] = (0.0, 0.0, 0.0)
    since_s: float | None = None


def watched(now: Response, sent: tuple[float, float, float], state: VehicleState, dt_s: float) -> Response:
    """The response after `dt_s` with `sent` as the NED setpoint: expected' = (sent - expected) / LAG_S."""
    part = 1.0 - math.exp(-dt_s / LAG_S)
    north, east, down = (e + part * (s - e) for e, s in zip(now.expected, sent, strict=True))
    level = math.hypot(state.north_m_s - north, state.east_m_s - east)
    climb = abs(state.down_m_s - down)
    speed, flown = math.hypot(north, east), math.hypot(state.north_m_s, state.east_m_s)
    stands = speed >= WALK_M_S and flown < STANDS * speed
    obeys = not stands and level <= LEVEL_M_S + FRACTION * speed and climb <= CLIMB_M_S + FRACTION * abs(down)
    since_s = None if obeys else state.t_s if now.since_s is None else now.since_s
    return Response((north, east, down), since_s)


def disobeying(now: Response, state: VehicleState, limits: Limits) -> Reason | None:
    """The reason to stop if the velocity has differed for `disobey_after_s`."""
    if now.since_s is None or state.t_s - now.since_s < limits.disobey_after_s:
        return None
    flown = state.north_m_s, state.east_m_s, state.down_m_s
    off, speed = math.dist(flown, now.expected), math.hypot(*now.expected)
    return Reason(Cause.NOT_OBEYING, f"its velocity is {off:.1f} m/s off the {speed:.1f} m/s that it should have")
