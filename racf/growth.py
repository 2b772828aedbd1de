"""How much the target grew from one image to the next, by the optical flow of its own pixels.

The scale filter knows the target as it was over some forty frames and answers in steps; one that grows by 4 % a frame
leaves it behind.  The flow [Lucas and Kanade 1981] of a grid of points has no memory: it knows the change between two
images alone, and its errors add up.  So it predicts the size, and the scale filter corrects it.

Points whose flow does not lead back to where they were [Kalal 2010] are dropped; of the others those count that agree
best on one similarity (RANSAC).  Where few agree (a walker's limbs) nothing is predicted, nor where what surrounds
the box moves in the same way: then it may be the ground that was measured, or a tree, and a box that grows with it
holds ever less of the target.  What comes nearer grows in width and height alike; ground that slides beside the target,
or a car that turns, seems to grow in one of them, so that the lesser is believed.  Numbers are measured:
docs/notebook.md, "The size by optical flow".
"""

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from racf.box import Box
from racf.patch import resample

UInt8 = NDArray[np.uint8]
Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]

LEAST_SIDE_PX = 20.0  # of the box: fewer pixels have no flow
SIDE_PX = 56.0  # root of the area to which larger targets are shrunk
MARGIN_PX = 6.0  # around the box, beside half its side
INSIDE = 6  # points in each direction
AROUND = 0.7  # sides of the box from its centre to the ring of points around it
EDGE = 8  # points along each edge of that ring
WINDOW, SMALL_WINDOW = (13, 13), (9, 9)  # the small one in patches below SMALL_PX
SMALL_PX = 60
BACK_PX = 1.0  # furthest from where a point was, by the flow there and back
AGREE = 0.0075  # of the target's side: how near a point must be to where the similarity puts it
LEAST_AGREEING = 0.5  # share of the points inside, of those whose flow leads back best, that must agree
MOST_ALIKE = 0.5  # share of those around that may agree also
LEAST_POINTS = 8  # of either kind, or they say nothing
MOST = 0.1  # largest change that is believed, of the size's logarithm: a factor of 1.1 a frame

_SEARCH = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 10, 0.03)


def _places(across: Float64) -> Float64:
    """(n², 2): x, y of all crossings."""
    return np.stack(np.meshgrid(across, across), axis=-1).reshape(-1, 2)


# In sides of the box, from its centre.
_INSIDE = _places((np.arange(INSIDE) + 0.5) / INSIDE - 0.5)
_AROUND = np.array([at for at in _places(np.linspace(-AROUND, AROUND, EDGE)) if np.abs(at).max() > AROUND - 1e-6])


