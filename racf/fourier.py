"""Discrete Fourier transforms as dense matrix products.

A filter has a small m x n support, so most of a transform between it and the H x W grid would work on zeros; matrix
products skip them, and at these sizes (H, W about 50, D = 42) they are far faster than an FFT, and no slower on the
full grid.

Both axes count positions from the middle, so that cosines are even and sines odd in them: the sums and the differences
of the entries at +j and -j ("folded") take one product each with a quarter of the full matrix.  Spectra stay folded:

    (2, H//2 + 1, 2, W//2 + 1, D) = (P and Q, frequency down k, real and imaginary, frequency across, channel)

holds X_k = P_k - i Q_k and X_-k = P_k + i Q_k, of the non-redundant half of the frequencies across.  Samples and
filters are (W, H, D) and (n, m, D), the first axis across: a transform's first product then has one operand.  Linear
operations act on P and Q directly; others go through `unfolded` and `folded`, or do the same in their kernel.
"""

import functools

import numpy as np
from numpy.typing import NDArray

from racf.kernels import compiled

Float32 = NDArray[np.float32]
Complex = NDArray[np.complex64]
UInt32 = NDArray[np.uint32]


class PrunedDft:
    """Transforms between a `rows` x `cols` grid, its centred `support` = (m, n) part, and folded spectra.

    Position 0 of the transforms is the grid's middle (rows//2, cols//2): a filter and a sample that are both centred
    there correlate to a peak at zero shift.  Each transform returns a new array unless `out` is given.
    """

    def __init__(self, rows: int, cols: int, support: tuple[int, int], channels: int) -> None:
        self.rows, self.cols, self.half, self.support = rows, cols, cols // 2 + 1, support
        self.shape = (2, rows // 2 + 1, 2, self.half, channels)  # of a spectrum
        self._grid = _Plan(cols, rows, (cols, rows), channels)
        self._support = _Plan(cols, rows, (support[1], support[0]), channels)

    def weights(self) -> NDArray[np.float64]:
        """(W//2 + 1,): how many of the full spectrum's columns each kept one represents."""
        return _counts(self.cols)

    def forward(self, x: Float32, out: Float32 | None = None) -> Float32:
        """F x: (W, H, D) -> folded spectrum."""
        return self._grid.forward(x, np.empty(self.shape, np.float32) if out is None else out)

    def forward_support(self, f: Float32, out: Float32 | None = None) -> Float32:
        """F P f: the folded spectrum of a filter (n, m, D) padded with zeros."""
        return self._support.forward(f, np.empty(self.shape, np.float32) if out is None else out)

    def inverse_support(self, g_f: Float32, out: Float32 | None = None) -> Float32:
        """P^T F^-1 g: the (n, m, D) part around the middle of the inverse transform."""
        shape = (self.support[1], self.support[0], self.shape[-1])
        return self._support.inverse(g_f, np.empty(shape, np.float32) if out is None else out)


def move(spectrum: Float32, dy: float, dx: float, shape: tuple[int, int], scratch: Float32) -> None:
    """Shift a grid of this (H, W) circularly by `dy` down and `dx` across, in its folded spectrum.

    X_k is multiplied by exp(2 pi i k dy / H), which rotates P and Q into each other, and across the real and imaginary
    parts.  The Nyquist frequency of an even axis is not rotated.
    """
    _, below, _, half, channels = spectrum.shape
    flat, between, (down, across) = spectrum.reshape(-1), scratch.reshape(-1), _pairs_to_turn(below, half, channels)
    _combined(flat, down, np.repeat(_turns(dy, shape[0]), 2 * half, axis=0), channels, between)
    _combined(between, across, np.tile(_turns(-dx, shape[1]), (2 * below, 1)), channels, flat)


def _turns(by: float, size: int) -> Float32:
    """(N//2 + 1, 4): the weights for `_combined` that rotate a pair at each frequency of an axis."""
    turn = 2 * np.pi * by / size * np.arange(size // 2 + 1)
    if size % 2 == 0:
        turn[-1] = 0.0
    cos, sin = np.cos(turn), np.sin(turn)
    return np.stack([cos, sin, -sin, cos], axis=1).astype(np.float32)


@functools.lru_cache(maxsize=16)
def _pairs_to_turn(below: int, half: int, channels: int) -> tuple[UInt32, UInt32]:
    """Rows for `_combined` from a spectrum to a spectrum: P and Q, k down slowest; real and imaginary part."""
    at = (np.arange(4 * below * half) * channels).reshape(2, below, 2, half).astype(np.uint32)
    down, across = (at[0].ravel(), at[1].ravel()), (at[:, :, 0].ravel(), at[:, :, 1].ravel())
    return np.stack(down * 2, axis=1), np.stack(across * 2, axis=1)


def unfolded(spectrum: Float32, rows: int) -> Complex:
    """(H, W//2 + 1, D): the frequencies down and across of a folded spectrum."""
    p, q = (planes[:, 0] + 1j * planes[:, 1] for planes in spectrum)
    mirrored = slice((rows - 1) // 2, 0, -1)
    return np.concatenate([p - 1j * q, (p + 1j * q)[mirrored]]).astype(np.complex64)


def folded(frequencies: Complex) -> Float32:
    """The folded spectrum of (H, W//2 + 1, D) frequencies down and across."""
    rows = len(frequencies)
    at = np.arange(rows // 2 + 1)
    here, mirrored = frequencies[at], frequencies[-at % rows]
    p, q = (here + mirrored) / 2, 1j * (here - mirrored) / 2
    return np.stack([np.stack([part.real, part.imag], axis=1) for part in (p, q)]).astype(np.float32)


@functools.lru_cache(maxsize=16)
def places(rows: int, half: int, channels: int) -> UInt32:
    """(H//2 + 1) (W//2 + 1) times 6: indices of a pair of frequencies in flat arrays, k down slowest.

    In a folded spectrum: the first channels of P's real and imaginary part and of Q's; in (H, W//2 + 1): the frequency
    k down, and -k.
    """
    k, n = (axis.ravel() for axis in np.mgrid[: rows // 2 + 1, :half])
    p, q = 2 * k * half + n, 2 * (rows // 2 + 1 + k) * half + n
    spectrum = np.stack([p, p + half, q, q + half]) * channels
    return np.ascontiguousarray([*spectrum, k * half + n, -k % rows * half + n], np.uint32).T.copy()


def _counts(size: int) -> NDArray[np.float64]:
    counts = np.full(size // 2 + 1, 2.0)
    counts[0] = 1.0
    if size % 2 == 0:
        counts[-1] = 1.0
    return counts


def _waves(size: int, count: int) -> tuple[Float32, Float32]:
    """cos and sin of 2 pi k j / n: (2, k = 0..n//2, j = 0..count//2); the way back is (2, j, k)."""
    turns = np.outer(np.arange(size // 2 + 1), np.arange(count // 2 + 1)) * (2 * np.pi / size)
    waves, counted = np.stack([np.cos(turns), np.sin(turns)]), _counts(size) / size
    there, back = (np.ascontiguousarray(of, np.float32) for of in (waves, waves.swapaxes(1, 2) * counted))
    return there, back


def _halves(pair: Float32) -> Float32:
    """Two matrices (2, ..., N) as (2, 2, rows, N/2), each split into its left and right half if N is even.

    OpenBLAS packs operands of more than a million products; halves need no packing, which saves a fifth of a transform.
    """
    rows = pair.shape[1]
    width = pair[0].size // rows
    return pair.reshape(2, rows, 2 - width % 2, -1).swapaxes(1, 2)


class _Plan:
    """Transforms between the centred (m, n) part of a grid and folded spectra, with their scratch."""

    def __init__(self, cols: int, rows: int, part: tuple[int, int], channels: int) -> None:
        n, m = part
        self.part, half = part, cols // 2 + 1
        self._across, self._across_back = (waves[:, None] for waves in _waves(cols, n))
        self._across[1] *= -1
        self._down, self._down_back = (waves[:, None] for waves in _waves(rows, m))
        self._lines = np.empty((2, n // 2 + 1, m * channels), np.float32)
        self._there, self._back = _pairs_down(half, m, channels)
        self._sums = np.tile(np.array([1, 1, 1, -1], np.float32), (len(self._there), 1))
        self._padded = np.zeros(2 * half * m * channels + channels, np.float32)
        self._of_planes = 2, half, m * channels
        self._pairs = np.empty((2, m // 2 + 1, 2, half, channels), np.float32)

    def _planes(self) -> Float32:
        """A view of all but the row of zeros; made on each call, so that a copied plan has its own."""
        return self._padded[: np.prod(self._of_planes)].reshape(self._of_planes)

    def forward(self, x: Float32, out: Float32) -> Float32:
        n = self.part[0]
        flat, middle, pairs = x.reshape(n, -1), n // 2, (n - 1) // 2
        even, odd = self._lines
        even[0], odd[0] = flat[middle], 0
        after, before = flat[middle + 1 : middle + 1 + pairs], flat[middle - pairs : middle][::-1]
        np.add(after, before, out=even[1 : pairs + 1])
        np.subtract(after, before, out=odd[1 : pairs + 1])
        if n % 2 == 0:  # the one at -n/2 has no partner
            even[-1] = flat[0]
            np.negative(flat[0], out=odd[-1])
        np.matmul(self._across, _halves(self._lines), out=_halves(self._planes()))
        self._padded[-x.shape[2] :] = 0
        _combined(self._padded, self._there, self._sums, x.shape[2], self._pairs.reshape(-1))
        np.matmul(self._down, _halves(self._pairs), out=_halves(out))
        return out

    def inverse(self, g_f: Float32, out: Float32) -> Float32:
        n = self.part[0]
        np.matmul(self._down_back, _halves(g_f), out=_halves(self._pairs))
        _combined(self._pairs.reshape(-1), self._back, self._sums, g_f.shape[-1], self._padded)
        np.matmul(self._across_back, _halves(self._planes()), out=_halves(self._lines))
        (even, odd), flat, middle, pairs = self._lines, out.reshape(n, -1), n // 2, (n - 1) // 2
        flat[middle] = even[0]
        np.subtract(even[1 : pairs + 1], odd[1 : pairs + 1], out=flat[middle + 1 : middle + 1 + pairs])
        np.add(even[pairs:0:-1], odd[pairs:0:-1], out=flat[middle - pairs : middle])
        if n % 2 == 0:
            np.add(even[-1], odd[-1], out=flat[0])
        return out


@compiled
def _combined(x: Float32, rows: UInt32, weights: Float32, channels: int, out: Float32) -> None:
    """out[s] = w0 x[a] + w1 x[b] and out[t] = w2 x[a] + w3 x[b] for each (a, b, s, t) of `rows`, `channels` each."""
    for i in range(rows.shape[0]):
        a, b, s, t = rows[i, 0], rows[i, 1], rows[i, 2], rows[i, 3]
        w0, w1, w2, w3 = weights[i, 0], weights[i, 1], weights[i, 2], weights[i, 3]
        for d in range(np.uint32(channels)):
            out[s + d] = w0 * x[a + d] + w1 * x[b + d]
            out[t + d] = w2 * x[a + d] + w3 * x[b + d]


def _pairs_down(half: int, m: int, channels: int) -> tuple[UInt32, UInt32]:
    """Rows for `_combined`: planes (2, W//2 + 1, m, D) to pairs (2, m//2 + 1, 2, W//2 + 1, D), and back.

    Sums and differences over positions +j and -j.  The middle, and the one at -m/2, have no partner: a row of zeros
    after the planes stands in for it, and takes its output.
    """
    middle = m // 2
    j, part, k = (axis.ravel() for axis in np.mgrid[: middle + 1, :2, :half])
    even = (j * 2 + part) * half + k
    odd = even + (middle + 1) * 2 * half
    before = (part * half + k) * m + middle - j
    after = np.where((j > 0) & (j < m - middle), before + 2 * j, 2 * half * m)
    there, back = np.stack([after, before, even, odd], 1), np.stack([even, odd, after, before], 1)
    return (there * channels).astype(np.uint32), (back * channels).astype(np.uint32)
