"""The feature stack of a sample: FHOG (31), colour names (10, colour images only), grey (1), under a Hann window."""

import numpy as np
from numpy.typing import NDArray

from racf import colornames, hog
from racf.kernels import compiled

UInt8 = NDArray[np.uint8]
Float32 = NDArray[np.float32]
Int32 = NDArray[np.int32]


GREY_OF_BGR = np.array([0.114, 0.587, 0.299], np.float32)  # ITU-R BT.601
GREY_OF_GREY = np.ones(1, np.float32)


@compiled
def mean_grey(
    patch: UInt8, cell: int, mix: Float32, window: Float32, sums: Int32, out: Float32, channel: int
) -> None:  # fmt: skip
    """Write the mean grey of each cell, -0.5..0.5, times the window into one channel of `out` (W/cell, H/cell, D).

    `mix`: share of each plane in grey.  `sums` (W,) is scratch.
    """
    cols, rows = out.shape[0], out.shape[1]
    scale = np.float32(255 * cell * cell)
    for row in range(rows):
        for col in range(cols):
            out[col, row, channel] = 0
        for c in range(patch.shape[0]):
            for x in range(cols * cell):
                sums[x] = 0
            for y in range(row * cell, (row + 1) * cell):
                line = patch[c, y]
                for x in range(cols * cell):
                    sums[x] += line[x]
            for col in range(cols):
                total = np.int32(0)
                for x in range(col * cell, (col + 1) * cell):
                    total += sums[x]
                out[col, row, channel] += mix[c] * np.float32(total)
        for col in range(cols):
            out[col, row, channel] = (out[col, row, channel] / scale - np.float32(0.5)) * window[col, row]


class Features:
    """Turns patches of one size into (cols, rows, D) float32, first axis across; D is 42 for colour, 32 for grey.

    What `extract` returned is overwritten by its next call.
    """

    def __init__(self, rows: int, cols: int, cell: int, colour: bool) -> None:
        self.cell = cell
        self.names = colornames.padded_table() if colour else None
        self.bins = hog.orientation_bins()
        self.shape = (cols, rows, hog.CHANNELS + (colornames.CHANNELS if colour else 0) + 1)
        # Hann without its zero ends, as is usual for cosine windows in tracking.
        across = [np.hanning(n + 2)[1:-1] for n in (cols, rows)]
        self.window = np.outer(*across).astype(np.float32)
        self._hog = hog.scratch(rows, cols, cell)
        self._sums, self._colours = np.empty(cols * cell, np.int32), np.empty(cell * cols * cell, np.uint32)
        self._out = np.empty(self.shape, np.float32)

    def extract(self, patch: UInt8) -> Float32:
        """(3 or 1, rows * cell, cols * cell) -> (cols, rows, D), windowed."""
        out, window, cell = self._out, self.window, self.cell
        hog.fhog(patch, cell, self.bins, self._hog, window, out)
        if self.names is not None:
            colornames.colour_names(patch, cell, self.names, window, self._colours, out, hog.CHANNELS)
        mix = GREY_OF_GREY if len(patch) == 1 else GREY_OF_BGR
        mean_grey(patch, cell, mix, window, self._sums, out, self.shape[2] - 1)
        return out
