"""Discrete Fourier transforms as dense matrix products.

Spectra are real arrays (2, H, Wf, D): real and imaginary planes, H x Wf non-redundant frequencies with Wf = W//2 + 1,
channels last.  A filter lives on a small m x n support, so most of a transform between it and the H x W grid would
work on zeros; two matrix products skip them, and at these sizes (H, W about 50, D = 42) they beat an FFT by far and
tie with it even on the full grid.  Channels last makes each step one contiguous `sgemm`.
"""

import numpy as np
from numpy.typing import NDArray

Float32 = NDArray[np.float32]
Complex = NDArray[np.complex128]


class PrunedDft:
    """Transforms between a `rows` x `cols` grid, its centred `support` = (m, n) part, and spectra.

    Position 0 of the transforms is the grid's middle (rows//2, cols//2): a filter and a sample that are both centred
    there correlate to a peak at zero shift.
    """

    def __init__(self, rows: int, cols: int, support: tuple[int, int]) -> None:
        self.rows, self.cols, self.half, self.support = rows, cols, cols // 2 + 1, support
        top, left = rows // 2 - support[0] // 2, cols // 2 - support[1] // 2
        y, x = np.arange(rows) - rows // 2, np.arange(cols) - cols // 2
        row_waves = np.exp(-2j * np.pi * np.outer(np.arange(rows), y) / rows)  # (H, H)
        col_waves = np.exp(-2j * np.pi * np.outer(np.arange(self.half), x) / cols)  # (Wf, W)
        row_support, col_support = row_waves[:, top : top + support[0]], col_waves[:, left : left + support[1]]
        self._rows_forward, self._cols_forward = _row_step(row_waves), _col_step(col_waves)
        self._rows_forward_support, self._cols_forward_support = _row_step(row_support), _col_step(col_support)
        self._rows_inverse_support = np.ascontiguousarray(_row_step_back(row_support.conj().T / rows))
        self._cols_inverse_support = np.ascontiguousarray(_col_step((col_support.T * (self.weights() / cols)).T).T)

    def weights(self) -> NDArray[np.float64]:
        """(Wf,): how many of the full spectrum's columns each kept one stands for."""
        weights = np.full(self.half, 2.0)
        weights[0] = 1.0
        if self.cols % 2 == 0:
            weights[-1] = 1.0
        return weights

    def forward(self, x: Float32) -> Float32:
        """F x: (H, W, D) -> (2, H, Wf, D)."""
        along_cols = np.matmul(self._cols_forward, x).reshape(2 * self.rows, -1)
        return (self._rows_forward @ along_cols).reshape(2, self.rows, self.half, -1)

    def forward_support(self, f: Float32) -> Float32:
        """F P f: the spectrum (2, H, Wf, D) of a filter (m, n, D) padded with zeros."""
        along_cols = np.matmul(self._cols_forward_support, f).reshape(2 * self.support[0], -1)
        return (self._rows_forward_support @ along_cols).reshape(2, self.rows, self.half, -1)

    def inverse_support(self, g_f: Float32) -> Float32:
        """P^T F^-1 g: the (m, n, D) part around the middle of what has the spectrum (2, H, Wf, D)."""
        along_rows = self._rows_inverse_support @ g_f.reshape(2 * self.rows, -1)
        return np.matmul(self._cols_inverse_support, along_rows.reshape(self.support[0], 2 * self.half, -1))


def _col_step(waves: Complex) -> Float32:
    """(2 Wf, W): a real row of pixels -> the real parts, then the imaginary parts, of its spectrum."""
    return np.ascontiguousarray(np.concatenate([waves.real, waves.imag]).astype(np.float32))


def _row_step(waves: Complex) -> Float32:
    """Complex (K, H) product as a real one, (row, part) -> (part, frequency)."""
    step = np.empty((2, waves.shape[0], waves.shape[1], 2), np.float32)
    step[0, :, :, 0], step[0, :, :, 1] = waves.real, -waves.imag
    step[1, :, :, 0], step[1, :, :, 1] = waves.imag, waves.real
    return step.reshape(2 * waves.shape[0], 2 * waves.shape[1])


def _row_step_back(waves: Complex) -> Float32:
    """Complex (m, K) product as a real one, (part, frequency) -> (row, part)."""
    step = np.empty((waves.shape[0], 2, 2, waves.shape[1]), np.float32)
    step[:, 0, 0, :], step[:, 0, 1, :] = waves.real, -waves.imag
    step[:, 1, 0, :], step[:, 1, 1, :] = waves.imag, waves.real
    return step.reshape(2 * waves.shape[0], 2 * waves.shape[1])
