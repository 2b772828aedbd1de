"""A box for a click: what stands out from its surroundings at the place that a person pointed at.

GrabCut (Rother et al. 2004) separates a window around the click into target and surroundings, at several scales.  A
small window may hold only a part of the target, a large one also its shadow or a path; the answer is the middle one of
the segments that do not touch their window's border.  `python -m tools.studies.clicks` measures it.
"""

import cv2
import numpy as np
from numpy.typing import NDArray

from racf.box import Box

UInt8 = NDArray[np.uint8]

SIDES = (0.06, 0.09, 0.13, 0.18, 0.26, 0.37, 0.52)
"""Sides of the windows, in image heights: targets of 6 to 130 pixels in 360 rows."""
SQUARE_PX = 64  # GrabCut sees each window at this size: 8 ms
SURE = 0.10  # diameter of the middle in which everything is target, as a fraction of the window
FRAME = 0.08  # width of the border in which everything is surroundings, as a fraction of the window
MIN_SHARE, MAX_SHARE = 0.015, 0.45  # of the window that a segment may cover
ROUNDS = 3


def box_at(image: UInt8, x: float, y: float) -> Box | None:
    """The box of what is at pixel (x, y) of `image` (rows, columns[, 3]); None if nothing stands out there."""
    rows, columns = image.shape[:2]
    if not (0 <= x < columns and 0 <= y < rows):
        return None
    colour = image if image.ndim == 3 else cv2.cvtColor(image, cv2.COLOR_GRAY2BGR)
    pixels = np.asarray(colour, np.uint8)
    found = (free_segment(pixels, Box.around(x, y, side * rows, side * rows)) for side in SIDES)
    segments = [segment for segment in found if segment is not None]
    return segments[len(segments) // 2] if segments else None


def free_segment(image: UInt8, window: Box) -> Box | None:
    """The box, in the image's pixels, of the segment in the window's middle; None if it touches the window's border."""
    scale = window.w / SQUARE_PX
    matrix = np.array([[scale, 0.0, window.x + scale / 2 - 0.5], [0.0, scale, window.y + scale / 2 - 0.5]])
    flags = cv2.INTER_AREA if scale > 1 else cv2.INTER_LINEAR
    square = cv2.warpAffine(
        image, matrix, (SQUARE_PX, SQUARE_PX), flags=flags | cv2.WARP_INVERSE_MAP, borderMode=cv2.BORDER_REPLICATE
    )
    mask = np.full((SQUARE_PX, SQUARE_PX), cv2.GC_PR_BGD, np.uint8)
    border, middle = round(FRAME * SQUARE_PX), SQUARE_PX // 2
    cv2.circle(mask, (middle, middle), round(0.3 * SQUARE_PX), cv2.GC_PR_FGD, -1)
    mask[:border], mask[-border:], mask[:, :border], mask[:, -border:] = (cv2.GC_BGD,) * 4
    cv2.circle(mask, (middle, middle), max(round(SURE * SQUARE_PX / 2), 1), cv2.GC_FGD, -1)
    cv2.setRNGSeed(0)  # equal images give equal boxes
    models = np.zeros((1, 65)), np.zeros((1, 65))
    try:
        cv2.grabCut(square, mask, (0, 0, 0, 0), *models, ROUNDS, cv2.GC_INIT_WITH_MASK)
    except cv2.error:  # no samples on one side: nothing stands out
        return None
    target = np.isin(mask, (cv2.GC_FGD, cv2.GC_PR_FGD)).astype(np.uint8)
    _, labels, stats, _ = cv2.connectedComponentsWithStats(target, connectivity=8)
    left, top, w, h, area = (int(v) for v in stats[labels[middle, middle]])
    is_free = min(left, top, SQUARE_PX - left - w, SQUARE_PX - top - h) > border
    if labels[middle, middle] == 0 or not is_free or not MIN_SHARE <= area / SQUARE_PX**2 <= MAX_SHARE:
        return None
    return Box(window.x + left * scale, window.y + top * scale, w * scale, h * scale)
