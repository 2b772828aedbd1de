"""Measured responses of two flown autopilots: PX4 1.16.0 (SIH quadrotor) and ArduCopter 4.7-dev (SITL quad).

Velocity steps over MAVLink, 20 setpoints a second, frame 8, two samples of each (docs/vehicle.md).  The response models
are fitted by `tools/studies/fit_vehicle.py`; the stream timeouts are in `follow/link/flight_modes.py`.
"""

import math
from dataclasses import dataclass, replace

from typing_extensions import Self

from follow.messages import Autopilot

GRAVITY_M_S2 = 9.80665  # standard gravity, CGPM 1901

PX4_SINK_M_S = 0.6
"""PX4 after a lost stream without a remote control (COM_OBL_RC_ACT = 0, position mode): it drifts and sinks."""

TOP_M_S = {Autopilot.ARDUPILOT: (11.4, math.radians(30.0))}
"""(top speed, tilt), measured: ArduCopter following a car reached 11 to 11.8 m/s at its tilt limit of 30 degrees."""


@dataclass(frozen=True, slots=True)
class VelocityLoop:
    """A PI velocity loop on one axis, with air drag.

    a_ask = gain·(v_ref - v) + integral·∫(v_ref - v)dt + feed_forward·a_ref, limited to `limit_m_s2`;
    a follows a_ask as ä = ω²(a_ask - a) - 2ζω·ȧ;  v̇ = a - (drag_per_s + drag_per_m·|u|)·u with u = v - wind.
    """

    dead_time_s: float
    gain_per_s: float
    integral_per_s2: float
    feed_forward: float
    omega_rad_s: float
    zeta: float
    drag_per_s: float
    drag_per_m: float
    limit_m_s2: float
    ramp_m_s2: float  # the reference's own acceleration limit; inf: the setpoint is not shaped
    jerk_m_s3: float

    def drag(self, through: complex) -> complex:
        """The air's deceleration, m/s², of a vehicle that moves through it at this velocity, m/s."""
        return (self.drag_per_s + self.drag_per_m * abs(through)) * through

    def lean_rad(self, speed_m_s: float) -> float:
        """The tilt that keeps a speed in calm air."""
        return math.atan(abs(self.drag(speed_m_s)) / GRAVITY_M_S2)


@dataclass(frozen=True, slots=True)
class YawLoop:
    """The yaw loop: ṙ = gain·(r_ref - r) + integral·∫(r_ref - r)dt - damping·r, with r_ref limited."""

    dead_time_s: float
    gain_per_s: float
    integral_per_s2: float
    damping_per_s: float
    rate_limit_rad_s: float
    ramp_rad_s2: float


@dataclass(frozen=True, slots=True)
class GaussMarkov:
    """First-order Gauss-Markov noise of a velocity: standard deviations of its axes and a correlation time."""

    north_m_s: float = 0.0
    east_m_s: float = 0.0
    down_m_s: float = 0.0
    time_s: float = 1.0


@dataclass(frozen=True, slots=True)
class SpeedLimits:
    """The autopilot's own speed limits: it clips setpoints to them."""

    level_m_s: float = math.inf
    climb_m_s: float = math.inf
    descend_m_s: float = math.inf


@dataclass(frozen=True, slots=True)
class ResponseModel:
    """How one autopilot responds.

    `velocity_error` is the error of its estimated velocity, which it controls and reports: the vehicle drifts by that
    velocity while its telemetry shows that it stands still.
    """

    horizontal: VelocityLoop
    vertical: VelocityLoop
    turn: YawLoop
    limits: SpeedLimits = SpeedLimits()
    velocity_error: GaussMarkov = GaussMarkov()

    def steady(self) -> Self:
        """The same without an error of the estimated velocity."""
        return replace(self, velocity_error=GaussMarkov())


def tilt_m_s2(tilt_rad: float) -> float:
    """The horizontal acceleration of a vehicle that carries its weight at this tilt."""
    return GRAVITY_M_S2 * math.tan(tilt_rad)


# Limits and ramps are the autopilots' default parameters, not fitted; `sim/autopilot/parameters.py` changes them.
_PX4_TILT = tilt_m_s2(math.radians(45.0))  # MPC_TILTMAX_AIR
_ARDUPILOT_TILT = tilt_m_s2(math.radians(30.0))  # ATC_ANGLE_MAX

# PILOT_ACCEL_Z, and a jerk like PSC_JERK_NE; ATC_SLEW_YAW
_ARDUPILOT_VERTICAL = VelocityLoop(0.081, 1.59, 0.37, 1.2, 12.2, 1.0, 0.0, 0.0, 5.0, 2.5, 5.0)
_ARDUPILOT_TURN = YawLoop(0.1, 3.14, 20.3, 2.03, math.radians(60.0), 19.2)

RESPONSES: dict[Autopilot, tuple[ResponseModel, ...]] = {
    # One model for both samples: they differ by no more than PX4 drifts.
    Autopilot.PX4: (
        ResponseModel(
            VelocityLoop(0.066, 1.54, 0.425, 0.342, 11.7, 0.567, 0.261, 0.0, _PX4_TILT, math.inf, math.inf),
            VelocityLoop(0.059, 6.17, 2.97, 0.092, 25.0, 1.0, 0.11, 0.0, 5.0, math.inf, math.inf),
            YawLoop(0.071, 3.57, 1.12, 0.657, 3.5, 8.7),
            SpeedLimits(12.0, 3.0, 1.5),  # MPC_XY_VEL_MAX, MPC_Z_VEL_MAX_UP, MPC_Z_VEL_MAX_DN
            # North and east: during forward steps the reported sideways velocity is 0.07 m/s RMS, which the model gives
            # with an error of 0.2.  Hold reports 0.2 to 0.5 m/s; at a commanded zero PX4 moves 1 to 3 m in 5 s.
            # Down: the change of the reported height less the integral of the reported velocity.
            GaussMarkov(0.2, 0.2, 0.14, 5.0),
        ),
    ),
    # One for each sample: in the second its tilt loop is slower, so that it starts later and overshoots.
    Autopilot.ARDUPILOT: (
        ResponseModel(
            # 2.5 and 5.0: WP_ACC, PSC_JERK_NE
            VelocityLoop(0.081, 3.62, 8.0, 1.01, 29.6, 1.21, 0.254, 0.0213, _ARDUPILOT_TILT, 2.5, 5.0),
            _ARDUPILOT_VERTICAL,
            _ARDUPILOT_TURN,
        ),
        ResponseModel(
            VelocityLoop(0.067, 2.39, 5.26, 0.76, 12.3, 1.28, 0.204, 0.0257, _ARDUPILOT_TILT, 2.5, 5.0),
            _ARDUPILOT_VERTICAL,
            _ARDUPILOT_TURN,
        ),
    ),
}


def response_of(autopilot: Autopilot, seed: int = 0) -> ResponseModel:
    """The response of the flight with this seed: each sample in turn."""
    samples = RESPONSES[autopilot]
    return samples[seed % len(samples)]
