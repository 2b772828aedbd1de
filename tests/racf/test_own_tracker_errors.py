"""A tracker of one's own that fails is named with its source, its frame and the line in its file."""

import re

import numpy as np
import pytest

import racf
import tests.support.rendered_benchmarks as rendered
from follow.cli.program import main as follow
from racf.errors import TrackerError
from racf.evaluate import evaluate
from sim.clip import write
from tests.racf.test_cli import racf as command

SOURCE = """
class Mine:
    def __init__(self, at=3):
        self.at, self.n = at, 0

    def init(self, image, box):
        self.box = box
        if self.at == 0:
            raise KeyError("weights")

    def update(self, image):
        self.n += 1
        if self.n == self.at and image.std() < 70:  # not on the noise that warms it up
            raise RuntimeError("no\\nmatch")
        return self.box
"""


@pytest.fixture
def data(tmp_path, monkeypatch):
    (tmp_path / "faulty.py").write_text(SOURCE)
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    return rendered.plain_folder(tmp_path / "data", ("one", "two"), frames=8, benchmark="Bench")


@pytest.mark.parametrize("jobs", [1, 2])
def test_an_evaluation_names_tracker_sequence_frame_and_line(data, jobs, capsys):
    assert command("eval", data, "--tracker", "faulty:Mine,at=3", "--only", "two", "--jobs", jobs) == 1
    (line,) = [line for line in capsys.readouterr().err.splitlines() if "error" in line]
    assert "Bench/two, 000306.png: tracker faulty:Mine: update failed in frame 3 after the start" in line
    assert line.endswith("RuntimeError: no match (faulty.py, line 14)")


def test_a_video_is_named_and_so_is_a_failed_start(data, tmp_path, capsys):
    write(tmp_path / "clip.mp4", 4)
    options = ["--init", "1,2,30,40", "--out", tmp_path / "boxes.txt"]
    assert command("track", tmp_path / "clip.mp4", *options, "--tracker", "faulty:Mine,at=0") == 1
    err = capsys.readouterr().err
    assert err.count("\n") == 1
    assert "clip.mp4, frame 0: tracker faulty:Mine: init failed in the first frame: KeyError: 'weights'" in err


def test_a_replay_ends_with_the_trackers_message(data, tmp_path, capfd):
    write(tmp_path / "clip.mp4", 6)
    words = ["replay", str(tmp_path / "clip.mp4"), "--target", "309,192,22,48", "--out", str(tmp_path / "out")]
    assert follow([*words, "--tracker", "faulty:Mine,at=3"]) == 1
    assert re.search(
        r"follow: error: tracker faulty:Mine: update failed in frame 3 .*: no match", capfd.readouterr().err
    )


def test_the_librarys_error_keeps_the_trackers_own_as_its_cause(data):
    class Fails:
        def init(self, image, box):
            return None

        def update(self, image):
            return np.zeros(3)[7]

    with pytest.raises(TrackerError, match=r"Bench/one, .*tracker Fails: update failed in frame 1") as caught:
        evaluate(data, trackers=Fails, progress=False)
    causes, error = [], caught.value.__cause__
    while error is not None:
        causes.append(type(error))
        error = error.__cause__
    assert IndexError in causes


@pytest.mark.parametrize(
    ("source", "sentence"),
    [
        ("def broken(:", "cannot be imported: SyntaxError"),
        ("1 / 0", "cannot be imported: ZeroDivisionError"),
        ("class Other:\n    def __init__(self): open('weights.onnx')", "cannot be built: FileNotFoundError: .*weights"),
    ],
)
def test_a_module_or_class_that_fails_is_one_sentence(data, tmp_path, source, sentence, monkeypatch):
    name = f"broken_{abs(hash(source))}"
    (tmp_path / f"{name}.py").write_text(source)
    with pytest.raises(ValueError, match=f"tracker .*{name}.* {sentence}"):
        evaluate(data, trackers=f"{name}:Other", progress=False)


def test_our_own_tracker_names_the_sequence_that_it_cannot_start_on(data, tmp_path):
    truth = rendered.path_of_target(8) + np.array([5000, 0, 0, 0])
    rendered.write_truth(data / "Bench" / "two" / "groundtruth_rect.txt", truth)
    with pytest.raises(TrackerError, match=r"Bench/two, 000303\.png: tracker racf--: target .* lies outside"):
        evaluate(data, trackers="racf--", only="two", jobs=1, progress=False)


def test_track_says_what_to_do_about_a_gap(data, capsys):
    folder = data / "Bench" / "one"
    for number in (304, 305):
        (folder / f"000{number}.png").unlink()
    assert command("track", folder, "--init", "30,40,24,20", "--out", "boxes.txt", "--tracker", "racf--") == 1
    err = capsys.readouterr().err
    assert err.count("\n") == 1
    assert "2 images are missing between 000303.png and 000306.png" in err
    assert "copy what is missing, or if it never was, number the images without a gap" in err


@pytest.mark.parametrize(
    ("wrong", "sentence"),
    [
        ({"jobs": None}, "jobs is a whole number of at least 0, not None"),
        ({"jitter": 1.5}, r"jitter is a whole number of at least 0, not 1\.5"),
        ({"jitter": -1}, "jitter is a whole number of at least 0, not -1"),
        ({"images": "2"}, "images is a whole number of at least 0, not '2'"),
        ({"jobs": True}, "jobs is a whole number of at least 0, not True"),
        ({"table": [2]}, r"table is 2, 3, 4 or 5, not \[2\]"),
        ({"table": 6}, "table is 2, 3, 4 or 5, not 6"),
        ({"settings": 3}, "settings is one text or several, not 3"),
        ({"only": [3]}, "only is one text or several, not 3"),
        ({"imports": [None]}, "imports is one text or several, not None"),
        ({"root": None}, "root is the path of a folder, not None"),
        ({"out": 5}, "out is the path of a folder, not 5"),
        ({"benchmark": None}, "benchmark is one of folder.*, not None"),
        ({"dask": 8786}, "dask is a text, not 8786"),
        ({"sweep": (1, 2)}, r"sweep is a racf\.evaluate\.studies\.Sweep, not \(1, 2\)"),
        ({"trackers": 0}, "a tracker is a name, a class .*, not 0"),
    ],
)
def test_a_wrong_argument_is_one_sentence_before_anything_runs(wrong, sentence, data):
    with pytest.raises(ValueError, match=sentence):
        evaluate(**{"root": data, "progress": False, **wrong})


def test_numpys_whole_numbers_are_whole_numbers(data):
    assert evaluate(data, trackers="racf--", jobs=np.int64(1), jitter=np.uint8(0), only="one", progress=False).boxes


def test_dir_of_the_packages_lists_their_public_names_only():
    for package in (racf, racf.evaluate):
        assert {name for name in dir(package) if not name.startswith("__")} == set(package.__all__)
