"""The closed loop over any ground, without images: a target on a path, a tracker that knows the truth and errs.

The real target, servo and gate fly the simulator's vehicle.  The target is an upright billboard; its box has errors as
RACF was measured to have in drawn scenes (docs/estimate.md).
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from follow.control.servo import Servo, ServoConfig
from follow.control.target import Target, TargetConfig
from follow.flight.session import once
from follow.geometry import Intrinsics, camera_to_ned, project
from follow.loop import follow
from follow.messages import Autopilot, Frame, ImageMotion, Order, Tick, VehicleState
from follow.safety.gate import Limits, Safety
from follow.selection import AS_SET, Wanted
from racf.box import Box
from racf.track import Track
from sim.dynamics import Vehicle, VehicleTruth
from sim.link import SimLink
from sim.measured import ResponseModel

LENS = Intrinsics.from_fov(640, 360, math.radians(80.0))
FRAME_S = 1 / 30
Path = Callable[[float], tuple[float, float]]
Ground = Callable[[float, float], float]


def flat(_north_m: float, _east_m: float) -> float:
    """Ground at the height of the start."""
    return 0.0


def hill(slope: float, foot_m: float = 12.0) -> Ground:
    """Ground that rises northward by `slope` from `foot_m` on (negative: falls); metres down."""
    return lambda north, _east: -slope * max(north - foot_m, 0.0)


def walk(speed_m_s: float, from_m: float = 12.0, after_s: float = 4.0) -> Path:
    """A target that stands, then goes north."""
    return lambda t_s: (from_m + speed_m_s * max(t_s - after_s, 0.0), 0.0)


@dataclass(frozen=True)
class BoxErrors:
    """Errors of a box: white and slowly varying (first-order Gauss-Markov) parts, radians and ln size.

    As RACF's were measured (docs/estimate.md): 0.005 rad, correlation 0.8 over 0.5 s and 0.6 over 2 s; and as much
    of the autopilot's attitude.
    """

    white_rad: float = 0.001
    slow_rad: float = 0.007
    white_size: float = 0.01
    slow_size: float = 0.055
    slow_s: float = 4.0


@dataclass
class Parallax:
    """As the meter of the image's motion: the height over the target's ground, five times a second while it flies.

    Its deviation is that of an attitude error of 0.2 degrees between the two images; a third of it was measured.
    """

    flight: "GroundFlight"
    last_s: float = 0.0

    def update(self, frame: Frame | None, _track: Track | None, state: VehicleState) -> ImageMotion | None:
        """A measurement every 0.2 s, or None."""
        flight, truth = self.flight, self.flight.link.vehicle.motion
        if frame is None or state.t_s - self.last_s < 0.2:
            return None
        since_s, self.last_s = self.last_s, state.t_s
        north, east = flight.path(state.t_s)
        height_m = flight.ground(north, east) - truth.down_m
        slant_m = math.hypot(north - truth.north_m, east - truth.east_m, height_m)
        moved_rad = 0.2 * math.hypot(truth.north_m_s, truth.east_m_s, truth.down_m_s) / slant_m
        if moved_rad < 0.008:
            return None
        std_m = height_m * math.radians(0.2) / moved_rad
        seen_m = height_m + std_m / 3 * float(flight.random.standard_normal())
        return ImageMotion(since_s, state.t_s, 20, *[0.0] * 6, height_m=seen_m, height_std_m=std_m)


WANTED_S = 4.0
"""When a person trims the flight."""


@dataclass
class GroundFlight:
    """One flight.  After `fly`, `rows` holds what was true at each tick."""

    path: Path
    ground: Ground = flat
    autopilot: Autopilot = Autopilot.PX4
    response: ResponseModel | None = None  # the vehicle's; None: as the autopilot was measured
    height_m: float = 8.0
    end_s: float = 60.0
    seed: int | None = 0  # None: boxes without errors
    down_rad: float = 0.5
    size_m: tuple[float, float] = (0.6, 1.8)
    errors: BoxErrors = field(default_factory=BoxErrors)
    servo: ServoConfig = field(default_factory=ServoConfig)
    target: TargetConfig = field(default_factory=TargetConfig)
    limits: Limits = field(default_factory=Limits)
    visible: Callable[[float], bool] = lambda t_s: True
    grown: Callable[[float], float] = lambda t_s: 1.0  # by what factor the tracker's box is wrong
    late_s: float = 0.0  # by how much an image is older than its time says
    parallax: bool = False  # whether the ground's motion in the image is measured
    wanted: Wanted = AS_SET  # from WANTED_S on
    state: Callable[[VehicleState], VehicleState] = lambda state: state  # what the estimator hears
    watch: Callable[[], None] = lambda: None  # runs after each tick, while the estimate is that of the tick
    ticks: list[Tick] = field(default_factory=list)
    truths: list[VehicleTruth] = field(default_factory=list)

    def box(self) -> Box | None:
        """The target's box in the present image, with its errors; None out of view."""
        m, t_s = self.link.vehicle.motion, self.link.vehicle.motion.t_s
        north, east = self.path(t_s)
        rotation = camera_to_ned(self.down_rad, *self._attitude(m))
        middle = [[north, east, self.ground(north, east) - self.size_m[1] / 2]]
        pixels, depth = project(LENS, rotation, (m.north_m, m.east_m, m.down_m), middle)
        if not self.visible(t_s) or depth[0] < 0.5:
            return None
        right, down, grown = self._errors()
        x, y = pixels[0] + LENS.fx * np.array([right, down])
        scale = LENS.fx / depth[0] * math.exp(grown) * self.grown(t_s)
        inside = 0 < x < LENS.width and 0 < y < LENS.height
        return Box.around(float(x), float(y), self.size_m[0] * scale, self.size_m[1] * scale) if inside else None

    def _attitude(self, now: VehicleTruth) -> tuple[float, float, float]:
        """Roll, pitch and yaw `late_s` ago; extrapolated if it is negative."""
        before = next((m for m in reversed(self.truths) if m.t_s <= now.t_s - abs(self.late_s)), now)
        part = self.late_s / max(now.t_s - before.t_s, FRAME_S)
        roll, pitch = (
            n + part * (b - n) for n, b in ((now.roll_rad, before.roll_rad), (now.pitch_rad, before.pitch_rad))
        )
        return roll, pitch, now.yaw_rad + part * math.remainder(before.yaw_rad - now.yaw_rad, math.tau)

    def _errors(self) -> np.ndarray:
        if self.seed is None:
            return np.zeros(3)
        e = self.errors
        slow = np.array([e.slow_rad, e.slow_rad, e.slow_size])
        keep = math.exp(-FRAME_S / e.slow_s)
        self._slow = keep * self._slow + math.sqrt(1 - keep**2) * slow * self.random.standard_normal(3)
        return self._slow + self.random.standard_normal(3) * (e.white_rad, e.white_rad, e.white_size)

    def update(self, _image: np.ndarray, _prior: Box | None = None) -> Track:
        """As a tracker."""
        box = self.box()
        where = box or Box(0, 0, 20, 40)
        return Track(where, where.scaled(3), 15.0, 60.0, 1.0, found=box is not None)

    def frames(self) -> Iterator[Frame]:
        """As a camera: each frame lets the vehicle's time pass."""
        index = 0
        while self.link.vehicle.motion.t_s < self.end_s:
            yield Frame(np.zeros((2, 2, 3), np.uint8), self.link.vehicle.motion.t_s, index)
            self.link.advance(FRAME_S)
            index += 1

    def fly(self) -> "GroundFlight":
        """The whole flight."""
        start = VehicleTruth(down_m=-self.height_m)
        self.link = SimLink(Vehicle(self.autopilot, start, seed=self.seed or 0, response=self.response))
        heard = self.link.state
        self.link.state = lambda: self.state(heard())
        self.random = np.random.default_rng(self.seed)
        self._slow = self.random.standard_normal(3) * (
            self.errors.slow_rad,
            self.errors.slow_rad,
            self.errors.slow_size,
        )
        self.estimator = Target(LENS, self.down_rad, self.target)
        orders = once(Order.FOLLOW)
        loop = follow(
            self,
            self.link,
            self,
            self.estimator,
            Servo(self.down_rad, self.servo),
            Safety(self.limits),
            lambda: replace(orders(), wanted=self.wanted if self.now_s >= WANTED_S else AS_SET),
            Parallax(self) if self.parallax else None,
        )
        for tick in loop:
            self.ticks.append(tick)
            self.truths.append(self.link.vehicle.motion)
            self.watch()
        return self

    @property
    def now_s(self) -> float:
        """Simulated time."""
        return self.link.vehicle.motion.t_s

    # What came of it

    def ranges(self) -> np.ndarray:
        """True distance along the ground at each tick."""
        places = (self.path(m.t_s) for m in self.truths)
        return np.array(
            [math.hypot(n - m.north_m, e - m.east_m) for (n, e), m in zip(places, self.truths, strict=True)]
        )

    def to_body(self) -> np.ndarray:
        """True distance to the upright line from the target's feet to its head, at each tick."""
        out = []
        for m, level in zip(self.truths, self.ranges(), strict=True):
            feet = self.ground(*self.path(m.t_s))
            off = max(feet - self.size_m[1] - m.down_m, m.down_m - feet, 0.0)
            out.append(math.hypot(level, off))
        return np.array(out)

    def heights(self) -> np.ndarray:
        """True height over the ground under the vehicle."""
        return np.array([self.ground(m.north_m, m.east_m) - m.down_m for m in self.truths])

    def standoff_rms(self, after_s: float = 12.0) -> float:
        """RMS error of the stand-off, relative, from `after_s` on."""
        error = [r - self.servo.standoff_m for r, m in zip(self.ranges(), self.truths, strict=True) if m.t_s >= after_s]
        return math.sqrt(float(np.mean(np.square(error)))) / self.servo.standoff_m
