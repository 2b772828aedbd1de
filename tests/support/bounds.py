"""The bounds of the fault matrix, derived: from the time of detection, the gate's limits and the vehicle's response.

A vehicle at speed v is told to stop `noticed_s` after the fault.  The gate's ramp needs v/a + a/j and covers
v²/2a + v a/2j; a vehicle that lags by a time constant L covers v L more and then still has the speed a L, which falls
below 0.3 m/s after L ln(a L / 0.3).  The autopilot's own position hold, if it takes over meanwhile, returns to the
place where it began: it covers up to a L² again, at a gain of 0.95 /s.
"""

import math
from dataclasses import dataclass

from follow.control.image_motion import SPAN_S, WAIT_S
from follow.safety.consistency import LONG_S, SHORT_S
from follow.safety.limits import Limits
from follow.safety.response import LAG_S

LIMITS = Limits()
STILL_M_S = 0.3  # below it the vehicle stands: a PX4 that stands still drifts
HOLD_GAIN_PER_S = 0.95  # of PX4's position controller (MPC_XY_P); ArduPilot's is 1.0
STREAM_LOSS_S = 1.2  # each autopilot's failsafe for missing setpoints, of 1.0 s, acts by then
HEARTBEAT_S = 1.0  # between two heartbeats of PX4: what it says of its mode is up to this old
RC_S = 0.2  # between two RC_CHANNELS, at the 5 Hz that the link accepts
ROUND_S = 0.1  # two rounds of the loop and the way of a packet


@dataclass(frozen=True)
class Stop:
    """Time and distance within which the vehicle stands, counted from the fault."""

    within_s: float
    within_m: float


def stop(speed_m_s: float, noticed_s: float, hold: bool = True) -> Stop:
    """The bound of a stop from a speed; `hold`: the autopilot's position hold takes over at the end."""
    a, j = LIMITS.accel_m_s2, LIMITS.jerk_m_s3
    left_m_s = a * LAG_S
    seconds = noticed_s + speed_m_s / a + a / j + LAG_S * math.log(left_m_s / STILL_M_S)
    metres = speed_m_s * (noticed_s + a / (2 * j) + LAG_S) + speed_m_s**2 / (2 * a)
    if hold:
        back_m = left_m_s * LAG_S
        seconds += math.log(HOLD_GAIN_PER_S * back_m / STILL_M_S) / HOLD_GAIN_PER_S
        metres += back_m
    return Stop(round(seconds, 1), round(metres, 1))


RUN_M_S = 3.0  # the speed of the rows' target
FASTEST_M_S = LIMITS.speed_m_s
CONTRADICTED_S = SHORT_S + SPAN_S + WAIT_S
"""A frozen image is noticed after the window of intervals, the one that the fault cut, and the wait for telemetry."""

RIDING_S = LONG_S + SPAN_S + WAIT_S
"""A box that rides on the vehicle shows by small wobbles, for which the longer window may be needed."""

STALE_FRAME_S = LIMITS.frame_age_s
STALE_POSITION_S = LIMITS.position_age_s
STALE_HEARTBEAT_S = LIMITS.heartbeat_age_s + HEARTBEAT_S / 4  # it comes four times a second, as requested
REMOTE_TOLD_S = 2.0 + 0.5  # the row's autopilot says so after 2 s; SYS_STATUS comes twice a second
LANDED_TOLD_S = 0.5  # EXTENDED_SYS_STATE comes twice a second, as requested
SILENT_S = round(HEARTBEAT_S + 2 * ROUND_S, 1)
"""A mode that somebody else chose is known after PX4's own heartbeat, a packet's way and a round of the loop."""
STICK_SEEN_S = round(1.0 + 3 * RC_S + 2 * ROUND_S, 1)
"""The rows push the stick 1 s after the fault; two samples must show it, and one may have just passed."""
DISOBEYS_S = LIMITS.disobey_after_s + LAG_S  # the difference grows with the vehicle's own lag
AVOID_AHEAD_M = 12.0  # where the row's fence lies
AVOIDED_S = AVOID_AHEAD_M / RUN_M_S + DISOBEYS_S
HEIGHT_LOST_M = 0.3  # below the floor: the climb's own lag at border_speed


def coast(speed_m_s: float) -> Stop:
    """The bound of a target that is lost: full speed for half of `search_after_s`, then a linear fall to zero."""
    half_s = LIMITS.search_after_s / 2
    left_m_s = speed_m_s / half_s * LAG_S
    seconds = LIMITS.coast_after_s + 2 * half_s + LAG_S * math.log(left_m_s / STILL_M_S)
    return Stop(round(seconds, 1), round(speed_m_s * (1.5 * half_s + LAG_S), 1))


STOPS = {
    "stale frame, attitude or telemetry": stop(RUN_M_S, STALE_FRAME_S),
    "stale position": stop(RUN_M_S, STALE_POSITION_S),
    "on the ground, it says": stop(RUN_M_S, LANDED_TOLD_S),
    "stale heartbeat": stop(RUN_M_S, STALE_HEARTBEAT_S),
    "setpoints lost: the autopilot's failsafe": stop(RUN_M_S, STREAM_LOSS_S),
    "remote control lost": stop(RUN_M_S, REMOTE_TOLD_S),
    "target lost": coast(RUN_M_S),
    "contradicted by the image's motion": stop(RUN_M_S, CONTRADICTED_S),
    "contradicted by the box's motion": stop(RUN_M_S, RIDING_S),
    "the autopilot's own avoidance": stop(RUN_M_S, AVOIDED_S),
    "stale frame at the highest speed": stop(FASTEST_M_S, STALE_FRAME_S),
    "stale position at the highest speed": stop(FASTEST_M_S, STALE_POSITION_S),
    "stale heartbeat at the highest speed": stop(FASTEST_M_S, STALE_HEARTBEAT_S),
    "setpoints lost at the highest speed": stop(FASTEST_M_S, STREAM_LOSS_S),
}
"""Cause of a stop -> its bound; docs/hazards.md shows them with their derivation."""
