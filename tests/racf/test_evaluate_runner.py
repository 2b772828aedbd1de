"""The same boxes for any number of processes, any order and any interruption."""

import importlib.util
from dataclasses import dataclass

import cv2
import numpy as np
import pytest

import tests.support.rendered_benchmarks as rendered
from racf.box import Box
from racf.evaluate.benchmarks import read_benchmark
from racf.evaluate.outcomes import read_outcomes
from racf.evaluate.report import build_report
from racf.evaluate.runner import SequenceRun, jittered, run_all, run_task, tasks
from racf.evaluate.stored import Stored
from racf.track import Track

NAMES = ("one", "two", "three")


class Matcher:
    """Finds the first frame's target by the best match of its pixels, plus a random error of OpenCV's making."""

    def __init__(self, trail):
        self.trail = trail

    def init(self, image, box):
        self.box = box
        x, y, w, h = (round(v) for v in (box.x, box.y, box.w, box.h))
        self.target = image[y : y + h, x : x + w]
        return self._track()

    def update(self, image):
        if self.trail is not None:
            with open(self.trail, "a") as file:
                file.write(".")
        _, _, _, (x, y) = cv2.minMaxLoc(cv2.matchTemplate(image, self.target, cv2.TM_CCOEFF_NORMED))
        noise = np.zeros(1)
        cv2.randu(noise, 0.0, 1.0)
        self.box = Box(x + float(noise[0]), y, self.box.w, self.box.h)
        return self._track()

    def _track(self):
        return Track(self.box, self.box, 0.0, 0.0, 1.0, stage_ms={"match": 1.5})


@dataclass(frozen=True)
class Spec:
    """A tracker to run; the file at `trail` grows by a byte a frame, from whatever process."""

    label: str = "matcher"
    trail: str | None = None

    def build(self):
        return Matcher(self.trail)

    def fingerprint(self):
        return f"{self.label}0"


@pytest.fixture
def sequences(tmp_path):
    return read_benchmark("folder", rendered.plain_folder(tmp_path / "data", NAMES))


def boxes_of(runs: dict) -> dict:
    return {key: run.boxes.tolist() for key, run in sorted(runs.items())}


def all_tasks(sequences, spec=Spec(), jitter=2):
    return [task for sequence in sequences for task in tasks(spec, sequence, jitter)]


def test_boxes_do_not_depend_on_how_many_run_at_once_nor_on_their_order(sequences):
    todo = all_tasks(sequences)
    alone = boxes_of(run_all(todo))
    assert len(alone) == 9
    assert boxes_of(run_all(todo[::-1])) == alone
    assert boxes_of(run_all(todo, jobs=2)) == alone
    assert boxes_of({("matcher", t.sequence, t.start): run_task(t) for t in todo}) == alone


def test_boxes_come_in_the_benchmarks_1_based_pixels(sequences):
    run = run_task(tasks(Spec(), sequences[0], 0)[0])
    assert run.boxes[0] == pytest.approx(sequences[0].truth[0])
    assert np.abs(run.boxes - sequences[0].truth).max() <= 1.0
    assert run.stage_ms == {"match": 1.5}
    assert run.fps > 0


def test_an_interrupted_evaluation_goes_on_where_it_stopped(sequences, tmp_path):
    trail = tmp_path / "trail"
    todo = all_tasks(sequences, Spec(trail=str(trail)))
    whole = boxes_of(run_all(todo, folder=tmp_path / "whole"))
    out = tmp_path / "out"

    def stop_after_four(task, run, stored, count=[0]):  # noqa: B006 - counts calls
        count[0] += 1
        if count[0] == 4:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_all(todo, folder=out, done=stop_after_four)
    trail.write_text("")
    found = []
    again = run_all(todo, folder=out, done=lambda task, run, stored: found.append(stored))
    assert boxes_of(again) == whole
    assert sum(found) == 4
    assert len(trail.read_text()) == 5 * 5  # five tasks left, five updates each: nothing was run twice


def test_stored_boxes_of_other_starts_trackers_or_frames_are_not_reused(sequences, tmp_path):
    run_all(all_tasks(sequences[:1], jitter=0), folder=tmp_path)
    for others in (
        all_tasks(sequences[:1], Spec("other"), jitter=0),
        all_tasks(sequences[:1], jitter=1)[1:],
        all_tasks(sequences[1:2], jitter=0),
    ):
        found = []
        run_all(others, folder=tmp_path, done=lambda task, run, stored: found.append(stored))  # noqa: B023
        assert found == [False]


