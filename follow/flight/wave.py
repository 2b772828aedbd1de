"""Mount, field of view and delay of a camera, from a vehicle that is turned by hand.

Corners of the background are tracked over `SPAN_S`.  A camera that turns by R moves the ray r of a far corner to R r,
and R follows from the autopilot's attitude B (body to NED) at the two frames' times t, u less the delay d:

    R = M' B(u - d)' B(t - d) M        M: camera to body, of the mount's yaw, angle below the nose and roll

The unknowns are the three angles, the focal length, d, and the lever l/h from the point about which the vehicle is
turned to the camera, over the height above the ground: it shifts corners below the horizon.  A coarse search by angular
velocities (any mount, lens and delay) gives the start for least squares over the corners' pixels.
"""

import itertools
import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation, RotationSpline

from follow.control.image_motion import WINDOW, corners, shrunk_grey
from follow.geometry import Array, Intrinsics, camera_to_body, distort, rays
from follow.messages import NEVER, Frame, VehicleState

SPAN_S = 0.09  # of an interval: three frames at 30 per second; long enough to turn by some degrees
FEWEST = 10  # corners of an interval
BACK_PX = 0.5  # largest error of a corner tracked forward and back again, in the shrunk image
LONGEST_DELAY_S = 0.6
DELAYS_S = np.arange(-0.1, LONGEST_DELAY_S + 0.01, 0.02)  # searched; below zero: frames stamped before they were taken
FOVS_DEG = (25.0, 35.0, 45.0, 55.0, 67.0, 80.0, 95.0, 110.0, 125.0, 140.0, 152.0)
DOWNS_DEG = np.arange(-90.0, 91.0, 15.0)
ROLLS_DEG = (0.0, 90.0, 180.0, 270.0)
YAW_PRIOR_DEG = 10.0  # turning the vehicle in yaw alone cannot show whether the camera looks straight ahead
LEVER_PRIOR = 0.3  # of the height: an arm's length at chest height
HUBER_PX = 0.5  # residual in the shrunk image beyond which a corner counts less
BLOCKS = 8  # of the time, each left out once (jackknife): the scatter of the results is their uncertainty
LEAST_TURN_RAD_S = 0.1  # RMS angular velocity: with less the result is noise
FEWEST_INTERVALS = 40


@dataclass(frozen=True, slots=True, eq=False)
class Interval:
    """Corners of two frames, (N, 2) full-size pixels each, with the frames' times."""

    from_t_s: float
    to_t_s: float
    before: Array
    after: Array


@dataclass(slots=True)
class Waved:
    """The data of a wave: intervals of corners, the attitude (times, and roll, pitch, yaw), and the frames' size."""

    intervals: list[Interval] = field(default_factory=list)
    attitude_t_s: list[float] = field(default_factory=list)
    attitude_rad: list[tuple[float, float, float]] = field(default_factory=list)
    size: tuple[int, int] = (0, 0)
    frames: int = 0

    def add_state(self, state: VehicleState) -> None:
        """Take in an attitude if it is new."""
        if state.attitude_t_s > (self.attitude_t_s[-1] if self.attitude_t_s else NEVER):
            self.attitude_t_s.append(state.attitude_t_s)
            self.attitude_rad.append((state.roll_rad, state.pitch_rad, state.yaw_rad))


@dataclass(frozen=True, slots=True)
class Measured:
    """A value with its standard deviation."""

    value: float
    std: float


@dataclass(frozen=True, slots=True)
class Mounting:
    """The result of a wave.  `delay_s` counts from exposure to the frames' time stamp.

    `roll_deg` is the camera's turn about its own axis (180: upside down), `yaw_deg` to the right of the nose.
    `explained` is the fraction of the vehicle's angular velocity that the image shows.
    """

    down_deg: Measured
    roll_deg: Measured
    yaw_deg: Measured
    fov_deg: Measured
    focal_ratio: Measured
    delay_s: Measured
    explained: float
    turn_rad_s: float
    intervals: int


class WaveError(RuntimeError):
    """The wave gives no result; the message says why and what to do."""


