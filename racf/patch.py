"""From the frame to fixed-size samples: the only file that converts `(x, y)` geometry to `[row, col]` pixels."""

import math
from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from racf.kernels import compiled

UInt8 = NDArray[np.uint8]
UInt32 = NDArray[np.uint32]
Int32 = NDArray[np.int32]
Float64 = NDArray[np.float64]
Grids = Float64 | Sequence[tuple[float, float, float, float]]


def shrunk(image: UInt8, region: tuple[float, float, float, float], factor: int) -> tuple[UInt8, float, float]:
    """The part of `image` under `region` (x, y, w, h), averaged over `factor` x `factor` blocks, as (H, W, C).

    Returns the part and its top-left corner in the frame's pixels.  Averaging first prevents aliasing of fine texture
    when a large target is resampled; with factor 1 the image itself is returned.  The part is always read-only, because
    numba would otherwise compile every kernel twice, for read-only and for writable arrays.
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
def _sampled(
    source: UInt8, channels: int, grids: Float64, places: UInt32, weights: Int32, line: UInt32, pairs: UInt32,
    taken: UInt32, out: UInt8, shape: tuple[int, int],
) -> None:  # fmt: skip
    """See `bilinear`; source (H, W C) and out (N, C, h, w) flat.

    Scratch: places (2, 2, side) are indices, weights (2, side), line is a row of the source, pairs the same with each
    pixel's right neighbour packed in; a pixel without a neighbour gives it the weight 0.
    """
    rows, cols = shape
    size, width, beside = np.uint32(shape[1]), np.uint32(pairs.size), np.uint32(channels)
    for n in range(grids.shape[0]):
        for axis in range(2):
            first, step, last, stride = grids[n, axis, 0], grids[n, axis, 1], grids[n, axis, 2], grids[n, axis, 3]
            for i in range(shape[1 - axis]):
                at = first + step * i
                at = at if at > 0.0 else 0.0
                at = at if at < last else last
                whole = np.floor(at)
                places[axis, 0, i] = np.uint32(whole * stride)
                places[axis, 1, i] = np.uint32((whole + 1.0 if whole < last else whole) * stride)
                weights[axis, i] = np.int32((at - whole) * 256 + 0.5)
        begin = places[0, 0, 0]
        for j in range(size):
            places[0, 0, j] -= begin
        count = np.uint32(places[0, 1, cols - 1] - begin + channels)
        for i in range(rows):
            upper = np.uint32(places[1, 0, i] * width + begin)
            lower = np.uint32(places[1, 1, i] * width + begin)
            share = weights[1, i]
            for j in range(count):
                line[j] = 256 * np.int32(source[upper + j]) + share * (
                    np.int32(source[lower + j]) - np.int32(source[upper + j])
                )
            for j in range(count):
                pairs[j] = line[j] | (line[j + beside] << np.uint32(16))
            for c in range(channels):
                into, of_c = np.uint32(((n * channels + c) * rows + i) * cols), pairs[c:]
                for j in range(size):  # separate from the sums below, so that they vectorise
                    taken[j] = of_c[places[0, 0, j]]
                for j in range(size):
                    left, right = np.int32(taken[j] & np.uint32(65535)), np.int32(taken[j] >> np.uint32(16))
                    out[into + j] = np.int32(256 * left + weights[0, j] * (right - left) + 32768) >> 16


def bilinear(source: UInt8, grids: Grids, out: UInt8) -> None:
    """Sample (H, W, C) into (N, C, h, w): the n-th at x = first_x + j step_x, y = first_y + i step_y.

    `grids` (N, 4): first_x, step_x, first_y, step_y.  Border pixels repeat.  Axes do not mix, so each row is first
    blended from two source rows, then each pixel from two of its columns: like `cv2.remap`, but without a map.  The
    output has planes, because every later loop reads one channel at a time.
    """
    rows, cols, channels = source.shape
    _, _, high, wide = out.shape
    axes = np.empty((len(out), 2, 4))
    axes[..., :2] = np.reshape(grids, (-1, 2, 2))
    axes[..., 2], axes[..., 3] = (cols - 1, rows - 1), (channels, 1)
    side, width = max(high, wide), cols * channels
    line, pairs, taken = (np.empty(size, np.uint32) for size in (width + channels, width, side))
    _sampled(source.reshape(-1), channels, axes, np.empty((2, 2, side), np.uint32), np.empty((2, side), np.int32),
             line, pairs, taken, out.reshape(-1), (high, wide))  # fmt: skip


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
    bilinear(source, [(first_x, step_x / factor, first_y, step_y / factor)], out[None])
    return out
