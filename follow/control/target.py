"""Where the target is and how it moves: boxes and the vehicle's pose in, Estimate out, by a Kalman filter.

The filter lives on the ground: x = (north, east, v_north, v_east) of the target.  Each accepted box gives its place as
a bearing (from the box's centre and the pose at the picture's time) and a range along the ground, the latter from flat
ground and from the apparent size, each weighted with its own variance.  The true size is learnt beside it, slowly.
"""

import math
from collections import deque
from dataclasses import dataclass, field, replace

import numpy as np

from follow.control.pose_history import Pose, PoseHistory
from follow.geometry import Array, Intrinsics, bearing, camera_to_ned, direction, project, wrap
from follow.messages import NEVER, Estimate, VehicleState
from follow.ranges import require_numbers
from racf.box import Box
from racf.track import Track

FAR_M = 1e3
"""Range, and its uncertainty, of a target that was never seen."""


@dataclass(frozen=True, slots=True)
class TargetConfig:
    """Priors, measurement noise, and what counts as the target.

    Raises ValueError for a number out of its range.
    """

    size_m: float = 1.2  # Size of the target, sqrt(width x height): a person of 0.8 x 1.8 m.
    size_relative_std: float = 0.5  # Uncertainty of size_m, as a fraction of it: wide enough for a car.
    bearing_std_rad: float = 0.02  # Error of a bearing: 1 degree of a small autopilot's attitude, and two pixels.
    box_relative_std: float = 0.1  # Error of the box's size, as a fraction: a scale step of RACF is 3 %.
    speed_std_m_s: float = 3.0  # Speed of the target expected at the start: that of a runner.
    accel_psd: float = 0.5  # Spectral density of the target's acceleration, m²/s³: lower lags, higher is noisier.
    minimum_height_m: float = 1.0  # Height below which the ground gives no range.
    gate_sigmas: float = 4.0  # Largest distance of a box from the prediction, in standard deviations.
    gate_size: float = 2.0  # Largest ratio of a box's size to the expected size, or of its inverse.
    lost_after_s: float = 0.5  # A target not seen for this long must be confirmed.
    confirm: int = 3  # Number of consecutive frames that confirm a target.
    # Ratios of PSR to the target's running mean, measured on ten real sequences (docs/confidence.md):
    psr_ratio_lost: float = 0.6  # Ratio of PSR to its mean, below which a box is rejected: 3 % on target, 97 % off.
    psr_ratio_regained: float = 0.7  # The same ratio while a target must be confirmed: 5 % on target, 99 % off.
    psr_cap: float = 20.0  # Cap of the mean PSR: a PSR of 15 is the target although it was 40 before.
    psr_rate: float = 0.01  # Gain of the mean PSR for each accepted frame: it follows within about three seconds.
    settle: int = 5  # Number of frames before the mean PSR is used: the first response can be far sharper.
    steady_s: float = 6.0  # Assume constant velocity for this long after the last sighting: past a wall or some trees.
    coast_s: float = 6.0  # Time constant with which an unseen target slows down after steady_s.
    wait_s: float = 0.1  # Longest wait for the attitude at a frame's time: as old as the gate lets attitude be.
    compensate: bool = True  # Use the pose at the frame's time, and predict over the delay.

    def __post_init__(self) -> None:
        may_be_zero = (
            "lost_after_s",
            "confirm",
            "psr_ratio_lost",
            "psr_ratio_regained",
            "psr_rate",
            "settle",
            "steady_s",
            "wait_s",
        )
        require_numbers("target setting", self, may_be_zero=may_be_zero)


@dataclass(frozen=True, slots=True)
class Filter:
    """State of the filter at `t_s`: mean (4,), covariance (4, 4); the size's mean and variance, m and m²."""

    t_s: float
    mean: Array
    covariance: Array
    size_m: float
    size_var: float


@dataclass(frozen=True, slots=True)
class GroundFix:
    """What one box says: place on the ground (2,) with covariance (2, 2); its angle; the slant range by the ground."""

    ground: Array
    covariance: Array
    apparent_rad: float
    slant_m: float
    slant_std_m: float


