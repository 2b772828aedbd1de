"""The translation filter with its sample, features, label and model; learns and localises."""

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from racf import response as responses
from racf.box import Box
from racf.features import Features
from racf.filter import Solver
from racf.fourier import PrunedDft, move
from racf.params import Params
from racf.patch import resample

UInt8 = NDArray[np.uint8]
Float32 = NDArray[np.float32]
Complex64 = NDArray[np.complex64]


@dataclass(frozen=True, slots=True, eq=False)
class Match:
    """The maximum of the response: the box moved to it, the response and its sharpness.

    `value` is the response's peak; 1 is the filter's response to the model it was learned from.
    """

    box: Box
    response: Float32
    value: float
    psr: float
    apce: float


def approach(model: Float32, sample: Float32, residue: Float32, rate: np.float32) -> None:
    """residue = sample - model, then model += rate residue (Eq. 14), on arrays of one shape."""
    flat, apart = model.reshape(1, -1), residue.reshape(1, -1)
    cv2.subtract(sample.reshape(1, -1), flat, dst=apart)
    cv2.scaleAdd(apart, float(rate), flat, dst=flat)


class TranslationFilter:
    """Learns a target box and finds its new position.  The first box fixes the sizes in cells."""

    def __init__(self, params: Params, first: Box, colour: bool) -> None:
        self.params, cell = params, params.cell_px
        side = math.sqrt(first.area) * params.search_area
        cells = round(min(max(side, params.sample_min_px), params.sample_max_px) / cell)
        self._features = Features(cells, cells, cell, colour)
        self._target_cells = (first.w * cells / side, first.h * cells / side)
        support = [min(max(math.floor(n), 1), cells) for n in self._target_cells]
        self._grid = PrunedDft(cells, cells, (support[1], support[0]), self._features.shape[2])
        self._solver = Solver(self._grid, params)
        sigma = math.sqrt(self._target_cells[0] * self._target_cells[1]) * params.label_sigma
        shift = np.fft.fftfreq(cells, 1 / cells)
        label = np.exp(-0.5 * (shift[:, None] ** 2 + shift[None, :] ** 2) / sigma**2).astype(np.float32)
        label_f = np.fft.rfft2(label)
        self._label_f = np.stack([label_f.real, label_f.imag]).astype(np.float32)
        self._model_f: Float32 | None = None
        self._learned_f: Float32 | None = None  # the sample that was learned last, for the residue between samples
        self._sample_f, self._residue_f = (np.zeros(self._grid.shape, np.float32) for _ in range(2))
        self._localised_at: Box | None = None  # where `_sample_f` was taken
        self._response_f: Complex64 | None = None
        self._self_response = 1.0

    def region(self, box: Box) -> Box:
        """The square search region around a box."""
        side = math.sqrt(box.area) * self.params.search_area
        return Box.around(box.centre_x, box.centre_y, side, side)

    def sample(self, image: UInt8, box: Box, out: Float32 | None = None) -> Float32:
        """Folded spectrum (see `racf.fourier`) of the windowed features around a box."""
        region, size = self.region(box), self._grid.rows * self.params.cell_px
        patch = resample(image, region.centre_x, region.centre_y, region.w, region.h, size, size)
        return self._grid.forward(self._features.extract(patch), out)

    def _correlate(self, z_f: Float32) -> Complex64:
        learned = self._solver.learned
        assert learned is not None, "learn comes before locate"
        out = np.empty((self._grid.rows, self._grid.half), np.complex64)
        responses.correlate(z_f, learned.g_f, out)
        return out

    def locate(self, image: UInt8, box: Box) -> Match:
        """Find the target in the region around `box` (its size counts as known)."""
        grid = self._grid
        response_f = self._correlate(self.sample(image, box, self._sample_f))
        self._localised_at = box
        response = responses.response_map(response_f, (grid.rows, grid.cols))
        row, col = (int(i) for i in np.unravel_index(int(np.argmax(response)), response.shape))
        start = float(row - grid.rows // 2), float(col - grid.cols // 2)
        dy, dx = responses.refine_peak(response_f, grid.cols, *start, self.params.newton_iterations)
        psr, apce = responses.sharpness(response, self._target_cells)
        self._response_f = response_f
        per_cell = self.region(box).w / grid.cols
        response /= np.float32(self._self_response)
        return Match(box.moved(dx * per_cell, dy * per_cell), response, float(response[row, col]), psr, apce)

    def learn(self, image: UInt8, box: Box, belief: float = 1.0) -> None:
        """Take the target at `box` into the model, with a fraction `belief` of the learning rate, and learn the filter.

        The residue (Eq. 14) is not scaled by `belief`.
        """
        params, residue_f = self.params, self._residue_f
        sample_f = self._sample_to_learn(image, box)
        model_f = self._model_f
        if model_f is None:
            model_f = self._model_f = sample_f.copy()
        else:
            approach(model_f, sample_f, residue_f, np.float32(belief * params.learning_rate))
        if not params.residue_to_model:
            if self._learned_f is not None:
                np.subtract(sample_f, self._learned_f, out=residue_f)
            self._learned_f = sample_f.copy()
        label_f, gamma = self._label_f, 0.0
        if params.aberrance > 0 and self._response_f is not None:
            gamma = params.aberrance
            label_f = self._label_f + np.float32(gamma) * self._centred_response(self._response_f)
        self._solver.learn(model_f, residue_f, label_f, gamma)
        own = self._correlate(model_f).real @ self._grid.weights()
        self._self_response = max(float(own.sum()) / (self._grid.rows * self._grid.cols), 1e-9)

    def _sample_to_learn(self, image: UInt8, box: Box) -> Float32:
        """The sample around a box of the image that `locate` searched last.

        If the target has the same size and hardly moved, the sample that localised it is reused, moved in the frequency
        domain as ECO does (Danelljan 2017), which saves a new one.
        """
        at, self._localised_at = self._localised_at, None
        if at is not None and (at.w, at.h) == (box.w, box.h):
            grid, per_cell = self._grid, self.region(box).w / self._grid.cols
            dx, dy = (box.centre_x - at.centre_x) / per_cell, (box.centre_y - at.centre_y) / per_cell
            if max(abs(dx), abs(dy)) <= self.params.reuse_cells:
                move(self._sample_f, dy, dx, (grid.rows, grid.cols), self._residue_f)
                return self._sample_f
        return self.sample(image, box, self._sample_f)

    def _centred_response(self, response_f: Complex64) -> Float32:
        """(2, H, Wf): the last response with its peak shifted to zero: M_{k-1}[psi] of Eq. 2."""
        shape = (self._grid.rows, self._grid.cols)
        response = np.fft.irfft2(response_f, s=shape)
        row, col = np.unravel_index(int(np.argmax(response)), shape)
        centred = np.fft.rfft2(np.roll(response, (-int(row), -int(col)), axis=(0, 1)))
        # The learned correlation is the mirror of the localising one: conjugate spectrum.
        return np.stack([centred.real, -centred.imag]).astype(np.float32)
