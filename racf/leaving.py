"""Corrects a first box that is too large or beside the target: the tracker restarts on what moves out of the box.

A box drawn with a finger is loose.  If most of it is ground, the filter may stay on that ground while the target walks
off, and its confidence stays high.  So points of the first box are tracked from frame to frame, and the motion of the
ground, fitted to a ring of points around the tracker's box, is subtracted.  The tracker restarts if some points move
off together, the rest stays, and the points that moved cover much less than the tracker's box or lie beside it.  The
new box spans these points and has the first box's aspect ratio, because a loose box is loose on all sides.

Each of these cases could restart a tracker whose box is right, and has its own test:

* A passer-by: every tracked point begins inside the first box; motion that came in from outside is not followed.
* An edge that passes drags points along: points must still look as in the first frame, and must look different where
  they would be if they had stayed on the ground.
* A standing person leans in the image as the camera moves, because the head moves over the ground behind and the feet
  do not: motion that decreases downwards is not a departure.
* A person gets off a standing vehicle, or leaves somebody who stands: most points that stay must have a colour that is
  also found around the box, as ground has, and the others must be few beside those that moved.  In grey images that
  says too little, so that nothing is corrected there.

Once the points that moved agree with the tracker's box, the box is confirmed and the search ends.
How each number was set is in docs/notebook.md, "A loose first box".
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from racf.box import Box
from racf.offground import ALIKE, INSIDE, POINTS, OffGround

UInt8 = NDArray[np.uint8]
Float64 = NDArray[np.float64]

LONGEST, FIRST = 200, 3  # most frames until the search ends; first frame that may give a result
LEAST_PX, LEAST, NOISES = 2.0, 0.05, 6.0  # least departure: px of the patch, sides, times the ground's noise
ALIKE_PX = 1.0  # least tolerance of a common motion, px of the patch
KNOWN = 1 / 3  # least fraction of the points still tracked: with fewer the search ends
MOVED, STILL, NEITHER = 0.06, 0.08, 0.4  # least fractions of points that moved and that stay; most of neither
SMALLEST, LARGEST = 0.15, 0.8  # of the first box: least area, largest width and height of what moved
SMALLER, BESIDE = 0.6, 0.3  # of the tracker's box: area below which it is loose, or offset in sides
LEANS = 0.4  # largest decrease of the motion from the box's top to its bottom: more is a standing body that leans
CONSECUTIVE, AGREED = 2, 3  # frames with another box before a restart; frames that confirm the tracker's box


@dataclass(frozen=True, slots=True)
class Moved:
    """Points that moved off together.

    box: around them; spread (2,): its width and height in those of the first box; off_ground: whether what stays
    looks like ground.
    """

    box: Box
    spread: Float64
    off_ground: bool

    def is_within(self) -> bool:
        """Whether it is narrower and shorter than the first box: so is a target in a loose box, but no part of one."""
        return float(np.prod(self.spread)) > SMALLEST and float(self.spread.max()) < LARGEST

    def is_another(self, box: Box) -> bool:
        """Whether the tracker's box is loose, or beside it."""
        dx, dy = self.box.centre_x - box.centre_x, self.box.centre_y - box.centre_y
        return self.box.area < SMALLER * box.area or max(abs(dx) / box.w, abs(dy) / box.h) > BESIDE


class Leaving:
    """Tracks points of the first box; returns the target's box if the tracker's is wrong."""

    def __init__(self) -> None:
        self.forget()

    def forget(self) -> None:
        """End the search: the tracker's box is confirmed, or nothing can be known any more."""
        self._points: OffGround | None = None

    def start(self, image: UInt8, box: Box) -> None:
        """Begin with the first box in its image, (rows, columns[, 3]) in BGR or grey."""
        self._points = OffGround(image, box)
        self._frames, self._consecutive, self._agreed = 0, 0, 0

    def look(self, image: UInt8, box: Box) -> Box | None:
        """Take the next image, in which the tracker is at `box`; return the target's box if it is another one."""
        points = self._points
        if points is None:
            return None
        self._frames += 1
        points.follow(image, box)
        moved = _moved_off(points) if self._frames >= FIRST else None
        another = moved is not None and moved.is_another(box)
        self._consecutive = (
            self._consecutive + 1 if moved is not None and another and moved.is_within() and moved.off_ground else 0
        )
        self._agreed += moved is not None and not another
        few = np.mean(points.seen) < KNOWN
        if few or self._frames >= LONGEST or self._consecutive >= CONSECUTIVE or self._agreed >= AGREED:
            self.forget()
        return moved.box if moved is not None and self._consecutive >= CONSECUTIVE else None


def _moved_off(points: OffGround) -> Moved | None:
    """The points that moved off the ground together; None unless other points stayed."""
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
    spread = (high - low) / points.sides + points.grown / POINTS  # each point represents one cell of the grid
    middle, scale = (low + high) / 2, math.sqrt(spread[0] * spread[1])
    box = Box.around(float(middle[0]), float(middle[1]), *(scale * points.sides).tolist())
    return Moved(box, spread / points.grown, points.leave_ground(moved, still))


def _leans(down: Float64, part: Float64) -> bool:
    """Whether the motion decreases downwards: a standing body leans so in the image as the camera moves.

    down (n,): the points' positions, downwards in heights of the first box; part (n,): of the common motion.
    """
    around = down - down.mean()
    square = float(around @ around)
    return square > 0 and float(around @ part) < -LEANS * square