def gather(frames: Iterable[Frame | None], state: Callable[[], VehicleState], seconds: float) -> Waved:
    """Take frames and attitudes for `seconds` of the vehicle's time."""
    waved, chain, began_s = Waved(), Chain(), math.nan
    for frame in frames:
        now = state()
        began_s = now.t_s if math.isnan(began_s) else began_s
        waved.add_state(now)
        if frame is not None:
            waved.frames += 1
            waved.size = frame.image.shape[1], frame.image.shape[0]
            if (interval := chain.add(frame)) is not None:
                waved.intervals.append(interval)
        if now.t_s - began_s > seconds:
            break
    return waved


class Chain:
    """Corners tracked from frame to frame (Lucas-Kanade), returned every SPAN_S and then found again."""

    def __init__(self) -> None:
        self._images: list[NDArray[np.uint8]] = []  # since the corners were found
        self._points: NDArray[np.float32] = np.empty((0, 1, 2), np.float32)
        self._moved = self._points
        self._from_t_s = NEVER

    def add(self, frame: Frame) -> Interval | None:
        """The corners' interval that ends with this frame, if one does."""
        image, scale = shrunk_grey(frame.image)
        done = None
        if self._images:
            self._follow(image)
            span_s = frame.t_s - self._from_t_s
            if span_s < SPAN_S - 1e-3 and len(self._points) >= FEWEST:
                return None
            if len(self._points) >= FEWEST and span_s < 4 * SPAN_S:
                before, after = ((part[:, 0].astype(np.float64) + 0.5) * scale for part in (self._points, self._moved))
                done = Interval(self._from_t_s, frame.t_s, before, after)
        found = corners(image, None, scale)
        self._images, self._from_t_s = ([image] if found is not None else []), frame.t_s
        self._points = self._moved = np.empty((0, 1, 2), np.float32) if found is None else found
        return done

    def _follow(self, image: NDArray[np.uint8]) -> None:
        """Track to the next image and back; drop the corners that do not come back."""
        last, into, again_into = self._images[-1], np.empty_like(self._moved), np.empty_like(self._moved)
        moved, found, _ = cv2.calcOpticalFlowPyrLK(last, image, self._moved, into, winSize=WINDOW, maxLevel=3)
        back, again, _ = cv2.calcOpticalFlowPyrLK(image, last, moved, again_into, winSize=WINDOW, maxLevel=3)
        off = np.linalg.norm(np.asarray(back) - self._moved, axis=2)[:, 0]
        good = (found[:, 0] > 0) & (again[:, 0] > 0) & (off < BACK_PX)
        self._points, self._moved = self._points[good], np.asarray(moved, np.float32)[good]
        self._images[-1] = image


def mount_matrix(yaw_rad: float, down_rad: float, roll_rad: float) -> Array:
    """(3, 3) camera to body: turned about its axis by `roll_rad`, then down, then to the right."""
    spin = Rotation.from_euler("z", roll_rad).as_matrix()
    return Rotation.from_euler("z", yaw_rad).as_matrix() @ camera_to_body(down_rad) @ spin


class Attitudes:
    """The vehicle's attitude at any time, by a spline through the telemetry."""

    def __init__(self, waved: Waved) -> None:
        self.first_s, self.last_s = waved.attitude_t_s[0], waved.attitude_t_s[-1]
        turned = Rotation.from_euler("ZYX", np.array(waved.attitude_rad)[:, ::-1])
        self._spline = RotationSpline(np.array(waved.attitude_t_s), turned)

    def at(self, t_s: Array) -> Array:
        """(N, 3, 3) body to NED; a time outside the telemetry gives its end."""
        return np.asarray(self._spline(np.clip(t_s, self.first_s, self.last_s)).as_matrix())


