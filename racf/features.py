"""The feature stack of a sample: FHOG (31), colour names (10, colour images only), grey (1), under a Hann window."""

import numba
import numpy as np
from numpy.typing import NDArray

from racf import colornames, hog

UInt8 = NDArray[np.uint8]
Float32 = NDArray[np.float32]


GREY_OF_BGR = np.array([0.114, 0.587, 0.299], np.float32)  # ITU-R BT.601
GREY_OF_GREY = np.ones(1, np.float32)


@numba.njit(cache=True, fastmath=True)
def _mean_grey(patch: UInt8, cell: int, mix: Float32, out: Float32, channel: int) -> None:
    """Write the mean grey of each cell, -0.5..0.5, into one channel of `out`; `mix`: share of each plane in grey."""
    rows, cols = out.shape[0], out.shape[1]
    totals, sums = np.empty(cols, np.float32), np.empty(cols * cell, np.int32)
    for row in range(rows):
        totals[:] = 0
        for c in range(patch.shape[0]):
            sums[:] = 0
            for y in range(row * cell, (row + 1) * cell):
                line = patch[c, y]
                for x in range(cols * cell):
                    sums[x] += line[x]
            for col in range(cols):
                totals[col] += mix[c] * np.float32(sums[col * cell : (col + 1) * cell].sum())
        for col in range(cols):
            out[row, col, channel] = totals[col] / np.float32(255 * cell * cell) - np.float32(0.5)


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
        self.names = colornames.padded_table() if colour else None
        self.bins = hog.orientation_bins()
        self.shape = (rows, cols, hog.CHANNELS + (colornames.CHANNELS if colour else 0) + 1)
        # Hann without its zero ends, as is usual for cosine windows in tracking.
        across = [np.hanning(n + 2)[1:-1] for n in (rows, cols)]
        self.window = np.outer(*across).astype(np.float32)

    def extract(self, patch: UInt8) -> Float32:
        """(3 or 1, rows * cell, cols * cell) -> (rows, cols, D), windowed."""
        out = np.empty(self.shape, np.float32)
        hog.fhog(patch, self.cell, self.bins, out)
        if self.names is not None:
            colornames.colour_names(patch, self.cell, self.names, out, hog.CHANNELS)
        _mean_grey(patch, self.cell, GREY_OF_GREY if len(patch) == 1 else GREY_OF_BGR, out, self.shape[2] - 1)
        _apply_window(out, self.window)
        return out
