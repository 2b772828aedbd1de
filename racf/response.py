"""The response map: where its peak is, and how sharp it is.  `[row, col]` in, `(x, y)` shifts out."""

import functools
import math

import numpy as np
from numpy.typing import NDArray

from racf.kernels import compiled

Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]
Complex64 = NDArray[np.complex64]
Complex128 = NDArray[np.complex128]


@compiled
def correlate(z_f: Float32, g_f: Float32, out: Complex64) -> None:
    """out = sum_d z_d conj(g_d): folded spectra -> (H, W//2 + 1).

    The mirror of Eq. 15, so that a shift of the target has its own sign in the map.
    """
    rows, channels = out.shape[0], z_f.shape[4]
    for k in range(z_f.shape[1]):
        for n in range(z_f.shape[3]):
            z_p, z_pi, z_q, z_qi = z_f[0, k, 0, n], z_f[0, k, 1, n], z_f[1, k, 0, n], z_f[1, k, 1, n]
            g_p, g_pi, g_q, g_qi = g_f[0, k, 0, n], g_f[0, k, 1, n], g_f[1, k, 0, n], g_f[1, k, 1, n]
            re1 = im1 = re2 = im2 = np.float32(0)
            for m in range(channels):
                a1, b1, a2, b2 = z_p[m] + z_qi[m], z_pi[m] - z_q[m], z_p[m] - z_qi[m], z_pi[m] + z_q[m]
                c1, d1, c2, d2 = g_p[m] + g_qi[m], g_pi[m] - g_q[m], g_p[m] - g_qi[m], g_pi[m] + g_q[m]
                re1 += a1 * c1 + b1 * d1
                im1 += b1 * c1 - a1 * d1
                re2 += a2 * c2 + b2 * d2
                im2 += b2 * c2 - a2 * d2
            out[(rows - k) % rows, n] = complex(re2, im2)
            out[k, n] = complex(re1, im1)


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
    sums = np.empty(5)
    _sums(response, *window, sums)
    total, squares, low, inside, squares_inside = sums.tolist()
    peak, size = float(response[row, col]), response.size
    apce = (peak - low) ** 2 / max((squares - 2 * low * total) / size + low * low, 1e-12)
    count = size - (window[1] - window[0]) * (window[3] - window[2])
    if count <= 1:
        return 0.0, apce
    mean = (total - inside) / count
    variance = (squares - squares_inside) / count - mean**2
    return (peak - mean) / max(math.sqrt(max(variance, 0.0)), 1e-6), apce


@compiled
def _sums(response: Float32, top: int, bottom: int, left: int, right: int, out: Float64) -> None:
    """Sum, sum of squares and least of a response; sum and sum of squares of its rows top.. and columns left.. ."""
    total = squares = inside = squares_inside = 0.0
    low = response[0, 0]
    for i in range(response.shape[0]):
        line = response[i]
        for j in range(line.size):
            value = np.float64(line[j])
            total += value
            squares += value * value
            low = min(low, line[j])
        if top <= i < bottom:
            for j in range(left, right):
                value = np.float64(line[j])
                inside += value
                squares_inside += value * value
    out[0], out[1], out[2], out[3], out[4] = total, squares, low, inside, squares_inside


@compiled
def _slopes(response_f: Complex64, waves: Complex128, steps: Float64, out: Float64) -> None:
    """First and second derivatives (r, c, rr, rc, cc) of the response's trigonometric interpolation, times H W.

    steps (2, max): the angle per cell of each frequency down and across.  waves: e^(i angle) at the place, those across
    times how many frequencies each stands for.
    """
    height, half = response_f.shape
    out[:] = 0.0
    for i in range(height):
        ky, down = steps[0, i], waves[0, i]
        value_re = value_im = value_c_re = value_c_im = value_cc = 0.0
        for j in range(half):
            kx = steps[1, j]
            term = response_f[i, j] * waves[1, j]
            value_re += term.real
            value_im += term.imag
            value_c_re += kx * term.real
            value_c_im += kx * term.imag
            value_cc += kx * kx * (term.real * down.real - term.imag * down.imag)
        re, im = value_re * down.real - value_im * down.imag, value_re * down.imag + value_im * down.real
        c_re = value_c_re * down.real - value_c_im * down.imag
        c_im = value_c_re * down.imag + value_c_im * down.real
        out[0] -= ky * im
        out[1] -= c_im
        out[2] -= ky * ky * re
        out[3] -= ky * c_re
        out[4] -= value_cc


@functools.lru_cache(maxsize=16)
def _angles(height: int, width: int) -> tuple[Float64, Float64]:
    """(2, max) angles per cell down and across, and (W//2 + 1,) how many frequencies each across stands for."""
    half = width // 2 + 1
    angles = np.zeros((2, max(height, half)))
    angles[0, :height] = 2 * np.pi * np.fft.fftfreq(height)
    if height % 2 == 0:  # the Nyquist row of an even height has no side to lean to
        angles[0, height // 2] = 0.0
    angles[1, :half] = 2 * np.pi * np.arange(half) / width
    counts = np.full(half, 2.0)
    counts[0] = 1.0
    if width % 2 == 0:
        counts[-1] = 1.0
    return angles, counts


def refine_peak(response_f: Complex64, width: int, row: float, col: float, steps: int) -> tuple[float, float]:
    """Newton steps to the maximum of the response's trigonometric interpolation, from the grid's maximum.

    row, col are shifts in cells; steps that leave the starting cell's neighbourhood are not taken.
    """
    start_row, start_col = row, col
    (height, half), slopes = response_f.shape, np.empty(5)
    angles, counts = _angles(height, width)
    place = np.empty((2, 1))
    for _ in range(steps):
        place[:, 0] = row, col
        waves = np.exp(1j * angles * place)
        waves[1, :half] *= counts
        _slopes(response_f, waves, angles, slopes)
        d_r, d_c, d_rr, d_rc, d_cc = slopes.tolist()
        det = d_rr * d_cc - d_rc * d_rc
        if det <= 0 or d_rr >= 0:  # not a maximum here
            break
        step_row, step_col = (d_rc * d_c - d_cc * d_r) / det, (d_rc * d_r - d_rr * d_c) / det
        if max(abs(row + step_row - start_row), abs(col + step_col - start_col)) > 1:
            break
        row, col = row + step_row, col + step_col
    return row, col
