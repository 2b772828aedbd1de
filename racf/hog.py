"""FHOG: Felzenszwalb's 31-channel histogram of oriented gradients (PAMI 2010), in cells.

Channels: 18 contrast-sensitive orientations, 9 insensitive, 4 texture energies.  Gradient of the strongest colour
channel, hard orientation bins, bilinear vote into the four nearest cells, each cell normalised by the energy of the
four 2 x 2 blocks it belongs to, clipped at 0.2.  Blocks beyond the border repeat the border's cells, so that an
(H, W) patch gives exactly (H/cell, W/cell, 31).
"""

import functools

import numba
import numpy as np
from numpy.typing import NDArray

UInt8 = NDArray[np.uint8]
Float32 = NDArray[np.float32]
Int32 = NDArray[np.int32]

ORIENTATIONS = 9
CHANNELS = 3 * ORIENTATIONS + 4
CLIP = 0.2
EPSILON = 2.5e-5  # added to block energies (gradients of a 0..1 image, summed over cells)
TEXTURE_GAIN = 0.2357  # 1/sqrt(18): each texture channel is a projection, as in Felzenszwalb's Eq. 7


@functools.lru_cache(maxsize=1)
def orientation_bins() -> UInt8:
    """(511, 511): the contrast-sensitive bin 0..17 of the gradient (dy, dx), each offset by 255."""
    d = np.arange(-255, 256)
    turn = np.arctan2(d[:, None], d[None, :]) / (np.pi / ORIENTATIONS)
    return (np.round(turn).astype(np.int64) % (2 * ORIENTATIONS)).astype(np.uint8)


def gradients_numpy(patch: UInt8) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """dy, dx of the channel with the strongest gradient at each pixel of (C, H, W); border pixels repeat."""
    padded = np.pad(patch.astype(np.int64), ((0, 0), (1, 1), (1, 1)), mode="edge")
    dx = padded[:, 1:-1, 2:] - padded[:, 1:-1, :-2]
    dy = padded[:, 2:, 1:-1] - padded[:, :-2, 1:-1]
    best = np.argmax(dx**2 + dy**2, axis=0)[None]
    return np.take_along_axis(dy, best, 0)[0], np.take_along_axis(dx, best, 0)[0]


def _votes(cells: int, cell: int) -> NDArray[np.float64]:
    """(cells, cells * cell): how much each pixel of a row votes for each cell, falling linearly with distance."""
    middle_of_pixel = (np.arange(cells * cell) + 0.5) / cell
    middle_of_cell = np.arange(cells) + 0.5
    return np.maximum(0.0, 1.0 - np.abs(middle_of_cell[:, None] - middle_of_pixel[None, :]))


def fhog_numpy(patch: UInt8, cell: int) -> Float32:
    """The equations that `fhog` compiles.  (C, H, W) -> (H/cell, W/cell, 31)."""
    rows, cols = patch.shape[1] // cell, patch.shape[2] // cell
    dy, dx = (d[: rows * cell, : cols * cell] for d in gradients_numpy(patch))
    magnitude = np.sqrt(dx**2 + dy**2) / 510
    one_hot = np.eye(2 * ORIENTATIONS)[orientation_bins()[dy + 255, dx + 255]] * magnitude[..., None]
    sensitive = np.einsum("ry,yxo,cx->rco", _votes(rows, cell), one_hot, _votes(cols, cell))
    insensitive = sensitive[..., :ORIENTATIONS] + sensitive[..., ORIENTATIONS:]
    energy = np.pad(np.sum(insensitive**2, axis=2), 1, mode="edge")
    block = energy[:-1, :-1] + energy[1:, :-1] + energy[:-1, 1:] + energy[1:, 1:]  # (rows+1, cols+1)
    out = np.zeros((rows, cols, CHANNELS))
    for corner, (top, left) in enumerate(((0, 0), (0, 1), (1, 0), (1, 1))):
        norm = 1 / np.sqrt(block[top : top + rows, left : left + cols, None] + EPSILON)
        clipped = np.minimum(sensitive * norm, CLIP)
        out[..., : 2 * ORIENTATIONS] += clipped / 2
        out[..., 2 * ORIENTATIONS : 3 * ORIENTATIONS] += np.minimum(insensitive * norm, CLIP) / 2
        out[..., 3 * ORIENTATIONS + corner] = TEXTURE_GAIN * clipped.sum(axis=2)
    return out.astype(np.float32)


@numba.njit(cache=True, fastmath=True)
def _strongest_gradients(patch: UInt8, y: int, strength: Int32, index: Int32) -> None:
    """For each pixel of row y of (C, H, W): the gradient's squared strength, and (dy + 255) * 511 + dx + 255."""
    channels, height, width = patch.shape
    above, below = max(y - 1, 0), min(y + 1, height - 1)
    strength[:] = -1
    for c in range(channels):
        row, upper, lower = patch[c, y], patch[c, above], patch[c, below]
        for x in range(1, width - 1):
            dx, dy = np.int32(row[x + 1]) - np.int32(row[x - 1]), np.int32(lower[x]) - np.int32(upper[x])
            square = dx * dx + dy * dy
            better = square > strength[x]
            strength[x] = square if better else strength[x]
            index[x] = (dy + 255) * 511 + dx + 255 if better else index[x]
        for x in (0, width - 1):
            dx = np.int32(row[min(x + 1, width - 1)]) - np.int32(row[max(x - 1, 0)])
            dy = np.int32(lower[x]) - np.int32(upper[x])
            if dx * dx + dy * dy > strength[x]:
                strength[x], index[x] = dx * dx + dy * dy, (dy + 255) * 511 + dx + 255