def predicted(f: Filter, t_s: float, accel_psd: float) -> Filter:
    """The filter carried to `t_s` under white acceleration of that density, m²/s³; backward in time it stays.

    Q = q [[t³/3, t²/2], [t²/2, t]] on each axis (Bar-Shalom et al., 2001, §6.2.2), so one long step is many short ones.
    """
    dt = t_s - f.t_s
    if dt <= 0:
        return f
    step = np.eye(4)
    step[0, 2] = step[1, 3] = dt
    noise = accel_psd * np.kron([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]], np.eye(2))
    return Filter(t_s, step @ f.mean, step @ f.covariance @ step.T + noise, f.size_m, f.size_var)


def corrected(f: Filter, place: Array, place_covariance: Array) -> Filter:
    """The filter after a measured place (2,) with its covariance (2, 2): Kalman's update in Joseph's form."""
    observe = np.eye(2, 4)
    gain = np.linalg.solve(f.covariance[:2, :2] + place_covariance, observe @ f.covariance).T
    keep = np.eye(4) - gain @ observe
    covariance = keep @ f.covariance @ keep.T + gain @ place_covariance @ gain.T
    return Filter(f.t_s, f.mean + gain @ (place - f.mean[:2]), covariance, f.size_m, f.size_var)


def resized(f: Filter, place: GroundFix, box_relative_std: float) -> Filter:
    """The filter after flat ground's word on the true size (a scalar Kalman update); the ground may be silent."""
    if not math.isfinite(place.slant_std_m):
        return f
    measured = place.slant_m * place.apparent_rad
    variance = measured**2 * ((place.slant_std_m / place.slant_m) ** 2 + box_relative_std**2)
    gain = f.size_var / (f.size_var + variance)
    # An aspect change is a new size: 1 % a picture keeps the filter awake.
    size_var = (1 - gain) * f.size_var + (0.01 * f.size_m) ** 2
    return replace(f, size_m=f.size_m + gain * (measured - f.size_m), size_var=size_var)


def ground_slant(depression_rad: float, box_height_rad: float, height_m: float, c: TargetConfig) -> tuple[float, float]:
    """Slant range to the centre of a box whose lower edge stands on flat ground, and its standard deviation.

    The centre lies half the target's height, slant·box_height·cos(e)/2, above the ground; so from h - that =
    slant·sin(e) follows slant = h / (sin e + box_height·cos(e)/2).  Its error is d slant/de = slant/tan(e).  Both are
    inf when the ray is too flat or the vehicle too low to tell.
    """
    if depression_rad < 3 * c.bearing_std_rad or height_m < c.minimum_height_m:
        return math.inf, math.inf
    slant = height_m / (math.sin(depression_rad) + box_height_rad * max(math.cos(depression_rad), 0.0) / 2)
    # Straight down the angle says nothing of the length, but the height's own error (a tenth of a metre) remains.
    return slant, slant * max(c.bearing_std_rad / abs(math.tan(depression_rad)), 0.1 / height_m)


def half_height(size_m: float, box: Box) -> float:
    """Half the target's true height: size is sqrt(w h), so h/2 = size sqrt(h/w)/2."""
    return size_m * math.sqrt(box.h / box.w) / 2


