"""`racf track` and `racf eval` as commands: output, files and exit status."""

import json
import re
import sys

import cv2
import numpy as np
import pytest

import tests.support.rendered_benchmarks as rendered
from racf.cli import main
from racf.evaluate.boxfiles import read_boxes, write_boxes
from sim.clip import write


def racf(*argv: object) -> int:
    """Exit status of the command."""
    before = sys.argv
    sys.argv = ["racf", *map(str, argv)]
    try:
        with pytest.raises(SystemExit) as stop:
            main()
    finally:
        sys.argv = before
    return int(stop.value.code or 0)


@pytest.fixture
def data(tmp_path):
    return rendered.plain_folder(tmp_path / "data", ("one", "two"), frames=8, benchmark="Bench")


def test_track_writes_a_box_a_frame_near_the_target(data, tmp_path):
    source, out = data / "Bench" / "one", tmp_path / "deep" / "boxes.txt"
    assert racf("track", source, "--init", "30,40,24,20", "--out", out, "--tracker", "racf-") == 0
    boxes = read_boxes(out)
    truth = rendered.path_of_target(8) - [1, 1, 0, 0]
    assert boxes.shape == (8, 4)
    assert np.abs((boxes - truth)[:, :2]).max() < 4


@pytest.mark.parametrize("broken", [b"no image", cv2.imencode(".png", np.zeros((20, 30, 3), np.uint8))[1].tobytes()])
def test_what_was_tracked_before_a_frame_that_cannot_be_tracked_is_written(broken, data, tmp_path, capsys):
    source, out, overlay = data / "Bench" / "one", tmp_path / "boxes.txt", tmp_path / "drawn.mp4"
    sorted(source.glob("*.png"))[5].write_bytes(broken)
    given = ("track", source, "--init", "30,40,24,20", "--out", out, "--tracker", "racf-", "--overlay", overlay)
    assert racf(*given) == 1
    assert read_boxes(out).shape == (5, 4)
    assert len(out.with_suffix(".csv").read_text().splitlines()) == 6
    assert overlay.stat().st_size > 0
    lines = capsys.readouterr().err.splitlines()
    assert lines[-2].startswith("the 5 boxes before that are written to ")
    assert lines[-1].startswith("racf: error: ")


def test_a_start_that_cannot_be_tracked_writes_nothing(data, tmp_path):
    out = tmp_path / "boxes.txt"
    assert racf("track", data / "Bench" / "one", "--init", "3000,40,24,20", "--out", out) == 2
    assert not out.exists()


def test_eval_prints_only_its_json_with_the_promised_keys(data, capsys):
    assert racf("eval", data, "--tracker", "racf-", "--set", "robust", "--jitter", 2, "--json", "--jobs", 1) == 0
    figures = json.loads(capsys.readouterr().out)
    promised = {"precision_20px", "auc", "precision_20px_strict", "auc_strict", "fps"}
    assert promised | {"sequences", "jittered"} <= set(figures["racf-"])
    assert figures["racf-"]["jittered"]["starts"] == 2
    assert set(figures["racf-"]["sequences"]) == {"one", "two"}
    assert all(promised | {"frames"} <= set(s) for s in figures["racf-"]["sequences"].values())
    assert figures["racf-"]["precision_20px"] == 100.0
    assert 50 < figures["racf-"]["auc"] <= 100


def test_eval_leaves_boxes_tables_and_figures_and_resumes_from_them(data, tmp_path, capsys):
    out = tmp_path / "out"
    arguments = ("eval", data, "--tracker", "racf-", "--tracker", "racf-,robust", "--json", "--jobs", 1, "--out", out)
    assert racf(*arguments) == 0
    first = capsys.readouterr().out
    for name in ("report.json", "tables.md", "precision.png", "precision.svg", "success.png", "success.svg"):
        assert (out / name).stat().st_size > 0
    assert "| racf-,robust |" in (out / "tables.md").read_text()
    assert racf(*arguments) == 0
    assert capsys.readouterr().out == first  # also the speed: nothing ran again


