"""GrabCut on rectangles whose size is known."""

import dataclasses

import cv2
import numpy as np
import pytest

from racf import Box, Params, Refined, Refiner

WHOLE = dataclasses.replace(Params(), refine_blend=1.0)


def scene(box: Box, grey: bool = False) -> np.ndarray:
    """A reddish rectangle on noisy green ground."""
    rng = np.random.default_rng(2)
    image = np.clip(rng.normal((90, 200, 110), 12, (200, 300, 3)), 0, 255).astype(np.uint8)
    x, y, w, h = (round(v) for v in (box.x, box.y, box.w, box.h))
    image[y : y + h, x : x + w] = np.clip(rng.normal((40, 60, 200), 12, (h, w, 3)), 0, 255).astype(np.uint8)
    return cv2.cvtColor(image, cv2.COLOR_BGR2GRAY) if grey else image


@pytest.mark.parametrize("grey", [False, True])
@pytest.mark.parametrize("guess", [(0, 0, 1.12, 1.0), (2, -1, 0.92, 1.08), (-2, 2, 1.0, 0.9)])
def test_a_box_that_is_off_is_put_right(guess, grey):
    truth = Box(120, 80, 50, 36)
    dx, dy, wide, high = guess
    box = Box.around(truth.centre_x + dx, truth.centre_y + dy, truth.w * wide, truth.h * high)
    refinement = Refiner(WHOLE).refine(scene(truth, grey), box)
    assert refinement is not None
    assert refinement.box is not None
    assert refinement.box.iou(truth) > 0.9
    assert refinement.box.iou(truth) > box.iou(truth)


def test_blending_goes_part_of_the_way():
    truth, box = Box(120, 80, 50, 36), Box(119, 80, 56, 36)
    half = Refiner(dataclasses.replace(WHOLE, refine_blend=0.5)).refine(scene(truth), box)
    whole = Refiner(WHOLE).refine(scene(truth), box)
    assert half is not None
    assert whole is not None
    assert half.box is not None
    assert whole.box is not None
    assert half.box.w == pytest.approx((box.w + whole.box.w) / 2)


def test_a_segment_that_disagrees_is_not_trusted():
    refinement = Refiner(WHOLE).refine(scene(Box(120, 80, 30, 60)), Box(110, 90, 55, 40))
    assert refinement is None or refinement.box is None


def test_a_target_of_few_pixels_is_left_alone():
    assert Refiner(WHOLE).refine(scene(Box(120, 80, 12, 12)), Box(120, 80, 12, 12)) is None


def test_kept_colour_models_give_the_mask_that_new_ones_give():
    truth = Box(120, 80, 50, 36)
    warm = Refiner(WHOLE)
    masks = [warm.refine(scene(truth), truth.scaled(1.04)) for _ in range(3)]
    assert all(mask is not None and np.mean(mask.mask != masks[0].mask) < 0.02 for mask in masks)


def test_rejected_segments_make_pauses():
    refiner = Refiner(WHOLE)
    flat = np.full((200, 300, 3), 90, np.uint8)
    asked = [refiner.refine(flat, Box(120, 80, 50, 36)) is not None for _ in range(100)]
    assert [n for n, was in enumerate(asked) if was] == [0, 2, 6, 14, 30, 62, 94]


@pytest.mark.parametrize("size", [16, 17, 52])
@pytest.mark.parametrize("side", [21.0, 60.0, 190.0])
def test_colour_models_are_learned_from_whatever_size_is_segmented(size, side):
    refiner = Refiner(dataclasses.replace(WHOLE, refine_size_px=size, refine_min_target_px=1, refine_pause=0))
    for ratio in (0.1, 1.0, 9.0):
        box = Box.around(150, 100, side * ratio, side)
        assert refiner.refine(scene(Box(120, 80, 50, 36)), box) is not None


class Still:
    """A tracker that keeps its first box."""

    def init(self, image, box):
        self.box = box

    def update(self, image):
        return True, self.box


def test_any_opencv_tracker_can_be_refined():
    truth = Box(120, 80, 50, 36)
    tracker = Refined(Still(), WHOLE)
    tracker.init(scene(truth), (118, 80, 56, 36))
    found, box = tracker.update(scene(truth))
    assert found
    assert Box(*box).iou(truth) > 0.93


def test_a_second_target_is_refined_like_a_first_one():
    truth = Box(120, 80, 50, 36)
    flat = np.full((200, 300, 3), 90, np.uint8)
    tracker = Refined(Still(), WHOLE)
    for image in (flat, scene(truth)):  # on the flat one every segment is rejected, which makes pauses
        tracker.init(image, (118, 80, 56, 36))
        boxes = [tracker.update(image)[1] for _ in range(3)]
    assert Box(*boxes[0]).iou(truth) > 0.93
