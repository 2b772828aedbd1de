"""From the frame to fixed-size samples: the only file that turns `(x, y)` geometry into `[row, col]` pixels."""

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from racf.kernels import compiled

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


@compiled
def _taps(first: float, step: float, stride: int, size: int, places: UInt32, weights: Int32) -> None:
    """Both neighbours of each sampling place, in 0..size-1, times `stride`; the second one's weight in 1/256."""
    for i in range(weights.size):
        at = min(max(first + step * i, 0.0), size - 1.0)
        whole = int(at)
        places[0, i], places[1, i] = whole * stride, min(whole + 1, size - 1) * stride
        weights[i] = int((at - whole) * 256 + 0.5)


@compiled
def bilinear(
    source: UInt8, first_x: float, step_x: float, first_y: float, step_y: float,
    places: UInt32, weights: Int32, line: Int32, out: UInt8,
) -> None:  # fmt: skip
    """Sample (H, W, C) at x = first_x + j step_x, y = first_y + i step_y into (C, h, w); border pixels repeat.

    Axes do not mix, so each row is first blended from two source rows, then each pixel from two of its columns:
    what `cv2.remap` does with a map, without the map.  Planes, because every later loop wants one channel in a row.
    `places`, `weights` and `line` are scratch, see `scratch`.
    """
    channels, rows, cols = out.shape
    # Unsigned places spare numba the check for Python's negative indices, which would keep loops from vectorising.
    x_place, y_place, x_weight, y_weight = places[:, :cols], places[:, cols:], weights[:cols], weights[cols:]
    _taps(first_x, step_x, channels, source.shape[1], x_place, x_weight)
    _taps(first_y, step_y, 1, source.shape[0], y_place, y_weight)
    begin, end = np.int64(x_place[0, 0]), np.int64(x_place[1, cols - 1]) + channels
    for j in range(cols):
        x_place[0, j] -= np.uint32(begin)
        x_place[1, j] -= np.uint32(begin)
    flat = source.reshape(source.shape[0], -1)
    for i in range(rows):
        upper, lower, share = flat[y_place[0, i], begin:end], flat[y_place[1, i], begin:end], y_weight[i]
        for j in range(end - begin):
            line[j] = 256 * np.int32(upper[j]) + share * (np.int32(lower[j]) - np.int32(upper[j]))
        for c in range(channels):
            plane, from_c = out[c, i], line[c:]
            for j in range(cols):
                left, right = from_c[x_place[0, j]], from_c[x_place[1, j]]
                plane[j] = (256 * left + x_weight[j] * (right - left) + 32768) >> 16


def scratch(source: UInt8, rows: int, cols: int) -> tuple[UInt32, Int32, Int32]:
    """What `bilinear` works with between a source and an output of this size."""
    line = np.empty(source.shape[1] * source.shape[2], np.int32)
    return np.empty((2, rows + cols), np.uint32), np.empty(rows + cols, np.int32), line


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
    bilinear(source, first_x, step_x / factor, first_y, step_y / factor, *scratch(source, out_h, out_w), out)
    return out
