"""The evaluation as a library: what the command does, with trackers of your own, and compared with earlier results."""

import inspect
import json
import os
import subprocess
import sys

import av
import cv2
import numpy as np
import pytest

import racf
import tests.support.rendered_benchmarks as rendered
from racf.evaluate import evaluate
from racf.evaluate.boxfiles import write_boxes
from racf.evaluate.images import read_frame
from racf.evaluate.imports import import_boxes
from racf.evaluate.metrics import interval_of_mean
from sim.clip import clip, write
from tests.racf.test_cli import racf as command
from tests.support.clips import encode

NAMES = ("one", "two", "three")


class Still:
    """Keeps the first box; the four lines that a tracker of one's own needs."""

    def __init__(self, dx: int = 0) -> None:
        self.dx = dx

    def init(self, image, box):
        self.box = (box.x + self.dx, box.y, box.w, box.h)

    def update(self, image):
        return self.box


class Template(Still):
    """The best match of the first frame's pixels."""

    def init(self, image, box):
        super().init(image, box)
        x, y, w, h = (round(v) for v in self.box)
        self.target = image[y : y + h, x : x + w]

    def update(self, image):
        _, _, _, at = cv2.minMaxLoc(cv2.matchTemplate(image, self.target, cv2.TM_CCOEFF_NORMED))
        return racf.Box(*at, *self.box[2:])


class Blind(Still):
    """Never finds anything."""

    def update(self, image):
        return None


@pytest.fixture
def data(tmp_path):
    return rendered.plain_folder(tmp_path / "data", NAMES, frames=8, benchmark="Bench")


def test_the_library_does_what_the_command_does(data, tmp_path, capsys):
    wanted = evaluate(data, trackers="racf-", jitter=1, jobs=1, out=tmp_path / "a", only=["t*"], progress=False)
    arguments = ["--tracker", "racf-", "--jitter", 1, "--jobs", 1, "--out", tmp_path / "a", "--only", "t*", "--json"]
    capsys.readouterr()
    assert command("eval", data, *arguments) == 0
    assert json.loads(capsys.readouterr().out) == wanted.figures()
    assert list(wanted.boxes["racf-"]) == ["three", "two"]
    assert "| racf- |" in wanted.summary[0].markdown()


def test_evaluate_is_exported_by_the_package_and_has_a_docstring():
    lines = "import racf, sys; help(racf.evaluate.evaluate); print('cv2' in sys.modules)"
    out = subprocess.run([sys.executable, "-c", lines], capture_output=True, text=True, check=True).stdout
    for word in ("trackers:", "imports:", "jitter:", "csrt", "module:Class", "MyTracker", "Raises ValueError"):
        assert word in out
    assert "evaluate" in dir(racf.evaluate)
    with pytest.raises(AttributeError, match="has no attribute 'evalute'"):
        _ = racf.evaluate.evalute


def test_a_class_of_ones_own_is_a_tracker(data):
    trackers = {"best": Template, "still": Still, "blind": Blind}
    evaluation = evaluate(data, trackers=trackers, jobs=1, progress=False)
    figures = evaluation.figures()
    assert figures["best"]["auc"] > 90
    assert evaluation.boxes["blind"].keys() == evaluation.boxes["still"].keys()
    for name, boxes in evaluation.boxes["still"].items():
        assert (boxes == boxes[0]).all()
        assert (boxes == evaluation.boxes["blind"][name]).all()


def test_a_class_named_on_the_command_line_runs_in_other_processes(data, tmp_path, monkeypatch, capsys):
    (tmp_path / "mine.py").write_text(
        "class Mine:\n"
        "    def __init__(self, dx=0): self.dx = dx\n"
        "    def init(self, image, box): self.box = box\n"
        "    def update(self, image): self.box = self.box.moved(self.dx, 1); return self.box\n"
    )
    monkeypatch.chdir(tmp_path)
    arguments = ["--tracker", "mine:Mine,dx=2", "--tracker", "mine:Mine", "--jobs", 2, "--json"]
    assert command("eval", data, *arguments) == 0
    figures = json.loads(capsys.readouterr().out)
    assert figures["mine:Mine,dx=2"]["auc"] == pytest.approx(100 * 20 / 21)  # the target walks (2, 1) a frame
    assert figures["mine:Mine"]["auc"] < 90