class Growth:
    """Remembers what is in the target's box, and tells how much larger that is in the next image."""

    def __init__(self) -> None:
        self._box: Box | None = None

    def forget(self) -> None:
        """The target is not seen."""
        self._box = None

    def remember(self, image: UInt8, box: Box) -> None:
        """Keep the target at `box` in `image`, (rows, columns[, 3]) in BGR or grey."""
        self.forget()
        if min(box.w, box.h) >= LEAST_SIDE_PX:
            self._box, self._zoom = box, min(1.0, SIDE_PX / math.sqrt(box.area))
            self._patch = self._seen(image, box)

    def factor(self, image: UInt8, dx: float, dy: float) -> float:
        """The size in `image` over the remembered one, about `dx`, `dy` px away from there; 1 if it cannot be told."""
        if self._box is None:
            return 1.0
        patch, moved = self._seen(image, self._box.moved(dx, dy)), np.array([dx, dy])
        before, after, apart = self._flow(_INSIDE, patch, moved, image.shape)
        if len(before) < LEAST_POINTS:
            return 1.0
        best, within = apart <= np.median(apart), AGREE * math.sqrt(self._box.area) * self._zoom
        before, after = before[best], after[best]
        similarity, agree = cv2.estimateAffinePartial2D(before, after, ransacReprojThreshold=within)
        if np.mean(agree) < LEAST_AGREEING:  # none agrees where there is no similarity
            return 1.0
        growth = _log_growth(before[agree[:, 0] == 1], after[agree[:, 0] == 1])
        if growth == 0.0:
            return 1.0
        before, after, _ = self._flow(_AROUND, patch, moved, image.shape)
        off = np.linalg.norm(before @ similarity[:, :2].T + similarity[:, 2] - after, axis=1)
        if len(off) >= LEAST_POINTS and np.mean(off <= within) >= MOST_ALIKE:
            return 1.0
        return math.exp(min(max(growth, -MOST), MOST))

    def _seen(self, image: UInt8, box: Box) -> UInt8:
        """The box and what surrounds it, in grey, shrunk."""
        around, zoom = math.sqrt(box.area) + 2 * MARGIN_PX, self._zoom
        wide, high = (round((side + around) * zoom) for side in (box.w, box.h))
        planes = resample(image, box.centre_x, box.centre_y, wide / zoom, high / zoom, wide, high)
        if len(planes) == 1:
            return planes[0]
        return np.asarray(cv2.cvtColor(cv2.merge(list(planes)), cv2.COLOR_BGR2GRAY), np.uint8)

    def _flow(
        self, places: Float64, patch: UInt8, moved: Float64, shape: tuple[int, ...]
    ) -> tuple[Float32, Float32, Float32]:
        """Of `places` (in sides of the box) those whose flow leads back, before and after (n, 2), and how far off."""
        assert self._box is not None
        box, size = self._box, shape[1::-1]
        from_centre = places * (box.w, box.h)
        first = from_centre + np.array([box.centre_x, box.centre_y])
        second = first + moved
        # What lies beyond the edge are repeated pixels, which do not grow.
        inside = np.all((first >= 0) & (first <= size) & (second >= 0) & (second <= size), axis=1)
        points = (from_centre[inside] * self._zoom + np.array(patch.shape[::-1]) / 2 - 0.5).astype(np.float32)
        if len(points) == 0:
            return points, points, points[:, 0]
        there, seen = _followed(self._patch, patch, points)
        back, seen_back = _followed(patch, self._patch, there)
        apart = np.linalg.norm(back - points, axis=1)
        good = seen & seen_back & (apart < BACK_PX)
        return points[good], there[good], apart[good]


def _log_growth(before: Float32, after: Float32) -> float:
    """Logarithm of the factor by which points (n, 2) moved apart across or down: the smaller; 0 if signs differ."""
    if len(before) <= 3:  # any three points fit some affine map
        return 0.0
    first, second = before.astype(np.float64), after.astype(np.float64)
    first -= first.mean(axis=0)
    (xx, xy), (_, yy) = (first.T @ first).tolist()
    (xu, xv), (yu, yv) = (first.T @ second).tolist()
    spread = xx * yy - xy * xy
    wider, higher = yy * xu - xy * yu, xx * yv - xy * xv  # times `spread`: least squares, by Cramer's rule
    if spread <= 1e-9 * xx * yy or min(wider, higher) <= 0:
        return 0.0
    across, down = math.log(wider / spread), math.log(higher / spread)
    return math.copysign(min(abs(across), abs(down)), across) if across * down > 0 else 0.0


def _followed(before: UInt8, after: UInt8, points: Float32) -> tuple[Float32, NDArray[np.bool_]]:
    """Where points (n, 2) went, and which of them were followed (n,)."""
    at, size = points[:, None], SMALL_WINDOW if min(before.shape) < SMALL_PX else WINDOW
    moved, seen, _ = cv2.calcOpticalFlowPyrLK(
        before, after, at, np.empty_like(at), winSize=size, maxLevel=1, criteria=_SEARCH
    )
    return np.asarray(moved, np.float32)[:, 0], seen[:, 0] == 1
