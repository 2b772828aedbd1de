"""The paper's tables and figures as commands, on results small enough to add up by hand."""

import re

import numpy as np
import pytest

import tests.support.rendered_benchmarks as rendered
from racf.evaluate import plots, studies
from racf.evaluate.benchmarks import read_benchmark
from racf.evaluate.report import build_report
from racf.evaluate.runner import SequenceRun
from racf.evaluate.stored import Stored
from tests.racf.test_cli import racf

GRID = studies.Sweep(iterations=(1, 2), etas=(0.5, 1.0))


@pytest.fixture
def sequences(tmp_path):
    for benchmark in ("A", "B"):
        rendered.plain_folder(tmp_path / "data", (f"{benchmark}1", f"{benchmark}2"), benchmark=benchmark)
    return read_benchmark("folder", tmp_path / "data")


def report_of(sequences, shifts: dict[str, float]):
    """Trackers whose every box after the first is off by the given number of pixels."""
    runs = {
        label: {s.name: [SequenceRun(s.truth + np.array([shift, 0, 0, 0]), 50.0, {})] for s in sequences}
        for label, shift in shifts.items()
    }
    return build_report(sequences, runs, {})


def numbers(cells) -> list[float]:
    return [float(n) for cell in cells for n in re.findall(r"[\d.]+", cell)]


def test_table_3_has_a_row_a_tracker_and_marks_its_best_iteration(sequences):
    labels = studies.trackers_of(3, GRID)
    assert len(labels) == 6
    report = report_of(sequences, {label: float(i) for i, label in enumerate(labels)})
    table = studies.lay_out(3, report, GRID)
    assert table.header == ("tracker", "1", "2")
    for row in table.rows:
        assert row[1].startswith("**")  # the smaller shift
        assert not row[2].startswith("**")
    aucs = [value for row in table.rows for value in numbers(row[1:])]
    assert aucs == sorted(aucs, reverse=True)


def test_jittered_starts_count_in_table_3_as_the_nominal_one_does(sequences):
    perfect, gone = (
        lambda s, shift=shift: SequenceRun(s.truth + np.array([shift, 0, 0, 0]), 50.0, {}) for shift in (0, 1000)
    )
    runs = {label: {s.name: [perfect(s), gone(s)] for s in sequences} for label in studies.trackers_of(3, GRID)}
    nominal = {label: {name: starts[:1] for name, starts in of.items()} for label, of in runs.items()}
    both, one = (
        numbers(studies.lay_out(3, build_report(sequences, r, {}), GRID).rows[0][1:2])[0] for r in (runs, nominal)
    )
    first_frame_only = one / len(sequences[0].truth)
    assert both == pytest.approx((one + first_frame_only) / 2, abs=0.01)


def test_table_4_has_a_row_an_iteration_and_a_column_a_weight(sequences):
    labels = studies.trackers_of(4, GRID)
    report = report_of(sequences, {label: float(i) for i, label in enumerate(labels)})
    table = studies.lay_out(4, report, GRID)
    assert table.header == ("iterations", "0.5", "1")
    assert [row[0] for row in table.rows] == ["1", "2"]
    (first, second), (third, fourth) = (numbers(row[1:]) for row in table.rows)
    assert first > second > third > fourth


def test_tables_2_and_5_average_over_benchmarks(sequences):
    report = report_of(sequences, {"good": 0.0, "bad": 30.0})
    hit = 100 / 6  # the first of six frames is given
    speed = studies.lay_out(2, report, GRID)
    assert speed.header[-3:] == ("A", "B", "all sequences")
    assert numbers(speed.rows[0][1:]) == pytest.approx([100, 50, 100, 100, 100])
    assert numbers(speed.rows[1][1:]) == pytest.approx([hit, 50, hit, hit, hit], abs=0.05)
    components = studies.lay_out(5, report, GRID)
    assert numbers(components.rows[1][1:])[1::2] == pytest.approx([hit] * 4, abs=0.05)


def test_jittered_starts_count_in_tables_2_and_5(sequences):
    runs = {
        "x": {s.name: [SequenceRun(s.truth + np.array([d, 0, 0, 0]), 50.0, {}) for d in (0, 30)] for s in sequences}
    }
    half = (100 + 100 / 6) / 2
    report = build_report(sequences, runs, {})
    assert numbers(studies.lay_out(2, report, GRID).rows[0][-1:]) == pytest.approx([half], abs=0.05)
    assert numbers(studies.lay_out(5, report, GRID).rows[0][1:])[1::2] == pytest.approx([half] * 4, abs=0.05)


def test_table_5_gives_what_each_component_adds(sequences):
    shifts = {"bacf": 30.0, "bacf,refine": 0.0, "racf--": 30.0, "racf-": 0.0, "racf": 30.0}
    rows = {row[0]: row[-1] for row in studies.lay_out(5, report_of(sequences, shifts), GRID).rows}
    gain = 100 - 100 / 6  # the first of six frames is given
    assert rows["bacf"] == rows["racf--"] == ""
    for label, base, sign in (("bacf,refine", "bacf", 1), ("racf-", "racf--", 1), ("racf", "racf-", -1)):
        assert rows[label].startswith(f"over `{base}`: ")
        precision = [float(n) for n in re.findall(r"[-+][\d.]*\d", rows[label].split(" / ")[1])]
        assert precision == pytest.approx([sign * gain] * 3, abs=0.06)


