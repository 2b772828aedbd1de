"""A first box that is too large, or beside the target: what of it moves off the ground is the target.

Who draws a box with a finger draws it loosely.  Most of such a box is ground, and a tracker that stays on that ground
while the target walks out of it is as confident as one that follows.  So points of the first box are followed from
frame to frame, and the motion of the ground, fitted to a ring around them, is taken off.  Where some of them move off
together, the rest stays, and those that moved span much less than the tracker's box or lie elsewhere, the tracker is
to start again on what they span, in the first box's aspect: who draws loosely draws loosely all around.

What stands upright leans in the image as the camera moves: its head moves over the ground behind, its feet do not.  So
what moves the less, the lower it is, has not left.

A passer-by must not be followed.  It is not in the first box: every point begins there.  Points that its edge drags
along no longer look as they did; the target looks the same where its points are, and no longer where they would be on
the ground.  Once what moves agrees with the tracker's box, that is proven, and nothing more is looked at.
The numbers were set on the study's sequences, LEANS in simulated flights: docs/notebook.md, "A loose first box".
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from racf.box import Box
from racf.offground import ALIKE, INSIDE, POINTS, OffGround

UInt8 = NDArray[np.uint8]
Float64 = NDArray[np.float64]

LONGEST, FIRST = 200, 3  # frames for which it is looked, and before anything is told
LEAST_PX, LEAST, NOISES = 2.0, 0.05, 6.0  # what moved: px of the patch, sides, and times the ground's own errors so far
ALIKE_PX = 1.0  # the same, px of the patch at least
KNOWN = 1 / 3  # least share of the points that are still followed: fewer do not speak for the box
MOVED, STILL, NEITHER = 0.06, 0.08, 0.4  # least share of all points, twice, and most of those left
SMALLEST, LARGEST = 0.15, 0.8  # of the first box: area of what moved, and either side
SMALLER, BESIDE = 0.6, 0.3  # area of the tracker's box below which it is loose, or sides by which it is off
LEANS = 0.4  # of the motion, by which it falls off from the first box's top to its bottom, in what stands and leans
TOLD, AGREED = 2, 3  # frames in a row that must tell of another box, and frames that prove the tracker's


@dataclass(frozen=True, slots=True)
class Moved:
    """What moved off the ground together: a box around it, and its width and height in those of the first (2,)."""

    box: Box
    spread: Float64

    def is_within(self) -> bool:
        """Whether it is smaller than the first box all around, as a target in a loose box is; a part of one is not."""
        return float(np.prod(self.spread)) > SMALLEST and float(self.spread.max()) < LARGEST

    def is_another(self, box: Box) -> bool:
        """Whether the tracker's box is loose, or beside it."""
        dx, dy = self.box.centre_x - box.centre_x, self.box.centre_y - box.centre_y
        return self.box.area < SMALLER * box.area or max(abs(dx) / box.w, abs(dy) / box.h) > BESIDE


class Leaving:
    """Follows points of the first box, and tells the target's box when it is another than the tracker's."""

    def __init__(self) -> None:
        self.forget()

    def forget(self) -> None:
        """The tracker's box is believed from now on."""
        self._points: OffGround | None = None

    def start(self, image: UInt8, box: Box) -> None:
        """The first box in its image, (rows, columns[, 3]) in BGR or grey."""
        self._points = OffGround(image, box)
        self._frames, self._told, self._agreed = 0, 0, 0

    def look(self, image: UInt8, box: Box) -> Box | None:
        """The next image, in which the tracker is at `box`; the target's box if it is another."""
        points = self._points
        if points is None:
            return None
        self._frames += 1
        points.follow(image, box)
        moved = _moved_off(points) if self._frames >= FIRST else None
        another = moved is not None and moved.is_another(box)
        self._told = self._told + 1 if moved is not None and another and moved.is_within() else 0
        self._agreed += moved is not None and not another
        few = np.mean(points.seen) < KNOWN
        if few or self._frames >= LONGEST or self._told >= TOLD or self._agreed >= AGREED:
            self.forget()
        return moved.box if moved is not None and self._told >= TOLD else None


def _moved_off(points: OffGround) -> Moved | None:
    """The points that moved off the ground together; None unless others stayed."""
    side = points.side * points.grown
    least = max(LEAST_PX / points.zoom, LEAST * side, NOISES * points.noise)
    size = np.linalg.norm(points.off, axis=1)
    off = points.seen & (size > least)
    if np.sum(off) < MOVED * len(points.at):
        return None
    motion = np.median(points.off[off], axis=0)
    whole = float(np.hypot(*motion))
    near, apart = max(ALIKE * whole, ALIKE_PX / points.zoom), np.linalg.norm(points.off - motion, axis=1)
    moved = points.seen & (apart < near) & (apart < size)
    still = points.seen & (size < near) & (size <= apart)
    enough = np.sum(moved) >= MOVED * len(points.at) and np.sum(still) >= STILL * len(points.at)
    clear = np.sum(points.seen & ~moved & ~still) <= NEITHER * np.sum(points.seen)
    if whole < least or not enough or not clear or _leans(INSIDE[moved, 1], points.off[moved] @ motion / whole**2):
        return None
    if points.come_from_outside(moved) or not points.look_the_same(moved):
        return None
    spans = points.at[moved]
    low, high = spans.min(axis=0), spans.max(axis=0)
    spread = (high - low) / points.sides + points.grown / POINTS  # a point stands for what is around it
    middle, scale = (low + high) / 2, math.sqrt(spread[0] * spread[1])
    box = Box.around(float(middle[0]), float(middle[1]), *(scale * points.sides).tolist())
    return Moved(box, spread / points.grown)


def _leans(down: Float64, share: Float64) -> bool:
    """Whether points move the less, the lower they are: so does the image of what stands upright as the camera moves.

    down (n,): how far down the first box they are, in its heights; share (n,): of their common motion.
    """
    around = down - down.mean()
    square = float(around @ around)
    return square > 0 and float(around @ share) < -LEANS * square
