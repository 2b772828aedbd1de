"""Precision and success of one-pass evaluation, in the published toolkits' convention and in a strict one.

Boxes are (frames, 4) float64 arrays of `x, y, w, h`, both sides in the same pixel convention.  All figures are percent.

The **toolkit** convention is what the published MATLAB toolkits compute, and so what papers print.  A frame whose
annotation says "absent" (NaN) or touches the image's border (`x <= 0` or `y <= 0`) counts as a hit of the precision
and a miss of the success.  The **strict** convention leaves out the frames without a target and counts those at the
border as any other.
"""

from dataclasses import dataclass
from enum import Enum

import numpy as np
from numpy.typing import NDArray

Boxes = NDArray[np.float64]  # (frames, 4): x, y, w, h
Curve = NDArray[np.float64]  # one share in percent for each threshold

ERROR_THRESHOLDS_PX = np.arange(51, dtype=np.float64)  # the toolkits' 0:50
OVERLAP_THRESHOLDS = np.linspace(0.0, 1.0, 21)  # the toolkits' 0:0.05:1
RANK_ERROR_PX = 20  # the error at which every paper on these benchmarks quotes the precision


class Convention(str, Enum):
    """How invalid annotations are counted; see the module's docstring."""

    TOOLKIT = "toolkit"
    STRICT = "strict"


@dataclass(frozen=True, slots=True, eq=False)
class Score:
    """How well boxes follow the annotation, in percent.

    `precision` has one value for each of ERROR_THRESHOLDS_PX (centre no further than it), `success` one for each of
    OVERLAP_THRESHOLDS (overlap greater than it).
    """

    precision: Curve
    success: Curve

    @property
    def precision_20px(self) -> float:
        """Share of frames whose centre is at most 20 px off."""
        return float(self.precision[RANK_ERROR_PX])

    @property
    def auc(self) -> float:
        """Area under the success curve."""
        return float(np.mean(self.success))


def score(boxes: Boxes, truth: Boxes, convention: Convention = Convention.TOOLKIT) -> Score:
    """Judge one sequence.  Raises ValueError when there are not as many boxes as annotations."""
    if boxes.shape != truth.shape or truth.ndim != 2 or truth.shape[1:] != (4,) or len(truth) == 0:
        raise ValueError(f"one box of x, y, w, h for each annotation is needed: {boxes.shape} boxes, {truth.shape}")
    tracked = filled(np.concatenate([truth[:1], boxes[1:]]))  # the target was shown in the first frame
    absent = ~np.all(np.isfinite(truth), axis=1) | np.any(truth[:, 2:] <= 0, axis=1)
    with np.errstate(invalid="ignore"):
        error_px, overlap = centre_error_px(tracked, truth), overlaps(tracked, truth)
    if convention is Convention.TOOLKIT:
        unusable = absent | np.any(truth[:, :2] <= 0, axis=1)
        error_px[unusable], overlap[unusable] = -1.0, -1.0
    else:
        error_px, overlap = error_px[~absent], overlap[~absent]
        if len(overlap) == 0:
            raise ValueError("the annotation has no frame with a target")
    return Score(
        precision=100.0 * np.mean(error_px[:, None] <= ERROR_THRESHOLDS_PX, axis=0),
        success=100.0 * np.mean(overlap[:, None] > OVERLAP_THRESHOLDS, axis=0),
    )


def mean_score(scores: list[Score]) -> Score:
    """The mean over sequences, each counting alike however long it is."""
    return Score(
        precision=np.mean([s.precision for s in scores], axis=0),
        success=np.mean([s.success for s in scores], axis=0),
    )


def filled(boxes: Boxes) -> Boxes:
    """A copy in which an invalid box (NaN, or a side not positive) repeats the one before it."""
    usable = np.all(np.isfinite(boxes), axis=1) & np.all(boxes[:, 2:] > 0, axis=1)
    latest = np.maximum.accumulate(np.where(usable, np.arange(len(boxes)), 0))
    return boxes[latest].copy()


def centre_error_px(boxes: Boxes, truth: Boxes) -> NDArray[np.float64]:
    """Distance of the centres; the toolkits' `x + (w - 1) / 2` differs from `x + w / 2` by the same on both sides."""
    apart_px = (boxes[:, :2] + boxes[:, 2:] / 2) - (truth[:, :2] + truth[:, 2:] / 2)
    return np.hypot(apart_px[:, 0], apart_px[:, 1])


def overlaps(boxes: Boxes, truth: Boxes) -> NDArray[np.float64]:
    """Intersection over union, 0..1."""
    near = np.maximum(boxes[:, :2], truth[:, :2])
    far = np.minimum(boxes[:, :2] + boxes[:, 2:], truth[:, :2] + truth[:, 2:])
    shared = np.prod(np.maximum(far - near, 0.0), axis=1)
    union = np.prod(boxes[:, 2:], axis=1) + np.prod(truth[:, 2:], axis=1) - shared
    return np.minimum(shared / union, 1.0)  # rounding can leave equal boxes slightly above 1


def interval_of_mean(values: list[float], *, resamples: int = 2000, seed: int = 0) -> tuple[float, float]:
    """95 % bootstrap interval of the mean, by drawing sequences with replacement (2000 draws: ends steady to 0.1)."""
    sample = np.asarray(values, dtype=np.float64)
    draws = np.random.default_rng(seed).integers(0, len(sample), (resamples, len(sample)))
    low, high = np.percentile(np.mean(sample[draws], axis=1), [2.5, 97.5])
    return float(low), float(high)
