"""Does a limit keep the vehicle from its target?  If one does for some seconds, the pilot is told.

A target that outruns the vehicle, or stands beyond the fence, is followed at a distance with a reason for the pilot,
and given up after `out_of_reach_s`.  Pure functions.
"""

from dataclasses import dataclass, replace

from follow.geometry import ned_to_heading
from follow.messages import Setpoint, VehicleState
from follow.safety.distance import Worst
from follow.safety.limits import Limits

CUT_M_S = 0.5
"""A limit counts if it reduces the desired speed towards the target by more than this: less is ordinary shaping."""

LAG_M_S = 1.0
"""A vehicle slower than the permitted speed by more than this is still accelerating: the limit does not hold it yet."""

FALLEN_M = 0.3
"""The vehicle comes nearer if the range falls by more than this in `reach_after_s`."""

TOLD = "its limits keep the vehicle from it"


@dataclass(frozen=True, slots=True)
class TargetReach:
    """Since when a limit keeps the vehicle from its target (None: no limit does), and the text for the pilot.

    The range is compared with `mark_m`, its value at `mark_s`.  The text stays until the range falls, or until no limit
    has acted for `reach_after_s`; `free_s` is since when no limit acts.
    """

    since_s: float | None = None
    mark_s: float = 0.0
    mark_m: float = 0.0
    told: str = ""
    free_s: float | None = None


def watched_reach(
    now: TargetReach,
    desired: Setpoint,
    permitted: tuple[float, float],
    target: Worst,
    state: VehicleState,
    limits: Limits,
) -> TargetReach:
    """The reach after a round in FOLLOW; `permitted` is the NED velocity that the limits left of the desired one."""
    closing = ned_to_heading(desired.forward_m_s, desired.right_m_s, target.sight_rad - state.yaw_rad)[0]
    allowed = ned_to_heading(*permitted, target.sight_rad)[0]
    flown = ned_to_heading(state.north_m_s, state.east_m_s, target.sight_rad)[0]
    if not (desired.is_finite() and closing - max(allowed, 0.0) > CUT_M_S and flown > allowed - LAG_M_S):
        free_s = state.t_s if now.free_s is None else now.free_s
        is_free = state.t_s - free_s >= limits.reach_after_s or target.range_m < now.mark_m - FALLEN_M
        return replace(now, free_s=free_s) if now.told and not is_free else TargetReach()
    if now.since_s is None:
        return TargetReach(state.t_s, state.t_s, target.range_m)
    now = replace(now, free_s=None)
    if state.t_s - now.mark_s < limits.reach_after_s:
        return now
    told = TOLD if target.range_m > now.mark_m - FALLEN_M else ""
    return TargetReach(now.since_s if told else state.t_s, state.t_s, target.range_m, told)


def given_up(now: TargetReach, state: VehicleState, limits: Limits) -> bool:
    """Whether the target is out of reach for `out_of_reach_s`."""
    return bool(now.told) and now.since_s is not None and state.t_s - now.since_s >= limits.out_of_reach_s
