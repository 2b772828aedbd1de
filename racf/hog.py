"""FHOG: Felzenszwalb's 31-channel histogram of oriented gradients (PAMI 2010), in cells.

Channels: 18 contrast-sensitive orientations, 9 insensitive, 4 texture energies.  Gradient of the strongest colour
channel, hard orientation bins, bilinear vote into the four nearest cells, each cell normalised by the energy of the
four 2 x 2 blocks it belongs to, clipped at 0.2.  Blocks beyond the border repeat the border's cells, so that an
(H, W) patch gives exactly (H/cell, W/cell, 31).
"""

import functools

import numpy as np
from numpy.typing import NDArray

from racf.kernels import compiled, inlined

UInt8 = NDArray[np.uint8]
Float32 = NDArray[np.float32]
Int32 = NDArray[np.int32]
UInt32 = NDArray[np.uint32]

ORIENTATIONS = 9
CHANNELS = 3 * ORIENTATIONS + 4
CLIP = 0.2
EPSILON = 2.5e-5  # added to block energies (gradients of a 0..1 image, summed over cells)
AT_ONCE = 4  # sets of votes that are summed together
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


Scratch = tuple[UInt32, Float32, Int32, Int32, UInt32, UInt32, Float32, Float32, Float32, Float32, Float32]


