"""Misplaced first boxes: the boxes themselves, and what counts as on the target."""

import numpy as np
import pytest

from racf.box import Box
from tools.studies.first_boxes import BOXES, GROWN, inside, line, misplaced


def test_the_first_of_the_boxes_is_the_targets_own_and_the_others_are_not():
    box = Box(100.0, 50.0, 20.0, 40.0)
    assert misplaced(box, BOXES[0]) == box
    assert all(misplaced(box, change) != box for change in BOXES[1:])


@pytest.mark.parametrize("change", BOXES)
def test_a_misplaced_box_has_the_requested_size_and_place(change):
    times, right, down = change
    moved = misplaced(Box(100.0, 50.0, 20.0, 40.0), change)
    assert (moved.w, moved.h) == pytest.approx((20.0 * times, 40.0 * times))
    assert (moved.centre_x, moved.centre_y) == pytest.approx((110.0 + 20.0 * right, 70.0 + 40.0 * down))


def test_a_centre_is_on_the_target_in_its_box_grown_by_a_tenth():
    boxes = np.tile([10.0, 20.0, 100.0, 50.0], (5, 1))
    edge = 10.0 - GROWN * 100.0
    centres = np.array([(60.0, 45.0), (edge, 45.0), (edge - 0.1, 45.0), (60.0, 75.0), (60.0, 75.1)])
    assert inside(centres, boxes).tolist() == [True, True, False, True, False]


def test_a_row_has_a_pair_for_each_box():
    assert line("boat5", np.array([(100.0, 0.0), (74.25, 25.75)])) == "| boat5 | 100.0 / 0.0 | 74.2 / 25.8 |"
