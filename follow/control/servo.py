"""The visual servo: yaw keeps the target across the middle, climb up and down, flight at the wanted place about it.

Everything is written in two directions of the ground: along the line of sight to the target, and across it (positive
to the right).  The modes differ only in what they want in these two.
"""

import math
from dataclasses import dataclass, field
from enum import Enum

from follow.control.pid import Gains, Pid
from follow.geometry import wrap
from follow.messages import NEVER, Estimate, Setpoint, VehicleState
from follow.ranges import require_numbers


class ServoMode(str, Enum):
    """How to accompany the target."""

    CHASE = "chase"  # keep the stand-off along the line of sight, from wherever it is seen
    CENTRE = "centre"  # stay in place: turn and climb only
    ORBIT = "orbit"  # keep the stand-off and fly around
    PROFILE = "profile"  # keep the stand-off at right angles to the target's course
    TOP_DOWN = "top-down"  # above it, for a camera that looks steeply down: height and heading stay


YAW = Gains(kp=3.0, limit=1.5)  # 1/s: below the bandwidth of both autopilots' yaw (0.08 s dead time, 0.2 s answer)
CLIMB = Gains(kp=0.6, limit=3.0)  # 1/s, on metres of height; m/s
APPROACH = Gains(kp=0.35, ki=0.02, limit=6.0)  # 1/s, on metres; velocity answers within 0.7 s; m/s


@dataclass(frozen=True, slots=True)
class ServoConfig:
    """The wanted picture and the gains.  Raises ValueError for a number out of its range."""

    mode: ServoMode = ServoMode.CHASE
    standoff_m: float = 12.0  # along the ground; a person of 1.8 m is then some 50 pixels high in 640x360
    orbit_m_s: float = 2.0  # positive flies to the right; a turn about 12 m takes 38 s
    yaw: Gains = YAW
    climb: Gains = CLIMB
    approach: Gains = APPROACH
    feed_forward: float = 1.0  # share of the target's own velocity that is flown with it
    pitch_filter_s: float = 1.0  # height follows the pitch of steady flight, not each twitch
    abeam_per_s: float = 0.3  # profile: how fast the angle off right angles is flown away ...
    abeam_m_s: float = 3.0  # ... and the fastest across the line of sight for it
    course_m_s: float = 0.5  # below this speed a target has no course to be abeam of

    def __post_init__(self) -> None:
        may_be_zero = ("feed_forward", "pitch_filter_s", "abeam_per_s", "abeam_m_s", "course_m_s")
        require_numbers("servo setting", self, may_be_zero=may_be_zero, any_sign=("orbit_m_s",))


STEEPEST_RAD = math.radians(75.0)
"""Steeper lines of sight count as this: the tangent of one straight down is no height."""


