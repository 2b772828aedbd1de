"""The two-fold study: no choice is evaluated on a sequence that it was made by, and every start begins on a target."""

import importlib.util
import runpy
import sys
from pathlib import Path

import numpy as np
import pytest

import tests.support.rendered_benchmarks as rendered
from racf.evaluate.benchmarks import Sequence
from racf.evaluate.trackers import TrackerSpec
from tools.studies import authors, confidence, halves, occlusions, other_starts, reliability
from tools.studies.halves import AUTHORS, HALVES, STARTS, difference, inner_starts, main, over, two_fold

EVERY = [*HALVES["A"], *HALVES["B"]]


def test_the_halves_share_no_sequence_and_are_of_one_size() -> None:
    assert len(set(EVERY)) == len(EVERY) == 20
    assert len(HALVES["A"]) == len(HALVES["B"])


def test_sequences_cut_out_of_one_video_are_on_one_side() -> None:
    assert {"car16_1", "car16_2"} <= set(HALVES["A"])


def test_a_choice_is_judged_only_by_the_other_half() -> None:
    """A candidate that is best on one half and worst on the other must not profit from where it is best."""
    steady = dict.fromkeys(EVERY, (50.0, 50.0))
    fits_a = {name: (90.0, 90.0) if name in HALVES["A"] else (10.0, 10.0) for name in EVERY}
    folds, reported = two_fold({"steady": steady, "fits A": fits_a})
    assert [(fold.chosen_on, fold.label, fold.reported_on) for fold in folds] == [
        ("A", "fits A", "B"),
        ("B", "steady", "A"),
    ]
    assert over(reported, HALVES["B"]) == (10.0, 10.0)
    assert over(reported, HALVES["A"]) == (50.0, 50.0)


def test_a_paired_difference_does_not_depend_on_the_difficulty_of_sequences() -> None:
    rng = np.random.default_rng(0)
    hard = dict(zip(EVERY, rng.uniform(0, 90, (20, 2)).tolist(), strict=True))
    better = {name: (p + 3.0, a + 2.0) for name, (p, a) in hard.items()}
    apart = difference(better, hard, EVERY)
    assert apart.precision == pytest.approx((3.0, 3.0, 3.0))
    assert apart.auc == pytest.approx((2.0, 2.0, 2.0))


def test_inner_starts_begin_where_the_target_is_annotated() -> None:
    truth = np.tile([10.0, 10.0, 20.0, 20.0], (30, 1))
    truth[8:14] = np.nan
    truth[20] = 0.0
    sequence = Sequence("walk", "made", truth, attributes=())
    parts = list(inner_starts(sequence, STARTS["five"]))
    assert [len(part.truth) for part in parts] == [30 - 14, 30 - 21]
    assert len({part.name for part in parts} | {sequence.name}) == 3


def test_no_start_is_in_two_sets_and_each_set_has_as_many_as_its_name_says() -> None:
    truth = np.tile([10.0, 10.0, 20.0, 20.0], (60, 1))
    sequence = Sequence("walk", "made", truth, tuple(Path(f"{i}.jpg") for i in range(60)), ())
    spec = TrackerSpec.parse("racf-")
    begun = {
        name: {(task.sequence, task.start): (task.first_box, task.frames[0]) for task in halves.todo(spec, sequence, s)}
        for name, s in STARTS.items()
    }
    assert {name: len(tasks) for name, tasks in begun.items()} == {
        "five": 5, "seven": 7, "eight": 8, "fifteen": 15, "twenty": 20,
    }  # fmt: skip
    assert begun["seven"] | begun["eight"] == begun["fifteen"]
    assert begun["five"] | begun["fifteen"] == begun["twenty"]
    assert len(set(begun["twenty"].values())) == 20


@pytest.fixture
def twenty(tmp_path):
    """The twenty by name, each seven rendered frames, with the annotation as the authors' boxes."""
    data = rendered.plain_folder(tmp_path / "data", tuple(EVERY), frames=7)
    for name in EVERY:
        truth = (data / name / "groundtruth_rect.txt").read_text()
        (data / "results" / "RACF").mkdir(parents=True, exist_ok=True)
        (data / "results" / "RACF" / f"{name}.txt").write_text(truth)
    return data


def printed(capsys, monkeypatch, *arguments: object) -> str:
    monkeypatch.setattr(sys, "argv", ["halves", *map(str, arguments)])
    main()
    return capsys.readouterr().out


