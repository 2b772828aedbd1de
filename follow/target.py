"""Where the target is and how it moves: boxes and the vehicle's pose in, Estimate out, by a Kalman filter.

The filter lives on the ground: x = (north, east, v_north, v_east) of the target.  Each accepted box gives its place as
a bearing (from the box's centre and the pose at the picture's time) and a range along the ground, the latter from flat
ground and from the apparent size, each weighted with its own variance.  The true size is learnt beside it, slowly.
"""

import math
from dataclasses import dataclass, field

import numpy as np

from follow.geometry import Array, Intrinsics, bearing, camera_to_ned, direction, project, wrap
from follow.messages import NEVER, Estimate, VehicleState
from follow.motion import Motion, Pose
from racf.box import Box
from racf.track import Track


@dataclass(frozen=True, slots=True)
class TargetConfig:
    """What the estimate knows beforehand."""

    size_m: float = 1.2  # sqrt(width x height) of what is followed: a person of 0.8 x 1.8 m
    size_relative_std: float = 0.5  # ... which may as well be a car: the ground's range soon corrects it
    bearing_std_rad: float = 0.02  # 1 degree: attitude error of a small autopilot, plus two pixels of the tracker's
    box_relative_std: float = 0.1  # apparent size: RACF's scale steps are 3 %, aspect changes more
    accel_std_m_s2: float = 2.0  # a runner's start and turn
    minimum_height_m: float = 1.0  # below it flat ground says nothing of range
    compensate: bool = True  # use the pose at the picture's time and predict over the delay
    lead_s: float = 0.0  # predict this much further, for a vehicle's dead time


@dataclass(frozen=True, slots=True)
class Filter:
    """State of the filter at `t_s`: mean (4,), covariance (4, 4); the size's mean and variance, m and m²."""

    t_s: float
    mean: Array
    covariance: Array
    size_m: float
    size_var: float


def predicted(f: Filter, t_s: float, accel_std_m_s2: float) -> Filter:
    """The filter carried to `t_s` under white acceleration (Bar-Shalom, 2001, §6.2); backward in time it stays."""
    dt = t_s - f.t_s
    if dt <= 0:
        return f
    step = np.eye(4)
    step[0, 2] = step[1, 3] = dt
    push = np.array([[dt * dt / 2, 0], [0, dt * dt / 2], [dt, 0], [0, dt]])
    noise = push @ push.T * accel_std_m_s2**2
    return Filter(t_s, step @ f.mean, step @ f.covariance @ step.T + noise, f.size_m, f.size_var)


def corrected(f: Filter, place: Array, place_covariance: Array) -> Filter:
    """The filter after a measured place (2,) with its covariance (2, 2): Kalman's update in Joseph's form."""
    observe = np.eye(2, 4)
    gain = np.linalg.solve(f.covariance[:2, :2] + place_covariance, observe @ f.covariance).T
    keep = np.eye(4) - gain @ observe
    covariance = keep @ f.covariance @ keep.T + gain @ place_covariance @ gain.T
    return Filter(f.t_s, f.mean + gain @ (place - f.mean[:2]), covariance, f.size_m, f.size_var)


