"""The residue-aware correlation filter: the paper's Eq. 3, learned with ADMM.

    E(f) = 1/(2T) |y - sum_d x_d * P f_d|^2 + eta/(2T) |sum_d delta_d * P f_d|^2
         + theta/2 sum_d |w . f_d|^2 + tau/2 sum_d |f_d - f'_d|^2 + lambda/2 sum_d |f_d|^2        (f': last frame's f)

Letters, beside the code's names: x model sample, delta `residue_f`, y label, f `filter` (m, n, D), g `response filter`
(its spectrum without the support constraint), zeta Lagrangian, w bowl, P zero padding, mu penalty, T = H W the number
of samples; a hat is `_f`.  Spectra are (2, H, Wf, D) float32 planes (see `racf.fourier`).  BACF is the same with
eta = theta = tau = 0; ARCF adds gamma/(2T) |M' - M|^2 (Eq. 2), which turns the data term into
(1 + gamma) |M - (y + gamma M') / (1 + gamma)|^2 / (2T).

Eq. 3 as printed lacks the 1/T: beside data and residue, lambda, theta and tau weigh T times as much here as they would
there.  The published trackers of this family do so with mu: their transform is not unitary, so that their mu stands for
T mu in the step of g, which `shift` below is; the step of f (Eq. 8) has mu beside lambda, theta and tau as printed.
"""

from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray

from racf.fourier import PrunedDft
from racf.params import Params

Float32 = NDArray[np.float32]
Scalar = np.float32  # a Python float would turn the compiled sums into doubles


def bowl_weight(rows: int, cols: int, rim: float) -> Float32:
    """(m, n): w, the spatial regularisation: 0 in the middle of the support, `rim` at the ends of its axes."""
    y = (np.arange(rows) - (rows - 1) / 2) / max(rows / 2, 1)
    x = (np.arange(cols) - (cols - 1) / 2) / max(cols / 2, 1)
    return (rim * (y[:, None] ** 2 + x[None, :] ** 2)).astype(np.float32)


def solve_rank_two_numpy(x_f: Float32, residue_f: Float32, rhs_f: Float32, eta: float, shift: float) -> Float32:
    """Solve (x xᴴ + eta δ δᴴ + shift I) g = rhs at every frequency, by Sherman-Morrison twice (Eq. 11).

    All are (2, H, Wf, D); the D x D matrix is never formed.
    """
    x, delta, rhs = (planes[0] + 1j * planes[1].astype(np.float64) for planes in (x_f, residue_f, rhs_f))

    def inner(u: NDArray[np.complex128], v: NDArray[np.complex128]) -> NDArray[np.complex128]:
        return np.sum(u.conj() * v, axis=-1, keepdims=True)

    def without_residue(v: NDArray[np.complex128]) -> NDArray[np.complex128]:  # A1^-1 v
        return (v - eta * delta * inner(delta, v) / (shift + eta * inner(delta, delta))) / shift

    a_rhs, a_x = without_residue(rhs), without_residue(x)
    g = a_rhs - a_x * inner(x, a_rhs) / (1 + inner(x, a_x))
    return np.stack([g.real, g.imag]).astype(np.float32)


