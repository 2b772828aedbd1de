"""Where the target is and how it moves: boxes and the vehicle's pose in, Estimate out.

`joint_filter` holds the equations, `ground` the measurements of the ground's height.  This module turns a box into a
measurement and accepts or rejects it.
"""

import math
from collections import deque
from dataclasses import dataclass, field, replace

import numpy as np

from follow.control.candidates import Candidates
from follow.control.ground import GroundSources, GroundTrust, Parallax
from follow.control.image_motion import within
from follow.control.joint_filter import (
    JointFilter,
    Motion,
    Sight,
    corrected,
    innovation,
    moved,
    predicted,
    started,
)
from follow.control.pose_history import Pose, PoseHistory
from follow.control.regain import Candidate, PathDistance, Regain, distance_to_segment, next_look
from follow.control.seen_from import seen_from
from follow.control.turning import Turning, turned_on
from follow.geometry import Array, Intrinsics, camera_to_ned, project, rays, undistort
from follow.messages import NEVER, Estimate, ImageMotion, VehicleState
from follow.ranges import require_numbers
from follow.selection import Detections
from racf.box import Box
from racf.track import Track

CUT = 5.0
"""Factor on the noise of a box that reaches out of the image: only a part of the target is visible."""

FAR_M = 1e3
"""Range, and its uncertainty, of a target that was never seen."""


@dataclass(frozen=True, slots=True)
class TargetConfig:
    """Priors, measurement noise, and what counts as the target.

    Raises ValueError for a number out of its range.
    """

    size_m: float = 1.2  # Size of the target, sqrt(width x height): a person of 0.8 x 1.8 m.
    size_relative_std: float = 0.3  # Uncertainty of size_m, as a fraction of it: a car (2.5 m) needs its own size_m.
    middle_fraction: float = 0.5  # Height of the box's middle over the ground, as a fraction of the box's: a car 0.15.
    bearing_std_rad: float = 0.007  # White error of a bearing: one to two pixels at 80 degrees in 640 columns.
    box_relative_std: float = 0.06  # White error of the box's height, as a fraction: steps of 3 %, and gait.
    pitching_std_s: float = 0.05  # Error of a vertical bearing per pitch rate: covers image times wrong by some 20 ms.
    speed_std_m_s: float = 3.0  # Speed of the target expected at the start: that of a runner.
    motion: Motion = field(default_factory=Motion)
    ground: GroundTrust = field(default_factory=GroundTrust)
    near_sigmas: float = 2.0  # Standard deviations between the range and the nearest plausible one: 97.7 % lie farther.
    jump_m: float = 1.5  # Least jump of the position, beyond what the velocity explains, that is an estimator reset.
    gate_noise: float = 2.5  # The gate on boxes expects errors this many times larger: keeps a target that sets off.
    gate_sigmas: float = 4.0  # Largest distance of a box from the prediction, in standard deviations.
    gate_size: float = 2.0  # Largest ratio of a box's size to the expected size, or of its inverse.
    lost_after_s: float = 0.5  # A target not seen for this long must be confirmed.
    confirm: int = 3  # Number of consecutive frames that confirm a target.
    confirm_fraction: float = 0.05  # Confirmation must also last this fraction of the time unseen before it.
    regain_sigmas: float = 3.0  # Largest distance of a candidate from the lost target's path, in standard deviations.
    regain_area_m2: float = 100.0  # Largest area of likelier places: 10 % risk at one person in 400 m², 40 % alike.
    # Ratios of PSR to the target's running mean, measured on ten real sequences (docs/confidence.md):
    psr_ratio_lost: float = 0.6  # Boxes below this ratio of PSR to its mean are rejected: 3 % on target, 97 % off it.
    psr_ratio_regained: float = 0.7  # The same while a target must be confirmed; rejects 5 % on target, 99 % off it.
    psr_cap: float = 20.0  # Cap of the mean PSR: after a mean of 40 a PSR of 15 is still accepted.
    psr_rate: float = 0.01  # Gain of the running mean of PSR per accepted frame: a time constant of about 3 s.
    settle: int = 5  # Number of frames before the mean PSR is used: the first response can be far sharper.
    steady_s: float = 6.0  # Assume constant velocity for this long after the last sighting: time to pass some trees.
    coast_s: float = 6.0  # Time constant with which an unseen target slows down after steady_s.
    wait_s: float = 0.1  # Longest wait for the attitude at a frame's time: as old as the gate accepts attitude.
    compensate: bool = True  # Use the pose at the frame's time, and predict over the delay.

    def __post_init__(self) -> None:
        may_be_zero = (
            "pitching_std_s",
            "lost_after_s",
            "confirm",
            "confirm_fraction",
            "psr_ratio_lost",
            "psr_ratio_regained",
            "psr_rate",
            "settle",
            "steady_s",
            "wait_s",
        )
        require_numbers("target setting", self, may_be_zero=may_be_zero)

    @property
    def noise(self) -> Array:
        """(3,) standard deviations of a box's white errors: right, down (radians) and ln size."""
        return np.array([self.bearing_std_rad, self.bearing_std_rad, self.box_relative_std])