def test_results_of_a_class_are_reused_until_its_source_changes(data, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    source = "class Again:\n    def init(self, image, box): self.box = box\n"
    source += "    def update(self, image): return self.box\n"
    prints = []
    for text in (source, source, source.replace("return self.box", "return None")):
        (tmp_path / "again.py").write_text(text)
        prints.append(racf.evaluate.TrackerSpec.parse("again:Again").fingerprint())
    assert prints[0] == prints[1] != prints[2]


class Nothing:
    """No tracker."""


@pytest.mark.parametrize(
    ("tracker", "sentence"),
    [
        (Nothing, "tracker Nothing: it needs two methods, init.* init is missing"),
        ("nowhere_at_all:Mine", "module 'nowhere_at_all' cannot be imported"),
        ("json:Nothing", "json has no class 'Nothing'"),
        ("tests.racf.test_evaluate_evaluation:Still,speed=3", "cannot be built: .*speed"),
        ("cstr", r"there is no tracker 'cstr'; did you mean csrt\?"),
        ("goturn", "no tracker 'goturn'; there are racf, .*csrt, kcf, mil, nano, vit, and your own as module:Class"),
        (3, "a tracker is a name, a class with init.*, not 3"),
        ([3], "a tracker is a name, a class with init.*, not 3"),
        (Still(), "a tracker is a name, a class with init.*, not <"),
        (["racf", "racf"], "each tracker is named once, not racf 2 times"),
    ],
)
def test_what_is_no_tracker_is_refused_before_anything_runs(tracker, sentence, data):
    with pytest.raises(ValueError, match=sentence):
        evaluate(data, trackers=tracker, progress=False)


def test_a_result_that_is_no_box_is_named(data):
    class Wrong(Still):
        def update(self, image):
            return "there"

    with pytest.raises(ValueError, match=r"tracker Wrong: update gives a racf\.Box.*, not 'there'"):
        evaluate(data, trackers=Wrong, progress=False)


def test_a_difference_is_paired_by_sequence(data):
    figures = evaluate(data, trackers={"a": Template, "b": Still}, jitter=2, jobs=1, progress=False).figures()
    assert "difference" not in figures["a"]
    found = figures["b"]["difference"]
    of = {name: [figures[name]["sequences"][s]["auc"] for s in NAMES] for name in "ab"}
    pairs = [b - a for a, b in zip(of["a"], of["b"], strict=True)]
    assert found["to"] == "a"
    assert found["auc"] == pytest.approx(np.mean(pairs), abs=1e-5)
    assert found["interval_95"]["auc"] == pytest.approx(interval_of_mean(pairs), abs=0.01)
    jittered = [figures[name]["jittered"]["auc"] for name in "ab"]
    assert found["jittered"]["auc"] == pytest.approx(jittered[1] - jittered[0], abs=1e-5)


def test_one_sequence_has_no_interval_and_is_not_called_sequences(data):
    trackers = {"a": Still, "b": Blind}
    for only, title, dashes in (("one", "over 1 sequence,", 2), (NAMES, "over 3 sequences,", 0)):
        report = evaluate(data, trackers=trackers, only=only, jobs=1, progress=False).report
        for table in (report.overall(), report.differences()):
            assert table is not None
            assert title in table.title
            assert table.rows[-1][1:5].count("-") == dashes


def test_the_output_folder_of_an_evaluation_is_imported_with_its_starts(data, tmp_path):
    ran = {}
    for out, tracker in (("before", Still), ("after", Template)):
        ran[out] = evaluate(data, trackers={"mine": tracker}, jitter=1, jobs=1, out=tmp_path / out, progress=False)
    both = evaluate(data, imports=[str(tmp_path / "before"), str(tmp_path / "after")])
    assert list(both.figures()) == ["mine", "mine (after)"]
    for label, out in (("mine", "before"), ("mine (after)", "after")):
        wanted, found = ran[out].figures()["mine"], both.figures()[label]
        assert {key: found[key] for key in wanted} == wanted
    assert "jittered" in both.figures()["mine (after)"]["difference"]
    named = evaluate(data, imports=[f"old={tmp_path / 'before'}", f"new={tmp_path / 'after' / 'runs'}"])
    assert list(named.figures()) == ["old", "new"]
    again = evaluate(data, trackers={"mine": Still}, imports=[str(tmp_path / "before")], jobs=1, progress=False)
    assert list(again.figures()) == ["mine", "mine (before)"]


def test_of_an_evaluation_of_several_trackers_one_is_named(data, tmp_path):
    evaluate(data, trackers={"a": Still, "b": Template}, jobs=1, out=tmp_path / "out", progress=False)
    assert list(evaluate(data, imports=[f"b={tmp_path / 'out'}"]).figures()) == ["b"]
    with pytest.raises(ValueError, match="holds a, b; NAME is one of these"):
        evaluate(data, imports=[f"c={tmp_path / 'out'}"])
    other = rendered.plain_folder(tmp_path / "other", ("four",), benchmark="Bench")
    with pytest.raises(ValueError, match="has none of the sequences"):
        evaluate(other, imports=[str(tmp_path / "out")])


def test_a_broken_note_in_an_imported_evaluation_is_named(data, tmp_path):
    evaluate(data, trackers=Still, out=tmp_path / "out", progress=False)
    note = next((tmp_path / "out/runs").rglob("*.json"))
    note.write_text("")
    with pytest.raises(ValueError, match=rf"{note} is not the JSON that an evaluation leaves: .*; delete it"):
        evaluate(data, imports=[str(tmp_path / "out")], progress=False)


def test_one_text_is_as_good_as_a_list_of_one(data, tmp_path):
    evaluation = evaluate(data, trackers=Still, only="two", out=tmp_path / "out", progress=False)
    assert list(evaluation.boxes["Still"]) == ["two"]
    imported = evaluate(data, imports=f"Still={tmp_path / 'out'}", only="two", progress=False)
    assert imported.boxes["Still"]["two"].tolist() == evaluation.boxes["Still"]["two"].tolist()
    with pytest.raises(ValueError, match="no setting 'nothing'"):
        evaluate(data, trackers="racf--", settings="nothing=3", progress=False)


class Blinking(Still):
    """Answers with Tracks, and finds nothing in every other frame."""

    def init(self, image, box):
        self.count = 0

    def update(self, image):
        self.count += 1
        box = racf.Box(10 * self.count, 5, 20, 20)
        return racf.Track(box, box, psr=1.0, apce=1.0, confidence=1.0, found=True) if self.count % 2 else None


def test_a_frame_without_a_result_keeps_the_last_box(data):
    boxes = evaluate(data, trackers=Blinking, only=["one"], jobs=1, progress=False).boxes["Blinking"]["one"]
    assert boxes[1:5, 0].tolist() == [11, 11, 31, 31]


def test_of_two_results_with_one_label_the_newer_is_imported(data, tmp_path):
    sequences = racf.evaluate.read_benchmark("folder", data)
    for place, shift in (("mine-1", 5), ("mine-2", 0)):
        for s in sequences:
            path = tmp_path / "runs" / place / s.benchmark / s.name
            path.parent.mkdir(parents=True, exist_ok=True)
            write_boxes(path.with_suffix(".txt"), s.truth + np.array([shift, 0, 0, 0]))
            path.with_suffix(".json").write_text(json.dumps({"key": "x", "fps": 10.0}))
    (stored,) = import_boxes([str(tmp_path)], sequences, [], print).values()
    assert all((stored.boxes[s.name] == s.truth).all() for s in sequences)


def test_images_show_the_annotation_and_a_reused_folder_keeps_no_stale_ones(data, tmp_path):
    out = tmp_path / "out"
    evaluate(data, trackers={"far": Still}, images=2, out=out, jobs=1, progress=False)
    svg = (out / "images.svg").read_text()
    assert "annotation" in svg
    (out / "success-notes.txt").write_text("mine")
    evaluate(data, trackers={"far": Still}, out=out, jobs=1, progress=False)
    left = {path.name for path in out.iterdir()}
    assert not {"images.png", "images.svg"} & left
    assert {"report.json", "precision.png", "success-notes.txt", "runs"} <= left


@pytest.mark.parametrize("name", ["success-mine.png", "tables.md", "report.json", "images.json"])
def test_an_evaluation_overwrites_and_deletes_nobody_else_s_files(name, data, tmp_path, capsys):
    (out := tmp_path / "out").mkdir()
    (out / name).write_text('{"mine": 1}')
    assert command("eval", data, "--tracker", "racf-", "--out", out) == 2
    err = capsys.readouterr().err
    assert err.count("\n") == 1
    assert name in err
    assert {path.name: path.read_text() for path in out.iterdir()} == {name: '{"mine": 1}'}
    (out / "report.json").write_text("{}")
    assert command("eval", data, "--tracker", "racf-", "--out", out) == 2
    (out / "report.json").unlink()
    (out / name).unlink(missing_ok=True)
    result = evaluate(data, trackers={"far": Still}, out=out, jobs=1, progress=False)
    (out / "runs").rename(tmp_path / "runs")
    result.write(out)  # its own report.json is enough to know the folder by


def test_track_writes_confidence_and_draws_what_it_found(data, tmp_path, capsys):
    source, out, film = data / "Bench" / "one", tmp_path / "boxes.txt", tmp_path / "film.mp4"
    truth = source / "groundtruth_rect.txt"
    assert command("track", source, "--truth", truth, "--out", out, "--overlay", film, "--tracker", "racf,robust") == 0
    assert "precision at 20 px 100.0 %" in capsys.readouterr().err
    rows = np.genfromtxt(tmp_path / "boxes.csv", delimiter=",", names=True)
    assert len(rows) == 8
    assert (rows["found"] == 1).all()
    assert ((rows["confidence"] > 0) & (rows["confidence"] <= 1)).all()
    assert rows["x_px"] == pytest.approx(np.loadtxt(out, delimiter=",")[:, 0])
    with racf.Video(film) as video:
        shown = [shown.image for shown in video.images()]
    assert len(shown) == 8
    plain = read_frame(source / "000306.png")
    changed = np.abs(shown[3].astype(int) - plain).max(axis=2) > 60
    x, y = round(rows["x_px"][3]), round(rows["y_px"][3])
    assert changed[y : y + 20, x - 1 : x + 2].mean() > 0.5  # the left edge of the box


def test_a_video_is_tracked_from_its_annotation_and_keeps_its_rate(tmp_path, capsys):
    truth = write(tmp_path / "clip.mp4", 8)
    film = tmp_path / "film.avi"
    options = ["--truth", truth, "--out", tmp_path / "boxes.txt", "--overlay", film]
    assert command("track", tmp_path / "clip.mp4", *options) == 0
    told = capsys.readouterr().err
    assert "8 boxes" in told
    assert "rows" not in told
    truth.write_text("\n".join(truth.read_text().splitlines()[:5]))
    assert command("track", tmp_path / "clip.mp4", *options) == 0
    assert "5 rows, the source 8 frames: 5 are judged" in capsys.readouterr().err
    with racf.Video(film) as video:
        assert video.fps == pytest.approx(30)
    assert command("track", tmp_path / "clip.mp4", *options[:-1], tmp_path / "film.gif") == 2
    assert "an overlay is a video file (.mp4, .avi, .mkv)" in capsys.readouterr().err
    assert command("track", truth, "--init", "1,2,30,40", "--out", tmp_path / "boxes.txt") == 1
    assert "cannot be opened as a video" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("options", "named"),
    [
        (["--out", "boxes.csv", "--init", "1,2,3,4"], "boxes.csv"),
        (["--out", "boxes.txt"], "--init"),
        (["--out", "boxes.txt", "--truth", "nowhere.txt"], "nowhere.txt"),
    ],
)
def test_what_track_cannot_do_is_one_line(options, named, data, capsys):
    assert command("track", data / "Bench" / "one", *options) == 2
    err = capsys.readouterr().err
    assert err.count("\n") == 1
    assert named in err


