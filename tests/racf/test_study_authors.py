"""Stored boxes tell whether a tracker moved by whole cells, and a filter led along its own boxes agrees with itself."""

from dataclasses import replace

import numpy as np
import pytest

import tests.support.rendered_benchmarks as rendered
from racf.evaluate.benchmarks import read_benchmark
from racf.evaluate.images import read_frame
from racf.params import Params, preset
from racf.tracker import Racf
from tools.studies.authors import agreement, cell_px, moves, whole_cells

PARAMS = Params()


def walk(steps_cells: np.ndarray, side_px: float = 60.0) -> np.ndarray:
    """Boxes rounded to whole pixels, as they are stored, of a target that takes these steps, (n, 2) in cells."""
    cell = cell_px(np.array([[0, 0, side_px, side_px]]), PARAMS)[0]
    places = 300 + np.concatenate([[[0, 0]], np.cumsum(steps_cells, axis=0)]) * cell
    return np.column_stack([np.round(places), np.full((len(places), 2), side_px)])


def test_a_cell_is_four_pixels_of_the_sample():
    # 60 px: the sample is 300 px of the image, drawn at 200, so a cell is 6 px; it grows with the target.
    assert cell_px(np.array([[0, 0, 60, 60], [0, 0, 90, 90]]), PARAMS) == pytest.approx([6, 9])


def test_moves_by_whole_cells_are_recognised_although_boxes_are_rounded():
    rng = np.random.default_rng(0)
    whole, count = whole_cells(walk(rng.integers(-2, 3, (200, 2)).astype(float)), PARAMS)
    assert whole == 1.0
    assert count > 100
    assert whole_cells(walk(rng.uniform(-2, 2, (400, 2))), PARAMS)[0] < 0.5


def test_a_move_is_counted_in_cells_of_the_sample_that_was_searched():
    boxes = np.array([[100, 100, 60, 60], [106, 94, 60, 60], [106, 94, 90, 90], [124, 94, 90, 90]], float)
    assert moves(boxes, PARAMS)[[0, 2]] == pytest.approx(np.array([[1, -1], [2, 0]]))


def test_a_filter_that_is_led_along_its_own_boxes_agrees_with_itself(tmp_path):
    (sequence,) = read_benchmark("folder", rendered.plain_folder(tmp_path, ("walk",), frames=12))
    params = preset("racf-,newton_iterations=0")
    tracker = Racf(params)
    tracker.init(read_frame(sequence.frames[0]), sequence.first_box())
    tracks = [tracker.update(read_frame(path)) for path in sequence.frames[1:]]
    boxes = np.vstack([sequence.truth[:1], [[t.box.x + 1, t.box.y + 1, t.box.w, t.box.h] for t in tracks]])
    assert np.any(np.round(moves(boxes, params)) != 0)
    assert agreement(sequence, boxes, params) == 1.0
    opposite = boxes.copy()
    opposite[:, :2] = 2 * boxes[0, :2] - boxes[:, :2]
    assert agreement(sequence, opposite, replace(params, learning_rate=0.0)) < 0.8
