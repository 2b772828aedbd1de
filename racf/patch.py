"""From the frame to fixed-size samples: the only file that turns `(x, y)` geometry into `[row, col]` pixels."""

import math

import cv2
import numpy as np
from numpy.typing import NDArray

UInt8 = NDArray[np.uint8]
Float32 = NDArray[np.float32]


def shrunk(image: UInt8, region: tuple[float, float, float, float], factor: int) -> tuple[UInt8, float, float]:
    """The part of `image` under `region` (x, y, w, h), averaged over `factor` x `factor` blocks.

    Returns the part and where its top-left corner lies, in the frame's pixels.  Averaging first is what keeps fine
    texture from aliasing when a large target is resampled; with factor 1 the frame itself is returned.
    """
    if factor <= 1:
        return image, 0.0, 0.0
    rows, cols = image.shape[:2]
    x, y, w, h = region
    left = min(max(math.floor(x) - factor, 0), cols - 1)
    top = min(max(math.floor(y) - factor, 0), rows - 1)
    wide = min(math.ceil(x + w) + factor, cols) - left
    high = min(math.ceil(y + h) + factor, rows) - top
    wide, high = max(wide // factor, 1) * factor, max(high // factor, 1) * factor
    part = image[top : top + high, left : left + wide]
    small = cv2.resize(part, (max(wide // factor, 1), max(high // factor, 1)), interpolation=cv2.INTER_AREA)
    return np.asarray(small, dtype=np.uint8), float(left), float(top)


def resample(
    image: UInt8, centre_x: float, centre_y: float, width: float, height: float, out_w: int, out_h: int
) -> UInt8:
    """The `width` x `height` pixels around a centre, bilinearly resampled to `(out_h, out_w[, 3])`.

    Beyond the frame its border pixels are repeated.  Output pixel j covers `[j, j+1) * width/out_w` of the region.
    """
    step_x, step_y = width / out_w, height / out_h
    factor = int(min(step_x, step_y))
    region = (centre_x - width / 2, centre_y - height / 2, width, height)
    source, left, top = shrunk(image, region, factor)
    factor = max(factor, 1)
    # Source pixel i has its middle at left + (i + 1/2) * factor; output pixel j at region.x + (j + 1/2) * step.
    to_source = np.array(
        [
            [step_x / factor, 0.0, (region[0] + step_x / 2 - left) / factor - 0.5],
            [0.0, step_y / factor, (region[1] + step_y / 2 - top) / factor - 0.5],
        ]
    )
    patch = cv2.warpAffine(
        source,
        to_source,
        (out_w, out_h),
        flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
        borderMode=cv2.BORDER_REPLICATE,
    )
    return np.asarray(patch, dtype=np.uint8)
