"""The ADMM solve against dense linear algebra and the paper's objective."""

import dataclasses
import itertools

import numpy as np
import pytest
import scipy.fft

from racf.filter import Learned, Solver, bowl_weight, solve_g, solve_rank_two_numpy
from racf.fourier import PrunedDft, folded, move, unfolded
from racf.params import Params
from racf.response import refine_peak, response_map, sharpness

ROWS, COLS, CHANNELS, SUPPORT = 9, 12, 3, (4, 5)


def smooth(x: np.ndarray) -> np.ndarray:
    """Without the frequencies in the middle of even axes."""
    for axis in (0, 1):
        x = (np.roll(x, 1, axis) + 2 * x + np.roll(x, -1, axis)) / 4
    return x


def planes(z: np.ndarray) -> np.ndarray:
    return np.stack([z.real, z.imag]).astype(np.float32)


def across_first(x: np.ndarray) -> np.ndarray:
    """(rows, columns, D) <-> (columns, rows, D)."""
    return np.ascontiguousarray(x.swapaxes(0, 1))


def random_planes(rng, *shape) -> np.ndarray:
    return rng.normal(size=(2, *shape)).astype(np.float32)


def centred_rfft2(x: np.ndarray) -> np.ndarray:
    """scipy's own transform of an image whose middle is position 0."""
    return scipy.fft.rfft2(scipy.fft.ifftshift(x, axes=(0, 1)), axes=(0, 1))


@pytest.mark.parametrize("size", [(9, 12), (12, 9), (10, 10), (7, 7)])
def test_a_spectrum_moved_in_two_parts_of_cells_is_that_of_the_image_rolled_by_whole_ones(size):
    image = smooth(np.random.default_rng(0).normal(size=(*size, CHANNELS)).astype(np.float32))
    grid = PrunedDft(*size, SUPPORT, CHANNELS)
    spectrum, scratch = grid.forward(across_first(image)), np.empty(grid.shape, np.float32)
    for share in (0.3, 0.7):
        move(spectrum, 2 * share, -3 * share, size, scratch)
    expected = grid.forward(across_first(np.roll(image, (-2, 3), axis=(0, 1))))
    np.testing.assert_allclose(spectrum, expected, atol=1e-4)