@dataclass(slots=True)
class Target:
    """The estimate, fed once a round; `camera` looks `down_rad` below the vehicle's nose."""

    camera: Intrinsics
    down_rad: float
    config: TargetConfig = field(default_factory=TargetConfig)
    motion: PoseHistory = field(default_factory=PoseHistory)
    filter: Filter | None = None
    box: Box | None = None
    seen_t_s: float = NEVER
    proofs: int = 0
    accepted: int = 0
    usual_psr: float = 0.0
    on_trial: bool = False
    waiting: deque[tuple[float, Track]] = field(default_factory=lambda: deque[tuple[float, Track]](maxlen=16))

    def forget(self) -> None:
        """Forget the target; the next box starts a new one."""
        self.filter, self.box, self.seen_t_s, self.on_trial = None, None, NEVER, False
        self.proofs, self.accepted, self.usual_psr = 0, 0, 0.0
        self.waiting.clear()

    def predict(self, state: VehicleState, t_s: float) -> Box | None:
        """Return the box where the target should appear in the frame of `t_s`; None: search around the last one.

        None also while a found target is not yet confirmed: the tracker must stay on it.
        """
        self.motion.add(state)
        if self.filter is None or self.box is None or self.on_trial:
            return None
        pose = self.pose(state, t_s)
        f = self.carried(t_s)
        place = np.array([[f.mean[0], f.mean[1], -half_height(f.size_m, self.box)]])
        pixels, depth = project(self.camera, self.rotation(pose), (pose.north_m, pose.east_m, pose.down_m), place)
        if depth[0] <= self.config.minimum_height_m:
            return None
        scale = f.size_m * self.camera.fx / depth[0] / math.sqrt(self.box.area)
        return Box.around(float(pixels[0, 0]), float(pixels[0, 1]), self.box.w * scale, self.box.h * scale)

    def update(self, track: Track | None, state: VehicleState, t_s: float) -> Estimate:
        """Take in the track of the frame of `t_s` (None: no new frame); the estimate is for `state.t_s`."""
        self.motion.add(state)
        if track is not None:
            self.waiting.append((t_s, track))
        while self.waiting and self.readable(self.waiting[0][0], state):
            t_s, track = self.waiting.popleft()
            if not (track.found and self.accept(track, t_s, self.pose(state, t_s))):
                self.proofs = 0
            self.on_trial = self.proofs > 0
        return self.estimate(state)

    def readable(self, t_s: float, state: VehicleState) -> bool:
        """Whether the attitude at a frame's time is known, or `wait_s` has passed.

        Telemetry is some hundredths of a second late.  An extrapolated attitude of a tilting vehicle makes the range
        swing, and the servo with it; waiting costs nothing, because the estimate is predicted meanwhile.
        """
        late_s = state.t_s - t_s
        known = not self.config.compensate or state.attitude_t_s >= t_s
        return known or not 0 <= late_s < self.config.wait_s or state.attitude_t_s == NEVER

    def accept(self, track: Track, t_s: float, pose: Pose) -> bool:
        """Whether the box is where and as large as the target should be; if so it corrects the filter.

        After a loss it does so only once it was right, and sharp, `confirm` times in a row.
        """
        c, box = self.config, track.box
        if self.filter is None:
            size_var = (c.size_relative_std * c.size_m) ** 2
            place = self.place(box, pose, c.size_m, size_var)
            wide = np.zeros((4, 4))
            wide[:2, :2] = place.covariance
            # A vehicle that starts in flight already flies along with the target.
            wide[2:, 2:] = np.eye(2) * c.speed_std_m_s**2
            mean = np.append(place.ground, [pose.north_m_s, pose.east_m_s])
            self.filter = Filter(t_s, mean, wide, c.size_m, size_var)
        else:
            f = self.carried(t_s)
            place = self.place(box, pose, f.size_m, f.size_var)
            if not self.plausible(f, place, box, pose):
                return False
            lost = t_s - self.seen_t_s > c.lost_after_s
            settling = self.accepted < c.settle and not lost
            asked = (c.psr_ratio_regained if lost else c.psr_ratio_lost) * min(self.usual_psr, c.psr_cap)
            if not settling and track.psr < asked:
                return False
            if lost:
                self.proofs += 1
                if self.proofs < c.confirm:
                    return True
            self.filter = corrected(f, place.ground, place.covariance)
        self.filter = resized(self.filter, place, c.box_relative_std)
        if track.psr > 0:  # the box that was given at the start has no response
            self.accepted += 1
            self.usual_psr += max(c.psr_rate, 1.0 / self.accepted) * (track.psr - self.usual_psr)
        self.box, self.seen_t_s, self.proofs = box, t_s, 0
        return True

    def plausible(self, f: Filter, place: GroundFix, box: Box, pose: Pose) -> bool:
        """Whether a box lies within the gate about the prediction, in place (Mahalanobis) and in size."""
        off = place.ground - f.mean[:2]
        spread = f.covariance[:2, :2] + place.covariance
        if float(off @ np.linalg.solve(spread, off)) > self.config.gate_sigmas**2:
            return False
        height = -pose.down_m
        slant = math.hypot(f.mean[0] - pose.north_m, f.mean[1] - pose.east_m, height)
        expected_rad = f.size_m / max(slant, 0.1)
        ratio = place.apparent_rad / expected_rad
        return 1 / self.config.gate_size < ratio < self.config.gate_size

    def pose(self, state: VehicleState, t_s: float) -> Pose:
        """Return the vehicle's pose for the frame of `t_s`."""
        return self.motion.at(t_s if self.config.compensate else state.t_s)

    def rotation(self, pose: Pose) -> Array:
        """Camera axes to NED at a pose."""
        return camera_to_ned(self.down_rad, pose.roll_rad, pose.pitch_rad, pose.yaw_rad)

    def carried(self, t_s: float) -> Filter:
        """Return the filter at `t_s`; a target unseen for longer than `steady_s` slows down."""
        assert self.filter is not None
        c = self.config
        f = predicted(self.filter, t_s, c.accel_psd)
        unseen = f.t_s - self.filter.t_s - c.steady_s
        if unseen <= 0:
            return f
        slowed = c.coast_s * (1 - math.exp(-unseen / c.coast_s))
        mean = f.mean.copy()
        mean[:2] -= mean[2:] * (unseen - slowed)
        mean[2:] *= math.exp(-unseen / c.coast_s)
        return replace(f, mean=mean)

    def place(self, box: Box, pose: Pose, size_m: float, size_var: float) -> GroundFix:
        """Where on the ground a box of a target of that size is, seen from `pose`."""
        c = self.config
        azimuth, depression = bearing(self.camera, self.rotation(pose), box.centre_x, box.centre_y)
        level = max(math.cos(depression), 0.05)
        apparent_rad = math.sqrt(box.area) / self.camera.fx
        by_size = size_m / apparent_rad
        by_size_std = by_size * math.hypot(math.sqrt(size_var) / size_m, c.box_relative_std)
        slant, slant_std = ground_slant(depression, box.h / self.camera.fy, -pose.down_m, c)
        weight = by_size_std**2 / (by_size_std**2 + slant_std**2) if math.isfinite(slant_std) else 0.0
        range_m = (weight * slant + (1 - weight) * by_size if weight else by_size) * level
        range_std = (math.sqrt(weight) * slant_std if weight else by_size_std) * level
        # The slant's direction errs, too: along the ground that is the height times the angle's error.
        range_std += abs(pose.down_m) * c.bearing_std_rad
        toward = direction(azimuth, 0.0)[:2]
        across = np.array([-toward[1], toward[0]])
        across_std = math.hypot(range_m, pose.down_m) * c.bearing_std_rad
        spread = np.outer(toward, toward) * range_std**2 + np.outer(across, across) * across_std**2
        ground = np.array([pose.north_m, pose.east_m]) + range_m * toward
        return GroundFix(ground, spread, apparent_rad, slant, slant_std)

    def estimate(self, state: VehicleState) -> Estimate:
        """The filter's answer for `state.t_s`, seen from where the vehicle is."""
        if self.filter is None or self.box is None:
            return Estimate(state.t_s, 0.0, self.down_rad - state.pitch_rad, FAR_M, FAR_M)
        pose = self.motion.at(state.t_s)
        f = self.carried(state.t_s) if self.config.compensate else self.filter
        north, east = f.mean[0] - pose.north_m, f.mean[1] - pose.east_m
        range_m = max(math.hypot(north, east), 0.1)
        toward = np.array([north, east]) / range_m
        azimuth = wrap(math.atan2(east, north) - pose.yaw_rad)
        depression = math.atan2(-pose.down_m - half_height(f.size_m, self.box), range_m)
        range_std = math.sqrt(max(float(toward @ f.covariance[:2, :2] @ toward), 0.0))
        speed = float(f.mean[2]), float(f.mean[3])
        return Estimate(state.t_s, azimuth, depression, range_m, range_std, *speed, self.seen_t_s)
