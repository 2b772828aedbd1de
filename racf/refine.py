"""Refining a box with GrabCut (section 4.2), for any tracker: `Refiner.refine` or the wrapper `Refined`.

The image around the box, 1.5 times its size, is resampled to a small fixed square; GrabCut separates the slightly
enlarged box into target and background; the smallest box around the largest segment is the second estimate of the size.
The rule as printed (keep the tracker's size if both agree) must be an error; as in the paper's prose, the segment's box
counts only if it overlaps the tracker's by more than a threshold.
"""

import math
from dataclasses import dataclass
from typing import Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from racf.box import Box
from racf.params import Params
from racf.patch import resample

UInt8 = NDArray[np.uint8]
Float64 = NDArray[np.float64]

CONTEXT = 1.5  # side of the image that GrabCut sees over the box's [Paper]
MAX_MARGIN = 0.4  # Delta s over the box's side: the paper asks for less than half


@dataclass(frozen=True, slots=True, eq=False)
class Refinement:
    """`box`: the refined box, None if the segment was not trusted; `mask` (0/1) covers `mask_box` of the frame."""

    box: Box | None
    segment: Box | None
    mask: UInt8
    mask_box: Box


class Refiner:
    """GrabCut around a box, with the parameters `refine_*`; one for each target, because it keeps its colour models.

    Learning GrabCut's two colour models takes longer than segmenting with known ones.  So they are learned from every
    second pixel of every second line, and only every `refine_renew` frames, because the colours of target and
    surroundings hardly change.  While segments are rejected it backs off: it skips 1 frame after the first rejection,
    then 3, 7, 15 and so on, at most `refine_pause`.

    As a side effect, learning the models seeds OpenCV's random generator (`cv2.setRNGSeed(0)`), so that equal
    images give equal masks.
    """

    def __init__(self, params: Params) -> None:
        self.params = params
        self._min_iou = params.strict_iou if params.strict_refine else params.refine_min_iou
        self._models: tuple[Float64, Float64] | None = None
        self._age = self._pause = self._waiting = 0

    def refine(self, image: UInt8, box: Box) -> Refinement | None:
        """The refinement of `box`; None if the target is too small, or after recent rejections."""
        params = self.params
        if math.sqrt(box.area) < params.refine_min_target_px:
            return None
        if self._waiting > 0:
            self._waiting -= 1
            return None
        refinement = self._segment(image, box)
        if refinement.box is None:
            self._pause, self._models = min(2 * self._pause + 1, params.refine_pause), None
            self._waiting = self._pause
        else:
            self._pause = 0
        return refinement

    def _segment(self, image: UInt8, box: Box) -> Refinement:
        params, size = self.params, self.params.refine_size_px
        around = box.scaled(CONTEXT)
        planes = resample(image, box.centre_x, box.centre_y, around.w, around.h, size, size)
        patch = np.ascontiguousarray(np.broadcast_to(planes, (3, size, size)).transpose(1, 2, 0))
        inner_w, inner_h = (side + min(params.refine_margin_px, MAX_MARGIN * side) for side in (box.w, box.h))
        cols, rows = round(size * inner_w / around.w), round(size * inner_h / around.h)
        left, top = (size - cols) // 2, (size - rows) // 2
        mask = _largest_segment(self._cut(patch, (left, top, cols, rows)))
        if not mask.any():
            return Refinement(None, None, mask, around)
        x, y, w, h = cv2.boundingRect(mask)
        step_x, step_y = around.w / size, around.h / size
        segment = Box(around.x + x * step_x, around.y + y * step_y, w * step_x, h * step_y)
        # A segment that touches the border of the possible foreground is cut off there: its extent is unknown.
        whole = x > left and y > top and x + w < left + cols and y + h < top + rows
        if not whole or segment.iou(box) <= self._min_iou:
            return Refinement(None, segment, mask, around)
        return Refinement(blend(box, segment, params.refine_blend), segment, mask, around)

    def _cut(self, patch: UInt8, inner: tuple[int, int, int, int]) -> UInt8:
        """0/1 foreground of (s, s, 3), all of it inside `inner` (x, y, w, h)."""
        if self._models is None or self._age >= self.params.refine_renew:
            self._models, self._age = self._learned(patch, inner), 0
        self._age += 1
        x, y, w, h = inner
        labels = np.full(patch.shape[:2], cv2.GC_BGD, np.uint8)
        labels[y : y + h, x : x + w] = cv2.GC_PR_FGD
        cv2.grabCut(patch, labels, inner, *self._models, 1, cv2.GC_EVAL_FREEZE_MODEL)
        return np.bitwise_and(labels, np.uint8(1), dtype=np.uint8)

    def _learned(self, patch: UInt8, inner: tuple[int, int, int, int]) -> tuple[Float64, Float64]:
        """The colour models of the surroundings and of the target inside `inner`, from a quarter of the pixels."""
        sparse, (x, y, w, h) = np.ascontiguousarray(patch[::2, ::2]), inner
        models = np.zeros((1, 65)), np.zeros((1, 65))
        # OpenCV seeds the colour models from its global generator: the same images must give the same masks.
        cv2.setRNGSeed(0)
        labels, rectangle = np.empty(sparse.shape[:2], np.uint8), ((x + 1) // 2, (y + 1) // 2, w // 2, h // 2)
        cv2.grabCut(sparse, labels, rectangle, *models, self.params.refine_iterations, cv2.GC_INIT_WITH_RECT)
        return models


def blend(box: Box, other: Box, fraction: float) -> Box:
    """Linear interpolation from one box to another."""
    mix = [
        (1 - fraction) * a + fraction * b
        for a, b in zip((box.x, box.y, box.w, box.h), (other.x, other.y, other.w, other.h), strict=True)
    ]
    return Box(*mix)


def _largest_segment(foreground: UInt8) -> UInt8:
    """The largest connected part of a 0/1 mask."""
    _, components, stats, _ = cv2.connectedComponentsWithStats(foreground, connectivity=8)
    if len(stats) == 1:
        return foreground
    largest = 1 + int(np.argmax(stats[1:, cv2.CC_STAT_AREA]))
    return (components == largest).astype(np.uint8)


class OpenCvTracker(Protocol):
    """The interface of OpenCV's trackers (`cv2.TrackerCSRT` and others)."""

    def init(self, image: UInt8, box: tuple[int, int, int, int]) -> object:
        """Start on a box (x, y, w, h)."""
        ...

    def update(self, image: UInt8) -> tuple[bool, tuple[float, float, float, float]]:
        """Whether the target was found, and its box."""
        ...


class Refined:
    """An OpenCV tracker followed by the refinement: same `init` and `update`, refined boxes.

    The tracker's own state cannot be corrected from outside, so the refinement improves its result, not its model.
    """

    def __init__(self, tracker: OpenCvTracker, params: Params | None = None) -> None:
        self.tracker = tracker
        self.params = params or Params()
        self.refiner = Refiner(self.params)

    def init(self, image: UInt8, box: tuple[int, int, int, int]) -> None:
        """Start on a box (x, y, w, h); forgets an earlier target."""
        self.tracker.init(image, box)
        self.refiner = Refiner(self.params)

    def update(self, image: UInt8) -> tuple[bool, tuple[float, float, float, float]]:
        """The tracker's result, its box refined if the segmentation is trusted."""
        found, box = self.tracker.update(image)
        if not found or box[2] <= 0 or box[3] <= 0:
            return found, box
        refinement = self.refiner.refine(image, Box(*map(float, box)))
        if refinement is None or refinement.box is None:
            return found, box
        better = refinement.box
        return found, (better.x, better.y, better.w, better.h)
