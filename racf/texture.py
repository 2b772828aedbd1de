"""Whether a box has the features that a tracker needs: edges in both directions, above the image's noise.

A patch of sky, noise or a single edge (a horizon, a kerb, stripes) looks the same at another position, so a response on
it is no evidence, however sharp it is.  The structure tensor [Shi and Tomasi 1994] decides: the smaller of its
eigenvalues is the mean squared gradient in the direction in which the patch changes least.
"""

import cv2
import numpy as np
from numpy.typing import NDArray

from racf.box import Box

AROUND = 1.5  # times the box: the target's outline counts also
SMOOTH_PX = 2.0  # of the Gaussian before the gradient; noise is uncorrelated between pixels, edges are not
LEAST = 0.25
"""Least root of the smaller eigenvalue, grey levels a pixel.  JPEG blocks in a clear sky have up to 0.2, an object 10
grey levels darker than its surroundings 0.5, the boxes of 21 real sequences at least 1.5: of the 4127 frames examined
one, under a dark bridge, counts as featureless."""
OF_NOISE = 0.06
"""The same as a multiple of the noise's standard deviation: white noise of 1 has 0.03."""
LAPLACIAN = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]], np.float32)
"""Zero for anything linear in either direction; it multiplies white noise's deviation by six [Immerkaer 1996]."""


def is_featureless(image: NDArray[np.uint8], box: Box) -> bool:
    """Whether the box, in an image of (rows, columns[, 3]) in BGR or grey, lacks edges in at least one direction."""
    rows, cols = image.shape[:2]
    wide = box.scaled(AROUND)
    left, top = max(int(wide.x), 0), max(int(wide.y), 0)
    right, bottom = min(int(np.ceil(wide.x + wide.w)), cols), min(int(np.ceil(wide.y + wide.h)), rows)
    part = np.ascontiguousarray(image[top:bottom, left:right])
    if min(part.shape[:2], default=0) < LAPLACIAN.shape[0]:
        return True
    grey = (part if part.ndim == 2 else cv2.cvtColor(part, cv2.COLOR_BGR2GRAY)).astype(np.float32)
    return weakest_gradient(grey) < max(LEAST, OF_NOISE * noise(grey))


def weakest_gradient(grey: NDArray[np.float32]) -> float:
    """Root mean square of the gradient in the direction in which a patch changes least, grey levels a pixel."""
    smooth = cv2.GaussianBlur(grey, (0, 0), SMOOTH_PX)
    gx, gy = (np.asarray(cv2.Sobel(smooth, cv2.CV_32F, *order, scale=1 / 8), np.float64) for order in ((1, 0), (0, 1)))
    xx, xy, yy = (float(np.mean(product)) for product in (gx * gx, gx * gy, gy * gy))
    lesser = (xx + yy) / 2 - np.hypot((xx - yy) / 2, xy)
    return float(np.sqrt(max(lesser, 0.0)))


def noise(grey: NDArray[np.float32]) -> float:
    """Standard deviation of a patch's white noise, grey levels, by its quietest fifth: a target has many edges."""
    inner = np.abs(cv2.filter2D(grey, cv2.CV_32F, LAPLACIAN))[1:-1, 1:-1]
    return float(np.percentile(inner, 20.0)) / (0.2533 * 6.0)  # of a normal distribution