@pytest.mark.parametrize(
    ("kind", "left"),
    [("txt", left) for left in (None, "", "1,2,3,4\n", "half")]
    + [("json", left) for left in (None, "", '{"key": "', "[]", "{}")],
)
def test_boxes_or_a_note_that_were_lost_or_cut_off_are_run_again(sequences, tmp_path, kind, left):
    todo = all_tasks(sequences[:1], jitter=0)
    run_all(todo, folder=tmp_path)
    (place,) = (tmp_path / "runs").rglob(f"*.{kind}")
    place.unlink()
    if left is not None:
        place.write_text(left)
    found = []
    run_all(todo, folder=tmp_path, done=lambda task, run, stored: found.append(stored))
    assert found == [False]


def test_sequences_of_one_name_in_folders_of_one_name_keep_their_own_boxes(tmp_path):
    for place in ("one/set", "two/set"):
        rendered.plain_folder(tmp_path / "data" / place, ("walk",))
    sequences = read_benchmark("folder", tmp_path / "data")
    assert len({s.name for s in sequences}) == 2
    sequences[1].truth[:] += 1  # another first box: another run
    runs = run_all(all_tasks(sequences, jitter=1), folder=tmp_path / "out")
    stored = read_outcomes(tmp_path / "out", sequences)["matcher"]
    for s in sequences:
        assert stored.boxes[s.name] == pytest.approx(runs["matcher", s.name, 0].boxes, abs=1e-3)
        assert len(stored.jittered[s.name]) == 1
    found = []
    run_all(all_tasks(sequences, jitter=1), folder=tmp_path / "out", done=lambda task, run, there: found.append(there))
    assert found == [True] * 4


def test_jittered_starts_are_drawn_by_sequence_and_start_and_stay_near_the_target():
    box = Box(100, 50, 40, 20)
    starts = [jittered(box, "walk", start) for start in range(1, 51)]
    assert len(set(starts)) == 50
    assert starts == [jittered(box, "walk", start) for start in range(1, 51)]
    assert starts[0] != jittered(box, "run", 1)
    for start in starts:
        assert abs(start.centre_x - box.centre_x) <= 4
        assert abs(start.centre_y - box.centre_y) <= 2
        assert 36 <= start.w <= 44
        assert 18 <= start.h <= 22


def test_the_means_are_over_the_sequences_that_every_row_has(sequences):
    runs = {"ours": {s.name: [SequenceRun(s.truth, 10.0, {}), SequenceRun(s.truth + 50, 10.0, {})] for s in sequences}}
    stored = {"theirs": Stored({s.name: s.truth + np.array([25, 0, 0, 0]) for s in sequences[:2]})}
    report = build_report(sequences, runs, stored)
    assert report.counted == tuple(s.name for s in sequences[:2])
    figures = report.as_json()
    assert figures["ours"]["precision_20px"] == 100.0
    assert figures["ours"]["jittered"]["precision_20px"] == pytest.approx(100 / 6)
    assert figures["theirs"]["precision_20px"] == pytest.approx(100 / 6)
    assert [s["counted"] for s in figures["ours"]["sequences"].values()] == [True, True, False]
    only = build_report(sequences, runs, {}, reference=[sequences[1].name, "elsewhere"])
    assert only.counted == (sequences[1].name,)
    with pytest.raises(ValueError, match="no sequence has a result of each of ours, none"):
        build_report(sequences, runs, {"none": Stored({})})


@pytest.mark.filterwarnings("default")  # of the cluster's own libraries
def test_a_dask_cluster_of_two_workers_gives_the_same_boxes(sequences):
    distributed = pytest.importorskip("distributed", reason="distributed (the extra dask) is missing")
    with distributed.LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster:
        todo = all_tasks(sequences)
        assert boxes_of(run_all(todo, dask=cluster.scheduler_address)) == boxes_of(run_all(todo))


@pytest.mark.skipif(importlib.util.find_spec("distributed") is not None, reason="the extra dask is installed")
def test_without_the_extra_the_error_says_what_to_install(sequences):
    with pytest.raises(ValueError, match=r"pip install '\.\[dask\]'"):
        run_all(all_tasks(sequences), dask="tcp://127.0.0.1:8786")
