"""A lower bound for each stage of the tracker: arithmetic of its transforms, bytes it must read and write once.

A stage cannot take less than its arithmetic at the speed of a matrix product, nor than its bytes at the speed of a
copy out of the caches; both speeds are measured on this machine.  Letters: N = H W cells of the sample, D
channels, m x n the filter's support, S scales; a real transform of N numbers counts 2.5 N log2 N operations.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from time import perf_counter

import numpy as np

from racf.box import Box
from racf.params import Params
from racf.scale import ScaleFilter

CHANNELS = 31 + 10 + 1  # FHOG, colour names, grey
HOG_CHANNELS = 31
FLOAT_BYTES = 4
RESAMPLE_FLOPS = 7 * 3  # per pixel of three colours: bilinear, four products and three sums
HOG_FLOPS = 30  # per pixel: gradient, magnitude, direction, bilinear votes
MIXTURE_FLOPS = 10 * 25  # per pixel and GrabCut iteration: ten Gaussians of three colours


@dataclass(frozen=True, slots=True)
class Work:
    """Floating-point operations and bytes moved."""

    flops: float
    moved_bytes: float

    def __add__(self, other: "Work") -> "Work":
        return Work(self.flops + other.flops, self.moved_bytes + other.moved_bytes)

    def times(self, count: float) -> "Work":
        """The same work `count` times."""
        return Work(self.flops * count, self.moved_bytes * count)


@dataclass(frozen=True, slots=True)
class Machine:
    """The peak rates of one core: operations and bytes per second."""

    flops_s: float
    bytes_s: float

    def ms(self, work: Work) -> float:
        """The least time for some work: arithmetic and memory transfer may overlap entirely."""
        return 1000 * max(work.flops / self.flops_s, work.moved_bytes / self.bytes_s)


def work_of_stages(params: Params, target: Box) -> dict[str, Work]:
    """The least work of a frame, by the tracker's stage names."""
    side = math.sqrt(target.area) * params.search_area
    sample_px = min(max(side, params.sample_min_px), params.sample_max_px)
    cells = round(sample_px / params.cell_px)
    features, spectrum = cells * cells * CHANNELS, 2 * cells * (cells // 2 + 1) * CHANNELS  # floats
    pixels = sample_px**2
    transform = Work(2.5 * cells**2 * math.log2(cells**2) * CHANNELS, (features + spectrum) * FLOAT_BYTES)
    sample = Work(pixels * (RESAMPLE_FLOPS + HOG_FLOPS), pixels * 6 + features * FLOAT_BYTES) + transform
    product = Work(4 * spectrum, 2 * spectrum * FLOAT_BYTES)  # sum over channels of conj(g) z, complex
    # Sherman-Morrison twice: five inner products and four updates over the channels; six spectra in, two out.
    solve = Work(9 * 4 * spectrum, 8 * spectrum * FLOAT_BYTES)
    step = solve + transform.times(2)  # there and back between the support and the grid
    scales = _scale_sample(params, target)
    grabcut = Work(params.refine_iterations * params.refine_size_px**2 * MIXTURE_FLOPS, params.refine_size_px**2 * 12)
    return {
        "localise": sample + product,
        "scale": scales,
        "refine": grabcut if params.refine else Work(0, 0),
        "learn filter": sample + step.times(params.admm_iterations),
        "learn scale": scales,
    }


def _scale_sample(params: Params, target: Box) -> Work:
    """Features of the target in every size, transformed along the sizes."""
    scale = ScaleFilter(params, target.w, target.h)
    pixels = scale.model_w * scale.model_h * params.scales
    features = pixels / params.cell_px**2 * HOG_CHANNELS
    return Work(
        pixels * (RESAMPLE_FLOPS + HOG_FLOPS) + 5 * features * math.log2(params.scales),
        pixels * 6 + 3 * features * FLOAT_BYTES,
    )


def machine() -> Machine:
    """Measure one core: the best of several matrix products and copies of the sizes that the tracker works with."""
    rng = np.random.default_rng(0)
    left, right = (rng.random((256, 256), dtype=np.float32) for _ in range(2))
    source = rng.random(250_000, dtype=np.float32)  # a megabyte: between the second and the third cache
    target = np.empty_like(source)
    product = min(_seconds(lambda: np.matmul(left, right)) for _ in range(50))
    copy = min(_seconds(lambda: np.copyto(target, source)) for _ in range(50))
    return Machine(2 * 256**3 / product, 2 * source.nbytes / copy)


def _seconds(work: Callable[[], object]) -> float:
    began = perf_counter()
    work()
    return perf_counter() - began