@numba.njit(cache=True, fastmath=True)
def _histogram(patch: UInt8, cell: int, bins: UInt8) -> Float32:
    """(rows + 2, cols + 2, 18): bilinear votes, with a margin for those that fall outside."""
    width, rows, cols = patch.shape[2], patch.shape[1] // cell, patch.shape[2] // cell
    directions = 2 * ORIENTATIONS
    histogram = np.zeros((rows + 2, (cols + 2) * directions), np.float32)
    strength, index = np.empty(width, np.int32), np.empty(width, np.int32)
    magnitude, place = np.empty(width, np.float32), np.empty(width, np.uint32)
    at_x = (np.arange(cols * cell) + 0.5) / cell + 0.5
    share_x = (at_x - np.floor(at_x)).astype(np.float32)
    first_place = (np.floor(at_x) * directions).astype(np.uint32)
    bin_of, scale = bins.ravel(), np.float32(1.0 / 510.0)
    for y in range(rows * cell):
        _strongest_gradients(patch, y, strength, index)
        for x in range(width):
            magnitude[x] = np.sqrt(np.float32(strength[x])) * scale
        for x in range(cols * cell):
            place[x] = first_place[x] + np.uint32(bin_of[index[x]])
        at_y = (y + 0.5) / cell + 0.5
        row = int(at_y)
        share_y = np.float32(at_y - row)
        upper, lower = histogram[row], histogram[row + 1]
        upper_next, lower_next = upper[directions:], lower[directions:]
        for x in range(cols * cell):
            down = magnitude[x] * share_y
            up = magnitude[x] - down
            up_next, down_next = up * share_x[x], down * share_x[x]
            at = place[x]
            upper[at] += up - up_next
            upper_next[at] += up_next
            lower[at] += down - down_next
            lower_next[at] += down_next
    return histogram.reshape(rows + 2, cols + 2, directions)


@numba.njit(cache=True, fastmath=True)
def fhog(patch: UInt8, cell: int, bins: UInt8, out: Float32) -> None:
    """Write the FHOG of (C, H, W) into `out[..., :31]`, (H/cell, W/cell, >= 31); same as `fhog_numpy`."""
    histogram = _histogram(patch, cell, bins)
    rows, cols = patch.shape[1] // cell, patch.shape[2] // cell
    energy = np.zeros((rows + 2, cols + 2), np.float32)
    for r in range(1, rows + 1):
        for c in range(1, cols + 1):
            for o in range(ORIENTATIONS):
                both = histogram[r, c, o] + histogram[r, c, o + ORIENTATIONS]
                energy[r, c] += both * both
    for r in range(1, rows + 1):
        energy[r, 0], energy[r, cols + 1] = energy[r, 1], energy[r, cols]
    for c in range(cols + 2):
        energy[0, c], energy[rows + 1, c] = energy[1, c], energy[rows, c]
    norm = np.empty((rows + 1, cols + 1), np.float32)
    for r in range(rows + 1):
        for c in range(cols + 1):
            block = energy[r, c] + energy[r + 1, c] + energy[r, c + 1] + energy[r + 1, c + 1]
            norm[r, c] = np.float32(1.0) / np.sqrt(block + np.float32(EPSILON))
    clip, half, gain = np.float32(CLIP), np.float32(0.5), np.float32(TEXTURE_GAIN)
    for r in range(rows):
        for c in range(cols):
            n0, n1, n2, n3 = norm[r, c], norm[r, c + 1], norm[r + 1, c], norm[r + 1, c + 1]
            t0 = t1 = t2 = t3 = np.float32(0)
            for o in range(2 * ORIENTATIONS):
                h = histogram[r + 1, c + 1, o]
                h0, h1, h2, h3 = min(h * n0, clip), min(h * n1, clip), min(h * n2, clip), min(h * n3, clip)
                out[r, c, o] = (h0 + h1 + h2 + h3) * half
                t0, t1, t2, t3 = t0 + h0, t1 + h1, t2 + h2, t3 + h3
            for o in range(ORIENTATIONS):
                h = histogram[r + 1, c + 1, o] + histogram[r + 1, c + 1, o + ORIENTATIONS]
                both = min(h * n0, clip) + min(h * n1, clip) + min(h * n2, clip) + min(h * n3, clip)
                out[r, c, 2 * ORIENTATIONS + o] = both * half
            first = 3 * ORIENTATIONS
            out[r, c, first], out[r, c, first + 1] = gain * t0, gain * t1
            out[r, c, first + 2], out[r, c, first + 3] = gain * t2, gain * t3