def test_eval_compares_stored_boxes(data, tmp_path, capsys):
    truth = rendered.path_of_target(8)
    for name, shift in (("Good", 0), ("Bad", 30)):
        (tmp_path / "stored" / name).mkdir(parents=True)
        write_boxes(tmp_path / "stored" / name / "one.txt", truth + np.array([shift, 0, 0, 0]))
    assert racf("eval", data, "--import", tmp_path / "stored", "--json") == 0
    figures = json.loads(capsys.readouterr().out)
    assert list(figures) == ["Bad", "Good"]
    assert figures["Good"]["precision_20px"] == 100.0
    assert figures["Bad"]["precision_20px"] == pytest.approx(100 / 8)
    assert "fps" not in figures["Good"]
    assert racf("eval", data, "--import", f"Good={tmp_path / 'stored'}") == 0
    assert re.search(r"Good +100\.00", capsys.readouterr().out)


def stored_boxes(folder, names: dict[str, tuple[str, ...]]) -> None:
    for tracker, sequences in names.items():
        (folder / tracker).mkdir(parents=True)
        for sequence in sequences:
            begin = ("one", "two").index(sequence)
            write_boxes(folder / tracker / f"{sequence}.txt", rendered.path_of_target(8, begin))


def test_what_an_import_leaves_out_is_reported(data, tmp_path, capsys):
    stored_boxes(tmp_path / "stored", {"Whole": ("one", "two"), "Part": ("one",), "anno": ("one", "two")})
    assert racf("eval", data, "--import", tmp_path / "stored", "--json") == 0
    out, err = capsys.readouterr()
    assert list(json.loads(out)) == ["Whole"]
    assert err.count("\n") == 1
    assert "Part is left out, for it has boxes for only 1 of the sequences" in err
    assert racf("eval", data, "--import", f"Part={tmp_path / 'stored'}", "--json") == 0
    out, err = capsys.readouterr()
    assert list(json.loads(out)) == ["Part"]
    assert "Part has boxes for 1 of 2 sequences; the others are left out of the mean" in err


def test_a_name_is_imported_once(data, tmp_path, capsys):
    for place in ("here", "there"):
        stored_boxes(tmp_path / place, {"T": ("one", "two")})
    assert racf("eval", data, "--import", tmp_path / "here", "--import", f"T={tmp_path / 'there'}") == 2
    err = capsys.readouterr().err
    assert err.count("\n") == 1
    assert "T is imported already" in err


WRONG = {
    "a folder that is not there": (("eval", "nowhere"), "nowhere"),
    "a benchmark nobody knows": (("eval", "DATA", "--benchmark", "otb"), "otb"),
    "a tracker nobody knows": (("eval", "DATA", "--tracker", "goturn"), "goturn"),
    "a setting nobody knows": (("eval", "DATA", "--set", "etta=1"), "etta"),
    "a setting that is no number": (("eval", "DATA", "--set", "residue=high"), "high"),
    "a pattern without a match": (("eval", "DATA", "--only", "three"), "three"),
    "an import without boxes": (("eval", "DATA", "--import", "X=DATA"), "X"),
    "a box of three numbers": (("track", "DATA/Bench/one", "--init", "1,2,3", "--out", "x.txt"), "1,2,3"),
    "a source that is not there": (("track", "nowhere.mp4", "--init", "1,2,3,4", "--out", "x.txt"), "nowhere.mp4"),
    "a tracker of OpenCV's to measure": (("bench", "DATA", "--tracker", "racf", "--tracker", "mil"), "not mil"),
    "a folder for the boxes": (
        ("track", "DATA/Bench/one", "--init", "1,2,3,4", "--out", "DATA"),
        "--out must be a file",
    ),
    "a command nobody knows": (("trak",), "the commands are track, eval, bench"),
    "an option nobody knows": (("eval", "DATA", "--jason"), "--jason"),
}


@pytest.mark.parametrize("what", WRONG)
def test_wrong_use_ends_in_2_with_one_line_that_names_it(what, data, capsys):
    argv, named = WRONG[what]
    assert racf(*(a.replace("DATA", str(data)) for a in argv)) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith("racf: error: ")
    assert err.count("\n") == 1
    assert named in err


def test_broken_data_ends_in_1_with_one_line_that_names_it(data, capsys):
    (data / "Bench" / "one" / "000305.png").unlink()
    assert racf("eval", data) == 1
    err = capsys.readouterr().err
    assert err.count("\n") == 1
    assert "000304.png" in err


