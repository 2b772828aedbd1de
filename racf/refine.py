"""Refining a box with GrabCut (section 4.2), for any tracker: `Refiner.refine` or the wrapper `Refined`.

The picture around the box, 1.5 times its size, is resampled to a small fixed square; GrabCut separates what lies in the
slightly enlarged box from the rest; the smallest box around the largest segment is the second opinion on the size.
The printed rule (keep the tracker's size if both agree) cannot be meant; as in the paper's prose, the segment's box
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

CONTEXT = 1.5  # side of the picture that GrabCut sees over the box's [Paper]
MAX_MARGIN = 0.4  # Delta s over the box's side: the paper asks for less than half


@dataclass(frozen=True, slots=True, eq=False)
class Refinement:
    """`box`: the refined box, None if the segment was not trusted; `mask` (0/1) covers `mask_box` of the frame."""

    box: Box | None
    segment: Box | None
    mask: UInt8
    mask_box: Box


class Refiner:
    """GrabCut around a box, with the parameters `refine_*`."""

    def __init__(self, params: Params) -> None:
        self.params = params

    def refine(self, image: UInt8, box: Box) -> Refinement | None:
        """A second opinion on `box`; None where the target is too small to be segmented."""
        params, size = self.params, self.params.refine_size_px
        if math.sqrt(box.area) < params.refine_min_target_px:
            return None
        around = box.scaled(CONTEXT)
        patch = resample(image, box.centre_x, box.centre_y, around.w, around.h, size, size)
        patch = np.ascontiguousarray(np.broadcast_to(patch, (3, size, size)).transpose(1, 2, 0))
        inner_w, inner_h = (side + min(params.refine_margin_px, MAX_MARGIN * side) for side in (box.w, box.h))
        cols, rows = (round(size * inner / side) for inner, side in ((inner_w, around.w), (inner_h, around.h)))
        left, top = (size - cols) // 2, (size - rows) // 2
        mask = _largest_segment(patch, (left, top, cols, rows), params.refine_iterations)
        segment = _bounds(mask)
        if segment is None:
            return Refinement(None, None, mask, around)
        x, y, w, h = segment
        step_x, step_y = around.w / size, around.h / size
        found = Box(around.x + x * step_x, around.y + y * step_y, w * step_x, h * step_y)
        inside = x > left and y > top and x + w < left + cols and y + h < top + rows
        if not inside or found.iou(box) <= params.refine_min_iou:
            return Refinement(None, found, mask, around)
        return Refinement(blend(box, found, params.refine_blend), found, mask, around)


def blend(box: Box, other: Box, share: float) -> Box:
    """`share` of the way from one box to another."""
    mix = [
        (1 - share) * a + share * b
        for a, b in zip((box.x, box.y, box.w, box.h), (other.x, other.y, other.w, other.h), strict=True)
    ]
    return Box(*mix)


def _largest_segment(patch: UInt8, inner: tuple[int, int, int, int], iterations: int) -> UInt8:
    """0/1 mask of GrabCut's largest connected foreground inside `inner` (x, y, w, h)."""
    labels = np.full(patch.shape[:2], cv2.GC_BGD, np.uint8)
    # GrabCut seeds its colour models from cv2's global generator: the same picture must give the same mask.
    cv2.setRNGSeed(0)
    models = np.zeros((1, 65)), np.zeros((1, 65))
    cv2.grabCut(patch, labels, inner, models[0], models[1], iterations, cv2.GC_INIT_WITH_RECT)
    foreground = np.asarray(labels & 1, dtype=np.uint8)
    _, components, stats, _ = cv2.connectedComponentsWithStats(foreground, connectivity=8)
    if len(stats) == 1:
        return foreground
    largest = 1 + int(np.argmax(stats[1:, cv2.CC_STAT_AREA]))
    return (components == largest).astype(np.uint8)


def _bounds(mask: UInt8) -> tuple[int, int, int, int] | None:
    """x, y, w, h of the smallest box around the mask; None if it is empty."""
    if not mask.any():
        return None
    x, y, w, h = cv2.boundingRect(mask)
    return x, y, w, h


class OpenCvTracker(Protocol):
    """What OpenCV's trackers have in common (`cv2.TrackerCSRT` and its kin)."""

    def init(self, image: UInt8, box: tuple[int, int, int, int]) -> object:
        """Start on a box (x, y, w, h)."""
        ...

    def update(self, image: UInt8) -> tuple[bool, tuple[float, float, float, float]]:
        """Whether the target was found, and its box."""
        ...


class Refined:
    """An OpenCV tracker with the refinement behind it: same `init` and `update`, refined boxes.

    The tracker's own state cannot be corrected from outside, so the refinement here improves its answer, not its model.
    """

    def __init__(self, tracker: OpenCvTracker, params: Params | None = None) -> None:
        self.tracker = tracker
        self.refiner = Refiner(params or Params())

    def init(self, image: UInt8, box: tuple[int, int, int, int]) -> None:
        """Start on a box (x, y, w, h)."""
        self.tracker.init(image, box)

    def update(self, image: UInt8) -> tuple[bool, tuple[float, float, float, float]]:
        """The tracker's answer, its box refined where the segmentation can be trusted."""
        found, box = self.tracker.update(image)
        if not found or box[2] <= 0 or box[3] <= 0:
            return found, box
        refinement = self.refiner.refine(image, Box(*map(float, box)))
        if refinement is None or refinement.box is None:
            return found, box
        better = refinement.box
        return found, (better.x, better.y, better.w, better.h)
