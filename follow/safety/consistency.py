"""Whether the image moves with the vehicle: detects a frozen image, a wrong mount or lens, a box on the vehicle itself.

Pure functions of `ImageMotion` messages (`follow.control.image_motion` measures them).  Over a window the measured
motion m of the background is compared with the motion p = r + t that attitude and velocity predict:

    gain = sum(m . p) / sum(p . p)        1: as predicted; 0: frozen; -1: the camera is mounted the wrong way round

Its standard deviation follows from the tracking noise and from the prediction's own error (unknown depth, a late
attitude).  There is no verdict until the prediction is large against both.  So a vehicle that does not
move at all is never contradicted, and then it hurts nobody.
"""

import math
from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass, field
from itertools import pairwise

from follow.messages import NEVER, ImageMotion

SHORT_S = 0.6  # a frozen image must be noticed within a second: three intervals, and the wait for their telemetry
LONG_S = 3.0  # a wrong lens or mount shows as a ratio, which needs more evidence
NOISE_PX = 0.5  # of the mean over some forty corners, each found to a fifth of a pixel at 640 px, and time stamp jitter
MODEL = 0.35  # fraction of the predicted motion that may be wrong: the ground's depth, and 20 ms of delay in a turn
LEAST_PX = 2.0  # rms of the predicted motion over an interval below which nothing is judged
SIGMAS = 3.0  # a gain contradicts only beyond this many standard deviations from 1
FROZEN_BELOW = 0.2  # gain of an image that does not follow the vehicle; 0.3 is still sound at 28 m instead of 8
LENS_RANGE = (0.75, 1.35)  # gain of the rotation beyond which the lens is not that of the settings: 130 for 80 degrees
# gives 0.67 (corners at the edge make up for some of the ratio of the focal lengths), 45 for 80 gives 1.7
BOX_NOISE_PX = 1.5  # of a tracker's box between two intervals
BOX_LEAST_PX = 12.0  # root of the summed squared motion that the box should have shown
RIDES_BELOW = 0.35  # gain of a box that does not follow the world
GONE_S = 0.6  # a verdict expires this long after the last measurement


@dataclass(frozen=True, slots=True)
class Gain:
    """A ratio of measured to predicted motion with its standard deviation; `px` is the rms predicted motion."""

    value: float
    std: float
    px: float

    def __str__(self) -> str:
        return f"{self.value:.1f} of {self.px:.0f} px"

    def is_below(self, bound: float) -> bool:
        """Whether the ratio is below the bound, and SIGMAS standard deviations below 1."""
        return self.value < min(bound, 1.0 - SIGMAS * self.std)

    def is_above(self, bound: float) -> bool:
        """Whether the ratio is above the bound, and SIGMAS standard deviations above 1."""
        return self.value > max(bound, 1.0 + SIGMAS * self.std)


def whole_gain(motions: Iterable[ImageMotion]) -> Gain | None:
    """Gain of the whole predicted motion, rotation and translation; None for too little motion."""
    return _gain([(m.mr_px2 + m.mt_px2, m.rr_px2 + 2 * m.rt_px2 + m.tt_px2) for m in motions])


def turn_gain(motions: Iterable[ImageMotion]) -> Gain | None:
    """Gain of the rotation alone, with the translation fitted at the same time."""
    pairs = list(motions)
    rr, rt, tt = (sum(getattr(m, name) for m in pairs) for name in ("rr_px2", "rt_px2", "tt_px2"))
    # The part of the rotation that translation cannot explain: r less its projection on t.
    own = [(m.mr_px2 - m.mt_px2 * rt / max(tt, 1e-9), m.rr_px2 - m.rt_px2 * rt / max(tt, 1e-9)) for m in pairs]
    free = rr - rt * rt / max(tt, 1e-9)
    return None if free < 0.2 * rr else _gain(own)


def _gain(pairs: list[tuple[float, float]]) -> Gain | None:
    """From (m . p, p . p) of each interval."""
    pp = sum(p for _, p in pairs)
    if len(pairs) < 2 or pp / len(pairs) < LEAST_PX**2:
        return None
    variance = sum(max(p, 0.0) * (NOISE_PX**2 + MODEL**2 * max(p, 0.0)) for _, p in pairs) / pp**2
    return Gain(sum(m for m, _ in pairs) / pp, math.sqrt(variance), math.sqrt(pp / len(pairs)))


def box_gain(motions: Iterable[ImageMotion]) -> Gain | None:
    """Gain of the box's motion against the vehicle's fast rotation.

    The servo holds a followed target at its position in the image, so the slow part of its motion is no evidence.
    Differences of successive intervals keep the vehicle's fast rotation, which a box on the ground must show and a box
    on the vehicle itself cannot.
    """
    listed = list(motions)
    seen = expected = 0.0
    for before, after in pairwise(listed):
        if after.from_t_s - before.t_s > GONE_S:
            continue
        for axis in (0, 1):
            e = after.box_expected_px[axis] - before.box_expected_px[axis]
            seen += e * (after.box_seen_px[axis] - before.box_seen_px[axis])
            expected += e * e
    if expected < BOX_LEAST_PX**2:
        return None
    return Gain(seen / expected, BOX_NOISE_PX / math.sqrt(expected), math.sqrt(expected))


@dataclass(slots=True)
class Consistency:
    """Judges the last `LONG_S`; `update` returns the contradiction as text, or ""."""

    motions: deque[ImageMotion] = field(default_factory=lambda: deque[ImageMotion](maxlen=64))
    until_s: float = NEVER
    words: str = ""

    def update(self, motion: ImageMotion | None, t_s: float) -> str:
        """Take in a measurement, if there is one; returns the contradiction that holds at `t_s`."""
        if motion is not None:
            self.motions.append(motion)
            self.words = self.judge(motion.t_s)
            self.until_s = motion.t_s + GONE_S
        return self.words if t_s <= self.until_s else ""

    def judge(self, t_s: float) -> str:
        """The contradiction in the measurements up to `t_s`; empty if they agree or are too few."""
        recent = [m for m in self.motions if t_s - m.from_t_s <= SHORT_S + 1e-6]
        longer = [m for m in self.motions if t_s - m.from_t_s <= LONG_S + 1e-6]
        turn = turn_gain(recent)
        turns = turn is not None and turn.value > FROZEN_BELOW
        if (gain := whole_gain(recent)) and gain.is_below(FROZEN_BELOW) and not turns and not follows_at_all(recent):
            return f"the image does not move with the vehicle ({gain}): frozen, or a wrong mount"
        if (gain := turn_gain(longer)) and (gain.is_below(LENS_RANGE[0]) or gain.is_above(LENS_RANGE[1])):
            return f"the image does not turn as far as the vehicle ({gain}): wrong field of view or mount"
        if (gain := box_gain(longer)) and gain.is_below(RIDES_BELOW):
            return f"the box does not move with the world ({gain}): it rides on the vehicle"
        return ""


def follows_at_all(motions: list[ImageMotion]) -> bool:
    """Whether the background moves about as much as predicted, only elsewhere: other footage, not a frozen image."""
    seen = sum(m.mm_px2 for m in motions)
    expected = sum(m.rr_px2 + 2 * m.rt_px2 + m.tt_px2 for m in motions)
    along = sum(m.mr_px2 + m.mt_px2 for m in motions)
    return seen > 0.3 * expected and along > -0.5 * math.sqrt(max(seen * expected, 0.0))