@numba.njit(cache=True, fastmath=True)
def solve_g(
    x_f: Float32, d_f: Float32, y_f: Float32, f_f: Float32, u_f: Float32, g_f: Float32,
    eta: Scalar, mu_before: Scalar, mu: Scalar, gain: Scalar,
) -> None:  # fmt: skip
    """One ADMM step on the spectra, in place: same as `solve_rank_two_numpy` with the step's right-hand side.

    x_f, d_f, f_f (2, N, D) and the label y_f (2, N) are read.  `u_f` holds g mu_before + zeta_before and becomes
    g mu + zeta, where zeta = u_before - mu_before f is the updated Lagrangian (Eq. 13): the array that the filter's
    subproblem transforms next.  `g_f` receives g.  The data term is weighed with `gain` (1 + gamma for ARCF).
    """
    channels = x_f.shape[2]
    for n in range(x_f.shape[1]):
        xx = dd = dx_re = dx_im = xr_re = xr_im = dr_re = dr_im = np.float32(0)
        y_re, y_im = y_f[0, n], y_f[1, n]
        for k in range(channels):
            a, b, c, d = x_f[0, n, k], x_f[1, n, k], d_f[0, n, k], d_f[1, n, k]
            # zeta, then rhs = y x + mu f - zeta; kept in u and g until the sums are known
            z_re = u_f[0, n, k] - mu_before * f_f[0, n, k]
            z_im = u_f[1, n, k] - mu_before * f_f[1, n, k]
            r_re = y_re * a - y_im * b + mu * f_f[0, n, k] - z_re
            r_im = y_re * b + y_im * a + mu * f_f[1, n, k] - z_im
            u_f[0, n, k], u_f[1, n, k], g_f[0, n, k], g_f[1, n, k] = z_re, z_im, r_re, r_im
            xx += a * a + b * b
            dd += c * c + d * d
            dx_re += c * a + d * b
            dx_im += c * b - d * a
            xr_re += a * r_re + b * r_im
            xr_im += a * r_im - b * r_re
            dr_re += c * r_re + d * r_im
            dr_im += c * r_im - d * r_re
        # A1^-1 v = (v - eta d (d^H v) / (mu + eta d^H d)) / mu;  g = A1^-1 rhs - A1^-1 x  s
        share = eta / (mu + eta * dd)
        x_a_x = (xx - share * (dx_re * dx_re + dx_im * dx_im)) / mu
        xd_dr_re = dx_re * dr_re + dx_im * dr_im  # (x^H d)(d^H rhs)
        xd_dr_im = dx_re * dr_im - dx_im * dr_re
        factor = gain / (mu * (1 + gain * x_a_x))
        s_re, s_im = (xr_re - share * xd_dr_re) * factor, (xr_im - share * xd_dr_im) * factor
        t_re = share * (dr_re - (dx_re * s_re - dx_im * s_im))
        t_im = share * (dr_im - (dx_re * s_im + dx_im * s_re))
        for k in range(channels):
            a, b, c, d = x_f[0, n, k], x_f[1, n, k], d_f[0, n, k], d_f[1, n, k]
            g_re = (g_f[0, n, k] - (a * s_re - b * s_im) - (c * t_re - d * t_im)) / mu
            g_im = (g_f[1, n, k] - (a * s_im + b * s_re) - (c * t_im + d * t_re)) / mu
            g_f[0, n, k], g_f[1, n, k] = g_re, g_im
            u_f[0, n, k] += mu * g_re
            u_f[1, n, k] += mu * g_im


@dataclass(frozen=True, slots=True, eq=False)
class Learned:
    """A filter on its support, (m, n, D), its spectrum and the unconstrained one that localises, (2, H, Wf, D)."""

    filter: Float32
    f_f: Float32
    g_f: Float32


def learn(
    grid: PrunedDft,
    params: Params,
    x_f: Float32,
    residue_f: Float32,
    y_f: Float32,
    previous: Learned | None,
    aberrance: float = 0.0,
) -> Learned:
    """Minimise E with `params.admm_iterations` steps of ADMM.

    x_f, residue_f (2, H, Wf, D): model sample and residue.  y_f (2, H, Wf): label; with `aberrance` (gamma) > 0,
    label + gamma times the previous response.  previous: last frame's filter, None in the first; with
    `params.warm_start` its spectrum is where the iterations begin, and zero else.
    """
    channels = x_f.shape[3]
    size = grid.rows * grid.cols
    temporal = params.temporal if previous is not None else 0.0
    weights = params.spatial * bowl_weight(*grid.support, params.bowl) ** 2
    u_f = np.zeros_like(x_f).reshape(2, -1, channels)
    g_f = np.empty_like(u_f)
    f_f = np.zeros_like(u_f) if previous is None or not params.warm_start else previous.f_f.reshape(u_f.shape)
    x, delta, y = x_f.reshape(u_f.shape), residue_f.reshape(u_f.shape), y_f.reshape(2, -1)
    penalty, before = params.penalty, 0.0
    filter_ = np.zeros((*grid.support, channels), np.float32)
    for _ in range(params.admm_iterations):
        shift = np.float32(penalty * size)
        solve_g(x, delta, y, f_f, u_f, g_f,
                np.float32(params.residue), np.float32(before * size), shift, np.float32(1 + aberrance))  # fmt: skip
        # Eq. 8: (mu + lambda + tau + theta w^2) f = mu g + zeta + tau f'
        pulled = grid.inverse_support(u_f.reshape(x_f.shape)) / np.float32(size)
        if previous is not None:
            pulled += np.float32(temporal) * previous.filter
        stiffness = np.asarray(penalty + params.ridge + temporal + weights, dtype=np.float32)
        filter_ = np.asarray(pulled / stiffness[..., None], dtype=np.float32)
        f_f = grid.forward_support(filter_).reshape(u_f.shape)
        before, penalty = penalty, min(penalty * params.penalty_growth, params.penalty_max)
    return Learned(filter_, f_f.reshape(x_f.shape), g_f.reshape(x_f.shape))
