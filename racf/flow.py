"""The optical flow of a target's pixels and of its surroundings, from one image to the next.

The flow [Lucas and Kanade 1981] of two sets of points, in the box and around it; points that fail the forward-backward
check [Kalal 2010] are dropped.  Large targets are shrunk, so that every target takes the same time.
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

SIDE_PX = 56.0  # root of the area to which larger targets are shrunk
MARGIN_PX = 6.0  # of the patch around the box, in addition to half its side
INSIDE = 6  # points in each direction
AROUND = 0.7  # sides of the box from its centre to the ring of points around it
EDGE = 8  # points along each edge of that ring
WINDOW, SMALL_WINDOW = (13, 13), (9, 9)  # the small one in patches below SMALL_PX
SMALL_PX = 60
BACK_PX = 1.0  # largest forward-backward error
LEAST_POINTS = 8  # fewer points of a kind are no measurement
CLEAR_PX = 1.0  # of the patch, between the box and the window around a point of the ground
# The ground has one motion if half of its points differ from their median by at most this fraction of the target's
# side, or this many pixels of the patch, whichever is more.
MOST_SPREAD, MOST_SPREAD_PX = 0.03, 0.5

_NOTHING = np.zeros((0, 2), np.float32)
_SEARCH = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 10, 0.03)


def _places(across: Float64) -> Float64:
    """(n², 2): x, y of all crossings."""
    return np.stack(np.meshgrid(across, across), axis=-1).reshape(-1, 2)


# In sides of the box, from its centre.
_INSIDE = _places((np.arange(INSIDE) + 0.5) / INSIDE - 0.5)
_RING = np.array([at for at in _places(np.linspace(-1.0, 1.0, EDGE)) if np.abs(at).max() > 1.0 - 1e-6])


class Flow:
    """Keeps the target's box and its surroundings; computes the flow of their points to the next image."""

    def __init__(self) -> None:
        self.forget()

    def forget(self) -> None:
        """Forget the box and both images."""
        self.box: Box | None = None
        self._next: UInt8 | None = None

    def remember(self, image: UInt8, box: Box) -> None:
        """Keep the target at `box` in `image`, (rows, columns[, 3]) in BGR or grey."""
        self.forget()
        self.box, self.zoom = box, min(1.0, SIDE_PX / math.sqrt(box.area))
        self._patch = self._seen(image, box)

    def look(self, image: UInt8, dx: float, dy: float) -> None:
        """Take the next image, with the target about `dx`, `dy` px away from the remembered box."""
        if self.box is not None:
            self._next, self._moved = self._seen(image, self.box.moved(dx, dy)), np.array([dx, dy])
            self._size = image.shape[1::-1]

    def inside(self) -> tuple[Float32, Float32, Float32]:
        """Points in the box before and after (n, 2), in pixels of the patch, and their forward-backward error."""
        return self._flow(_INSIDE)

    def around(self) -> tuple[Float32, Float32]:
        """Points around the box, before and after."""
        return self._flow(AROUND * _RING)[:2]

    def ground(self) -> tuple[float, float] | None:
        """How far the box's surroundings moved, in px of the image; None if unknown or not one motion."""
        if self.box is None:
            return None
        clear_px = (_window(self._patch)[0] / 2 + CLEAR_PX) / self.zoom  # keeps the windows off the target itself
        away = [max(AROUND, 0.5 + clear_px / side) for side in (self.box.w, self.box.h)]
        before, after, _ = self._flow(_RING * away)
        if len(before) < LEAST_POINTS:
            return None
        moves = after - before
        middle = np.median(moves, axis=0)
        spread = float(np.median(np.linalg.norm(moves - middle, axis=1)))
        if spread > max(MOST_SPREAD * math.sqrt(self.box.area) * self.zoom, MOST_SPREAD_PX):
            return None
        dx, dy = (middle / self.zoom + self._moved).tolist()
        return dx, dy

    def _seen(self, image: UInt8, box: Box) -> UInt8:
        """The box with its surroundings, in grey, shrunk."""
        around, zoom = math.sqrt(box.area) + 2 * MARGIN_PX, self.zoom
        wide, high = (round((side + around) * zoom) for side in (box.w, box.h))
        planes = resample(image, box.centre_x, box.centre_y, wide / zoom, high / zoom, wide, high)
        if len(planes) == 1:
            return planes[0]
        return np.asarray(cv2.cvtColor(cv2.merge(list(planes)), cv2.COLOR_BGR2GRAY), np.uint8)

    def _flow(self, places: Float64) -> tuple[Float32, Float32, Float32]:
        """See `inside`, of `places` in sides of the box."""
        if self.box is None or self._next is None:
            return _NOTHING, _NOTHING, _NOTHING[:, 0]
        box, size = self.box, self._size
        from_centre = places * (box.w, box.h)
        first = from_centre + np.array([box.centre_x, box.centre_y])
        second = first + self._moved
        # Beyond the image's edge there are only repeated pixels, which do not grow.
        inside = np.all((first >= 0) & (first <= size) & (second >= 0) & (second <= size), axis=1)
        points = (from_centre[inside] * self.zoom + np.array(self._next.shape[::-1]) / 2 - 0.5).astype(np.float32)
        if len(points) == 0:
            return points, points, points[:, 0]
        there, seen = _followed(self._patch, self._next, points)
        back, seen_back = _followed(self._next, self._patch, there)
        error_px = np.linalg.norm(back - points, axis=1)
        good = seen & seen_back & (error_px < BACK_PX)
        return points[good], there[good], error_px[good]


def _window(patch: UInt8) -> tuple[int, int]:
    return SMALL_WINDOW if min(patch.shape) < SMALL_PX else WINDOW


def _followed(before: UInt8, after: UInt8, points: Float32) -> tuple[Float32, NDArray[np.bool_]]:
    """The new positions of points (n, 2), and which of them were tracked (n,)."""
    at = points[:, None]
    moved, seen, _ = cv2.calcOpticalFlowPyrLK(
        before, after, at, np.empty_like(at), winSize=_window(before), maxLevel=1, criteria=_SEARCH
    )
    return np.asarray(moved, np.float32)[:, 0], seen[:, 0] == 1