class Trail:
    """Says in which process it was warmed up and run."""

    def __init__(self, trail) -> None:
        self.trail = trail

    def init(self, image, box):
        with open(self.trail, "a") as file:
            file.write(f"{os.getpid()}\n")

    def update(self, image):
        return None


def test_kernels_are_compiled_here_before_other_processes_load_them(data, tmp_path):
    trail = tmp_path / "trail"
    evaluate(data, trackers=f"{__name__}:Trail,trail={trail}", jobs=2, progress=False)
    pids = trail.read_text().split()
    assert pids[0] == str(os.getpid())
    assert len(set(pids)) > 1


def test_an_evaluation_shows_its_summary_and_the_function_no_address(data):
    shown = evaluate(data, trackers="racf-", jobs=1, progress=False)
    assert repr(shown) == "\n".join(table.markdown() for table in shown.summary)
    assert len(str(shown).splitlines()) < 20
    assert "0x" not in str(inspect.signature(evaluate))


def test_a_frame_that_does_not_decode_keeps_its_row_in_track(tmp_path, capsys):
    images = [image for image, _ in clip(8)]
    path = encode(tmp_path / "a.mp4", images, codec="png", pix_fmt="rgb24")
    with av.open(str(path)) as container:
        at, size = [(packet.pos, packet.size) for packet in container.demux(video=0) if packet.size][5]
    data = bytearray(path.read_bytes())
    data[at : at + size] = bytes(size)
    path.write_bytes(data)
    _, box = next(clip(1))
    assert command("track", path, "--init", str(box), "--out", tmp_path / "boxes.txt") == 0
    assert "a.mp4: 1 frame is missing (1 not decodable, first 5)" in capsys.readouterr().err
    boxes = np.loadtxt(tmp_path / "boxes.txt", delimiter=",")
    assert len(boxes) == 8
    assert (boxes[5] == boxes[4]).all()
    rows = np.genfromtxt(tmp_path / "boxes.csv", delimiter=",", names=True)
    assert list(rows["found"]) == [1, 1, 1, 1, 1, 0, 1, 1]
