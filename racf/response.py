"""The response map: its peak's position and sharpness.  `[row, col]` in, `(x, y)` shifts out."""

import functools
import math

import numpy as np
from numpy.typing import NDArray

from racf.fourier import places
from racf.kernels import compiled

Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]
Complex64 = NDArray[np.complex64]
Complex128 = NDArray[np.complex128]
UInt32 = NDArray[np.uint32]

SETTLED = 1e-4  # cells: Newton's method stops after a smaller step, because the next one is of the order of its square


def correlate(z_f: Float32, g_f: Float32, out: Complex64) -> None:
    """out = sum_d z_d conj(g_d): folded spectra -> (H, W//2 + 1).

    The mirror of Eq. 15, so that a shift of the target has its own sign in the map.
    """
    at = places(*out.shape, z_f.shape[-1])
    _products(z_f.reshape(-1), g_f.reshape(-1), at, z_f.shape[-1], out.reshape(-1).view(np.float32))


@compiled
def _products(z_f: Float32, g_f: Float32, at: UInt32, channels: int, out: Float32) -> None:
    """See `correlate`; frequencies k and -k down together, their letters end in 1 and 2."""
    for i in range(at.shape[0]):
        p, p_im, q, q_im, first, second = at[i, 0], at[i, 1], at[i, 2], at[i, 3], 2 * at[i, 4], 2 * at[i, 5]
        re1 = im1 = re2 = im2 = np.float32(0)
        for m in range(np.uint32(channels)):
            z_p, z_pi, z_q, z_qi = z_f[p + m], z_f[p_im + m], z_f[q + m], z_f[q_im + m]
            g_p, g_pi, g_q, g_qi = g_f[p + m], g_f[p_im + m], g_f[q + m], g_f[q_im + m]
            a1, b1, a2, b2 = z_p + z_qi, z_pi - z_q, z_p - z_qi, z_pi + z_q
            c1, d1, c2, d2 = g_p + g_qi, g_pi - g_q, g_p - g_qi, g_pi + g_q
            re1 += a1 * c1 + b1 * d1
            im1 += b1 * c1 - a1 * d1
            re2 += a2 * c2 + b2 * d2
            im2 += b2 * c2 - a2 * d2
        out[second], out[second + np.uint32(1)] = re2, im2
        out[first], out[first + np.uint32(1)] = re1, im1


def response_map(response_f: Complex64, shape: tuple[int, int]) -> Float32:
    """(H, W//2 + 1) -> (H, W) with zero shift in the middle."""
    down, across = _inverse(*shape)
    along_rows = down @ response_f
    return along_rows.view(np.float32) @ across


@functools.lru_cache(maxsize=16)
def _inverse(height: int, width: int) -> tuple[Complex64, Float32]:
    """The products of `response_map`: (H, H) along the columns, (2 (W//2 + 1), W) from real and imaginary parts."""
    rows, cols = np.arange(height) - height // 2, np.arange(width) - width // 2
    down = np.exp(2j * np.pi * np.outer(rows, np.arange(height)) / height) / height
    _, counts = _angles(height, width)
    waves = np.exp(2j * np.pi * np.outer(np.arange(len(counts)), cols) / width) * counts[:, None] / width
    across = np.stack([waves.real, -waves.imag], axis=1).reshape(-1, width)
    return down.astype(np.complex64), across.astype(np.float32)