@dataclass(slots=True)
class Servo:
    """Estimate in, desired setpoint out.

    `down_rad` is the camera's angle below the nose: it decides where the middle is.
    """

    down_rad: float
    config: ServoConfig = field(default_factory=ServoConfig)
    yaw: Pid = field(init=False)
    climb: Pid = field(init=False)
    approach: Pid = field(init=False)
    aside: Pid = field(init=False)  # top-down: as `approach`, to the right
    pitch_rad: float | None = None
    t_s: float = NEVER

    def __post_init__(self) -> None:
        c = self.config
        self.yaw, self.climb, self.approach, self.aside = Pid(c.yaw), Pid(c.climb), Pid(c.approach), Pid(c.approach)

    def update(self, estimate: Estimate, state: VehicleState) -> Setpoint:
        """The velocity that would keep the estimated target where it is wanted; zero before it was ever seen.

        While the autopilot does not obey, nothing is integrated: how long the operator waited must not be seen later.
        """
        dt = max(estimate.t_s - self.t_s, 0.0) if self.t_s > NEVER else 0.0
        self.t_s = estimate.t_s
        if self.pitch_rad is None:
            self.pitch_rad = state.pitch_rad
        self.pitch_rad += (state.pitch_rad - self.pitch_rad) * dt / (self.config.pitch_filter_s + dt)
        if not state.in_control:
            for pid in (self.yaw, self.climb, self.approach, self.aside):
                pid.reset()
        if estimate.seen_t_s == NEVER:
            return Setpoint()
        if self.config.mode is ServoMode.TOP_DOWN:
            return self.above(estimate, state, dt)
        along, across = sight_components(estimate, state.yaw_rad)
        forward, right, _ = state.body_velocity_m_s()
        c, s = math.cos(estimate.azimuth_rad), math.sin(estimate.azimuth_rad)
        radial, sideways = self.accompany(estimate, state, along, across, dt)
        # The line of sight turns by itself when target or vehicle move across it.
        turning = (across - (c * right - s * forward)) / max(estimate.range_m, 1.0)
        with_target = self.config.feed_forward * turning
        flown = state.yaw_rate_rad_s - with_target
        yaw_rate = self.yaw.update(estimate.azimuth_rad, -estimate.azimuth_rad, dt, flown) + with_target
        down = self.descend(estimate, state, dt)
        return Setpoint(c * radial - s * sideways, s * radial + c * sideways, down, yaw_rate)

    def accompany(
        self, estimate: Estimate, state: VehicleState, along: float, across: float, dt: float
    ) -> tuple[float, float]:
        """Wanted velocity along and across the line of sight, for the target's own two."""
        c = self.config
        if c.mode is ServoMode.CENTRE:
            return 0.0, 0.0
        error = estimate.range_m - c.standoff_m
        forward, right, _ = state.body_velocity_m_s()
        flown = math.cos(estimate.azimuth_rad) * forward + math.sin(estimate.azimuth_rad) * right
        with_target = c.feed_forward * along
        radial = self.approach.update(error, -estimate.range_m, dt, flown - with_target) + with_target
        if c.mode is ServoMode.ORBIT:
            return radial, c.orbit_m_s + c.feed_forward * across
        if c.mode is ServoMode.PROFILE and math.hypot(along, across) > c.course_m_s:
            sight = state.yaw_rad + estimate.azimuth_rad
            off = abeam_error(math.atan2(estimate.east_m_s, estimate.north_m_s), sight)
            swing = c.abeam_per_s * estimate.range_m * off
            return radial, min(max(swing, -c.abeam_m_s), c.abeam_m_s) + c.feed_forward * across
        return radial, 0.0

    def descend(self, estimate: Estimate, state: VehicleState, dt: float) -> float:
        """Downward speed that brings the target to the picture's middle row, at the pitch now flown."""
        pitch = self.pitch_rad or 0.0
        wanted = math.tan(min(max(self.down_rad - pitch, 0.0), STEEPEST_RAD))
        too_high_m = estimate.range_m * (math.tan(min(estimate.depression_rad, STEEPEST_RAD)) - wanted)
        return -self.climb.update(-too_high_m, too_high_m, dt, -state.down_m_s)

    def above(self, estimate: Estimate, state: VehicleState, dt: float) -> Setpoint:
        """Fly so that the optical axis meets the target, heading and height kept."""
        c = self.config
        height = estimate.range_m * math.tan(min(estimate.depression_rad, math.pi / 2 - 1e-3))
        ahead = height / math.tan(max(self.down_rad - state.pitch_rad, 0.2))
        ahead_m = estimate.range_m * math.cos(estimate.azimuth_rad) - ahead
        right_m = estimate.range_m * math.sin(estimate.azimuth_rad)
        forward, right, _ = state.body_velocity_m_s()
        co, si = math.cos(state.yaw_rad), math.sin(state.yaw_rad)
        with_forward = c.feed_forward * (co * estimate.north_m_s + si * estimate.east_m_s)
        with_right = c.feed_forward * (co * estimate.east_m_s - si * estimate.north_m_s)
        return Setpoint(
            self.approach.update(ahead_m, -ahead_m, dt, forward - with_forward) + with_forward,
            self.aside.update(right_m, -right_m, dt, right - with_right) + with_right,
        )


def sight_components(estimate: Estimate, yaw_rad: float) -> tuple[float, float]:
    """The target's velocity along the line of sight (positive: away) and across it (positive: to the right)."""
    sight = yaw_rad + estimate.azimuth_rad
    c, s = math.cos(sight), math.sin(sight)
    return c * estimate.north_m_s + s * estimate.east_m_s, c * estimate.east_m_s - s * estimate.north_m_s


def abeam_error(course_rad: float, sight_rad: float) -> float:
    """Angle by which the line of sight is past the nearer right angle to the course; flying right reduces it."""
    return min((wrap(sight_rad - course_rad - side * math.pi / 2) for side in (-1, 1)), key=abs)
