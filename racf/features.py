"""The feature stack of a sample: FHOG (31), colour names (10, colour pictures only), grey (1), under a Hann window."""

import cv2
import numba
import numpy as np
from numpy.typing import NDArray

from racf import colornames, hog

UInt8 = NDArray[np.uint8]
Float32 = NDArray[np.float32]


@numba.njit(cache=True, fastmath=True)
def _mean_grey(grey: UInt8, cell: int, out: Float32, channel: int) -> None:
    """Write the mean of each cell, -0.5..0.5, into one channel of `out`."""
    share = np.float32(1.0 / (255.0 * cell * cell))
    for row in range(out.shape[0]):
        for col in range(out.shape[1]):
            total = 0
            for y in range(row * cell, (row + 1) * cell):
                for x in range(col * cell, (col + 1) * cell):
                    total += grey[y, x]
            out[row, col, channel] = np.float32(total) * share - np.float32(0.5)


@numba.njit(cache=True, fastmath=True)
def _apply_window(features: Float32, window: Float32) -> None:
    """features *= window[..., None], in place."""
    for row in range(features.shape[0]):
        for col in range(features.shape[1]):
            for k in range(features.shape[2]):
                features[row, col, k] *= window[row, col]


class Features:
    """Turns patches of one size into (rows, cols, D) float32; D is 42 for colour, 32 for grey."""

    def __init__(self, rows: int, cols: int, cell: int, colour: bool) -> None:
        self.cell = cell
        self.names = colornames.table() if colour else None
        self.bins = hog.orientation_bins()
        self.shape = (rows, cols, hog.CHANNELS + (colornames.CHANNELS if colour else 0) + 1)
        # Hann without its zero ends, as is usual for cosine windows in tracking.
        across = [np.hanning(n + 2)[1:-1] for n in (rows, cols)]
        self.window = np.outer(*across).astype(np.float32)

    def extract(self, patch: UInt8) -> Float32:
        """(rows * cell, cols * cell[, 3]) -> (rows, cols, D), windowed."""
        out = np.empty(self.shape, np.float32)
        if patch.ndim == 2:
            grey, layered = patch, patch[..., None]
        else:
            grey, layered = np.asarray(cv2.cvtColor(patch, cv2.COLOR_BGR2GRAY), dtype=np.uint8), patch
        hog.fhog(layered, self.cell, self.bins, out)
        if self.names is not None:
            colornames.colour_names(layered, self.cell, self.names, out, hog.CHANNELS)
        _mean_grey(grey, self.cell, out, self.shape[2] - 1)
        _apply_window(out, self.window)
        return out
