"""From the frame to fixed-size samples: the only file that turns `(x, y)` geometry into `[row, col]` pixels."""

import math

import cv2
import numba
import numpy as np
from numpy.typing import NDArray

UInt8 = NDArray[np.uint8]
UInt32 = NDArray[np.uint32]
Int32 = NDArray[np.int32]


def shrunk(image: UInt8, region: tuple[float, float, float, float], factor: int) -> tuple[UInt8, float, float]:
    """The part of `image` under `region` (x, y, w, h), averaged over `factor` x `factor` blocks, as (H, W, C).

    Returns the part and where its top-left corner lies, in the frame's pixels.  Averaging first is what keeps fine
    texture from aliasing when a large target is resampled; with factor 1 the image itself is returned.  The part is
    read-only even if the image is not: numba would compile every kernel once for each kind.
    """
    layered = image if image.ndim == 3 else image[..., None]
    if factor <= 1:
        return _read_only(np.ascontiguousarray(layered)), 0.0, 0.0
    rows, cols = image.shape[:2]
    x, y, w, h = region
    left = min(max(math.floor(x) - factor, 0), cols - 1)
    top = min(max(math.floor(y) - factor, 0), rows - 1)
    wide = min(math.ceil(x + w) + factor, cols) - left
    high = min(math.ceil(y + h) + factor, rows) - top
    wide, high = max(wide // factor, 1) * factor, max(high // factor, 1) * factor
    part = image[top : top + high, left : left + wide]
    small = cv2.resize(part, (max(wide // factor, 1), max(high // factor, 1)), interpolation=cv2.INTER_AREA)
    small = np.asarray(small, dtype=np.uint8).reshape(*small.shape[:2], layered.shape[2])
    return _read_only(small), float(left), float(top)


def _read_only(image: UInt8) -> UInt8:
    view = image.view()
    view.flags.writeable = False
    return view


@numba.njit(cache=True, fastmath=True)
def _taps(first: float, step: float, count: int, size: int) -> tuple[UInt32, UInt32, Int32]:
    """Both neighbours of each sampling place, kept inside 0..size-1, and the second one's weight in 1/256."""
    # Unsigned places spare numba the check for Python's negative indices, which would keep loops from vectorising.
    low, high, weight = np.empty(count, np.uint32), np.empty(count, np.uint32), np.empty(count, np.int32)
    for i in range(count):
        at = min(max(first + step * i, 0.0), size - 1.0)
        whole = int(at)
        low[i], high[i] = whole, min(whole + 1, size - 1)
        weight[i] = int((at - whole) * 256 + 0.5)
    return low, high, weight


@numba.njit(cache=True, fastmath=True)
def bilinear(source: UInt8, first_x: float, step_x: float, first_y: float, step_y: float, out: UInt8) -> None:
    """Sample (H, W, C) at x = first_x + j step_x, y = first_y + i step_y into (C, h, w); border pixels repeat.

    Axes do not mix, so each row is first blended from two source rows, then each pixel from two of its columns:
    what `cv2.remap` does with a map, without the map.  Planes, because every later loop wants one channel in a row.
    """
    channels, rows, cols = out.shape
    x_low, x_high, x_weight = _taps(first_x, step_x, cols, source.shape[1])
    y_low, y_high, y_weight = _taps(first_y, step_y, rows, source.shape[0])
    begin, count = x_low[0], np.int64(x_high[cols - 1]) + 1 - np.int64(x_low[0])
    x_low -= begin
    x_high -= begin
    blended, line = np.empty(count * channels, np.int32), np.empty(count, np.int32)
    for i in range(rows):
        upper, lower = source[y_low[i], begin:].reshape(-1), source[y_high[i], begin:].reshape(-1)
        share = y_weight[i]
        for j in range(count * channels):
            blended[j] = 256 * np.int32(upper[j]) + share * (np.int32(lower[j]) - np.int32(upper[j]))
        for c in range(channels):
            plane = out[c, i]
            for j in range(count):
                line[j] = blended[j * channels + c]
            for j in range(cols):
                left, right = line[x_low[j]], line[x_high[j]]
                plane[j] = (256 * left + x_weight[j] * (right - left) + 32768) >> 16


def resample(
    image: UInt8, centre_x: float, centre_y: float, width: float, height: float, out_w: int, out_h: int
) -> UInt8:
    """The `width` x `height` pixels around a centre, bilinearly resampled to `(C, out_h, out_w)`; C is 1 for grey.

    Beyond the frame its border pixels are repeated.  Output pixel j covers `[j, j+1) * width/out_w` of the region.
    """
    step_x, step_y = width / out_w, height / out_h
    factor = max(int(min(step_x, step_y)), 1)
    x, y = centre_x - width / 2, centre_y - height / 2
    source, left, top = shrunk(image, (x, y, width, height), factor)
    out = np.empty((source.shape[2], out_h, out_w), np.uint8)
    # Source pixel i has its middle at left + (i + 1/2) * factor; output pixel j at x + (j + 1/2) * step.
    first_x = (x + step_x / 2 - left) / factor - 0.5
    first_y = (y + step_y / 2 - top) / factor - 0.5
    bilinear(source, first_x, step_x / factor, first_y, step_y / factor, out)
    return out
