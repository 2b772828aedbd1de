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

import numpy as np
from numpy.typing import NDArray

from racf.fourier import PrunedDft
from racf.kernels import compiled, inlined
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


Products = tuple[Scalar, Scalar, Scalar, Scalar, Scalar, Scalar, Scalar, Scalar]
Shares = tuple[Scalar, Scalar, Scalar, Scalar]


@inlined
def _products(
    x_f: Float32, d_f: Float32, f_f: Float32, u_f: Float32, k: int, n: int, pull: Scalar
) -> tuple[Products, Products]:  # fmt: skip
    """Inner products of x, delta and v = mu f - zeta at the frequencies k and -k down and n across."""
    x_p, x_pi, x_q, x_qi = x_f[0, k, 0, n], x_f[0, k, 1, n], x_f[1, k, 0, n], x_f[1, k, 1, n]
    d_p, d_pi, d_q, d_qi = d_f[0, k, 0, n], d_f[0, k, 1, n], d_f[1, k, 0, n], d_f[1, k, 1, n]
    f_p, f_pi, f_q, f_qi = f_f[0, k, 0, n], f_f[0, k, 1, n], f_f[1, k, 0, n], f_f[1, k, 1, n]
    u_p, u_pi, u_q, u_qi = u_f[0, k, 0, n], u_f[0, k, 1, n], u_f[1, k, 0, n], u_f[1, k, 1, n]
    xx1 = dd1 = dx_re1 = dx_im1 = xv_re1 = xv_im1 = dv_re1 = dv_im1 = np.float32(0)
    xx2 = dd2 = dx_re2 = dx_im2 = xv_re2 = xv_im2 = dv_re2 = dv_im2 = np.float32(0)
    for m in range(x_p.size):
        a1, b1, a2, b2 = x_p[m] + x_qi[m], x_pi[m] - x_q[m], x_p[m] - x_qi[m], x_pi[m] + x_q[m]
        c1, e1, c2, e2 = d_p[m] + d_qi[m], d_pi[m] - d_q[m], d_p[m] - d_qi[m], d_pi[m] + d_q[m]
        v_p, v_pi = pull * f_p[m] - u_p[m], pull * f_pi[m] - u_pi[m]
        v_q, v_qi = pull * f_q[m] - u_q[m], pull * f_qi[m] - u_qi[m]
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
    return (
        (xx1, dd1, dx_re1, dx_im1, xv_re1, xv_im1, dv_re1, dv_im1),
        (xx2, dd2, dx_re2, dx_im2, xv_re2, xv_im2, dv_re2, dv_im2),
    )


@inlined
def _shares(products: Products, y: Scalar, y_im: Scalar, eta: Scalar, mu: Scalar, gain: Scalar) -> Shares:
    """p and q of mu g = v + p x - q delta, for the right-hand side y x + v at one frequency.

    A1^-1 r = (r - eta delta (delta^H r) / (mu + eta delta^H delta)) / mu;  g = A1^-1 r - A1^-1 x s.
    """
    xx, dd, dx, dx_im, xv, xv_im, dv, dv_im = products
    xr, xr_im = y * xx + xv, y_im * xx + xv_im
    dr, dr_im = y * dx - y_im * dx_im + dv, y * dx_im + y_im * dx + dv_im
    share = eta / (mu + eta * dd)
    x_a_x = (xx - share * (dx * dx + dx_im * dx_im)) / mu
    factor = gain / (mu * (np.float32(1) + gain * x_a_x))
    s = (xr - share * (dx * dr + dx_im * dr_im)) * factor
    s_im = (xr_im - share * (dx * dr_im - dx_im * dr)) * factor
    t, t_im = share * (dr - (dx * s - dx_im * s_im)), share * (dr_im - (dx * s_im + dx_im * s))
    return y - s, y_im - s_im, t, t_im


