"""What was measured of two flown autopilots: PX4 1.16.0 (SIH quadrotor) and ArduCopter 4.7-dev (SITL quad).

Velocity steps over MAVLink, 20 setpoints a second, frame 8 (docs/vehicle.md).  The response models are fitted by
`tools/studies/fit_vehicle.py`; how long each obeys without setpoints stands in `follow/link/flight_modes.py`.
"""

import math
from dataclasses import dataclass

from follow.messages import Autopilot

GRAVITY_M_S2 = 9.80665  # standard gravity, CGPM 1901

PX4_SINK_M_S = 0.6
"""PX4 after a lost stream without a remote control (COM_OBL_RC_ACT = 0, position mode): it drifts and sinks."""


@dataclass(frozen=True, slots=True)
class VelocityLoop:
    """A PI velocity loop on one axis and the air that it works against.

    a_ask = gain·(v_ref - v) + integral·∫(v_ref - v)dt + feed_forward·a_ref, limited to `limit_m_s2`;
    a follows a_ask as ä = ω²(a_ask - a) - 2ζω·ȧ;  v̇ = a - drag·(v - wind).
    """

    gain_per_s: float
    integral_per_s2: float
    feed_forward: float
    omega_rad_s: float
    zeta: float
    drag_per_s: float
    limit_m_s2: float
    ramp_m_s2: float  # the reference's own acceleration limit; inf: the setpoint is not shaped
    jerk_m_s3: float


@dataclass(frozen=True, slots=True)
class YawLoop:
    """The yaw loop: ṙ = gain·(r_ref - r) + integral·∫(r_ref - r)dt - damping·r, with r_ref limited."""

    gain_per_s: float
    integral_per_s2: float
    damping_per_s: float
    rate_limit_rad_s: float
    ramp_rad_s2: float


@dataclass(frozen=True, slots=True)
class ResponseModel:
    """How one autopilot responds.  `drift_m_s` is the standard deviation of its velocity when it should stand still."""

    dead_time_s: float
    yaw_dead_time_s: float
    horizontal: VelocityLoop
    vertical: VelocityLoop
    turn: YawLoop
    drift_m_s: float
    drift_time_s: float


# 45 degrees: PX4's MPC_TILTMAX_AIR; ArduPilot's ANGLE_MAX raised from 30, without which a car outruns it.
_TILT_LIMIT_M_S2 = GRAVITY_M_S2 * math.tan(math.radians(45.0))

# Speeds up to 5 m/s; above, linear drag extrapolates.  Limits and ramps are the autopilots' parameters, not fitted.
RESPONSES: dict[Autopilot, ResponseModel] = {
    Autopilot.PX4: ResponseModel(
        dead_time_s=0.067,
        yaw_dead_time_s=0.071,
        horizontal=VelocityLoop(1.57, 0.46, 0.116, 13.4, 0.56, 0.279, _TILT_LIMIT_M_S2, math.inf, math.inf),
        vertical=VelocityLoop(5.64, 3.01, 0.092, 25.0, 1.0, 0.096, 5.0, math.inf, math.inf),
        turn=YawLoop(3.56, 1.09, 0.642, 3.5, 15.5),
        drift_m_s=0.065,  # measured: the velocity sideways to a commanded step
        drift_time_s=0.46,
    ),
    Autopilot.ARDUPILOT: ResponseModel(
        dead_time_s=0.081,
        yaw_dead_time_s=0.09,
        # The last two are WPNAV_ACCEL and PSC_JERK_XY.
        horizontal=VelocityLoop(3.85, 8.0, 1.0, 29.9, 1.22, 0.36, _TILT_LIMIT_M_S2, 2.5, 5.0),
        vertical=VelocityLoop(1.54, 0.41, 1.2, 13.5, 1.0, 0.0, 5.0, 2.5, 5.0),  # PILOT_ACCEL_Z
        turn=YawLoop(3.61, 20.9, 1.81, math.radians(60.0), 20.0),  # ATC_SLEW_YAW
        drift_m_s=0.0,  # it holds within 2 cm
        drift_time_s=1.0,
    ),
}
