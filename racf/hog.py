"""FHOG: Felzenszwalb's 31-channel histogram of oriented gradients (PAMI 2010), in cells.

Channels: 18 contrast-sensitive orientations, 9 insensitive, 4 texture energies.  Gradient of the strongest colour
channel, hard orientation bins, bilinear vote into the four nearest cells, each cell normalised by the energy of the
four 2 x 2 blocks it belongs to, clipped at 0.2.  Blocks beyond the border repeat the border's cells, so that an
(H, W) patch gives exactly (H/cell, W/cell, 31).
"""

import functools

import numpy as np
from numpy.typing import NDArray

from racf.kernels import compiled

UInt8 = NDArray[np.uint8]
Float32 = NDArray[np.float32]
Int32 = NDArray[np.int32]
UInt32 = NDArray[np.uint32]

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


Scratch = tuple[Float32, UInt32, Float32, Int32, Float32, Float32, Float32]


def scratch(rows: int, cols: int, cell: int) -> Scratch:
    """What `fhog` works with on (rows * cell, cols * cell) pixels.

    Votes, their first places, shares of a cell's pixels, rows of pixels and of weights, histogram, energy.
    """
    width, directions = cols * cell, 2 * ORIENTATIONS
    place = (np.arange(width) + (cell + 1) // 2) // cell
    phase = (np.arange(width) + (cell + 1) // 2) % cell
    votes = np.zeros((2, cell * (cols + 1) * directions), np.float32)
    first = (phase * (cols + 1) + place) * directions  # of each column's bins among the votes
    at = (np.arange(cell) - (cell + 1) // 2 + 0.5) / cell + 0.5
    shares = (at - np.floor(at)).astype(np.float32)
    pixels, weights = np.empty((3, width), np.int32), np.empty((2, width), np.float32)
    histogram = np.empty((rows + 2, (cols + 2) * directions), np.float32)
    energy = np.empty((2, rows + 2, cols + 2), np.float32)
    return votes, first.astype(np.uint32), shares, pixels, weights, histogram, energy


@compiled
def _strongest_gradients(patch: UInt8, y: int, strength: Int32, index: Int32) -> None:
    """For each pixel of row y of (C, H, W): the gradient's squared strength, and (dy + 255) * 511 + dx + 255."""
    channels, height, width = patch.shape
    above, below = max(y - 1, 0), min(y + 1, height - 1)
    for x in range(width):
        strength[x] = -1
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


@compiled
def _add_up(votes: Float32, shares: Float32, cells: Float32, further: Float32) -> None:
    """Add a row of cells' votes to these cells and to those one further; the votes are zero afterwards."""
    plane, one = votes.size // shares.size, np.float32(1)
    if shares.size == 4:  # the usual size of a cell: each sum of four in one go
        v0, v1, v2, v3 = votes[:plane], votes[plane:], votes[2 * plane :], votes[3 * plane :]
        w0, w1, w2, w3 = shares[0], shares[1], shares[2], shares[3]
        for i in range(plane):
            further[i] += v0[i] * w0 + v1[i] * w1 + v2[i] * w2 + v3[i] * w3
        w0, w1, w2, w3 = one - w0, one - w1, one - w2, one - w3
        for i in range(plane):
            cells[i] += v0[i] * w0 + v1[i] * w1 + v2[i] * w2 + v3[i] * w3
    else:
        for phase in range(shares.size):
            of_phase, right = votes[phase * plane :], shares[phase]
            for i in range(plane):
                further[i] += of_phase[i] * right
            for i in range(plane):
                cells[i] += of_phase[i] * (one - right)
    for i in range(votes.size):
        votes[i] = np.float32(0)


@compiled
def _histogram(patch: UInt8, cell: int, bins: UInt8, work: Scratch) -> None:
    """Bilinear votes into the scratch's histogram (rows + 2, (cols + 2) 18), whose margin takes what falls outside.

    Neighbours in a row vote for one cell: each of the `cell` columns that share a cell has votes of its own, which are
    added up when their rows are done.  Otherwise each vote would wait for the one before.
    """
    votes, first, shares, pixels, weights, histogram, _ = work
    strength, index, at, bin_of = pixels[0], pixels[1], pixels[2], bins.ravel()
    up, down = weights[0], weights[1]
    rows, directions = patch.shape[1] // cell, 2 * ORIENTATIONS
    scale = np.float32(1.0 / 510.0)
    upper_votes, lower_votes = votes[0], votes[1]
    for i in range(histogram.shape[1]):
        histogram[0, i] = np.float32(0)
    before = (cell + 1) // 2
    for row in range(rows + 1):
        for y in range(max(row * cell - before, 0), min((row + 1) * cell - before, rows * cell)):
            _strongest_gradients(patch, y, strength, index)
            share = shares[(y + before) % cell]
            for x in range(first.size):
                magnitude = np.sqrt(np.float32(strength[x])) * scale
                down[x] = magnitude * share
                up[x] = magnitude - down[x]
            for x in range(first.size):
                at[x] = first[x] + bin_of[np.uint32(index[x])]
            for x in range(first.size):
                upper_votes[np.uint32(at[x])] += up[x]
                lower_votes[np.uint32(at[x])] += down[x]
        for i in range(histogram.shape[1]):
            histogram[row + 1, i] = np.float32(0)
        for which in range(2):
            _add_up(votes[which], shares, histogram[row + which], histogram[row + which, directions:])


@compiled
def fhog(patch: UInt8, cell: int, bins: UInt8, work: Scratch, window: Float32, out: Float32) -> None:
    """Write the FHOG of (C, H, W) times the window into `out[..., :31]`; same as `fhog_numpy` with a window of ones.

    `out` is (W/cell, H/cell, >= 31) and the window (W/cell, H/cell): first axis across.
    """
    _histogram(patch, cell, bins, work)
    histogram, energy, norm = work[5], work[6][0], work[6][1]
    rows, cols, directions = patch.shape[1] // cell, patch.shape[2] // cell, 2 * ORIENTATIONS
    for r in range(1, rows + 1):
        for c in range(1, cols + 1):
            here, total = histogram[r, c * directions : (c + 1) * directions], np.float32(0)
            for o in range(ORIENTATIONS):
                both = here[o] + here[o + ORIENTATIONS]
                total += both * both
            energy[r, c] = total
    for r in range(1, rows + 1):
        energy[r, 0], energy[r, cols + 1] = energy[r, 1], energy[r, cols]
    for c in range(cols + 2):
        energy[0, c], energy[rows + 1, c] = energy[1, c], energy[rows, c]
    for r in range(rows + 1):
        for c in range(cols + 1):
            block = energy[r, c] + energy[r + 1, c] + energy[r, c + 1] + energy[r + 1, c + 1]
            norm[r, c] = np.float32(1.0) / np.sqrt(block + np.float32(EPSILON))
    clip, half, gain = np.float32(CLIP), np.float32(0.5), np.float32(TEXTURE_GAIN)
    for r in range(rows):
        for c in range(cols):
            n0, n1, n2, n3 = norm[r, c], norm[r, c + 1], norm[r + 1, c], norm[r + 1, c + 1]
            t0 = t1 = t2 = t3 = np.float32(0)
            here, cell_out, share = histogram[r + 1, (c + 1) * directions :], out[c, r], window[c, r]
            for o in range(2 * ORIENTATIONS):
                h = here[o]
                h0, h1, h2, h3 = min(h * n0, clip), min(h * n1, clip), min(h * n2, clip), min(h * n3, clip)
                cell_out[o] = (h0 + h1 + h2 + h3) * half * share
                t0, t1, t2, t3 = t0 + h0, t1 + h1, t2 + h2, t3 + h3
            for o in range(ORIENTATIONS):
                h = here[o] + here[o + ORIENTATIONS]
                both = min(h * n0, clip) + min(h * n1, clip) + min(h * n2, clip) + min(h * n3, clip)
                cell_out[directions + o] = both * half * share
            first = 3 * ORIENTATIONS
            cell_out[first], cell_out[first + 1] = gain * t0 * share, gain * t1 * share
            cell_out[first + 2], cell_out[first + 3] = gain * t2 * share, gain * t3 * share