def measure(waved: Waved, lens: Intrinsics) -> Mounting:
    """Mount, field of view and delay; `lens` gives the distortion, and the focal length that the ratio is of.

    Raises WaveError for too few corners or attitudes, or too little motion.
    """
    if len(waved.attitude_t_s) < FEWEST_INTERVALS:
        raise WaveError(f"only {len(waved.attitude_t_s)} attitudes came: check the rate of ATTITUDE")
    attitudes = Attitudes(waved)
    reach = attitudes.first_s + LONGEST_DELAY_S, attitudes.last_s + DELAYS_S[0]
    used = [one for one in waved.intervals if one.from_t_s > reach[0] and one.to_t_s < reach[1]]
    if len(used) < FEWEST_INTERVALS:
        raise WaveError(
            f"the background was tracked in {len(used)} intervals, {FEWEST_INTERVALS} are needed: more light, a "
            "background with structure, slower turns, or a longer --wave"
        )
    problem = Problem(used, attitudes, lens)
    turn = problem.turns(0.0)
    turn_rad_s = float(np.sqrt(np.mean(np.sum(turn**2, axis=1))))
    if turn_rad_s < LEAST_TURN_RAD_S:
        raise WaveError(
            f"too little motion to tell anything: {math.degrees(turn_rad_s):.1f} degrees/s on average, at least "
            f"{math.degrees(LEAST_TURN_RAD_S):.0f} are needed: turn the vehicle left and right, nose up and "
            "down, and roll it"
        )
    start, explained = search(problem)
    best = problem.solve(start)
    parts = np.array([problem.without(block).solve(best) for block in range(BLOCKS)])
    std = math.sqrt((BLOCKS - 1) / BLOCKS) * np.linalg.norm(parts - parts.mean(axis=0), axis=0)
    yaw, down, roll, log_focal, delay = (Measured(float(v), float(s)) for v, s in zip(best[:5], std[:5], strict=True))
    ratio = math.exp(log_focal.value)
    seen = replace(lens, fx=lens.fx * ratio, fy=lens.fy * ratio).horizontal_fov_rad
    wider = replace(lens, fx=lens.fx * ratio * 1.01, fy=lens.fy * ratio * 1.01).horizontal_fov_rad
    return Mounting(
        down_deg=_degrees(down),
        roll_deg=_degrees(replace(roll, value=math.remainder(roll.value, math.tau))),
        yaw_deg=_degrees(yaw),
        fov_deg=Measured(math.degrees(seen), math.degrees(abs(wider - seen)) / 0.01 * log_focal.std),
        focal_ratio=Measured(ratio, ratio * log_focal.std),
        delay_s=delay,
        explained=explained,
        turn_rad_s=turn_rad_s,
        intervals=len(used),
    )


def _degrees(angle: Measured) -> Measured:
    return Measured(math.degrees(angle.value), math.degrees(angle.std))


