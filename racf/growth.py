"""How much the target grew from one image to the next, by the optical flow of its own pixels.

The scale filter knows the target as it was over some forty frames and answers in steps; one that grows by 4 % a frame
leaves it behind.  The flow of a grid of points has no memory: it knows the change between two images alone, and its
errors add up.  So it predicts the size, and the scale filter corrects it.

Of the points those count that agree best on one similarity (RANSAC).  Where few agree (a walker's limbs) nothing is
predicted, nor where what surrounds the box moves in the same way: then it may be the ground that was measured, or a
tree, and a box that grows with it holds ever less of the target.  What comes nearer grows in width and height alike;
ground that slides beside the target, or a car that turns, seems to grow in one of them, so that the lesser is believed.
Numbers are measured: docs/notebook.md, "The size by optical flow".
"""

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from racf.flow import LEAST_POINTS, Flow

Float32 = NDArray[np.float32]

LEAST_SIDE_PX = 20.0  # of the box: fewer pixels have no flow
AGREE = 0.0075  # of the target's side: how near a point must be to where the similarity puts it
LEAST_AGREEING = 0.5  # share of the points inside, of those whose flow leads back best, that must agree
MOST_ALIKE = 0.5  # share of those around that may agree also
MOST = 0.1  # largest change that is believed, of the size's logarithm: a factor of 1.1 a frame


def growth(flow: Flow) -> float:
    """The target's size in the image that the flow looked at over the remembered one; 1 if it cannot be told."""
    box = flow.box
    if box is None or min(box.w, box.h) < LEAST_SIDE_PX:
        return 1.0
    before, after, apart = flow.inside()
    if len(before) < LEAST_POINTS:
        return 1.0
    best, within = apart <= np.median(apart), AGREE * math.sqrt(box.area) * flow.zoom
    before, after = before[best], after[best]
    similarity, agree = cv2.estimateAffinePartial2D(before, after, ransacReprojThreshold=within)
    if np.mean(agree) < LEAST_AGREEING:  # none agrees where there is no similarity
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