def sharpness(response: Float32, target_cells: tuple[float, float]) -> tuple[float, float]:
    """PSR and APCE.

    PSR (Bolme 2010): (peak - mean) / deviation of the sidelobe, which is all but a window of half the target's size
    around the peak.  APCE (Wang 2017): |max - min|^2 / mean of (response - min)^2.
    """
    row, col = (int(i) for i in np.unravel_index(int(np.argmax(response)), response.shape))
    half_rows, half_cols = (max(2, round(side / 2)) for side in (target_cells[1], target_cells[0]))
    rows, cols = response.shape
    window = (max(row - half_rows, 0), min(row + half_rows + 1, rows), max(col - half_cols, 0),
              min(col + half_cols + 1, cols))  # fmt: skip
    exact = response.astype(np.float64)
    near = exact[window[0] : window[1], window[2] : window[3]].ravel()
    total, squares, low = float(exact.sum()), float(np.vdot(exact, exact)), float(response.min())
    inside, squares_inside = float(near.sum()), float(near @ near)
    peak, size = float(response[row, col]), response.size
    apce = (peak - low) ** 2 / max((squares - 2 * low * total) / size + low * low, 1e-12)
    count = size - (window[1] - window[0]) * (window[3] - window[2])
    if count <= 1:
        return 0.0, apce
    mean = (total - inside) / count
    variance = (squares - squares_inside) / count - mean**2
    return (peak - mean) / max(math.sqrt(max(variance, 0.0)), 1e-6), apce


def _slopes(response_f: Complex128, waves: Complex128, row: float, col: float) -> Float64:
    """First and second derivatives of the response's trigonometric interpolation at a position, times H W.

    waves: see `_waves`.  out[i, j] is the i-th derivative down and the j-th across.
    """
    height, half = response_f.shape
    down, across = waves[0, :, :height], waves[1, :, :half]
    left, right = np.exp(row * down[1]) * down, np.exp(col * across[1]) * across
    right *= waves[2, 0, :half]
    return np.asarray((left @ response_f @ right.T).real)


@functools.lru_cache(maxsize=16)
def _waves(height: int, width: int) -> Complex128:
    """(3, 3, max): 1, i a, (i a)^2 of the angles a a cell of frequencies down; the same across; their counts."""
    angles, counts = _angles(height, width)
    waves = (1j * angles[:, None]) ** np.arange(3)[:, None]
    of_counts = np.zeros_like(waves[:1])
    of_counts[0, 0, : len(counts)] = counts
    return np.asarray(np.concatenate([waves, of_counts]), np.complex128)


@functools.lru_cache(maxsize=16)
def _angles(height: int, width: int) -> tuple[Float64, Float64]:
    """(2, max) angles per cell down and across, and (W//2 + 1,) how many frequencies each across stands for."""
    half = width // 2 + 1
    angles = np.zeros((2, max(height, half)))
    angles[0, :height] = 2 * np.pi * np.fft.fftfreq(height)
    if height % 2 == 0:  # the Nyquist row of an even height has no sign
        angles[0, height // 2] = 0.0
    angles[1, :half] = 2 * np.pi * np.arange(half) / width
    counts = np.full(half, 2.0)
    counts[0] = 1.0
    if width % 2 == 0:
        counts[-1] = 1.0
    return angles, counts


def refine_peak(response_f: Complex64, width: int, row: float, col: float, steps: int) -> tuple[float, float]:
    """Newton steps to the maximum of the response's trigonometric interpolation, from the grid's maximum.

    row, col are shifts in cells; it stops before a step that leaves the starting cell's neighbourhood, and after one
    below SETTLED.
    """
    start_row, start_col = row, col
    exact, waves = response_f.astype(np.complex128), _waves(len(response_f), width)
    for _ in range(steps):
        (_, d_c, d_cc), (d_r, d_rc, _), (d_rr, _, _) = _slopes(exact, waves, row, col).tolist()
        det = d_rr * d_cc - d_rc * d_rc
        if det <= 0 or d_rr >= 0:  # not a maximum here
            break
        step_row, step_col = (d_rc * d_c - d_cc * d_r) / det, (d_rc * d_r - d_rr * d_c) / det
        if max(abs(row + step_row - start_row), abs(col + step_col - start_col)) > 1:
            break
        row, col = row + step_row, col + step_col
        if max(abs(step_row), abs(step_col)) < SETTLED:
            break
    return row, col
