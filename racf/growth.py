"""How much the target grew from one image to the next, by the optical flow of its own pixels.

The scale filter has a memory of some forty frames and answers in steps, so it lags behind a target that grows by 4 % a
frame.  The flow of a grid of points has no memory: it measures only the change between two images, and its errors add
up.  So it predicts the size, and the scale filter corrects it.

Only the points that agree best on one similarity count (RANSAC).  Nothing is predicted if few agree (a walker's limbs),
nor if the box's surroundings move in the same way: then the flow may be that of the ground or a tree, and a box that
grows with it holds ever less of the target.  An approaching target grows equally in width and height; ground that
slides past it, or a turning car, seems to grow in only one of them, so the smaller growth counts.
Numbers are measured: docs/notebook.md, "The size by optical flow".
"""

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from racf.flow import LEAST_POINTS, Flow

Float32 = NDArray[np.float32]

LEAST_SIDE_PX = 20.0  # of the box: fewer pixels have no flow
AGREE = 0.0075  # largest error of an inlier of the similarity, in sides of the target
LEAST_AGREEING = 0.5  # least fraction of inliers among the better half of the points inside
MOST_ALIKE = 0.5  # largest fraction of the points around that may also be inliers
MOST = 0.1  # limit on the change of the size's logarithm: a factor of 1.1 a frame


def growth(flow: Flow) -> float:
    """The target's size in the flow's next image over that in the remembered one; 1 if it cannot be measured."""
    box = flow.box
    if box is None or min(box.w, box.h) < LEAST_SIDE_PX:
        return 1.0
    before, after, apart = flow.inside()
    if len(before) < LEAST_POINTS:
        return 1.0
    best, within = apart <= np.median(apart), AGREE * math.sqrt(box.area) * flow.zoom
    before, after = before[best], after[best]
    similarity, agree = cv2.estimateAffinePartial2D(before, after, ransacReprojThreshold=within)
    if np.mean(agree) < LEAST_AGREEING:  # all 0 if there is no similarity
        return 1.0
    grown = _log_growth(before[agree[:, 0] == 1], after[agree[:, 0] == 1])
    if grown == 0.0:
        return 1.0
    before, after = flow.around()
    off = np.linalg.norm(before @ similarity[:, :2].T + similarity[:, 2] - after, axis=1)
    if len(off) >= LEAST_POINTS and np.mean(off <= within) >= MOST_ALIKE:
        return 1.0
    return math.exp(min(max(grown, -MOST), MOST))


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
