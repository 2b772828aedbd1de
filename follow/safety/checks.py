"""What the gate checks each round: are the data fresh, what forbids FOLLOW, what must stop it.  Pure functions."""

import math
from dataclasses import dataclass

from follow.messages import LANDED_AGE_S, BatteryLevel, Cause, Estimate, Landed, Reason, VehicleState
from follow.safety.heights import least_height_m
from follow.safety.limits import Limits
from follow.safety.modes import open_modes

PLAUSIBLE = 1e6
"""Bound on telemetry numbers (m, m/s, rad): a larger one is invalid.  Desired velocities are clamped to it."""

UNSEEN = "target not seen"
"""What forbids FOLLOW while the target is not seen, or none is selected."""

CONTESTED_S = 3.0
"""The vehicle's id counts as used by two senders for this long after the last packet of the second one."""


@dataclass(frozen=True, slots=True)
class Hindrance:
    """Something that forbids FOLLOW.  `passing`: it may vanish by itself, so an order waits for it."""

    what: str
    passing: bool = False


def stale(state: VehicleState, frame_t_s: float, limits: Limits) -> tuple[str, ...]:
    """The data that are too old, too far in the future or invalid, one line for each."""
    ages = (
        ("frame", frame_t_s, limits.frame_age_s + (limits.latency_s or 0.0)),
        ("attitude", state.attitude_t_s, limits.attitude_age_s),
        ("position", state.position_t_s, limits.position_age_s),
        ("heartbeat", state.heartbeat_t_s, limits.heartbeat_age_s),
    )
    # abs: a time that far in the future means that the clocks disagree.
    late = [(name, state.t_s - t, limit) for name, t, limit in ages if not abs(state.t_s - t) <= limit]
    old = [aged(name, age, limit) for name, age, limit in late]
    numbers = (state.roll_rad, state.pitch_rad, state.yaw_rad, state.north_m, state.east_m, state.down_m)
    speeds = (state.north_m_s, state.east_m_s, state.down_m_s, state.yaw_rate_rad_s)
    if not all(abs(v) <= PLAUSIBLE for v in (*numbers, *speeds)):
        old.append("telemetry is not plausible")
    if abs(state.t_s - state.contested_t_s) <= CONTESTED_S:
        old.append("two senders use the vehicle's id")
    return tuple(old)


def aged(name: str, age_s: float, limit_s: float) -> str:
    """One stale datum as text.  It does not change while the datum stays stale."""
    if not math.isfinite(age_s):
        return f"no {name}"
    return f"{name} older than {limit_s:g} s" if age_s > 0 else f"{name} is {limit_s:g} s or more in the future"


def unseen(estimate: Estimate, t_s: float, limits: Limits) -> float:
    """Seconds since the target was last seen, less the camera's own delay.

    inf for an estimate that is not finite, and for a sighting in the future.
    """
    numbers = (estimate.azimuth_rad, estimate.depression_rad, estimate.range_m, estimate.range_std_m)
    if not all(abs(v) <= PLAUSIBLE for v in (*numbers, estimate.north_m_s, estimate.east_m_s)):
        return math.inf
    since_s, delay_s = t_s - estimate.seen_t_s, limits.latency_s or 0.0
    return since_s - delay_s if math.isfinite(since_s) and since_s >= -limits.frame_age_s else math.inf


def must_stop(state: VehicleState, had_remote: bool) -> Reason | None:
    """What ends FOLLOW for good: it brakes, then the stream ends."""
    if state.battery in (BatteryLevel.LOW, BatteryLevel.CRITICAL):
        return Reason(Cause.BATTERY, state.battery.value)
    if had_remote and state.rc_healthy is False:
        return Reason(Cause.REMOTE_LOST)
    if state.landed is Landed.ON_GROUND:
        return Reason(Cause.LANDED)
    return None


def hindrances(
    state: VehicleState, old: tuple[str, ...], unseen_s: float, stopping: Reason | None, forbids: str, limits: Limits
) -> tuple[Hindrance, ...]:
    """What forbids FOLLOW now, the ones that do not pass by themselves first; empty: FOLLOW would be granted."""
    found: list[Hindrance] = []
    if not abs(state.t_s - state.heartbeat_t_s) <= limits.heartbeat_age_s:
        # The last telemetry, above all the mode, is no longer valid.
        found.append(Hindrance(f"nothing heard from the vehicle for {limits.heartbeat_age_s:g} s"))
    found += [Hindrance(forbids)] if forbids else []
    if not state.armed:
        found.append(Hindrance("the vehicle is not armed"))
    if not state.in_control and state.mode not in open_modes(state):
        instead = " or ".join(open_modes(state)[:3])
        found.append(Hindrance(f"the vehicle is in {state.mode or 'no known mode'}: switch to {instead}"))
    if stopping is not None:
        found.append(Hindrance(str(stopping)))
    if state.landed is Landed.IN_AIR and not least_height_m(state) >= limits.floor_m:
        found.append(Hindrance(f"the height is below the floor of {limits.floor_m:g} m"))
    fresh = abs(state.t_s - state.landed_t_s) <= LANDED_AGE_S
    if not (state.landed is Landed.IN_AIR and fresh) and stopping is None:
        word = state.landed.value if fresh else "unknown"
        found.append(Hindrance(f"the autopilot must report that the vehicle is in the air, not {word}"))
    found += [Hindrance(text, passing=True) for text in old]
    if not unseen_s <= limits.coast_after_s:
        found.append(Hindrance(UNSEEN, passing=True))
    return tuple(found)
