"""Tracks points of a box and measures how far each has moved over the ground since the first frame.

The ground's motion is the similarity (RANSAC) that most points of a ring around the box agree on.  The ring has new
points in each frame, because the first ones soon leave the image; the points in the box stay the same until they are
lost.  The optical flow is that of [Lucas and Kanade 1981], forwards and backwards as in `racf.flow`.
"""

import math
from collections import deque
from collections.abc import Sequence

import cv2
import numpy as np
from cv2.typing import MatLike
from numpy.typing import NDArray

from racf.box import Box
from racf.patch import resample

UInt8 = NDArray[np.uint8]
Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]
Bool = NDArray[np.bool_]

SIDE_PX, MOST_ZOOM = 72.0, 2.0  # the first box is drawn to this root of its area, but never larger than that
POINTS, EDGE = 8, 9  # points in the box in each direction, and along each edge of the ring
AROUND = 0.35  # sides between the box and the ring, at least
LOOK = 4  # half the side of the square by which a point's look is judged, px of the patch
BACK_PX = 1.0  # largest forward-backward error of the flow, px of the patch
LEAST_RING, LEAST_GROUND = 6, 0.4  # least points of the ring, and fraction of them that agree on the motion
GROUND_PX, GROUND = 0.75, 0.01  # distance within which they agree: px of the patch, or sides
# Largest distance (8-bit Lab) at which two colours are the same; on varied ground, the distance within which this
# fraction of the ring's points have another one.
SAME_LAB, SAME_RING = 6.0, 0.75
SAME_SHARE = 0.7  # least fraction of points with a colour of the ring
GREY_LAB = 128.0  # both chroma channels of grey in 8-bit Lab
OTHERS = 1 / 3  # most staying points without such a colour, per point that moved: more are a second body
COLOURLESS = 4.0  # distance from grey (8-bit Lab) below which only brightness differs, which is not enough
SAME_LOOK = 0.6  # largest squared difference from the first look, over its contrast: a correlation of 0.7
ALIKE = 0.35  # largest distance from a common motion, as a fraction of it
NOW, LATELY = 5, 30  # frames
OUTSIDE = 3  # ring points with the same motion, over LATELY frames, that show an object from outside


def _places(across: Float64) -> Float64:
    """(n², 2): x, y of all crossings."""
    return np.stack(np.meshgrid(across, across), axis=-1).reshape(-1, 2)


# Positions in sides, from the box's centre: of the grid, and of the ring.
INSIDE = _places((np.arange(POINTS) + 0.5) / POINTS - 0.5)
_RING = np.array([at for at in _places(np.linspace(-1.0, 1.0, EDGE)) if np.abs(at).max() > 1.0 - 1e-6])
_LOOK = np.arange(-LOOK, LOOK + 1)
_SEARCH = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 10, 0.03)


