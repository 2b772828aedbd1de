"""The examples of the tracker's library run as they are written."""

import json
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import tests.support.rendered_benchmarks as rendered
from sim.clip import write
from tests.racf.test_cli import racf

EXAMPLES = Path(__file__).parents[2] / "examples"


def example(name: str, *argv: object) -> str:
    """Standard output of an example."""
    command = [sys.executable, str(EXAMPLES / name), *map(str, argv)]
    return subprocess.run(command, capture_output=True, text=True, check=True, timeout=120).stdout


def test_a_video_is_tracked_in_ten_lines(tmp_path):
    truth = np.loadtxt(write(tmp_path / "clip.mp4", 12), delimiter=",")
    x, y, w, h = truth[0] - [1, 1, 0, 0]
    lines = example("track_video.py", tmp_path / "clip.mp4", f"{x},{y},{w},{h}").splitlines()
    assert len(lines) == 11
    assert all(line.endswith("found") for line in lines)
    last = [float(v) for v in lines[-1].split()[1].split(",")]
    assert np.abs(np.array(last[:2]) - (truth[-1, :2] - 1)).max() < 5
    code = (EXAMPLES / "track_video.py").read_text().partition("import racf\n")[2]
    assert len([line for line in code.splitlines() if line]) <= 10


def test_a_tracker_of_ones_own_is_evaluated_beside_ours(tmp_path, monkeypatch, capsys):
    data = rendered.plain_folder(tmp_path / "data", ("one", "two"))
    shown = example("evaluate_own_tracker.py", data)
    assert re.search(r"\| Template \| 100\.00", shown)
    assert "## Difference to Template" in shown
    monkeypatch.chdir(EXAMPLES.parent)
    assert (
        racf("eval", data, "--tracker", "examples.evaluate_own_tracker:Template,margin=20", "--json", "--jobs", 1) == 0
    )
    (figures,) = json.loads(capsys.readouterr().out).values()
    assert figures["precision_20px"] == 100.0


@pytest.mark.parametrize(
    ("name", "argv", "says"),
    [
        ("track_video.py", (), "usage: track_video.py VIDEO x,y,w,h"),
        ("track_video.py", ("nowhere.mp4", "1,2,3,4"), "track_video.py: nowhere.mp4 is not a file"),
        ("track_video.py", ("CLIP", "550,232,41"), "track_video.py: a box is written x,y,w,h, not '550,232,41'"),
        ("evaluate_own_tracker.py", ("nowhere",), "nowhere is not a folder"),
        ("select_with_mavsdk.py", ("udpout://127.0.0.1:1", "middle,middle"), "usage: select_with_mavsdk.py URL x,y"),
        ("evaluate_own_tracker.py", (), "usage: evaluate_own_tracker.py DATA"),
        ("read_a_recording.py", ("nowhere",), "there is no nowhere/ticks.csv"),
    ],
)
def test_an_example_with_a_wrong_argument_says_so_in_its_last_line(name, argv, says, tmp_path):
    if "CLIP" in argv:
        write(tmp_path / "clip.mp4", 2)
    command = [sys.executable, str(EXAMPLES / name), *(word.replace("CLIP", f"{tmp_path}/clip.mp4") for word in argv)]
    ended = subprocess.run(command, capture_output=True, text=True, check=False, timeout=120)
    assert ended.returncode == 1
    assert says in ended.stderr.splitlines()[-1]
    assert "Traceback" not in ended.stderr
