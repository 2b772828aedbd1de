"""The ground's height under the target: by start or home, rangefinder, terrain map, or the ground's parallax.

Each source measures one length.  The filter has all lengths in proportion to the target's size, so a measured length
corrects the size, or contradicts it.
"""

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from enum import Enum

import numpy as np

from follow.control.joint_filter import CLEAR_M, JointFilter, height_row, scaled
from follow.control.pose_history import Pose
from follow.geometry import Array
from follow.messages import NEVER, VehicleState
from follow.ranges import require_numbers

FRESH_S = 2.0
"""Heights older than this do not count: a terrain report comes about once a second."""

LOW_M = 2.0
"""Lower than this over the ground, a height does not measure the range: a kerb is a tenth of it."""

BETTER = 0.7
"""The start counts again only when its said_std falls to this fraction: its error is the same each time."""

LEAST_SIZE_STD = 0.03
"""Lower limit of the size's relative deviation: the parallax beside a car was 3 % too high throughout."""

LEAST_RATIO = 0.3
"""Lower limit of near_ratio, for a source that puts the vehicle on the ground or below it."""


class Source(str, Enum):
    """What measures the ground's height."""

    START = "the start's height"
    RANGEFINDER = "the rangefinder"
    TERRAIN = "the terrain map"
    PARALLAX = "the ground's motion in the image"


CORRELATED = {Source.START: 1.0, Source.RANGEFINDER: 3.0, Source.TERRAIN: 3.0, Source.PARALLAX: 1.0}
"""Factor on a source's deviation, because its successive errors are correlated: ten in a row share the slope's error.
The start counts once.  The parallax's errors, 0.04 to 0.64 of the claimed deviation, correlate by at most 0.5 over a
second."""


@dataclass(frozen=True, slots=True)
class GroundTrust:
    """The uncertainty of each source of the ground's height.  Raises ValueError for a number out of its range."""

    start_std_m: float = 0.5  # Uncertainty of the height of the start's ground: barometer drift, a kerb.
    rangefinder_std_m: float = 0.3  # Uncertainty of the ground under the vehicle by a rangefinder: grass, and tilt.
    terrain_std_m: float = 5.0  # Uncertainty of a terrain map: a grid of 30 to 100 m.
    slope_std: float = 0.06  # Standard deviation of the slope between there and the target: most paths have 0 to 10 %.
    every_s: float = 1.0  # Time between two corrections by a source.
    contradiction_sigmas: float = 2.0  # Disagreement of size and ground that stops the vehicle, in standard deviations.

    def __post_init__(self) -> None:
        require_numbers("ground setting", self, may_be_zero=("every_s",))


@dataclass(frozen=True, slots=True)
class GroundWord:
    """The ground's height under the target by a source, beside that by the box and the filter's size.

    `height_m` is the camera's height over that ground by the source, with `std_m`; `by_size_m` the same by the box,
    with `own_std_m` for a known size.
    """

    height_m: float
    std_m: float
    by_size_m: float
    own_std_m: float

    @property
    def lowest_m(self) -> float:
        """The lower of both heights."""
        return max(min(self.height_m, self.by_size_m), CLEAR_M)

    @property
    def ratio_std(self) -> float:
        """Standard deviation of ln height - ln by_size, without the size's own."""
        return math.hypot(self.own_std_m, self.std_m) / self.lowest_m

    @property
    def said_std(self) -> float:
        """The source's own standard deviation, as a fraction of the lower height."""
        return self.std_m / self.lowest_m

    @property
    def clear(self) -> bool:
        """Whether both heights are large enough to compare."""
        return min(self.height_m, self.by_size_m) >= CLEAR_M

    def sigmas(self, size_std: float) -> float:
        """By how many standard deviations source and size contradict each other, for a relative `size_std`.

        The larger of two numbers: by the heights' ratio, and by their difference, because a ratio to a very low height
        is no evidence.
        """
        highest = max(self.height_m, self.by_size_m, CLEAR_M)
        off = abs(self.height_m - self.by_size_m) / math.hypot(self.own_std_m, self.std_m, highest * size_std)
        if not self.clear:
            return off
        return max(off, abs(math.log(self.height_m / self.by_size_m)) / math.hypot(self.ratio_std, size_std))


def ground_word(f: JointFilter, camera_ned: Array, middle: float, ground_down_m: float, std_m: float) -> GroundWord:
    """Compare a height of the ground under the target (NED down, metres) with the filter's."""
    expected, row = height_row(f, camera_ned, middle)
    height = ground_down_m - float(camera_ned[2])
    own = math.sqrt(max(float(row @ f.covariance @ row), 0.0))
    return GroundWord(height, std_m, expected, own)


def grounded(f: JointFilter, here: Array, velocity: Array, middle: float, word: GroundWord) -> JointFilter:
    """The filter after a measurement of the ground's height; unchanged unless the measurement is clear.

    All lengths in the filter are in proportion to the size, the camera's height over the ground among them, so
    ln height - ln by_size measures ln size.  It also measures the rest of the state, such as a grown box or a slope:
    each gets its part of the difference by its variance (Kalman's gain).  The remaining correlation of size and rest
    is negative; it is neglected, which makes the covariance larger, never smaller.
    """
    if not word.clear:
        return f
    _, row = height_row(f, here, middle)
    off, variance = math.log(word.height_m / word.by_size_m), f.size_var + word.ratio_std**2
    rest = f.covariance @ row / word.lowest_m
    f = replace(f, mean=f.mean + rest / variance * off, covariance=f.covariance - np.outer(rest, rest) / variance)
    gain = f.size_var / variance
    least = min(LEAST_SIZE_STD**2, f.size_var)
    return replace(scaled(f, here, velocity, gain * off), size_var=max((1 - gain) * f.size_var, least))