class Problem:
    """The intervals' corners as arrays, and where a mounting predicts them.

    A mounting is (8,): yaw, down, roll (radians), ln of the focal length's ratio, delay (s), lever over height (3).
    """

    def __init__(self, intervals: Sequence[Interval], attitudes: Attitudes, lens: Intrinsics) -> None:
        self.intervals, self.attitudes, self.lens = intervals, attitudes, lens
        self.times = np.array([(one.from_t_s, one.to_t_s) for one in intervals])
        self.before = np.concatenate([one.before for one in intervals])
        self.after = np.concatenate([one.after for one in intervals])
        counts = [len(one.before) for one in intervals]
        self.of = np.repeat(np.arange(len(intervals)), counts)
        self.starts = np.concatenate([[0], np.cumsum(counts)[:-1]])
        self.noise_px = HUBER_PX * max(lens.width / 320, 1.0)

    def without(self, block: int) -> "Problem":
        """The same problem without one of BLOCKS parts of the time."""
        size = math.ceil(len(self.intervals) / BLOCKS)
        kept = [one for n, one in enumerate(self.intervals) if n // size != block]
        return Problem(kept, self.attitudes, self.lens)

    def scaled(self, log_focal: float) -> Intrinsics:
        """The lens with its focal length times a ratio."""
        ratio = math.exp(log_focal)
        return replace(self.lens, fx=self.lens.fx * ratio, fy=self.lens.fy * ratio)

    def turns(self, delay_s: float) -> Array:
        """(P, 3) the vehicle's angular velocity in each interval, body axes, rad/s."""
        first, second = (self.attitudes.at(self.times[:, n] - delay_s) for n in (0, 1))
        turn = Rotation.from_matrix(np.einsum("pji,pjk->pik", first, second)).as_rotvec()
        return turn / np.diff(self.times, axis=1)

    def seen_turns(self, log_focal: float) -> Array:
        """(P, 3) the camera's angular velocity by its image, camera axes, rad/s: r2 - r1 = (r1 + r2)/2 x turn."""
        lens = self.scaled(log_focal)
        first, second = rays(lens, self.before), rays(lens, self.after)
        middle, change = (first + second) / 2, second - first
        weight = np.ones(len(middle))
        turn = np.zeros((len(self.intervals), 3))
        for _ in range(3):
            square = np.sum(middle**2, axis=1)[:, None, None] * np.eye(3) - middle[:, :, None] * middle[:, None, :]
            a = np.add.reduceat(weight[:, None, None] * square, self.starts)
            b = np.add.reduceat(weight[:, None] * np.cross(change, middle), self.starts)
            turn = np.linalg.solve(a + 1e-9 * np.eye(3), b[:, :, None])[:, :, 0]
            off = np.linalg.norm(change - np.cross(middle, turn[self.of]), axis=1)
            weight = np.minimum(1.0, 1.5 * float(np.median(off)) / np.maximum(off, 1e-12))
        return turn / np.diff(self.times, axis=1)

    def residuals(self, mounting: Array) -> Array:
        """(2N + 4,) errors of the corners over their noise, and residuals of the priors."""
        yaw, down, roll, log_focal, delay_s = mounting[:5]
        lens, mount = self.scaled(float(log_focal)), mount_matrix(float(yaw), float(down), float(roll))
        first, second = (self.attitudes.at(self.times[:, n] - delay_s) for n in (0, 1))
        ned = np.einsum("nij,nj->ni", (first @ mount)[self.of], rays(lens, self.before))
        inverse_depth = np.maximum(ned[:, 2], 0.0)[:, None]  # in heights above flat ground
        shift = ((second - first) @ mounting[5:8])[self.of]
        there = np.einsum("nji,nj->ni", (second @ mount)[self.of], ned - inverse_depth * shift)
        depth = np.maximum(there[:, 2:], 1e-3)
        pixels = distort(lens, there[:, :2] / depth) * (lens.fx, lens.fy) + (lens.cx, lens.cy)
        off = np.clip((pixels - self.after) / self.noise_px, -1e3, 1e3)
        root = math.sqrt(len(self.intervals))  # priors weigh as much as one corner of each interval
        prior = root * np.array([yaw / math.radians(YAW_PRIOR_DEG), *(mounting[5:8] / LEVER_PRIOR)])
        return np.concatenate([off.ravel(), 0.1 * prior])

    def solve(self, start: Array) -> Array:
        """The mounting that fits the corners best, from a start near it."""
        scale = np.array([0.01, 0.01, 0.01, 0.01, 0.01, 0.1, 0.1, 0.1])
        return least_squares(self.residuals, start, loss="soft_l1", x_scale=scale, max_nfev=60).x


def search(problem: Problem) -> tuple[Array, float]:
    """The mounting of a coarse grid that explains most of the vehicle's angular velocity, and that fraction."""
    plain = math.log(problem.lens.width / 2 / problem.lens.fx)
    focals = [-math.log(math.tan(math.radians(fov) / 2)) + plain for fov in FOVS_DEG]
    mounts = [(math.radians(d), math.radians(r)) for d, r in itertools.product(DOWNS_DEG.tolist(), ROLLS_DEG)]
    matrices = np.array([mount_matrix(0.0, *mount) for mount in mounts])
    best, found = -math.inf, np.zeros(8)
    turns = [(delay, problem.turns(float(delay))) for delay in DELAYS_S]
    for focal in focals:
        seen = problem.seen_turns(focal)
        for delay, turn in turns:
            total = float(np.sum(turn**2))
            # sum |turn - M seen|² = sum |turn|² + sum |seen|² - 2 trace(M' sum turn seen')
            along = np.einsum("mij,ij->m", matrices, turn.T @ seen)
            explained = (2 * along - float(np.sum(seen**2))) / total
            n = int(np.argmax(explained))
            if explained[n] > best:
                best = float(explained[n])
                found = np.array([0.0, *mounts[n], focal, delay, 0.0, 0.0, 0.0])
    return found, best