def scratch(rows: int, cols: int, cell: int, count: int = 1) -> Scratch:
    """The scratch arrays of `fhog` for `count` patches of (rows * cell, cols * cell) pixels.

    First index of each column's votes, weights of a cell's pixels, rows of pixels, indices and weights, votes,
    histograms, energy.
    """
    width, directions = cols * cell, 2 * ORIENTATIONS
    place = (np.arange(width) + (cell + 1) // 2) // cell
    phase = (np.arange(width) + (cell + 1) // 2) % cell
    first = (phase * (cols + 1) + place) * directions  # index of each column's bins in the votes
    at = (np.arange(cell) - (cell + 1) // 2 + 0.5) / cell + 0.5
    phases = -(-cell // AT_ONCE) * AT_ONCE
    shares = np.zeros((2, phases), np.float32)
    shares[1, :cell] = at - np.floor(at)
    shares[0] = 1 - shares[1]
    line, strength = np.empty(width + 2, np.int32), np.empty(width, np.int32)
    index, places = np.empty((2, width), np.uint32)
    (up, down), votes = np.empty((2, width), np.float32), np.zeros(2 * phases * (cols + 1) * directions, np.float32)
    histograms = np.empty((count, rows + 2, cols + 2, directions), np.float32)
    energy = np.empty((2, rows + 2, cols + 2), np.float32)
    return first.astype(np.uint32), shares, line, strength, index, places, up, down, votes, histograms, energy


@inlined
def _strongest_gradients(
    pixels: UInt8, first_row: int, y: int, height: int, channels: int, line: Int32, strength: Int32, index: UInt32
) -> None:  # fmt: skip
    """Of a row of pixels (C H, W): the gradient's squared strength, and (dy + 255) * 511 + dx + 255.

    line (W + 2,) is scratch: a channel's row with its border repeated.
    """
    cols = strength.size
    width = np.uint32(cols)
    above, below = y - (1 if y > 0 else 0), y + (1 if y + 1 < height else 0)
    for x in range(width):
        strength[x] = -1
    for c in range(channels):
        begin = first_row + c * height
        here, upper, lower = (
            np.uint32((begin + y) * cols),
            np.uint32((begin + above) * cols),
            np.uint32((begin + below) * cols),
        )
        for x in range(width):
            line[x + np.uint32(1)] = pixels[here + x]
        line[0], line[cols + 1] = line[1], line[cols]
        for x in range(width):
            # numba widens 32-bit sums and products to 64 bits, of which only half as many fit into a SIMD register
            dx = np.int32(line[x + np.uint32(2)] - line[x])
            dy = np.int32(np.int32(pixels[lower + x]) - np.int32(pixels[upper + x]))
            square = np.int32(np.int32(dx * dx) + np.int32(dy * dy))
            before, place = strength[x], np.int32(np.int32(dy * np.int32(511)) + dx)
            strength[x] = max(square, before)
            index[x] = np.uint32(place + np.int32(255 * 511 + 255)) if square > before else index[x]


@compiled
def _histograms(
    pixels: UInt8, channels: int, cell: int, bins: UInt8, first: UInt32, shares: Float32, line: Int32,
    strength: Int32, index: UInt32, places: UInt32, up: Float32, down: Float32, votes: Float32, out: Float32,
    shape: tuple[int, int, int],
) -> None:  # fmt: skip
    """Bilinear votes into histograms (N, rows + 2, (cols + 2) 18), of which the cells within the margin are written.

    Neighbouring pixels of a row vote for the same cell, so each vote would have to wait for the one before it.  To
    avoid that, each of the `cell` columns of a cell has votes of its own, which are summed when their row of cells is
    complete.  A pixel votes for the row of cells above its middle and for the one below: one half of `votes` belongs to
    the row that is about to be completed, the other to the next.
    """
    count, rows, cols = shape
    width, plane = np.uint32(first.size), (cols + 1) * 2 * ORIENTATIONS
    scale, phases = np.float32(1.0 / 510.0), shares.shape[1]
    for n in range(count):
        for row in range(rows + 1):
            upper, lower = np.uint32(row % 2 * phases * plane), np.uint32((row + 1) % 2 * phases * plane)
            for phase in range(cell):
                y = row * cell - (cell + 1) // 2 + phase
                if y < 0 or y >= rows * cell:
                    continue
                _strongest_gradients(
                    pixels, n * channels * rows * cell, y, rows * cell, channels, line, strength, index
                )
                share = shares[1, phase]
                for x in range(width):
                    magnitude = np.sqrt(np.float32(strength[x])) * scale
                    down[x] = magnitude * share
                    up[x] = magnitude - down[x]
                for x in range(width):
                    places[x] = first[x] + bins[index[x]]
                for x in range(width):
                    votes[upper + places[x]] += up[x]
                    votes[lower + places[x]] += down[x]
            into = np.uint32((n * (rows + 2) + row) * (cols + 2) * 2 * ORIENTATIONS)
            for phase in range(0, phases, AT_ONCE):
                v0 = np.uint32(upper + phase * plane)
                v1, v2, v3 = np.uint32(v0 + plane), np.uint32(v0 + 2 * plane), np.uint32(v0 + 3 * plane)
                for side in range(2):  # these cells, and the ones one further
                    w0, w1, w2, w3 = (shares[side, phase], shares[side, phase + 1], shares[side, phase + 2],
                                      shares[side, phase + 3])  # fmt: skip
                    to = np.uint32(into + side * 2 * ORIENTATIONS)
                    for i in range(np.uint32(plane)):
                        out[to + i] += votes[v0 + i] * w0 + votes[v1 + i] * w1 + votes[v2 + i] * w2 + votes[v3 + i] * w3
            for i in range(np.uint32(phases * plane)):
                votes[upper + i] = np.float32(0)
        for i in range(np.uint32(votes.size)):
            votes[i] = np.float32(0)


@compiled
def _normalised(
    histograms: Float32, energy: Float32, windows: Float32, out: Float32, shape: tuple[int, int, int],
    orientations: np.uint32,
) -> None:  # fmt: skip
    """Cells of histograms by the energy of their blocks, times the window; out (N, cols, rows, D), flat.

    Loops over nine that are known to be nine are unrolled instead of vectorised: hence the argument.
    """
    (count, rows, cols), directions, channels = shape, np.uint32(2 * ORIENTATIONS), out.size // windows.size
    clip, half, gain = np.float32(CLIP), np.float32(0.5), np.float32(TEXTURE_GAIN)
    for n in range(count):
        for r in range(1, rows + 1):
            for c in range(1, cols + 1):
                at, total = np.uint32(((n * (rows + 2) + r) * (cols + 2) + c) * 2 * ORIENTATIONS), np.float32(0)
                for o in range(orientations):
                    both = histograms[at + o] + histograms[at + orientations + o]
                    total += both * both
                energy[0, r, c] = total
            energy[0, r, 0], energy[0, r, cols + 1] = energy[0, r, 1], energy[0, r, cols]
        for c in range(cols + 2):
            energy[0, 0, c], energy[0, rows + 1, c] = energy[0, 1, c], energy[0, rows, c]
        for r in range(rows + 1):
            for c in range(cols + 1):
                block = energy[0, r, c] + energy[0, r + 1, c] + energy[0, r, c + 1] + energy[0, r + 1, c + 1]
                energy[1, r, c] = np.float32(1.0) / np.sqrt(block + np.float32(EPSILON))
        for r in range(rows):
            for c in range(cols):
                n0, n1, n2, n3 = energy[1, r, c], energy[1, r, c + 1], energy[1, r + 1, c], energy[1, r + 1, c + 1]
                t0 = t1 = t2 = t3 = np.float32(0)
                at = np.uint32(((n * (rows + 2) + r + 1) * (cols + 2) + c + 1) * 2 * ORIENTATIONS)
                place = (n * cols + c) * rows + r
                into, share = np.uint32(place * channels), windows[place]
                for o in range(directions):
                    h = histograms[at + o]
                    h0, h1, h2, h3 = min(h * n0, clip), min(h * n1, clip), min(h * n2, clip), min(h * n3, clip)
                    out[into + o] = (h0 + h1 + h2 + h3) * half * share
                    t0, t1, t2, t3 = t0 + h0, t1 + h1, t2 + h2, t3 + h3
                for o in range(orientations):
                    h = histograms[at + o] + histograms[at + orientations + o]
                    both = min(h * n0, clip) + min(h * n1, clip) + min(h * n2, clip) + min(h * n3, clip)
                    out[into + directions + o] = both * half * share
                texture = into + directions + orientations
                out[texture] = gain * t0 * share
                out[texture + np.uint32(1)] = gain * t1 * share
                out[texture + np.uint32(2)] = gain * t2 * share
                out[texture + np.uint32(3)] = gain * t3 * share


def fhog(patches: UInt8, cell: int, bins: UInt8, work: Scratch, windows: Float32, out: Float32) -> None:
    """Write the FHOG of patches (N, C, H, W) times windows into `out[..., :31]`; as `fhog_numpy` with windows of ones.

    `out` is (N, W/cell, H/cell, >= 31) and the windows (N, W/cell, H/cell): first axis of a patch across.
    """
    histograms, energy = work[-2:]
    shape, flat = (len(patches), out.shape[2], out.shape[1]), histograms.reshape(-1)
    flat.fill(0)
    _histograms(patches.reshape(-1), patches.shape[1], cell, bins.reshape(-1), *work[:-2], flat, shape)
    _normalised(flat, energy, windows.reshape(-1), out.reshape(-1), shape, np.uint32(ORIENTATIONS))