class OffGround:
    """A grid of points (n, 2) of the box in `image`, (rows, columns[, 3]) in BGR or grey, in its pixels.

    at: their positions; off: their motion over the ground since the start; seen: which are still tracked.
    grown: the ground's scale since the start; noise: accumulated error of the ground's points, px.
    """

    def __init__(self, image: UInt8, box: Box) -> None:
        self._size = image.shape[1::-1]
        self.sides, self.side = np.array([box.w, box.h]), math.sqrt(box.area)
        self.zoom = min(MOST_ZOOM, SIDE_PX / self.side)
        self._shape = np.maximum(np.round((self.sides + 2 * self.side) * self.zoom), 2 * LOOK + 2).astype(int)
        self._window = 9 if min(box.w, box.h) * self.zoom < 30 else 13
        self._centre, self._drift = np.array([box.centre_x, box.centre_y]), np.zeros(2)
        self.at = self._centre + INSIDE * self.sides
        self.off, self._step = np.zeros_like(self.at), np.zeros_like(self.at)
        self.seen = np.all((self.at > 3) & (self.at < np.array(self._size) - 3), axis=1)
        self.grown, self.noise = 1.0, 0.0
        self._around, self._steps = deque[Float64](maxlen=LATELY), deque[Float64](maxlen=NOW)
        planes = self._sampled(image, self._centre)
        self._patch = _grey(planes)
        self._first = self._looked(self.at)
        self._ground_like = self._like_ring(planes)

    def follow(self, image: UInt8, box: Box) -> None:
        """Track them into the next image, in which the tracker is at `box`."""
        there = np.array([box.centre_x, box.centre_y])
        after = _grey(self._sampled(image, there))
        ring = self._ring()
        known = np.flatnonzero(self.seen)
        points = np.vstack([self.at[known], ring])
        if len(points) == 0:
            return
        guess = self._centre - there + self._drift + np.vstack([self._step[known], np.zeros_like(ring)])
        found, good = self._followed(self._to_patch(points), guess * self.zoom, after)
        places = (found - self._shape / 2 + 0.5) / self.zoom + there
        on_ring = np.arange(len(points)) >= len(known)
        self.seen[known[~good[: len(known)]]] = False
        ground = self._ground(points[good & on_ring], places[good & on_ring])
        known, moved = known[good[: len(known)]], good & ~on_ring
        self.at[known] = places[moved]
        if ground is not None:
            self._step[known] = places[moved] - _mapped(ground, points[moved])
            self._steps.append(self._step.copy())
            self.off[known] = self.off[known] @ ground[:, :2].T + self._step[known]
            self._drift = _mapped(ground, self._centre[None])[0] - self._centre
            self.grown *= math.hypot(ground[0, 0], ground[1, 0])
        self._patch, self._centre = after, there

    def look_the_same(self, points: Bool) -> bool:
        """Whether the first look of points is where they are, and not on the ground where they were."""
        first, at, off = self._first[points], self.at[points], self.off[points]
        here, there = (float(np.nansum((first - self._looked(places)) ** 2)) for places in (at, at - off))
        return here <= SAME_LOOK * min(there, float(np.nansum(first**2)))

    def leave_ground(self, moved: Bool, still: Bool) -> bool:
        """Whether what stays is ground: most points have a colour of the ring, the others are few beside what moved."""
        others = np.sum(still & ~self._ground_like)
        return bool(np.mean(self._ground_like[still]) >= SAME_SHARE and others <= OTHERS * np.sum(moved))

    def come_from_outside(self, points: Bool) -> bool:
        """Whether an object around the box recently moved like these points do now."""
        steps = [np.median(step[points], axis=0) for step in self._steps]
        step = max(steps, key=lambda step: float(np.hypot(*step)))  # a slow one may rest in between
        near = ALIKE * float(np.hypot(*step))
        return sum(int(np.sum(np.linalg.norm(moved - step, axis=1) < near)) for moved in self._around) >= OUTSIDE

    def _ground(self, before: Float64, after: Float64) -> Float64 | None:
        """The similarity (2, 3) of most of the ring; None if it does not move as one."""
        if len(before) < LEAST_RING:
            return None
        within = max(GROUND_PX / self.zoom, GROUND * self.side)
        similarity, agree = cv2.estimateAffinePartial2D(before, after, ransacReprojThreshold=within)
        if np.mean(agree) < LEAST_GROUND:  # none agrees where there is no similarity
            return None
        ground = np.asarray(similarity, np.float64)
        self._around.append(after - _mapped(ground, before))
        self.noise = math.hypot(self.noise, float(np.median(np.linalg.norm(after - _mapped(ground, before), axis=1))))
        return ground

    def _ring(self) -> Float64:
        """(n, 2): positions around the box, inside the image."""
        away = np.maximum(self.sides / 2 + AROUND * self.side, self.sides / 2 + (self._window / 2 + 1) / self.zoom)
        ring = self._centre + _RING * away
        return ring[np.all((ring > 3) & (ring < np.array(self._size) - 3), axis=1)]

    def _like_ring(self, planes: UInt8) -> Bool:
        """(n,): whether the mean colour around each point is near one on the ring; all False without ring or colour."""
        ring = self._ring()
        if len(ring) < LEAST_RING:
            return np.zeros(len(self.at), bool)
        lab = cv2.cvtColor(_bgr(planes), cv2.COLOR_BGR2LAB)
        means = cv2.blur(lab.astype(np.float32), (len(_LOOK), len(_LOOK)), borderType=cv2.BORDER_REPLICATE)
        wide, high = self._shape
        at, around = (np.rint(self._to_patch(places)).astype(int) for places in (self.at, ring))
        inside, outside = (
            means[np.clip(places[:, 1], 0, high - 1), np.clip(places[:, 0], 0, wide - 1)] for places in (at, around)
        )
        if max(np.abs(means[..., 1:] - GREY_LAB).max() for means in (inside, outside)) < COLOURLESS:
            return np.zeros(len(self.at), bool)
        apart = np.linalg.norm(outside[:, None] - outside[None], axis=2)
        np.fill_diagonal(apart, np.inf)
        near = max(SAME_LAB, float(np.quantile(apart.min(axis=1), SAME_RING)))
        return np.linalg.norm(inside[:, None] - outside[None], axis=2).min(axis=1) <= near

    def _looked(self, at: Float64) -> Float32:
        """(n, pixels): the squares around places (n, 2), less their means; NaN beyond the patch."""
        x, y = np.rint(self._to_patch(at)).astype(int).T
        wide, high = self._shape
        inside = (x >= LOOK) & (y >= LOOK) & (x < wide - LOOK) & (y < high - LOOK)
        x, y = np.clip(x, LOOK, wide - LOOK - 1), np.clip(y, LOOK, high - LOOK - 1)
        squares = self._patch[y[:, None, None] + _LOOK[:, None], x[:, None, None] + _LOOK]
        looks = squares.reshape(len(at), len(_LOOK) ** 2).astype(np.float32)
        looks -= looks.mean(axis=1, keepdims=True)
        looks[~inside] = np.nan
        return looks

    def _to_patch(self, at: Float64) -> Float64:
        return (at - self._centre) * self.zoom + self._shape / 2 - 0.5

    def _sampled(self, image: UInt8, centre: Float64) -> UInt8:
        """(planes, rows, columns): the image around `centre`, resampled to the patch."""
        wide, high = self._shape.tolist()
        x, y = centre.tolist()
        return resample(image, x, y, wide / self.zoom, high / self.zoom, wide, high)

    def _followed(self, points: Float64, guess: Float64, after: UInt8) -> tuple[Float32, Bool]:
        """Where points (n, 2) of the patch went in the next, and which of them were followed there and back (n,)."""
        at, ahead = points.astype(np.float32)[:, None], guess.astype(np.float32)[:, None]
        found, seen, _ = self._flow(self._patch, after, at, at + ahead)
        back, seen_back, _ = self._flow(after, self._patch, found, found - ahead)
        good = (seen[:, 0] == 1) & (seen_back[:, 0] == 1) & (np.linalg.norm(back - at, axis=2)[:, 0] < BACK_PX)
        inside = [np.all((of[:, 0] > 1) & (of[:, 0] < self._shape - 2), axis=1) for of in (at, found)]
        return np.asarray(found, np.float32)[:, 0], good & inside[0] & inside[1]

    def _flow(self, before: UInt8, after: UInt8, at: MatLike, ahead: MatLike) -> Sequence[MatLike]:
        window, flags = (self._window, self._window), cv2.OPTFLOW_USE_INITIAL_FLOW
        return cv2.calcOpticalFlowPyrLK(
            before, after, at, ahead, winSize=window, maxLevel=2, criteria=_SEARCH, flags=flags
        )


def _bgr(planes: UInt8) -> UInt8:
    """(1 or 3, rows, columns) -> (rows, columns, 3)."""
    return np.asarray(cv2.merge([planes[0], planes[len(planes) // 2], planes[-1]]), np.uint8)


def _grey(planes: UInt8) -> UInt8:
    """(1 or 3, rows, columns) -> (rows, columns)."""
    return planes[0] if len(planes) == 1 else np.asarray(cv2.cvtColor(_bgr(planes), cv2.COLOR_BGR2GRAY), np.uint8)


def _mapped(similarity: Float64, points: Float64) -> Float64:
    """Points (n, 2) through (2, 3)."""
    return points @ similarity[:, :2].T + similarity[:, 2]