@pytest.mark.parametrize("size", [(9, 12), (12, 9), (10, 10), (7, 7)])
@pytest.mark.parametrize("support", [(4, 5), (5, 4), (1, 1), (7, 7)])
def test_dense_transforms_equal_an_fft(size, support):
    rng = np.random.default_rng(0)
    grid = PrunedDft(*size, support, CHANNELS)
    x = rng.normal(size=(*size, CHANNELS)).astype(np.float32)
    x_f = grid.forward(across_first(x))
    np.testing.assert_allclose(unfolded(x_f, size[0]), centred_rfft2(x), atol=1e-4)
    np.testing.assert_allclose(folded(unfolded(x_f, size[0])), x_f, atol=1e-4)
    (m, n), padded = support, np.zeros_like(x)
    part = np.s_[size[0] // 2 - m // 2 :, size[1] // 2 - n // 2 :]
    padded[part][:m, :n] = f = x[:m, :n]
    np.testing.assert_allclose(
        unfolded(grid.forward_support(across_first(f)), size[0]), centred_rfft2(padded), atol=1e-4
    )
    np.testing.assert_allclose(across_first(grid.inverse_support(x_f)), x[part][:m, :n], atol=1e-4)


def test_two_sherman_morrisons_equal_a_dense_solve():
    rng = np.random.default_rng(1)
    x, delta, rhs = (random_planes(rng, 4, 3, CHANNELS) for _ in range(3))
    eta, shift = 0.7, 2.5
    solved = solve_rank_two_numpy(x, delta, rhs, eta, shift)
    for n in np.ndindex(4, 3):
        xn, dn, bn = (a[0][n] + 1j * a[1][n] for a in (x, delta, rhs))
        dense = np.outer(xn, xn.conj()) + eta * np.outer(dn, dn.conj()) + shift * np.eye(CHANNELS)
        np.testing.assert_allclose(solved[0][n] + 1j * solved[1][n], np.linalg.solve(dense, bn), rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("gain", [1.0, 1.71])
@pytest.mark.parametrize("rows", [6, 7])
def test_the_compiled_step_equals_the_numpy_equation(gain, rows):
    rng = np.random.default_rng(2)
    # A real row's frequencies, as spectra of real samples have: those at 0 and at half the rows have no partner.
    x, d, f, u = (
        planes(rng.normal(size=(rows, 4, CHANNELS)) + 1j * rng.normal(size=(rows, 4, CHANNELS))) for _ in "xdfu"
    )
    y = random_planes(rng, rows, 4)
    eta, before, mu = 0.9, 0.5, 3.0
    zeta = u - before * f
    yx = (y[0] + 1j * y[1])[..., None] * (x[0] + 1j * x[1])
    scaled_x = x * np.float32(np.sqrt(gain))
    expected = solve_rank_two_numpy(scaled_x, d, planes(yx) + mu * f - zeta, eta, mu)
    x_f, d_f, f_f, u_f = (folded(z[0] + 1j * z[1]) for z in (x, d, f, u))
    g_f = np.empty_like(u_f)
    solve_g(x_f, d_f, y, f_f, u_f, g_f, eta, before, mu, gain)
    np.testing.assert_allclose(planes(unfolded(g_f, rows)), expected, rtol=1e-3, atol=1e-4)
    np.testing.assert_allclose(planes(unfolded(u_f, rows)), mu * expected + zeta, rtol=1e-3, atol=1e-3)


class Problem:
    """Eq. 3 on a tiny grid, its data and residue terms divided by the number of samples (see `racf.filter`).

    The circulant matrices are built sample by sample: no Fourier transform in it.
    """

    def __init__(self, params: Params) -> None:
        rng = np.random.default_rng(3)
        self.params = params
        self.x = rng.normal(size=(ROWS, COLS, CHANNELS)).astype(np.float32)
        self.delta = 0.3 * rng.normal(size=self.x.shape).astype(np.float32)
        self.previous = 0.1 * rng.normal(size=(*SUPPORT, CHANNELS)).astype(np.float32)
        fy, fx = np.fft.fftfreq(ROWS, 1 / ROWS), np.fft.fftfreq(COLS, 1 / COLS)
        self.y = np.exp(-0.5 * (fy[:, None] ** 2 + fx[None, :] ** 2)).astype(np.float32)

    def correlations(self, x: np.ndarray) -> np.ndarray:
        """(H W, m n D): row (r, c) holds the sample's part that the filter sees when shifted by (-r, -c)."""
        top, left = ROWS // 2 - SUPPORT[0] // 2, COLS // 2 - SUPPORT[1] // 2
        rows = []
        for r in range(ROWS):
            for c in range(COLS):
                shifted = np.roll(x, (r, c), axis=(0, 1))
                rows.append(shifted[top : top + SUPPORT[0], left : left + SUPPORT[1]].ravel())
        return np.array(rows, dtype=np.float64)

    def normal_equations(self) -> tuple[np.ndarray, np.ndarray]:
        p, size = self.params, ROWS * COLS
        a, d = self.correlations(self.x), self.correlations(self.delta)
        w2 = np.repeat(bowl_weight(*SUPPORT, p.bowl).ravel() ** 2, CHANNELS)
        matrix = (a.T @ a + p.residue * d.T @ d) / size
        matrix += np.diag(p.spatial * w2 + p.temporal + p.ridge)
        return matrix, a.T @ self.y.ravel() / size + p.temporal * self.previous.ravel()

    def objective(self, f: np.ndarray) -> float:
        matrix, right = self.normal_equations()
        return float(0.5 * f.ravel() @ matrix @ f.ravel() - right @ f.ravel())

    def solve(self, iterations: int, growth: float, *, warm: bool = True) -> np.ndarray:
        grid = PrunedDft(ROWS, COLS, SUPPORT, CHANNELS)
        params = dataclasses.replace(self.params, admm_iterations=iterations, penalty_growth=growth, warm_start=warm)
        y_f = planes(scipy.fft.rfft2(self.y))
        x_f, d_f = grid.forward(across_first(self.x)), grid.forward(across_first(self.delta))
        previous = across_first(self.previous)
        f_f = grid.forward_support(previous)
        solver = Solver(grid, params)
        solver.learned = Learned(previous, f_f, np.zeros_like(f_f))
        return across_first(solver.learn(x_f, d_f, y_f).filter)


@pytest.mark.parametrize("warm", [True, False])
@pytest.mark.parametrize("residue", [0.0, 1.0])
def test_admm_converges_to_the_direct_minimiser(residue, warm):
    problem = Problem(Params(residue=residue, temporal=0.2))
    matrix, right = problem.normal_equations()
    direct = np.linalg.solve(matrix, right).reshape(*SUPPORT, CHANNELS)
    np.testing.assert_allclose(
        problem.solve(300, growth=1.0, warm=warm), direct, atol=2e-4 * np.abs(direct).max() + 1e-5
    )


def test_the_objective_falls_with_the_iterations():
    problem = Problem(Params())
    values = [problem.objective(problem.solve(n, growth=1.0)) for n in (1, 2, 3, 5, 10)]
    assert all(later < earlier + 1e-9 for earlier, later in itertools.pairwise(values))


def test_a_warm_start_from_the_minimiser_stays_there_sooner_than_a_cold_one():
    """What two iterations are enough for from frame to frame, when little changes."""
    problem = Problem(Params(temporal=0.0))
    matrix, right = problem.normal_equations()
    best = np.linalg.solve(matrix, right)
    problem.previous = best.reshape(*SUPPORT, CHANNELS).astype(np.float32)
    warm, cold = (problem.objective(problem.solve(2, growth=10.0, warm=warm)) for warm in (True, False))
    assert problem.objective(best) <= warm < cold


@pytest.mark.parametrize("size", [(20, 21), (21, 20)])
@pytest.mark.parametrize("shift", [(0.3, -0.4), (-2.25, 3.1)])
def test_newton_finds_the_peak_between_the_cells(size, shift):
    fy, fx = np.fft.fftfreq(size[0], 1 / size[0]), np.fft.fftfreq(size[1], 1 / size[1])
    bump = np.exp(-0.5 * ((fy[:, None] - shift[0]) ** 2 + (fx[None, :] - shift[1]) ** 2) / 1.5**2)
    start = (round(shift[0]), round(shift[1]))
    found = refine_peak(np.fft.rfft2(bump).astype(np.complex64), size[1], *start, steps=5)
    assert found == pytest.approx(shift, abs=0.02)


@pytest.mark.parametrize("size", [(20, 21), (21, 20), (9, 9)])
def test_the_response_map_and_its_sharpness_equal_their_equations(size):
    response = np.random.default_rng(5).normal(size=size).astype(np.float32)
    response[size[0] // 2, 2] = 9
    spectrum = np.fft.rfft2(np.fft.ifftshift(response)).astype(np.complex64)
    np.testing.assert_allclose(response_map(spectrum, size), response, atol=1e-5)
    sidelobe = np.ones(size, bool)
    sidelobe[size[0] // 2 - 2 : size[0] // 2 + 3, :6] = False  # half of 4 x 6 cells around the peak
    psr = (9 - response[sidelobe].mean()) / response[sidelobe].std()
    apce = (9 - response.min()) ** 2 / np.mean((response - response.min()) ** 2)
    assert sharpness(response, (6.0, 4.0)) == pytest.approx((psr, apce), rel=1e-4)