def test_a_study_reuses_its_stored_runs(twenty, tmp_path, capsys, monkeypatch):
    asked = (twenty, "--tracker", "racf--", "--against", "bacf", "--jobs", 1, "--out", tmp_path / "out")
    first = printed(capsys, monkeypatch, *asked)
    assert [line.split("|")[1].strip() for line in first.splitlines()[2:]] == [f"`{AUTHORS}`", "`bacf`", "`racf--`"]
    assert printed(capsys, monkeypatch, *asked) == first
    for boxes in (tmp_path / "out").rglob("*.txt"):
        boxes.write_text("1,1,2,2\n" * len(boxes.read_text().splitlines()))
    assert printed(capsys, monkeypatch, *asked) != first


def test_some_of_the_sequences_are_enough_and_the_authors_boxes_are_not_needed(twenty, tmp_path, capsys, monkeypatch):
    (twenty / "results" / "RACF" / "person11.txt").unlink()
    some = ("--tracker", "racf--", "--against", "racf--", "--only", "person11", "--out", tmp_path / "out")
    monkeypatch.setattr(sys, "argv", ["halves", str(twenty), *map(str, some)])
    main()
    out, err = capsys.readouterr()
    assert [cell.strip() for cell in out.splitlines()[0].split("|")][2:5] == ["half A", "half B", "all 1"]
    assert [cell.strip() for cell in out.splitlines()[-1].split("|")][1:3] == ["`racf--`", "-"]
    assert "without the authors' row: person11, in a folder data, has no boxes of RACF in" in err


@pytest.mark.parametrize(
    ("wrong", "told"),
    [
        (("--tracker", "racff"), "there is no tracker 'racff'; did you mean racf"),
        (("--jobs", -1), "--jobs: a whole number of at least 0"),
        (("--only", "person11"), "--only goes with --tracker"),
        (("--tracker", "racf", "--only", "person99"), "--only names sequences of the study"),
    ],
)
def test_wrong_arguments_are_reported_in_one_line_before_anything_runs(twenty, capsys, monkeypatch, wrong, told):
    with pytest.raises(SystemExit):
        printed(capsys, monkeypatch, twenty, "--starts", "seven", *wrong)
    assert told in capsys.readouterr().err.splitlines()[-1]


@pytest.mark.parametrize("study", [authors, confidence, occlusions, other_starts, reliability])
def test_a_wrong_tracker_is_reported_in_one_line_by_every_study(study, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(sys, "argv", ["study", str(tmp_path), "--tracker", "racff"])
    with pytest.raises(SystemExit):
        study.main()
    assert "there is no tracker 'racff'; did you mean racf" in capsys.readouterr().err.splitlines()[-1]


@pytest.mark.skipif(importlib.util.find_spec("distributed") is not None, reason="the extra dask is installed")
@pytest.mark.parametrize("study", [halves, reliability])
def test_a_cluster_that_cannot_be_used_is_reported_in_one_line(study, twenty, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(sys, "argv", ["study", str(twenty), "--tracker", "racf--", "--dask", "nonsense"])
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit) as end:
        runpy.run_path(study.__file__, run_name="__main__")
    assert end.value.code == 1
    assert (
        capsys.readouterr()
        .err.splitlines()[-1]
        .endswith("error: Dask needs the extra: pip install '.[dask]' in the clone")
    )


def test_sequences_too_short_for_an_occlusion_are_reported_and_no_empty_table_is_printed(twenty, capsys, monkeypatch):
    monkeypatch.setattr(sys, "argv", ["study", str(twenty)])
    with pytest.raises(SystemExit):
        occlusions.main()
    out, err = capsys.readouterr()
    assert "long enough for an occlusion" in err.splitlines()[-1]
    assert not out


@pytest.mark.filterwarnings("default")  # of the cluster's own libraries
def test_a_study_has_the_same_figures_on_a_dask_cluster(twenty, tmp_path, capsys, monkeypatch):
    distributed = pytest.importorskip("distributed", reason="distributed (the extra dask) is missing")
    asked = (twenty, "--tracker", "racf--", "--against", "bacf")
    here = printed(capsys, monkeypatch, *asked, "--jobs", 1, "--out", tmp_path / "here")
    with distributed.LocalCluster(n_workers=1, threads_per_worker=1, dashboard_address=None) as cluster:
        there = printed(capsys, monkeypatch, *asked, "--dask", cluster.scheduler_address, "--out", tmp_path / "there")
    assert here == there
    assert "| `racf--` |" in here