def test_bench_prints_only_its_json_with_the_promised_keys(data, capsys):
    assert racf("bench", data, "--only", "one", "--tracker", "racf", "--json", "--no-first-call") == 0
    figures = json.loads(capsys.readouterr().out)
    (ours,) = figures["tracker"].values()
    assert ours["fps"] > 0
    assert sum(ours["ms"].values()) > 0
    assert set(ours["times_as_fast_as"]) == set(figures["peers"])
    assert all(peer["fps"] > 0 for peer in figures["peers"].values())


def test_help_of_bench_explains_no_first_call(capsys):
    assert racf("bench", "--help") == 0
    words = " ".join(re.sub(r"[^\w\s.-]", " ", capsys.readouterr().out).split())
    assert "--no-first-call Leave out the times" in words


@pytest.fixture
def clip(tmp_path):
    """A folder with clip.mp4, its annotation clip.txt and links to both."""
    write(tmp_path / "clip.mp4", 4)
    (tmp_path / "film.mp4").symlink_to(tmp_path / "clip.mp4")
    (tmp_path / "also.mp4").hardlink_to(tmp_path / "clip.mp4")
    (tmp_path / "link.txt").symlink_to(tmp_path / "clip.txt")
    (tmp_path / "sub").mkdir()
    return tmp_path


OVERWRITING = {
    "boxes over the video": (("--out", "clip.mp4"), "the source"),
    "boxes over a link to the video": (("--out", "film.mp4"), "the source"),
    "boxes over the video by another way": (("--out", "sub/../clip.mp4"), "the source"),
    "the overlay over the video": (("--out", "b.txt", "--overlay", "clip.mp4"), "the source"),
    "the overlay over a hard link": (("--out", "b.txt", "--overlay", "also.mp4"), "the source"),
    "boxes over the annotation": (("--out", "clip.txt", "--truth", "clip.txt"), "the annotation"),
    "boxes over a link to it": (("--out", "link.txt", "--truth", "clip.txt"), "the annotation"),
    "boxes over an annotation not given": (("--out", "clip.txt"), "not written by racf track"),
    "confidence over a table": (("--out", "table.txt"), "not written by racf track"),
    "the overlay over another video": (("--out", "b.txt", "--overlay", "other.mp4"), "not written by racf track"),
    "boxes and overlay in one file": (("--out", "new.mp4", "--overlay", "new.mp4"), "one file"),
}


@pytest.mark.parametrize("what", OVERWRITING)
def test_track_overwrites_nothing_but_its_own_boxes(what, clip, capsys, monkeypatch):
    monkeypatch.chdir(clip)
    (clip / "table.csv").write_text("my,own\n1,2\n")
    (clip / "other.mp4").write_bytes(b"a film")
    before = {path.name: path.read_bytes() for path in clip.iterdir() if path.is_file()}
    argv, named = OVERWRITING[what]
    assert racf("track", "clip.mp4", "--init", "309,192,22,48", *argv) == 2
    assert {path.name: path.read_bytes() for path in clip.iterdir() if path.is_file()} == before
    err = capsys.readouterr().err
    assert err.count("\n") == 1
    assert named in err


def test_track_overwrites_its_own_boxes_and_prints_the_path(clip, capsys, monkeypatch):
    monkeypatch.chdir(clip)
    words = ("track", "clip.mp4", "--init", "309,192,22,48", "--out", "sub/boxes.txt", "--tracker", "racf-")
    assert racf(*words) == racf(*words) == 0
    assert "4 boxes written to sub/boxes.txt and sub/boxes.csv" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("box", "status", "says"),
    [
        ("630,340,24,48", 2, "only 17 % of target 630,340,24,48 lies in the 640x360 image"),
        ("700,10,24,48", 2, "lies outside the 640x360 image"),
        ("0,0,640,360", 2, "needs some background"),
        ("622,192,24,48", 0, "25 % of target 622,192,24,48 lies outside the 640x360 image"),
    ],
)
def test_a_first_box_that_reaches_out_of_the_image_is_reported(box, status, says, clip, capsys):
    assert racf("track", clip / "clip.mp4", "--init", box, "--out", clip / "b.txt", "--tracker", "racf-") == status
    assert says in capsys.readouterr().err
