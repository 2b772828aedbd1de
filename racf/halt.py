"""A box that stops on the ground while its confidence falls: the target may have gone on, occluded.

A lamp, a tree or a bridge occludes the target and captures the box: the box then stands on the ground, and the smoothed
motion forgets that the target was moving.  When the target counts as lost some frames later, its expected position
would be where the box stood.  So the motion over the ground from before the halt is kept: a target that is lost after a
halt is expected where it would be if it had gone on, relative to the ground's measured motion.  The target may also
really have halted and then been occluded, so a match where it stood is as good as one at the expected position.
Numbers are measured: docs/notebook.md, "A target that halts".
"""

import math
from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from racf.box import Box

Float64 = NDArray[np.float64]

NOW, BEFORE = 8, 20  # numbers of frames: standing, and moving before that
LEAST_KNOWN = 0.8  # least fraction of the BEFORE frames with a known motion
LEAST_MOTION = 0.02  # least motion, in sides of the target per frame: less is standing
STEADY = 0.5  # least motion in either half of the BEFORE frames, as a fraction of their mean
STANDS = 0.35  # largest remaining motion of a halted box along the old direction, as a fraction; twice that in any
DOUBTED = 0.9  # the confidence must have fallen below this since the halt, or up to JUST_BEFORE frames earlier
JUST_BEFORE = 3  # frames
MOVES = 0.7  # at this fraction of the old motion the target moves again: nothing occluded it
LONGEST = 60  # most frames between halt and loss, and most frames of extrapolation after the loss


@dataclass(frozen=True, slots=True)
class _Frame:
    """Motion over the ground in sides of the target, None if it is unknown, and the confidence."""

    motion: tuple[float, float] | None
    confidence: float


class Halt:
    """Keeps the target's motion over the ground, and the position if it went on after a doubtful halt."""

    def __init__(self) -> None:
        self._frames: deque[_Frame] = deque(maxlen=BEFORE + NOW)
        self._motion: Float64 | None = None  # from before it halted; None: it did not
        self._at, self._stood, self._step, self._ground = np.zeros(2), np.zeros(2), np.zeros(2), np.zeros(2)
        self._age, self._is_seen = 0, True

    def forget(self) -> None:
        """Forget the motion."""
        self._frames.clear()
        self._motion = None

    def goes_on(self, ground: tuple[float, float] | None, side: float) -> None:
        """Advance one frame: the ground moved by `ground` px (None: as before), the target is `side` px large."""
        if ground is not None:
            self._ground = np.asarray(ground)
        if self._motion is None:
            return
        self._age += 1
        self._step = self._ground + self._motion * side
        self._at, self._stood = self._at + self._step, self._stood + self._ground
        if self._age > LONGEST:
            self._motion = None

    def moved(self, box: Box) -> Box:
        """The box where the target is if it went on; the same box if it did not halt."""
        return box if self._motion is None else _around(self._at, box)

    def places(self, expected: Box) -> tuple[Box, ...]:
        """Expected positions of a lost target: `expected` and, after a halt, also where it stood."""
        return (expected,) if self._motion is None else (expected, _around(self._stood, expected))

    def step(self) -> tuple[float, float] | None:
        """How far it went in the last frame if it went on, in px; None if it did not halt."""
        return None if self._motion is None else (float(self._step[0]), float(self._step[1]))

    def seen(self, before: Box, after: Box, ground: tuple[float, float] | None, confidence: float) -> None:
        """The target went from one box to the other while the ground moved by `ground` px (None: unknown)."""
        motion = None
        if ground is not None:
            side = math.sqrt(before.area)
            dx, dy = after.centre_x - before.centre_x, after.centre_y - before.centre_y
            motion = (dx - ground[0]) / side, (dy - ground[1]) / side
        self._frames.append(_Frame(motion, confidence))
        self._is_seen, self._stood = True, np.array([after.centre_x, after.centre_y])
        if self._motion is None:
            self._look_for_a_halt(after)
        elif self._age > NOW:
            latest = list(self._frames)[-NOW:]
            if confidence > DOUBTED and np.hypot(*_mean(latest)) > MOVES * np.hypot(*self._motion):
                self._motion = None

    def unseen(self) -> None:
        """The target was not found."""
        if self._is_seen:
            self._is_seen, self._age = False, 0
        self._frames.append(_Frame(None, 0.0))

    def found(self, confidence: float) -> None:
        """A lost target is found again: its position is known, its motion is not."""
        self._motion, self._is_seen = None, True
        self._frames.append(_Frame(None, confidence))

    def _look_for_a_halt(self, box: Box) -> None:
        frames = list(self._frames)
        earlier, latest = frames[:-NOW], frames[-NOW:]
        if len(earlier) < BEFORE or any(frame.motion is None for frame in latest):
            return
        if sum(frame.motion is not None for frame in earlier) < LEAST_KNOWN * BEFORE:
            return
        before, now = _mean(earlier), _mean(latest)
        size = float(np.hypot(*before))
        halves = _mean(earlier[: BEFORE // 2]), _mean(earlier[BEFORE // 2 :])
        if size < LEAST_MOTION or min(float(half @ before) for half in halves) < STEADY * size**2:
            return
        lately = _mean(latest[NOW // 2 :])  # checked separately, so that a turn within the mean is not a halt
        stands = all(of @ before < STANDS * size**2 and np.hypot(*of) < 2 * STANDS * size for of in (now, lately))
        if stands and min(frame.confidence for frame in frames[-NOW - JUST_BEFORE :]) < DOUBTED:
            self._motion, self._age = before, 0
            self._at = np.array([box.centre_x, box.centre_y]) + (before - now) * NOW * math.sqrt(box.area)


def _around(centre: Float64, box: Box) -> Box:
    return Box.around(float(centre[0]), float(centre[1]), box.w, box.h)


def _mean(frames: list[_Frame]) -> Float64:
    """The mean motion; an unknown motion counts as zero."""
    return np.mean([frame.motion or (0.0, 0.0) for frame in frames], axis=0)