@dataclass(slots=True)
class Target:
    """The estimate, fed once a round; `camera` looks `down_rad` below the vehicle's nose."""

    camera: Intrinsics
    down_rad: float
    config: TargetConfig = field(default_factory=TargetConfig)
    motion: PoseHistory = field(default_factory=PoseHistory)
    filter: JointFilter | None = None
    box: Box | None = None
    aspect: float = 1.0  # height over width of the first box, the lens undone
    seen_t_s: float = NEVER
    seen_ned: Array = field(default_factory=lambda: np.zeros(3))
    regain: Regain = field(default_factory=Regain)
    accepted: int = 0
    usual_psr: float = 0.0
    asked_t_s: float = NEVER
    looks: int = 0
    candidates: Candidates = field(default_factory=Candidates)
    turning: Turning = field(default_factory=Turning)
    sources: GroundSources = field(default_factory=GroundSources)
    waiting: deque[tuple[float, Track]] = field(default_factory=lambda: deque[tuple[float, Track]](maxlen=16))

    @property
    def middle(self) -> float:
        """Height of the box's middle over the target's ground, in sizes."""
        return self.config.middle_fraction * math.sqrt(self.aspect)

    def forget(self) -> None:
        """Forget the target; the next box starts a new one."""
        self.filter, self.box, self.seen_t_s, self.asked_t_s = None, None, NEVER, NEVER
        self.sources, self.candidates, self.turning = GroundSources(), Candidates(), Turning()
        self.regain, self.accepted, self.usual_psr = Regain(), 0, 0.0
        self.waiting.clear()

    def predict(self, state: VehicleState, t_s: float, found: Detections | None = None) -> Box | None:
        """Return the box where the target should appear in the frame of `t_s`; None: search around the last one.

        Also None while a candidate awaits confirmation, so that the tracker stays on it.  For a lost target every
        second frame searches the predicted position; the others search what a detector `found`, or around it.
        """
        self.observe(state)
        if self.filter is None or self.box is None or self.regain.frames > 0:
            return None
        pose = self.pose(state, t_s)
        f = self.carried(t_s)
        place = f.mean[:3]
        if t_s - self.seen_t_s > self.config.lost_after_s:
            if any(track.found and self.sharp(track, lost=True) for _, track in self.waiting):
                return None  # a candidate still waits for the attitude at its frame's time
            self.looks, place = next_look(f, self.seen_ned, self.looks, lambda place: self.in_image(place, pose))
            if self.looks % 2 == 1 and found is not None and found.t_s > self.seen_t_s:
                then = self.pose(state, found.t_s)
                candidate = self.candidates.next(found, lambda box: self.sight(box, then), then, f, self.seen_ned)
                place = place if candidate is None else candidate
        pixels, depth = project(self.camera, self.rotation(pose), pose.position_ned, place[None, :])
        if depth[0] <= 1.0:
            return None
        height = math.exp(f.mean[7] + f.mean[10]) * math.sqrt(self.aspect) * self.camera.fy / depth[0]
        scale = height / self.box.h
        return Box.around(float(pixels[0, 0]), float(pixels[0, 1]), self.box.w * scale, self.box.h * scale)

    def in_image(self, place: Array, pose: Pose) -> bool:
        """Whether a position (3,), NED, lies in the image taken at a pose."""
        pixels, depth = project(self.camera, self.rotation(pose), pose.position_ned, place[None, :])
        x, y = pixels[0]
        return bool(depth[0] > 1.0 and 0 <= x < self.camera.width and 0 <= y < self.camera.height)

    def update(
        self, track: Track | None, state: VehicleState, t_s: float, motion: ImageMotion | None = None
    ) -> Estimate:
        """Take in the track of the frame of `t_s` (None: no new frame); the estimate is for `state.t_s`.

        `motion` is the newest measurement of the background: its parallax measures the ground's height.
        """
        self.observe(state)
        if motion is not None and math.isfinite(motion.height_std_m):
            down_m = self.motion.at(motion.from_t_s).down_m + motion.height_m
            self.sources.parallax.append(Parallax(motion.t_s, down_m, motion.height_std_m, motion.height_shared_std_m))
        if track is not None:
            self.waiting.append((t_s, track))
        while self.waiting and self.readable(self.waiting[0][0], state):
            t_s, track = self.waiting.popleft()
            if track.restarted:  # the first box was not the target's
                self.forget()
            if not (track.found and self.accept(track, t_s, self.pose(state, t_s))):
                self.regain.miss()
            self.ask_ground(state, t_s)
        return self.estimate(state)

    def observe(self, state: VehicleState) -> None:
        """Take in the vehicle's state; when its position estimate jumps, the target and the history jump with it."""
        jump = self.motion.jump(state, self.config.jump_m)
        if jump is not None:
            self.motion.shift(jump)
            self.sources.reset()
            self.seen_ned = self.seen_ned + jump
            self.regain.shift(jump)
            if self.filter is not None:
                self.filter = moved(self.filter, jump)
        self.motion.add(state)

    def readable(self, t_s: float, state: VehicleState) -> bool:
        """Whether the attitude at a frame's time is known, or `wait_s` has passed.

        Telemetry arrives some hundredths of a second late.  Extrapolating the attitude of a tilting vehicle makes the
        range oscillate, and the servo with it; waiting costs nothing, because the estimate is predicted meanwhile.
        """
        late_s = state.t_s - t_s
        known = not self.config.compensate or state.attitude_t_s >= t_s
        return known or not 0 <= late_s < self.config.wait_s or state.attitude_t_s == NEVER

    def accept(self, track: Track, t_s: float, pose: Pose) -> bool:
        """Whether the box has a plausible position and size for the target; if so it corrects the filter.

        After a loss it corrects the filter only after enough consecutive plausible boxes with a sharp response.
        """
        c, box = self.config, track.box
        if self.filter is None:
            self.aspect = self.ideal_height(box) / self.ideal_width(box)
        sight = self.sight(box, pose)
        if self.filter is None:
            self.filter = self.start(sight, t_s, pose)
        else:
            f = self.carried(t_s)
            lost = t_s - self.seen_t_s > c.lost_after_s
            if not self.sharp(track, lost=lost):
                return False
            if not (self.is_admitted(f, sight, pose) if lost else self.plausible(f, sight, pose, self.noise(box))):
                return False
            if lost and not self.regain.confirmed(t_s, self.seen_t_s, c.confirm, c.confirm_fraction):
                return True
            if not self.plausible(f, sight, pose, self.noise(box)):
                f = self.start(sight, t_s, pose, f)
            self.filter = corrected(
                f, pose.position_ned, sight, self.noise(box, track.psr, self.motion.pitch_rate(t_s))
            )
        if track.psr > 0:  # the first box, which a person drew, has no response
            self.accepted += 1
            self.usual_psr += max(c.psr_rate, 1.0 / self.accepted) * (track.psr - self.usual_psr)
        assert self.filter is not None
        self.box, self.seen_t_s, self.regain = box, t_s, Regain()
        self.seen_ned = self.filter.mean[:3].copy()
        self.turning.add(self.filter)
        return True

    def noise(self, box: Box, psr: float = math.inf, pitch_rate_rad_s: float = 0.0) -> Array:
        """(3,) standard deviations of a box's white errors.

        They grow for a box that the image's border cuts, and for one whose response is less sharp than usual: as an
        occlusion begins, the box drifts onto the occluder.  While the vehicle pitches, the vertical bearing's
        error grows with the pitch rate: an image with a wrong time shifts the target up or down, and without this the
        servo would follow that apparent motion and pitch the vehicle again.
        """
        cut = 1.0 if within(box, self.camera) else CUT
        white = self.config.noise * max(cut, self.usual_psr / psr if psr > 0 else 1.0)
        white[1] = math.hypot(white[1], self.config.pitching_std_s * pitch_rate_rad_s)
        return white

    def start(self, sight: Sight, t_s: float, pose: Pose, before: JointFilter | None = None) -> JointFilter:
        """Start the filter: range by the size's prior, or after a loss by the size learnt `before`.

        A new target starts with the vehicle's velocity, because a pilot in flight usually accompanies it already.
        """
        c = self.config
        velocity = np.array([pose.north_m_s, pose.east_m_s]) if before is None else before.mean[3:5]
        size_m, size_std = (c.size_m, c.size_relative_std) if before is None else (before.size_m, before.size_var**0.5)
        return started(t_s, pose.position_ned, sight, velocity, c.speed_std_m_s, size_m, size_std, c.noise, c.motion)

    def ask_ground(self, state: VehicleState, t_s: float) -> None:
        """Let the sources of the ground's height correct the size, every `ground.every_s` while the target is seen."""
        if self.filter is None or self.seen_t_s != t_s or t_s - self.asked_t_s < self.config.ground.every_s:
            return
        self.asked_t_s = t_s
        pose = self.pose(state, t_s)
        c = self.config
        self.filter = self.sources.correct(
            self.filter, pose, state, (c.size_m, c.size_relative_std, self.middle), c.ground
        )

    def sharp(self, track: Track, *, lost: bool) -> bool:
        """Whether the response is sharp enough against the target's running mean."""
        c = self.config
        if self.accepted < c.settle and not lost:
            return True
        least = c.psr_ratio_regained if lost else c.psr_ratio_lost
        return track.psr >= least * min(self.usual_psr, c.psr_cap)

    def plausible(self, f: JointFilter, sight: Sight, pose: Pose, noise: Array) -> bool:
        """Whether a box passes the outlier gate around the prediction, in direction and in size."""
        c = self.config
        found = innovation(f, pose.position_ned, sight, c.gate_noise * noise)
        return abs(found.residual[2]) <= math.log(c.gate_size) and found.distance2 <= c.gate_sigmas**2

    def is_admitted(self, f: JointFilter, sight: Sight, pose: Pose) -> bool:
        """Whether a box after a loss may be the lost target, whether it moved on or stopped.

        Direction and size give the box a position; it must lie near the path from the last seen position to the
        predicted one, at a height that the ground there can have.
        """
        c, m = self.config, self.config.motion
        range_m = math.exp(min(f.mean[7] + f.mean[10] - sight.size_log, math.log(FAR_M)))
        place = pose.position_ned + range_m * sight.toward
        own_m = range_m * math.hypot(m.size_bias_std, c.box_relative_std)
        variance = float(np.linalg.eigvalsh(f.covariance[:2, :2])[-1])
        aside_m = distance_to_segment(place[:2], self.seen_ned[:2], f.mean[:2])
        gone_m = float(np.linalg.norm(place[:2] - self.seen_ned[:2]))
        rise_std_m = math.hypot(m.slope_std * gone_m, own_m, c.ground.start_std_m)
        near = aside_m <= c.regain_sigmas * math.sqrt(variance + own_m**2)
        level = bool(abs(place[2] - self.seen_ned[2]) <= c.regain_sigmas * rise_std_m)
        path_m = float(np.linalg.norm(f.mean[:2] - self.seen_ned[:2]))
        distance = PathDistance(max(aside_m - own_m, 0.0), path_m, near and level, f.t_s - self.seen_t_s, level)
        candidate = Candidate(f.t_s, place[:2], own_m, float(place[2]))
        return self.regain.admits(candidate, distance, c.regain_area_m2, c.confirm)

    def sight(self, box: Box, pose: Pose) -> Sight:
        """A box as a measurement: the lens undone, in NED."""
        ray = rays(self.camera, [(box.centre_x, box.centre_y)])[0]
        size = self.ideal_height(box) / math.sqrt(self.aspect)
        # On the plane at unit depth; a distance R along the ray has the depth R ray_z.
        return Sight(self.rotation(pose) @ ray, math.log(size * ray[2]))

    def ideal_height(self, box: Box) -> float:
        """A box's height on the plane at unit depth, the lens undone."""
        x = box.centre_x
        return max(float(np.diff(self.ideal([(x, box.y), (x, box.y + box.h)])[:, 1])[0]), 1e-6)

    def ideal_width(self, box: Box) -> float:
        """A box's width on the plane at unit depth, the lens undone."""
        y = box.centre_y
        return max(float(np.diff(self.ideal([(box.x, y), (box.x + box.w, y)])[:, 0])[0]), 1e-6)

    def ideal(self, pixels: list[tuple[float, float]]) -> Array:
        """(N, 2) pixels as points on the plane at unit depth, the lens undone."""
        camera = self.camera
        return undistort(camera, (np.array(pixels) - (camera.cx, camera.cy)) / (camera.fx, camera.fy))

    def pose(self, state: VehicleState, t_s: float) -> Pose:
        """Return the vehicle's pose for the frame of `t_s`."""
        return self.motion.at(t_s if self.config.compensate else state.t_s)

    def rotation(self, pose: Pose) -> Array:
        """Camera axes to NED at a pose."""
        return camera_to_ned(self.down_rad, pose.roll_rad, pose.pitch_rad, pose.yaw_rad)

    def carried(self, t_s: float) -> JointFilter:
        """Return the filter at `t_s`; a target unseen for longer than `steady_s` slows down."""
        assert self.filter is not None
        c = self.config
        unknown = t_s - self.filter.t_s > c.lost_after_s  # full process noise: an unseen target may manoeuvre
        f = predicted(replace(self.filter, stir=1.0) if unknown else self.filter, t_s, c.motion)
        if unknown:
            f = turned_on(f, f.t_s - self.filter.t_s, self.turning.bend())
        unseen = f.t_s - self.filter.t_s - c.steady_s
        if unseen <= 0:
            return f
        slowed = c.coast_s * (1 - math.exp(-unseen / c.coast_s))
        mean = f.mean.copy()
        mean[:2] -= mean[3:5] * (unseen - slowed)
        mean[3:5] *= math.exp(-unseen / c.coast_s)
        return replace(f, mean=mean)

    def estimate(self, state: VehicleState) -> Estimate:
        """Return the estimate for `state.t_s`, relative to the vehicle."""
        if self.filter is None or self.box is None:
            return Estimate(state.t_s, 0.0, self.down_rad - state.pitch_rad, FAR_M, FAR_M)
        pose = self.motion.at(state.t_s)
        f = self.carried(state.t_s) if self.config.compensate else self.filter
        seen = seen_from(f, pose, self.middle, self.seen_t_s, self.seen_ned, self.config.near_sigmas, self.sources)
        seen = replace(seen, doubt=self.regain.doubt(state.t_s), other=self.regain.sighting(pose))
        north, east, down = (float(v) for v in self.motion.drift.velocity)
        return replace(seen, drift_north_m_s=north, drift_east_m_s=east, drift_down_m_s=down)
