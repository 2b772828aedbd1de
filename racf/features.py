"""The feature stack of a sample: FHOG (31), colour names (10, colour images only), grey (1), under a Hann window."""

import numpy as np
from numpy.typing import NDArray

from racf import colornames, hog

UInt8 = NDArray[np.uint8]
Float32 = NDArray[np.float32]


class Features:
    """Turns patches of one size into (cols, rows, D) float32, first axis across; D is 42 for colour, 32 for grey.

    The next call of `extract` overwrites the returned array.
    """

    def __init__(self, rows: int, cols: int, cell: int, colour: bool) -> None:
        self.cell = cell
        self._colours = colornames.Colours(rows, cols, cell, colour)
        self.bins = hog.orientation_bins()
        self.shape = (cols, rows, hog.CHANNELS + (colornames.CHANNELS if colour else 0) + 1)
        # Hann without its zero ends, as is usual for cosine windows in tracking.
        across = [np.hanning(n + 2)[1:-1] for n in (cols, rows)]
        self.window = np.outer(*across).astype(np.float32)
        self._hog = hog.scratch(rows, cols, cell)
        self._out = np.empty(self.shape, np.float32)

    def extract(self, patch: UInt8) -> Float32:
        """(3 or 1, rows * cell, cols * cell) -> (cols, rows, D), windowed."""
        out, window, cell = self._out, self.window, self.cell
        hog.fhog(patch[None], cell, self.bins, self._hog, window, out[None])
        self._colours.write(patch, window, out)
        return out
