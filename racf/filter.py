"""The residue-aware correlation filter: the paper's Eq. 3, learned with ADMM.

    E(f) = 1/(2T) |y - sum_d x_d * P f_d|^2 + eta/(2T) |sum_d delta_d * P f_d|^2
         + theta/2 sum_d |w . f_d|^2 + tau/2 sum_d |f_d - f'_d|^2 + lambda/2 sum_d |f_d|^2        (f': last frame's f)

Letters, beside the code's names: x model sample, delta `residue_f`, y label, f `filter` (m, n, D), g `response filter`
(its spectrum without the support constraint), zeta Lagrangian, w bowl, P zero padding, mu penalty, T = H W the number
of samples; a hat is `_f`.  Spectra are (2, H, Wf, D) float32 planes (see `racf.fourier`).  BACF is the same with
eta = theta = tau = 0; ARCF adds gamma/(2T) |M' - M|^2 (Eq. 2), which turns the data term into
(1 + gamma) |M - (y + gamma M') / (1 + gamma)|^2 / (2T).

Eq. 3 as printed lacks the 1/T: relative to data and residue, lambda, theta and tau weigh T times as much here as there.
The published trackers of this family do the same with mu: their transform is not unitary, so their mu means T mu in the
step of g, which `shift` below is; the step of f (Eq. 8) has mu beside lambda, theta and tau as printed.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from racf.fourier import PrunedDft, places
from racf.kernels import compiled, inlined
from racf.params import Params

Float32 = NDArray[np.float32]
UInt32 = NDArray[np.uint32]
Scalar = np.float32  # a Python float would make the compiled sums double precision


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


@inlined
def _products(
    x: Float32, d: Float32, f: Float32, u: Float32, p: np.uint32, p_im: np.uint32, q: np.uint32, q_im: np.uint32,
    channels: int, pull: Scalar, out: Float32,
) -> None:  # fmt: skip
    """Inner products of x, delta and v = mu f - zeta at a pair of frequencies: out (2, 8)."""
    xx1 = dd1 = dx_re1 = dx_im1 = xv_re1 = xv_im1 = dv_re1 = dv_im1 = np.float32(0)
    xx2 = dd2 = dx_re2 = dx_im2 = xv_re2 = xv_im2 = dv_re2 = dv_im2 = np.float32(0)
    for m in range(np.uint32(channels)):
        x_p, x_pi, x_q, x_qi = x[p + m], x[p_im + m], x[q + m], x[q_im + m]
        d_p, d_pi, d_q, d_qi = d[p + m], d[p_im + m], d[q + m], d[q_im + m]
        a1, b1, a2, b2 = x_p + x_qi, x_pi - x_q, x_p - x_qi, x_pi + x_q
        c1, e1, c2, e2 = d_p + d_qi, d_pi - d_q, d_p - d_qi, d_pi + d_q
        v_p, v_pi = pull * f[p + m] - u[p + m], pull * f[p_im + m] - u[p_im + m]
        v_q, v_qi = pull * f[q + m] - u[q + m], pull * f[q_im + m] - u[q_im + m]
        v1, w1, v2, w2 = v_p + v_qi, v_pi - v_q, v_p - v_qi, v_pi + v_q
        xx1 += a1 * a1 + b1 * b1
        xx2 += a2 * a2 + b2 * b2
        dd1 += c1 * c1 + e1 * e1
        dd2 += c2 * c2 + e2 * e2
        dx_re1 += c1 * a1 + e1 * b1
        dx_im1 += c1 * b1 - e1 * a1
        dx_re2 += c2 * a2 + e2 * b2
        dx_im2 += c2 * b2 - e2 * a2
        xv_re1 += a1 * v1 + b1 * w1
        xv_im1 += a1 * w1 - b1 * v1
        xv_re2 += a2 * v2 + b2 * w2
        xv_im2 += a2 * w2 - b2 * v2
        dv_re1 += c1 * v1 + e1 * w1
        dv_im1 += c1 * w1 - e1 * v1
        dv_re2 += c2 * v2 + e2 * w2
        dv_im2 += c2 * w2 - e2 * v2
    out[0, 0], out[0, 1], out[0, 2], out[0, 3] = xx1, dd1, dx_re1, dx_im1
    out[0, 4], out[0, 5], out[0, 6], out[0, 7] = xv_re1, xv_im1, dv_re1, dv_im1
    out[1, 0], out[1, 1], out[1, 2], out[1, 3] = xx2, dd2, dx_re2, dx_im2
    out[1, 4], out[1, 5], out[1, 6], out[1, 7] = xv_re2, xv_im2, dv_re2, dv_im2


@inlined
def _shares(of: Float32, which: int, label: Float32, place: int, eta: Scalar, mu: Scalar, gain: Scalar) -> None:
    """Turn the inner products into p and q of mu g = v + p x - q delta, for right-hand side y x + v at one frequency.

    A1^-1 r = (r - eta delta (delta^H r) / (mu + eta delta^H delta)) / mu;  g = A1^-1 r - A1^-1 x s.
    """
    y, y_im = label[place], label[np.uint32(label.size // 2) + place]
    xx, dx, dx_im = of[which, 0], of[which, 2], of[which, 3]
    xr, xr_im = y * xx + of[which, 4], y_im * xx + of[which, 5]
    dr, dr_im = y * dx - y_im * dx_im + of[which, 6], y * dx_im + y_im * dx + of[which, 7]
    share = eta / (mu + eta * of[which, 1])
    x_a_x = (xx - share * (dx * dx + dx_im * dx_im)) / mu
    factor = gain / (mu * (np.float32(1) + gain * x_a_x))
    s = (xr - share * (dx * dr + dx_im * dr_im)) * factor
    s_im = (xr_im - share * (dx * dr_im - dx_im * dr)) * factor
    of[which, 0], of[which, 1] = y - s, y_im - s_im
    of[which, 2] = share * (dr - (dx * s - dx_im * s_im))
    of[which, 3] = share * (dr_im - (dx * s_im + dx_im * s))


@inlined
def _steps(
    x: Float32, d: Float32, p: np.uint32, p_im: np.uint32, q: np.uint32, q_im: np.uint32, channels: int,
    shares: Float32, first: int, out: Float32,
) -> None:  # fmt: skip
    """mu g - v at a pair of frequencies, folded: each part of P and Q into a quarter of `out`, from `first` on."""
    half, quarter = np.float32(0.5), out.size // 4
    o_p, o_pi, o_q, o_qi = (
        np.uint32(first),
        np.uint32(first + quarter),
        np.uint32(first + 2 * quarter),
        np.uint32(first + 3 * quarter),
    )
    s1, s_im1, t1, t_im1 = shares[0, 0], shares[0, 1], shares[0, 2], shares[0, 3]
    s2, s_im2, t2, t_im2 = shares[1, 0], shares[1, 1], shares[1, 2], shares[1, 3]
    for m in range(np.uint32(channels)):
        x_p, x_pi, x_q, x_qi = x[p + m], x[p_im + m], x[q + m], x[q_im + m]
        d_p, d_pi, d_q, d_qi = d[p + m], d[p_im + m], d[q + m], d[q_im + m]
        a1, b1, a2, b2 = x_p + x_qi, x_pi - x_q, x_p - x_qi, x_pi + x_q
        c1, e1, c2, e2 = d_p + d_qi, d_pi - d_q, d_p - d_qi, d_pi + d_q
        h1, i1 = a1 * s1 - b1 * s_im1 - c1 * t1 + e1 * t_im1, a1 * s_im1 + b1 * s1 - c1 * t_im1 - e1 * t1
        h2, i2 = a2 * s2 - b2 * s_im2 - c2 * t2 + e2 * t_im2, a2 * s_im2 + b2 * s2 - c2 * t_im2 - e2 * t2
        out[o_p + m], out[o_pi + m], out[o_q + m], out[o_qi + m] = (
            half * (h1 + h2), half * (i1 + i2), half * (i2 - i1), half * (h1 - h2)
        )  # fmt: skip


@compiled
def _solved(
    x: Float32, d: Float32, y: Float32, f: Float32, u: Float32, g: Float32, at: UInt32, work: Float32,
    steps: Float32, half: int, channels: int, eta: Scalar, mu_before: Scalar, mu: Scalar, gain: Scalar,
) -> None:  # fmt: skip
    """See `solve_g`; arrays are flat, `work` (2, 8) and `steps` (4 (W//2 + 1) D,) are scratch.

    Frequencies k and -k down are solved together; their letters end in 1 and 2.  The right-hand side is y x + v with
    v = mu f - zeta.
    """
    pull, inverse = mu_before + mu, np.float32(1) / mu
    for first in range(0, at.shape[0], half):  # one k
        for n in range(half):
            i = first + n
            p, p_im, q, q_im = at[i, 0], at[i, 1], at[i, 2], at[i, 3]
            _products(x, d, f, u, p, p_im, q, q_im, channels, pull, work)
            for which in range(2):
                _shares(work, which, y, at[i, 4 + which], eta, mu, gain)
            _steps(x, d, p, p_im, q, q_im, channels, work, n * channels, steps)
        for part in range(4):  # u = mu g + zeta = mu f + (mu g - v)
            begin, step = at[first, part], np.uint32(part * half * channels)
            for m in range(np.uint32(half * channels)):
                f_m, u_m, step_m = f[begin + m], u[begin + m], steps[step + m]
                g[begin + m] = (pull * f_m - u_m + step_m) * inverse
                u[begin + m] = mu * f_m + step_m


def solve_g(
    x_f: Float32, d_f: Float32, y_f: Float32, f_f: Float32, u_f: Float32, g_f: Float32,
    eta: float, mu_before: float, mu: float, gain: float,
) -> None:  # fmt: skip
    """One ADMM step on the spectra, in place: same as `solve_rank_two_numpy` with the step's right-hand side.

    x_f, d_f, f_f (folded spectra) and the label y_f (2, H, Wf) are read.  `u_f` holds g mu_before + zeta_before and
    becomes g mu + zeta, where zeta = u_before - mu_before f is the updated Lagrangian (Eq. 13): what the filter's
    subproblem transforms next.  `g_f` receives g.  The data term is weighed with `gain` (1 + gamma for ARCF).
    """
    half, channels = x_f.shape[-2:]
    x, d, y, f, u, g = (array.reshape(-1) for array in (x_f, d_f, y_f, f_f, u_f, g_f))
    work, steps = np.empty((2, 8), np.float32), np.empty(4 * half * channels, np.float32)
    weights = np.float32(eta), np.float32(mu_before), np.float32(mu), np.float32(gain)
    _solved(x, d, y, f, u, g, places(*y_f.shape[1:], channels), work, steps, half, channels, *weights)


@dataclass(frozen=True, slots=True, eq=False)
class Learned:
    """A filter on its support, (n, m, D), its folded spectrum, and the unconstrained one that localises."""

    filter: Float32
    f_f: Float32
    g_f: Float32


class Solver:
    """Minimises E with `params.admm_iterations` steps of ADMM; keeps the last filter and its scratch.

    `learned` is overwritten by the next `learn`.
    """

    def __init__(self, grid: PrunedDft, params: Params) -> None:
        self.grid, self.params = grid, params
        self.learned: Learned | None = None
        channels = grid.shape[-1]
        self._u_f = np.empty(grid.shape, np.float32)
        self._pulled = np.empty((grid.support[1], grid.support[0], channels), np.float32)
        self._weights = (params.spatial * bowl_weight(*grid.support, params.bowl) ** 2).T[..., None]

    def learn(self, x_f: Float32, residue_f: Float32, y_f: Float32, aberrance: float = 0.0) -> Learned:
        """x_f, residue_f: folded spectra of the model sample and the residue.  y_f (2, H, Wf): the label.

        With `aberrance` (gamma) > 0 the label is label + gamma times the previous response.  With `params.warm_start`
        the iterations begin from the last frame's filter, otherwise from zero.
        """
        grid, params, last, u_f = self.grid, self.params, self.learned, self._u_f
        temporal = params.temporal if last is not None else 0.0
        new = last or Learned(np.empty_like(self._pulled), np.zeros(grid.shape, np.float32), np.empty_like(u_f))
        if not params.warm_start:
            new.f_f.fill(0)
        u_f.fill(0)
        toward = None if last is None or temporal == 0 else np.float32(temporal) * last.filter
        penalty, before, size = params.penalty, 0.0, grid.rows * grid.cols
        for _ in range(params.admm_iterations):
            solve_g(x_f, residue_f, y_f, new.f_f, u_f, new.g_f, params.residue, before * size,
                    penalty * size, 1 + aberrance)  # fmt: skip
            # Eq. 8: (mu + lambda + tau + theta w^2) f = mu g + zeta + tau f'
            pulled = grid.inverse_support(u_f, self._pulled)
            pulled /= np.float32(size)
            if toward is not None:
                pulled += toward
            stiffness = np.asarray(penalty + params.ridge + temporal + self._weights, dtype=np.float32)
            np.divide(pulled, stiffness, out=new.filter)
            grid.forward_support(new.filter, new.f_f)
            before, penalty = penalty, min(penalty * params.penalty_growth, params.penalty_max)
        self.learned = new
        return new
