"""The tracker: init on a box, then per frame localise, estimate scale, refine, learn."""

import math
import time

import numpy as np
from numpy.typing import NDArray

from racf import response as responses
from racf.box import Box
from racf.features import Features
from racf.filter import Learned, learn
from racf.fourier import Grid
from racf.params import Params
from racf.patch import resample
from racf.refine import Refinement, Refiner
from racf.scale import ScaleFilter
from racf.track import Track

UInt8 = NDArray[np.uint8]
Float32 = NDArray[np.float32]
Complex64 = NDArray[np.complex64]

MIN_SIDE_PX = 2.0  # a smaller box holds no target


class Racf:
    """RACF and its kin (see `racf.params`), shaped like OpenCV's trackers.

        tracker = Racf()
        track = tracker.init(image, box)
        track = tracker.update(next_image)

    Pictures are uint8, (rows, columns, 3) in BGR or (rows, columns) in grey, all of one size.
    """

    def __init__(self, params: Params | None = None) -> None:
        self.params = params or Params(refine=True)
        self._frame_shape: tuple[int, ...] | None = None

    def init(self, image: UInt8, box: Box) -> Track:
        """Start on the target in `box`; raises ValueError if picture or box are not fit to start on."""
        check_image(image)
        rows, cols = image.shape[:2]
        inside = box.intersection(Box(0, 0, cols, rows))
        if inside <= 0:
            raise ValueError(f"target {box} lies outside the {cols}x{rows} picture")
        if min(box.w, box.h) < MIN_SIDE_PX:
            raise ValueError(f"a target needs sides of at least {MIN_SIDE_PX:g} pixels, not {box}")
        self._frame_shape = image.shape
        self._box = self._first = box
        self._set_up_filter(image.ndim == 3)
        self._scale = ScaleFilter(self.params, box.w, box.h)
        self._refiner = Refiner(self.params)
        self._model_f: Float32 | None = None
        self._sample_f: Float32 | None = None
        self._learned: Learned | None = None
        self._response_f: Complex64 | None = None
        self._learn_filter(image)
        self._scale.learn(image, box.centre_x, box.centre_y, box.w, box.h)
        self._psr_mean: float | None = None
        return Track(box, self._search_region(), psr=0.0, apce=0.0, confidence=1.0)

    def update(self, image: UInt8, prior: Box | None = None) -> Track:
        """Find the target in the next picture; `prior`: where the caller expects it, if it knows better."""
        self._check_next(image)
        clock = _Stopwatch()
        if prior is not None:
            self._box = Box.around(prior.centre_x, prior.centre_y, self._box.w, self._box.h)
        search = self._search_region()
        response, peak = self._localise(image, clock)
        self._estimate_scale(image)
        clock.lap("scale")
        refinement = self._refine(image)
        clock.lap("refine")
        reliable = self._reliable(peak.psr)
        if reliable:
            self._learn_filter(image, clock)
            at = self._box
            self._scale.learn(image, at.centre_x, at.centre_y, at.w, at.h)
            clock.lap("scale learn")
        return Track(
            self._box, search, peak.psr, peak.apce, self._confidence(peak.psr), found=reliable,
            refined=refinement is not None and refinement.box is not None, response=response,
            mask=None if refinement is None else refinement.mask,
            mask_box=None if refinement is None else refinement.mask_box, stage_ms=clock.laps,
        )  # fmt: skip

    def _check_next(self, image: UInt8) -> None:
        if self._frame_shape is None:
            raise ValueError("the tracker must be given a target with init before update")
        check_image(image)
        if image.shape != self._frame_shape:
            raise ValueError(f"pictures must keep the first one's shape {self._frame_shape}, not {image.shape}")

    def _set_up_filter(self, colour: bool) -> None:
        """Sizes that stay: sample, support, label.  The square sample has `search_area` times the target's side."""
        params, cell = self.params, self.params.cell_px
        target_px = math.sqrt(self._first.area)
        side = target_px * params.search_area
        sample_px = min(max(side, params.sample_min_px), params.sample_max_px)
        cells = round(sample_px / cell)
        self._features = Features(cells, cells, cell, colour)
        per_cell = side / cells  # frame pixels a cell at the first size
        self._target_cells = (self._first.w / per_cell, self._first.h / per_cell)
        support = [min(max(math.floor(n), 1), cells) for n in self._target_cells]
        self._grid = Grid(cells, cells, (support[1], support[0]))
        sigma = math.sqrt(self._target_cells[0] * self._target_cells[1]) * params.label_sigma
        shift = np.fft.fftfreq(cells, 1 / cells)
        label = np.exp(-0.5 * (shift[:, None] ** 2 + shift[None, :] ** 2) / sigma**2).astype(np.float32)
        label_f = np.fft.rfft2(label)
        self._label_f = np.stack([label_f.real, label_f.imag]).astype(np.float32)

    def _search_region(self) -> Box:
        side = math.sqrt(self._box.area) * self.params.search_area
        return Box.around(self._box.centre_x, self._box.centre_y, side, side)

    def _sample(self, image: UInt8) -> Float32:
        """Spectrum of the windowed features around the present box."""
        region, size = self._search_region(), self._grid.rows * self.params.cell_px
        patch = resample(image, region.centre_x, region.centre_y, region.w, region.h, size, size)
        return self._grid.forward(self._features.extract(patch))

    def _localise(self, image: UInt8, clock: "_Stopwatch") -> tuple[Float32, responses.Peak]:
        assert self._learned is not None
        z_f = self._sample(image)
        clock.lap("sample")
        grid, shape = self._grid, (self._grid.rows, self._grid.cols)
        response_f = np.empty(grid.rows * grid.half, np.complex64)
        responses.correlate(
            z_f.reshape(2, response_f.size, -1), self._learned.g_f.reshape(2, response_f.size, -1), response_f
        )
        response_f = response_f.reshape(grid.rows, grid.half)
        response = responses.response_map(response_f, shape)
        row, col = np.unravel_index(int(np.argmax(response)), shape)
        dy, dx = responses.refine_peak(
            response_f,
            grid.cols,
            float(row) - grid.rows // 2,
            float(col) - grid.cols // 2,
            self.params.newton_iterations,
        )
        psr, apce = responses.sharpness(response, self._target_cells)
        self._response_f = response_f
        per_cell = self._search_region().w / grid.cols
        self._move_to(self._box.moved(dx * per_cell, dy * per_cell))
        clock.lap("response")
        return response, responses.Peak(dx, dy, float(response[row, col]), psr, apce)

    def _move_to(self, box: Box) -> None:
        """Take a box as the target's, its centre kept in the picture and its size between 2 px and the picture's."""
        assert self._frame_shape is not None
        rows, cols = self._frame_shape[:2]
        w, h = min(max(box.w, MIN_SIDE_PX), cols), min(max(box.h, MIN_SIDE_PX), rows)
        self._box = Box.around(min(max(box.centre_x, 0.0), cols), min(max(box.centre_y, 0.0), rows), w, h)

    def _estimate_scale(self, image: UInt8) -> None:
        box, params = self._box, self.params
        steps = self._scale.estimate(image, box.centre_x, box.centre_y, box.w, box.h)
        if params.robust and params.limit_scale:
            steps = min(max(steps, -1), 1)
        if steps:
            self._move_to(box.scaled(params.scale_step**steps))

    def _refine(self, image: UInt8) -> Refinement | None:
        if not self.params.refine:
            return None
        refinement = self._refiner.refine(image, self._box)
        if refinement is not None and refinement.box is not None:
            self._move_to(refinement.box)
        return refinement

    def _reliable(self, psr: float) -> bool:
        """Whether the response is about as sharp as it has been; True outside `robust`."""
        params = self.params
        mean = self._psr_mean
        if mean is None:
            self._psr_mean = psr
            return True
        reliable = not (params.robust and params.gate_learning) or psr >= params.gate_psr * mean
        self._psr_mean = mean + 0.05 * (psr - mean)
        return reliable

    def _confidence(self, psr: float) -> float:
        return min(psr / self._psr_mean, 1.0) if self._psr_mean else 0.0

    def _learn_filter(self, image: UInt8, clock: "_Stopwatch | None" = None) -> None:
        params = self.params
        sample_f = self._sample(image)
        if clock is not None:
            clock.lap("learn sample")
        before = self._model_f
        model_f = sample_f.copy() if before is None else before + np.float32(params.learning_rate) * (sample_f - before)
        reference = before if params.residue_to_model else self._sample_f
        residue_f = np.zeros_like(sample_f) if reference is None else sample_f - reference
        label_f, gamma = self._label_f, 0.0
        if params.aberrance > 0 and self._response_f is not None:
            gamma = params.aberrance
            label_f = self._label_f + np.float32(gamma) * self._centred_response()
        previous = None if self._learned is None else self._learned.filter
        self._learned = learn(self._grid, params, model_f, residue_f, label_f, previous, gamma)
        self._model_f, self._sample_f = model_f, sample_f
        if clock is not None:
            clock.lap("learn filter")

    def _centred_response(self) -> Float32:
        """(2, H, Wf): the last response with its peak shifted to zero: M_{k-1}[psi] of Eq. 2."""
        assert self._response_f is not None
        shape = (self._grid.rows, self._grid.cols)
        response = np.fft.irfft2(self._response_f, s=shape)
        row, col = np.unravel_index(int(np.argmax(response)), shape)
        centred = np.fft.rfft2(np.roll(response, (-int(row), -int(col)), axis=(0, 1)))
        # The learned correlation is the mirror of the localising one: conjugate spectrum.
        return np.stack([centred.real, -centred.imag]).astype(np.float32)


