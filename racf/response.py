"""The response map: where its peak is, and how sharp it is.  `[row, col]` in, `(x, y)` shifts out."""

import math

import numba
import numpy as np
from numpy.typing import NDArray

Float32 = NDArray[np.float32]
Complex64 = NDArray[np.complex64]


@numba.njit(cache=True, fastmath=True)
def correlate(z_f: Float32, g_f: Float32, out: Complex64) -> None:
    """out = sum_d z_d conj(g_d): (2, N, D) spectra -> (N,).

    The mirror of Eq. 15, so that a shift of the target has its own sign in the map.
    """
    for n in range(z_f.shape[1]):
        re = im = np.float32(0)
        for k in range(z_f.shape[2]):
            re += z_f[0, n, k] * g_f[0, n, k] + z_f[1, n, k] * g_f[1, n, k]
            im += z_f[1, n, k] * g_f[0, n, k] - z_f[0, n, k] * g_f[1, n, k]
        out[n] = complex(re, im)


def response_map(response_f: Complex64, shape: tuple[int, int]) -> Float32:
    """(H, Wf) -> (H, W) with zero shift in the middle."""
    return np.fft.fftshift(np.fft.irfft2(response_f, s=shape)).astype(np.float32, copy=False)


def sharpness(response: Float32, target_cells: tuple[float, float]) -> tuple[float, float]:
    """PSR and APCE.

    PSR (Bolme 2010): (peak - mean) / deviation of the sidelobe, which is all but a window of half the target's size
    around the peak.  APCE (Wang 2017): |max - min|^2 / mean of (response - min)^2.
    """
    row, col = (int(i) for i in np.unravel_index(int(np.argmax(response)), response.shape))
    peak, low = float(response[row, col]), float(response.min())
    above = response - low
    apce = (peak - low) ** 2 / max(float(np.mean(above * above)), 1e-12)
    half_rows, half_cols = (max(2, round(side / 2)) for side in (target_cells[1], target_cells[0]))
    window = response[max(row - half_rows, 0) : row + half_rows + 1, max(col - half_cols, 0) : col + half_cols + 1]
    count = response.size - window.size
    if count <= 1:
        return 0.0, apce
    total, squares = float(response.sum(dtype=np.float64)), float(np.vdot(response, response))
    mean = (total - float(window.sum(dtype=np.float64))) / count
    variance = (squares - float(np.sum(window * window))) / count - mean**2
    return (peak - mean) / max(math.sqrt(max(variance, 0.0)), 1e-6), apce


@numba.njit(cache=True, fastmath=True)
def _slopes(response_f: Complex64, width: int, row: float, col: float) -> tuple[float, float, float, float, float]:
    """First and second derivatives (r, c, rr, rc, cc) of the response's trigonometric interpolation, times H W."""
    height, half = response_f.shape
    d_r = d_c = d_rr = d_rc = d_cc = 0.0
    for j in range(half):
        kx = 2 * np.pi * j / width
        weight = 1.0 if j == 0 or 2 * j == width else 2.0
        value, value_r, value_rr = 0.0j, 0.0j, 0.0j
        for i in range(height):
            # The Nyquist row of an even height has no side to lean to.
            ky = 0.0 if 2 * i == height else 2 * np.pi * (i if 2 * i < height else i - height) / height
            term = response_f[i, j] * complex(math.cos(ky * row), math.sin(ky * row))
            value += term
            value_r += 1j * ky * term
            value_rr -= ky * ky * term
        wave = weight * complex(math.cos(kx * col), math.sin(kx * col))
        d_r += (value_r * wave).real
        d_c += (value * 1j * kx * wave).real
        d_rr += (value_rr * wave).real
        d_rc += (value_r * 1j * kx * wave).real
        d_cc -= (value * kx * kx * wave).real
    return d_r, d_c, d_rr, d_rc, d_cc


def refine_peak(response_f: Complex64, width: int, row: float, col: float, steps: int) -> tuple[float, float]:
    """Newton steps to the maximum of the response's trigonometric interpolation, from the grid's maximum.

    row, col are shifts in cells; steps that leave the starting cell's neighbourhood are not taken.
    """
    start_row, start_col = row, col
    for _ in range(steps):
        d_r, d_c, d_rr, d_rc, d_cc = _slopes(response_f, width, row, col)
        det = d_rr * d_cc - d_rc * d_rc
        if det <= 0 or d_rr >= 0:  # not a maximum here
            break
        step_row, step_col = (d_rc * d_c - d_cc * d_r) / det, (d_rc * d_r - d_rr * d_c) / det
        if max(abs(row + step_row - start_row), abs(col + step_col - start_col)) > 1:
            break
        row, col = row + step_row, col + step_col
    return row, col