@inlined
def _advance(
    x_f: Float32, d_f: Float32, f_f: Float32, u_f: Float32, g_f: Float32, k: int, n: int,
    pull: Scalar, mu: Scalar, shares1: Shares, shares2: Shares,
) -> None:  # fmt: skip
    """Write g and u = mu g + zeta at the frequencies k and -k down and n across."""
    half, inverse = np.float32(0.5), np.float32(1) / mu
    (s1, s_im1, t1, t_im1), (s2, s_im2, t2, t_im2) = shares1, shares2
    x_p, x_pi, x_q, x_qi = x_f[0, k, 0, n], x_f[0, k, 1, n], x_f[1, k, 0, n], x_f[1, k, 1, n]
    d_p, d_pi, d_q, d_qi = d_f[0, k, 0, n], d_f[0, k, 1, n], d_f[1, k, 0, n], d_f[1, k, 1, n]
    f_p, f_pi, f_q, f_qi = f_f[0, k, 0, n], f_f[0, k, 1, n], f_f[1, k, 0, n], f_f[1, k, 1, n]
    u_p, u_pi, u_q, u_qi = u_f[0, k, 0, n], u_f[0, k, 1, n], u_f[1, k, 0, n], u_f[1, k, 1, n]
    g_p, g_pi, g_q, g_qi = g_f[0, k, 0, n], g_f[0, k, 1, n], g_f[1, k, 0, n], g_f[1, k, 1, n]
    for m in range(x_p.size):
        a1, b1, a2, b2 = x_p[m] + x_qi[m], x_pi[m] - x_q[m], x_p[m] - x_qi[m], x_pi[m] + x_q[m]
        c1, e1, c2, e2 = d_p[m] + d_qi[m], d_pi[m] - d_q[m], d_p[m] - d_qi[m], d_pi[m] + d_q[m]
        h1, i1 = a1 * s1 - b1 * s_im1 - c1 * t1 + e1 * t_im1, a1 * s_im1 + b1 * s1 - c1 * t_im1 - e1 * t1
        h2, i2 = a2 * s2 - b2 * s_im2 - c2 * t2 + e2 * t_im2, a2 * s_im2 + b2 * s2 - c2 * t_im2 - e2 * t2
        # mu g - v, folded; then u = mu g + zeta = mu f + (mu g - v)
        o_p, o_pi, o_q, o_qi = half * (h1 + h2), half * (i1 + i2), half * (i2 - i1), half * (h1 - h2)
        g_p[m] = (pull * f_p[m] - u_p[m] + o_p) * inverse
        g_pi[m] = (pull * f_pi[m] - u_pi[m] + o_pi) * inverse
        g_q[m] = (pull * f_q[m] - u_q[m] + o_q) * inverse
        g_qi[m] = (pull * f_qi[m] - u_qi[m] + o_qi) * inverse
        u_p[m], u_pi[m] = mu * f_p[m] + o_p, mu * f_pi[m] + o_pi
        u_q[m], u_qi[m] = mu * f_q[m] + o_q, mu * f_qi[m] + o_qi


@compiled
def solve_g(
    x_f: Float32, d_f: Float32, y_f: Float32, f_f: Float32, u_f: Float32, g_f: Float32,
    eta: Scalar, mu_before: Scalar, mu: Scalar, gain: Scalar,
) -> None:  # fmt: skip
    """One ADMM step on the spectra, in place: same as `solve_rank_two_numpy` with the step's right-hand side.

    x_f, d_f, f_f (folded spectra) and the label y_f (2, H, Wf) are read.  `u_f` holds g mu_before + zeta_before and
    becomes g mu + zeta, where zeta = u_before - mu_before f is the updated Lagrangian (Eq. 13): what the filter's
    subproblem transforms next.  `g_f` receives g.  The data term is weighed with `gain` (1 + gamma for ARCF).

    Frequencies k and -k down are solved together; their letters end in 1 and 2.  The right-hand side is y x + v with
    v = mu f - zeta.
    """
    rows, pull = y_f.shape[1], mu_before + mu
    for k in range(x_f.shape[1]):
        for n in range(x_f.shape[3]):
            first, second = _products(x_f, d_f, f_f, u_f, k, n, pull)
            shares1 = _shares(first, y_f[0, k, n], y_f[1, k, n], eta, mu, gain)
            mirrored = (rows - k) % rows
            shares2 = _shares(second, y_f[0, mirrored, n], y_f[1, mirrored, n], eta, mu, gain)
            _advance(x_f, d_f, f_f, u_f, g_f, k, n, pull, mu, shares1, shares2)


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
            solve_g(x_f, residue_f, y_f, new.f_f, u_f, new.g_f, np.float32(params.residue), np.float32(before * size),
                    np.float32(penalty * size), np.float32(1 + aberrance))  # fmt: skip
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
