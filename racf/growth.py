"""How much the target grew from one image to the next, by the optical flow of its own pixels.

The scale filter knows the target as it was over some forty frames and answers in steps; one that grows by 4 % a frame
leaves it behind.  The flow [Lucas and Kanade 1981] of a grid of points has no memory: it knows the change between two
images alone, and its errors add up.  So it predicts the size, and the scale filter corrects it.

Points whose flow does not lead back to where they were [Kalal 2010] are dropped; what the others tell is the similarity
in which most of them agree (RANSAC).  Where few agree, in a walker's limbs or a background that moves by itself,
nothing is predicted.  Numbers are measured: docs/notebook.md, "The size by optical flow".
"""

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from racf.box import Box
from racf.patch import resample

UInt8 = NDArray[np.uint8]
Float32 = NDArray[np.float32]

LEAST_SIDE_PX = 20.0  # of the box: fewer pixels have no flow
SIDE_PX = 56.0  # root of the area to which larger targets are shrunk
MARGIN_PX = 6.0  # around the box, beside half its side
POINTS = 8  # in each direction
WINDOW, SMALL_WINDOW = (13, 13), (9, 9)  # the small one in patches below SMALL_PX
SMALL_PX = 60
BACK_PX = 1.0  # furthest from where a point was, by the flow there and back; no more than the median either
AGREE = 0.015  # of the target's side: how near a point must be to where the similarity puts it
LEAST_AGREEING = 0.5  # share of the points that must agree
LEAST_POINTS = 8  # among which the similarity is looked for
MOST = 0.1  # largest change that is believed, of the size's logarithm: a factor of 1.1 a frame

_SEARCH = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 10, 0.03)
_AXIS = (np.arange(POINTS) + 0.5) / POINTS - 0.5
_GRID = np.stack(np.meshgrid(_AXIS, _AXIS), axis=-1).reshape(-1, 2)  # (n, 2): x, y in sides of the box, from its centre


@dataclass(frozen=True, slots=True, eq=False)
class _Seen:
    """A box, the grey patch (rows, columns) around it, and the patch's pixels for each of the image's."""

    box: Box
    patch: UInt8
    zoom: float


class Growth:
    """Remembers what is in the target's box, and tells how much larger that is in the next image."""

    def __init__(self) -> None:
        self._seen: _Seen | None = None

    def forget(self) -> None:
        """The target is not seen."""
        self._seen = None

    def remember(self, image: UInt8, box: Box) -> None:
        """Keep the target at `box` in `image`, (rows, columns[, 3]) in BGR or grey."""
        self._seen = None
        if min(box.w, box.h) >= LEAST_SIDE_PX:
            zoom = min(1.0, SIDE_PX / math.sqrt(box.area))
            self._seen = _Seen(box, _patch(image, box, zoom), zoom)

    def factor(self, image: UInt8, dx: float, dy: float) -> float:
        """The size in `image` over the remembered one, about `dx`, `dy` px away from there; 1 if it cannot be told."""
        if self._seen is None:
            return 1.0
        before, box, zoom = self._seen.patch, self._seen.box, self._seen.zoom
        from_centre = _GRID * (box.w, box.h)
        centre, moved, size = np.array([box.centre_x, box.centre_y]), np.array([dx, dy]), image.shape[1::-1]
        places = from_centre + centre
        there = places + moved
        # What lies beyond the edge are repeated pixels, which do not grow.
        inside = ((places >= 0) & (places <= size) & (there >= 0) & (there <= size)).all(axis=1)
        if inside.sum() < LEAST_POINTS:
            return 1.0
        middle = np.array(before.shape[::-1]) / 2 - 0.5
        points = (from_centre[inside] * zoom + middle).astype(np.float32)
        points, followed = _followed(before, _patch(image, box.moved(dx, dy), zoom), points)
        if len(points) < LEAST_POINTS:
            return 1.0
        within = AGREE * math.sqrt(box.area) * zoom
        similarity, agree = cv2.estimateAffinePartial2D(points, followed, ransacReprojThreshold=within)
        if np.mean(agree) < LEAST_AGREEING:  # none agrees where there is no similarity
            return 1.0
        growth = math.hypot(similarity[0, 0], similarity[1, 0])
        return min(max(growth, math.exp(-MOST)), math.exp(MOST))


def _patch(image: UInt8, box: Box, zoom: float) -> UInt8:
    """The box and what surrounds it, in grey, shrunk by `zoom`."""
    around = math.sqrt(box.area) + 2 * MARGIN_PX
    wide, high = (round((side + around) * zoom) for side in (box.w, box.h))
    planes = resample(image, box.centre_x, box.centre_y, wide / zoom, high / zoom, wide, high)
    return (
        planes[0]
        if len(planes) == 1
        else np.asarray(cv2.cvtColor(cv2.merge(list(planes)), cv2.COLOR_BGR2GRAY), np.uint8)
    )


def _followed(before: UInt8, after: UInt8, points: Float32) -> tuple[Float32, Float32]:
    """Those of the points (n, 2) in `before` whose flow leads back best, and where they are in `after`."""
    size, start = SMALL_WINDOW if min(before.shape) < SMALL_PX else WINDOW, points[:, None]
    there, seen = _flow(before, after, start, size)
    back, seen_back = _flow(after, before, there, size)
    apart = np.linalg.norm(back[:, 0] - points, axis=1)
    good = seen & seen_back & (apart < BACK_PX)
    if good.any():
        good &= apart <= np.median(apart[good])
    return points[good], there[good, 0]


def _flow(before: UInt8, after: UInt8, points: Float32, size: tuple[int, int]) -> tuple[Float32, NDArray[np.bool_]]:
    """Where points (n, 1, 2) went, and which of them were followed (n,)."""
    moved, seen, _ = cv2.calcOpticalFlowPyrLK(
        before, after, points, np.empty_like(points), winSize=size, maxLevel=1, criteria=_SEARCH
    )
    return np.asarray(moved, np.float32), seen[:, 0] == 1