@dataclass(frozen=True, slots=True)
class Parallax:
    """The ground around the target's feet by its parallax in the image: NED down and its deviation, metres.

    `shared_std_m` is the part of the deviation that measurements of the same second share.
    """

    t_s: float
    down_m: float
    std_m: float
    shared_std_m: float = 0.0

    @property
    def own_std_m(self) -> float:
        """The part of the deviation that this measurement alone has."""
        return max(math.sqrt(max(self.std_m**2 - self.shared_std_m**2, 0.0)), 0.01)


def mean_parallax(seen: Sequence[Parallax]) -> tuple[float, float]:
    """The mean of some measurements, weighted by their inverse variance: NED down and its deviation, metres."""
    weights = np.array([1 / one.own_std_m**2 for one in seen])
    fraction = weights / weights.sum()
    shared_m = float(fraction @ [one.shared_std_m for one in seen])
    return float(fraction @ [one.down_m for one in seen]), math.hypot(1 / math.sqrt(weights.sum()), shared_m)


@dataclass(slots=True)
class GroundSources:
    """Compares the sources; remembers the deviation with which each was last used, and which contradicts the size."""

    believed: dict[Source, float] = field(default_factory=dict[Source, float])
    parallax: deque[Parallax] = field(default_factory=lambda: deque[Parallax](maxlen=32))  # since the last correction
    contradiction: str = ""
    near_ratio: float = 1.0  # nearer range / estimated range while a source contradicts the size

    def correct(
        self, f: JointFilter, pose: Pose, state: VehicleState, size: tuple[float, float, float], c: GroundTrust
    ) -> JointFilter:
        """The filter corrected by the sources; `size` is the prior's metres, relative deviation, and `middle`.

        A source that contradicts the prior is rejected, and `contradiction` says so until it agrees.  So no source can
        move the size by more than `contradiction_sigmas` standard deviations of prior and source together.
        """
        here, velocity = pose.position_ned, np.array([pose.north_m_s, pose.east_m_s])
        size_m, size_std, middle = size
        self.contradiction, self.near_ratio = "", 1.0
        words = ground_words(f, here, state, c)
        if fresh := [one for one in self.parallax if 0 <= state.t_s - one.t_s <= FRESH_S]:
            words.insert(0, (Source.PARALLAX, *mean_parallax(fresh)))
        self.parallax.clear()
        for source, ground_down_m, std_m in words:
            word = ground_word(f, here, middle, ground_down_m, std_m)
            if max(word.by_size_m, word.height_m) < LOW_M:
                continue
            if source is Source.START and word.said_std >= BETTER * self.believed.get(source, math.inf):
                continue
            prior = replace(word, by_size_m=word.by_size_m * size_m / f.size_m)
            if prior.sigmas(size_std) > c.contradiction_sigmas:
                self.contradict(source, prior, size_m)
            else:
                f = grounded(f, here, velocity, middle, replace(word, std_m=CORRELATED[source] * word.std_m))
                self.believed[source] = word.said_std
        return f

    def reset(self) -> None:
        """The vehicle's height was reset: the start's height, if it was already used, does not count again."""
        if Source.START in self.believed:
            self.believed[Source.START] = 0.0

    def contradict(self, source: Source, word: GroundWord, size_m: float) -> None:
        """Note that a source and the target's size contradict each other; the nearer range of both counts."""
        ratio = max(word.height_m / max(word.by_size_m, CLEAR_M), LEAST_RATIO)
        self.near_ratio = min(self.near_ratio, ratio)
        self.contradiction = (
            f"the box does not fit a target of {size_m:.1f} m: by its size the vehicle is {word.by_size_m:.0f} m above "
            f"its ground, by {source.value} {word.height_m:.0f} m: box the whole target, or set target.size_m"
        )


def ground_words(f: JointFilter, here: Array, state: VehicleState, c: GroundTrust) -> list[tuple[Source, float, float]]:
    """The ground under the target by each source: NED down (metres), standard deviation (metres).

    The start's ground, at home or at the origin, is extrapolated to the target as flat, the ground under the vehicle
    by the filter's gradient; both with the uncertainty of the slope over the distance.
    """
    target = f.mean[:2]
    ahead = target - here[:2]
    below, std_m = float(ahead @ f.mean[5:7]), c.slope_std * float(np.linalg.norm(ahead))
    words: list[tuple[Source, float, float]] = []
    if 0 <= state.t_s - state.above_ground_t_s <= FRESH_S:
        down = state.down_m + state.above_ground_m + below
        words.append((Source.RANGEFINDER, down, math.hypot(c.rangefinder_std_m, std_m)))
    if 0 <= state.t_s - state.above_terrain_t_s <= FRESH_S:
        down = state.down_m + state.above_terrain_m + below
        words.append((Source.TERRAIN, down, math.hypot(c.terrain_std_m, std_m)))
    home = np.array([state.home_north_m, state.home_east_m]) if state.home_t_s > NEVER else np.zeros(2)
    start_std_m = math.hypot(c.start_std_m, c.slope_std * float(np.linalg.norm(target - home)))
    return [*words, (Source.START, start_down_m(state), start_std_m)]


def start_down_m(state: VehicleState) -> float:
    """NED down of the start's ground: by the height above home, else by home's position, else at the origin."""
    if 0 <= state.t_s - state.above_home_t_s <= FRESH_S:
        return state.down_m + state.above_home_m
    return state.home_down_m if state.home_t_s > NEVER else 0.0
