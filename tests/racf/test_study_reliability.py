"""The reliability diagram: every frame is in one bin, and a calibrated confidence lies on the diagonal."""

import numpy as np
import pytest

import tests.support.rendered_benchmarks as rendered
from racf.evaluate.benchmarks import read_benchmark
from racf.evaluate.runner import run_task, tasks
from racf.evaluate.trackers import TrackerSpec
from tools.studies import reliability
from tools.studies.reliability import Frames, calibration_error, diagram, interval, shares


def drawn(count: int, seed: int = 0) -> Frames:
    """Frames whose share on the target is their confidence; the others are off it."""
    rng = np.random.default_rng(seed)
    confidence = rng.uniform(0, 1, count)
    on = rng.uniform(0, 1, count) < confidence
    return Frames(confidence, np.where(on, 0.8, 0.0), confidence >= 0.5)


def test_every_frame_is_in_one_bin_the_ends_of_the_range_included():
    frames = Frames(np.array([0.0, 0.1, 0.55, 0.999, 1.0]), np.full(5, 0.5), np.ones(5, bool))
    rows = diagram(frames)
    assert sum(count for _, _, count, *_ in rows) == 5
    assert [(low, count) for low, _, count, *_ in rows] == [(0.0, 1), (0.1, 1), (0.5, 1), (0.9, 2)]


def test_a_calibrated_confidence_lies_on_the_diagonal():
    frames = drawn(200_000)
    for *_, mean, on, off in diagram(frames):
        assert on == pytest.approx(mean, abs=0.02)
        assert off == pytest.approx(1 - mean, abs=0.02)
    assert calibration_error(frames) < 0.01
    certain = Frames(np.ones(100), np.repeat([0.8, 0.0], 50), np.ones(100, bool))
    assert calibration_error(certain) == pytest.approx(0.5)


def test_the_shares_count_false_finds_and_false_losses():
    overlap, found = np.array([0.9, 0.9, 0.2, 0.0, 0.0, 0.0]), np.array([1, 0, 1, 1, 0, 0], bool)
    assert shares(Frames(np.ones(6), overlap, found)) == pytest.approx((100 / 6, 100 / 3, 50))


def test_the_interval_is_over_sequences_not_over_frames():
    """Twenty sequences of which one is wrong throughout: however long they are, the interval reaches far."""
    right, wrong = (Frames(np.ones(n), np.full(n, overlap), np.ones(n, bool)) for n, overlap in ((500, 0.9), (500, 0)))
    low, high = interval({str(k): wrong if k == 0 else right for k in range(20)})[:, 0]
    assert low == 0
    assert 10 < high < 20


def test_a_frame_is_judged_as_the_evaluation_judges_it(tmp_path):
    (sequence,) = read_benchmark("folder", rendered.plain_folder(tmp_path, ("walk",), frames=8))
    sequence.truth[5] = np.nan
    (task,) = tasks(TrackerSpec.parse("racf,robust"), sequence, 0)
    frames, run = reliability.watch(task, {"walk": sequence.truth}), run_task(task)
    assert len(frames.overlap) == 7
    assert frames.overlap[4] == 0
    there = [k for k in range(1, 8) if k != 5]
    expected = reliability.overlaps(run.boxes[there], sequence.truth[there])
    assert frames.overlap[[k - 1 for k in there]] == pytest.approx(expected, abs=1e-3)