class _Stopwatch:
    """Wall-clock milliseconds by stage, for the record only."""

    def __init__(self) -> None:
        self.laps: dict[str, float] = {}
        self._since = time.perf_counter()

    def lap(self, name: str) -> None:
        now = time.perf_counter()
        self.laps[name] = self.laps.get(name, 0.0) + (now - self._since) * 1e3
        self._since = now


def check_image(image: object) -> None:
    """Raise ValueError unless this is a non-empty uint8 picture, grey or BGR."""
    if not isinstance(image, np.ndarray):
        raise ValueError(f"a picture is a numpy array, not {type(image).__name__}")
    if image.dtype != np.uint8:
        raise ValueError(f"a picture has the type uint8, not {image.dtype}")
    if image.ndim not in {2, 3} or (image.ndim == 3 and image.shape[2] != 3):
        raise ValueError(f"a picture has the shape (rows, columns) or (rows, columns, 3), not {image.shape}")
    if image.size == 0:
        raise ValueError(f"a picture has at least one pixel, not the shape {image.shape}")


def warm_up() -> float:
    """Compile (or load from numba's cache) every kernel that tracking uses; returns the seconds it took."""
    start = time.perf_counter()
    for shape in ((48, 64, 3), (48, 64)):
        image = np.random.default_rng(0).integers(0, 256, shape, dtype=np.uint8)
        tracker = Racf(Params(refine=True))
        tracker.init(image, Box(16, 12, 24, 24))
        tracker.update(image)
    return time.perf_counter() - start
