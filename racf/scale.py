"""The one-dimensional scale filter (fDSST, Danelljan 2017): a correlation filter over 33 sizes of the target.

Letters: s number of scales, d features of one scale.  num = ysᶠ conj(xsᶠ) (s//2 + 1, d) and den = sum_d |xsᶠ|^2
(s//2 + 1,) are running means, of the non-redundant frequencies; the response over scales is
F^-1( sum_d num . zsᶠ / (den + lambda) ).
"""

import functools
import math

import numpy as np
from numpy.typing import NDArray

from racf import hog
from racf.box import Box
from racf.params import Params
from racf.patch import bilinear, shrunk

UInt8 = NDArray[np.uint8]
Float32 = NDArray[np.float32]
Complex64 = NDArray[np.complex64]


class ScaleFilter:
    """Estimates the change of the target's size; `base_w`, `base_h` are its size in the first frame."""

    def __init__(self, params: Params, base_w: float, base_h: float) -> None:
        self.params, cell = params, params.cell_px
        # In pixels of the fixed-size sample, as in ARCF: a target of ten pixels is also enlarged first, because
        # otherwise it would have only a cell or two.
        side = math.sqrt(base_w * base_h) * params.search_area
        zoom = min(max(side, params.sample_min_px), params.sample_max_px) / side
        shrink = min(zoom, math.sqrt(params.scale_model_area_px / (base_w * base_h)))
        # At least two cells a side: with one there is no shape to compare.
        self.model_w = max(2, math.floor(base_w * shrink / cell)) * cell
        self.model_h = max(2, math.floor(base_h * shrink / cell)) * cell
        count = params.scales
        steps = np.arange(count) - count // 2
        self.factors = params.scale_step ** steps.astype(np.float64)
        sigma = params.scale_sigma * math.sqrt(count)
        label = np.exp(-0.5 * (steps / sigma) ** 2)
        self._waves, self._waves_back = _waves(count)
        self._label_f = _complex(self._waves @ label.astype(np.float32)[:, None])
        self._bins = hog.orientation_bins()
        rows, cols = self.model_h // cell, self.model_w // cell
        self._hog, self._features = (
            hog.scratch(rows, cols, cell, count),
            np.empty((count, cols, rows, hog.CHANNELS), np.float32),
        )
        window = np.hanning(count + 2)[1:-1].astype(np.float32)
        self._windows = np.ascontiguousarray(np.broadcast_to(window[:, None, None], (count, cols, rows)))
        self._num: Complex64 | None = None
        self._den: Float32 | None = None
        self._at_hand: tuple[Box, Complex64] | None = None

    def sample(self, image: UInt8, box: Box) -> Complex64:
        """(s//2 + 1, d) spectrum over scales of the target's windowed FHOG; all scales in one call of each kernel."""
        x, y, w, h = box.centre_x, box.centre_y, box.w, box.h
        factor = max(int(min(w / self.model_w, h / self.model_h)), 1)
        reach = float(self.factors[-1])
        source, left, top = shrunk(image, (x - w * reach / 2, y - h * reach / 2, w * reach, h * reach), factor)
        high, wide = self.model_h, self.model_w
        steps = self.factors[:, None] * (w / factor / wide, h / factor / high)
        grids = np.empty((len(steps), 2, 2))
        grids[..., 0] = ((x - left) / factor, (y - top) / factor) - steps * ((wide - 1) / 2, (high - 1) / 2) - 0.5
        grids[..., 1] = steps
        patches = np.empty((len(steps), source.shape[2], high, wide), np.uint8)
        bilinear(source, grids.reshape(-1, 4), patches)
        hog.fhog(patches, self.params.cell_px, self._bins, self._hog, self._windows, self._features)
        return _complex(self._waves @ self._features.reshape(self.params.scales, -1))

    def estimate(self, image: UInt8, box: Box) -> int:
        """How many steps of `scale_step` the target's size changed: the response's maximum."""
        if self._num is None or self._den is None:
            return 0
        sample_f = self.sample(image, box)
        self._at_hand = (box, sample_f)
        response_f = np.sum(self._num * sample_f, axis=1) / (self._den + self.params.scale_ridge)
        response = self._waves_back @ np.concatenate([response_f.real, response_f.imag])
        return int(np.argmax(response)) - self.params.scales // 2

    def learn(self, image: UInt8, box: Box) -> None:
        """Take the target at this place and size into the running means."""
        # If the estimate did not change the box, its sample of this image can be reused.
        at_hand, self._at_hand = self._at_hand, None
        sample_f = at_hand[1] if at_hand is not None and at_hand[0] == box else self.sample(image, box)
        num = self._label_f * sample_f.conj()
        den = np.sum(sample_f.real**2 + sample_f.imag**2, axis=1)
        if self._num is None or self._den is None:
            self._num, self._den = num, den
            return
        rate = np.float32(self.params.scale_learning_rate)
        self._num += rate * (num - self._num)
        self._den += rate * (den - self._den)


@functools.lru_cache(maxsize=4)
def _waves(count: int) -> tuple[Float32, Float32]:
    """Real s values to the real, then the imaginary parts of their s//2 + 1 frequencies, and the way back.

    Scale 1 (index s//2) is position 0.
    """
    turns = np.outer(np.arange(count // 2 + 1), np.arange(count) - count // 2) * (2 * np.pi / count)
    counted = np.full((len(turns), 1), 2 / count)
    counted[0] = 1 / count
    if count % 2 == 0:
        counted[-1] = 1 / count
    forward = np.concatenate([np.cos(turns), -np.sin(turns)])
    back = np.concatenate([counted * np.cos(turns), -counted * np.sin(turns)]).T
    return np.ascontiguousarray(forward, np.float32), np.ascontiguousarray(back, np.float32)


def _complex(planes: Float32) -> Complex64:
    """(2 k, d), real parts first -> (k, d)."""
    half = len(planes) // 2
    out = np.empty((half, planes.shape[1]), np.complex64)
    out.real, out.imag = planes[:half], planes[half:]
    return out