@dataclass(slots=True)
class Target:
    """The estimate, fed once a round; `camera` looks `down_rad` below the vehicle's nose."""

    camera: Intrinsics
    down_rad: float
    config: TargetConfig = field(default_factory=TargetConfig)
    motion: Motion = field(default_factory=Motion)
    filter: Filter | None = None
    box: Box | None = None
    seen_t_s: float = NEVER

    def predict(self, state: VehicleState, t_s: float) -> Box | None:
        """Where in the picture of `t_s` the target should appear, or None for where it last did."""
        self.motion.add(state)
        if self.filter is None or self.box is None:
            return None
        pose = self.pose(state, t_s)
        f = predicted(self.filter, t_s, self.config.accel_std_m_s2)
        height = max(-pose.down_m - f.size_m / 2, 0.0)
        place = np.array([[f.mean[0], f.mean[1], pose.down_m + height]])
        pixels, depth = project(self.camera, self.rotation(pose), (pose.north_m, pose.east_m, pose.down_m), place)
        if depth[0] <= self.config.minimum_height_m:
            return None
        scale = f.size_m * self.camera.fx / depth[0] / math.sqrt(self.box.area)
        return Box.around(float(pixels[0, 0]), float(pixels[0, 1]), self.box.w * scale, self.box.h * scale)

    def update(self, track: Track | None, state: VehicleState, t_s: float) -> Estimate:
        """Take in the track of the picture of `t_s` (None: no new picture); the answer is for `state.t_s`."""
        self.motion.add(state)
        if track is not None and track.found:
            self.take(track.box, self.pose(state, t_s), t_s)
        return self.estimate(state)

    def pose(self, state: VehicleState, t_s: float) -> Pose:
        """The pose to read a picture of `t_s` with."""
        return self.motion.at(t_s if self.config.compensate else state.t_s)

    def rotation(self, pose: Pose) -> Array:
        """Camera axes to NED at a pose."""
        return camera_to_ned(self.down_rad, pose.roll_rad, pose.pitch_rad, pose.yaw_rad)

    def take(self, box: Box, pose: Pose, t_s: float) -> None:
        """Correct place and size with one box seen from `pose`."""
        c = self.config
        size_m = self.filter.size_m if self.filter else c.size_m
        size_var = self.filter.size_var if self.filter else (c.size_relative_std * c.size_m) ** 2
        azimuth, depression = bearing(self.camera, self.rotation(pose), box.centre_x, box.centre_y)
        apparent_rad = math.sqrt(box.area) / self.camera.fx
        by_size = size_m / apparent_rad * math.cos(depression)
        by_size_std = by_size * math.hypot(math.sqrt(size_var) / size_m, c.box_relative_std)
        height = -pose.down_m - size_m / 2
        ground, ground_std = ground_range(depression, height, c)
        weight = by_size_std**2 / (by_size_std**2 + ground_std**2) if math.isfinite(ground_std) else 0.0
        range_m = weight * ground + (1 - weight) * by_size
        range_std = math.sqrt(weight) * ground_std if weight else by_size_std
        toward = direction(azimuth, 0.0)[:2]
        across = np.array([-toward[1], toward[0]])
        spread = np.outer(toward, toward) * range_std**2 + np.outer(across, across) * (range_m * c.bearing_std_rad) ** 2
        place = np.array([pose.north_m, pose.east_m]) + range_m * toward
        if self.filter is None:
            wide = np.zeros((4, 4))
            wide[:2, :2] = spread
            wide[2:, 2:] = np.eye(2) * 3.0**2  # m/s: a runner either way
            self.filter = Filter(t_s, np.append(place, [0.0, 0.0]), wide, size_m, size_var)
        else:
            self.filter = corrected(predicted(self.filter, t_s, c.accel_std_m_s2), place, spread)
        self.learn_size(apparent_rad, ground / math.cos(depression), ground_std)
        self.box, self.seen_t_s = box, t_s

    def learn_size(self, apparent_rad: float, slant_m: float, ground_std_m: float) -> None:
        """Correct the true size by what flat ground says of it (a scalar Kalman update); the ground may be silent."""
        f = self.filter
        if f is None or not math.isfinite(ground_std_m):
            return
        measured = slant_m * apparent_rad
        variance = measured**2 * ((ground_std_m / slant_m) ** 2 + self.config.box_relative_std**2)
        gain = f.size_var / (f.size_var + variance)
        # An aspect change is a new size: 1 % a picture keeps the filter awake.
        size_var = (1 - gain) * f.size_var + (0.01 * f.size_m) ** 2
        self.filter = Filter(f.t_s, f.mean, f.covariance, f.size_m + gain * (measured - f.size_m), size_var)

    def estimate(self, state: VehicleState) -> Estimate:
        """The filter's answer for `state.t_s`, seen from where the vehicle is."""
        ahead = self.down_rad - state.pitch_rad
        if self.filter is None:
            return Estimate(state.t_s, 0.0, ahead, 1e3, 1e3)
        c = self.config
        pose = self.motion.at(state.t_s)
        f = predicted(self.filter, state.t_s + c.lead_s, c.accel_std_m_s2) if c.compensate else self.filter
        north, east = f.mean[0] - pose.north_m, f.mean[1] - pose.east_m
        range_m = max(math.hypot(north, east), 0.1)
        toward = np.array([north, east]) / range_m
        azimuth = wrap(math.atan2(east, north) - pose.yaw_rad)
        depression = math.atan2(-pose.down_m - f.size_m / 2, range_m)
        range_std = math.sqrt(max(float(toward @ f.covariance[:2, :2] @ toward), 0.0))
        return Estimate(
            state.t_s, azimuth, depression, range_m, range_std, float(f.mean[2]), float(f.mean[3]), self.seen_t_s
        )


def ground_range(depression_rad: float, height_m: float, config: TargetConfig) -> tuple[float, float]:
    """Range along flat ground at that depression and its standard deviation, d(h/tan e)/de = (h² + r²)/h; else inf."""
    if depression_rad < 3 * config.bearing_std_rad or height_m < config.minimum_height_m:
        return math.inf, math.inf
    range_m = height_m / math.tan(depression_rad) if depression_rad < math.pi / 2 else 0.0
    return range_m, (height_m**2 + range_m**2) / height_m * config.bearing_std_rad