def test_speeds_stored_beside_boxes_are_shown(sequences):
    stored = Stored({s.name: s.truth for s in sequences}, {s.name: 26.0 for s in sequences})
    report = build_report(sequences, {}, {"theirs": stored})
    assert studies.lay_out(2, report, GRID).rows[0][2] == "26.0"


def test_table_5_sets_every_tracker_with_the_refinement_beside_itself_without():
    labels = studies.trackers_of(5, GRID)
    refined = {label.removesuffix(",refine") for label in labels if label.endswith(",refine")}
    assert {"bacf", "arcf-hc"} < refined < set(labels)
    assert {"racf", "racf-", "racf--"} < set(labels)


def test_figures_are_written_as_png_and_svg_and_are_the_same_each_time(sequences, tmp_path):
    report = report_of(sequences, {"good": 0.0, "bad": 30.0})
    boxes = {row.label: {s.name: s.truth for s in sequences} for row in report.rows}

    def draw(folder):
        paths = [*plots.draw_curves(report, folder), *plots.draw_images(sequences[:2], boxes, folder / "images")]
        paths += plots.draw_lines({"a": [1.0, 2.0]}, [1, 2], ("x", "y"), folder / "lines")
        return {path.name: path.read_bytes() for path in paths}

    first = draw(tmp_path / "one")
    assert set(first) == {
        f"{name}.{kind}"
        for name in (
            "precision",
            "success",
            "precision-A",
            "success-A",
            "precision-B",
            "success-B",
            "images",
            "lines",
        )
        for kind in ("png", "svg")
    }
    assert draw(tmp_path / "two") == first


def test_attributes_have_tables_and_a_figure_where_two_sequences_share_one(tmp_path):
    for number in (1, 2):
        root = rendered.dtb70(tmp_path / "data")
        (root / "Walk1").rename(root / f"Run{number}")
        (root / "att" / "Walk1.txt").rename(root / "att" / f"Run{number}.txt")
    sequences = read_benchmark("dtb70", root)
    report = report_of(sequences, {"good": 0.0})
    assert report.attributes() == ["FCM", "SV"]
    assert report.as_json()["good"]["attributes"]["SV"]["precision_20px"] == 100.0
    assert [row[:2] for row in report.by_group()[0].rows] == [("FCM", "2"), ("SV", "2")]
    assert [path.name for path in plots.draw_attributes(report, tmp_path)] == [
        "success-by-attribute.png",
        "success-by-attribute.svg",
    ]


def test_images_are_of_the_sequences_that_tell_the_trackers_apart(sequences):
    runs = {
        label: {
            s.name: [SequenceRun(s.truth + np.array([shift * i, 0, 0, 0]), 1.0, {})] for i, s in enumerate(sequences)
        }
        for label, shift in {"good": 0.0, "bad": 5.0}.items()
    }
    report = build_report(sequences, runs, {})
    assert report.telling_apart(2) == [sequences[3].name, sequences[2].name]


def test_images_are_drawn_of_many_trackers_and_without_boxes_of_nan(sequences, tmp_path):
    boxes = {f"tracker {i}": {s.name: s.truth.copy() for s in sequences} for i in range(23)}
    boxes["tracker 3"][sequences[0].name][:] = np.nan
    for path in plots.draw_images(sequences[:1], boxes, tmp_path / "images"):
        assert path.stat().st_size > 0


def test_images_without_frames_are_refused_in_one_sentence(tmp_path, capsys):
    rendered.write_truth(tmp_path / "anno" / "walk.txt", rendered.path_of_target(4))
    rendered.write_truth(tmp_path / "T" / "walk.txt", rendered.path_of_target(4))
    assert racf("eval", tmp_path, "--import", f"T={tmp_path}", "--images", 1, "--out", tmp_path / "out") == 2
    err = capsys.readouterr().err
    assert err.count("\n") == 1
    assert "images need frames" in err
    with pytest.raises(ValueError, match="no sequence to draw images of"):
        plots.draw_images([], {}, tmp_path / "images")


def test_a_table_is_one_command(tmp_path, capsys):
    data, out = rendered.plain_folder(tmp_path / "data", frames=4), tmp_path / "out"
    arguments = ["eval", data, "--table", 3, "--iterations", "1,2", "--jobs", 1, "--out", out, "--images", 1]
    assert racf(*arguments) == 0
    assert "Table 3" in capsys.readouterr().out
    assert (out / "tables.md").read_text().startswith("## Table 3")
    for name in ("table3.png", "table3.svg", "images.png", "images.svg"):
        assert (out / name).stat().st_size > 0


@pytest.mark.parametrize(
    ("options", "named"),
    [
        (["--table", 7], "7"),
        (["--table", 3, "--tracker", "racf"], "table 3"),
        (["--table", 3, "--iterations", "one"], "one"),
        (["--images", 2], "out"),
        (["--jitter", -1], "-1"),
    ],
)
def test_what_a_table_cannot_be_is_one_line_and_status_2(options, named, tmp_path, capsys):
    assert racf("eval", rendered.plain_folder(tmp_path), *options) == 2
    err = capsys.readouterr().err
    assert err.count("\n") == 1
    assert named in err
