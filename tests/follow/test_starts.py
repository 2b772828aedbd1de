"""What the start of a flight refuses before anything is moved, keeps of the last one, and says when it is stopped."""

import json
from dataclasses import replace

import pytest

from follow.cli.program import main
from sim.clip import write
from sim.scenarios import SCENARIOS


def follow(capfd, *words: object) -> tuple[int, str]:
    """Exit status and standard error."""
    status = main([str(word) for word in words])
    return status, capfd.readouterr().err


@pytest.fixture
def brief(monkeypatch) -> str:
    """A scenario of half a second."""
    monkeypatch.setitem(SCENARIOS, "brief", replace(SCENARIOS["walker"], name="brief", duration_s=0.5))
    return "brief"


@pytest.mark.parametrize(("box", "says"), [("900,1,22,48", "lies outside"), ("0,0,640,360", "some background")])
def test_a_replay_with_a_box_that_cannot_start_moves_no_recording(capfd, tmp_path, box, says):
    write(tmp_path / "clip.mp4", 6)
    words = ("replay", tmp_path / "clip.mp4", "--record.no-pictures", "--out", tmp_path / "out", "--target")
    assert follow(capfd, *words, "309,192,22,48")[0] == 0
    before = {path.name: path.read_bytes() for path in (tmp_path / "out").iterdir()}
    status, err = follow(capfd, *words, box)
    assert status == 2
    assert err.count("\n") == 1
    assert says in err
    assert {path.name: path.read_bytes() for path in (tmp_path / "out").iterdir()} == before


def test_a_simulation_writes_over_itself_and_moves_any_other(capfd, brief, tmp_path):
    words = ("sim", brief, "--record.no-pictures", "--out", tmp_path / "out")
    for _ in range(2):
        assert "is now in" not in follow(capfd, *words)[1]
    err = follow(capfd, *words, "--seed", 1)[1]
    assert f"is now in {tmp_path / 'out/earlier-1'}" in err
    assert json.loads((tmp_path / "out/earlier-1/summary.json").read_text())["seed"] == 0
    (tmp_path / "out/summary.json").unlink()  # that flight was killed: nobody knows what it was
    assert f"is now in {tmp_path / 'out/earlier-2'}" in follow(capfd, *words, "--seed", 1)[1]


def test_ctrl_c_in_a_flight_is_said_once(capfd, brief, tmp_path, monkeypatch):
    def stopped(_camera):
        raise KeyboardInterrupt

    monkeypatch.setattr("sim.camera.SceneCamera.frames", lambda camera: (stopped(camera) for _ in range(1)))
    status, err = follow(capfd, "sim", brief, "--record.no-pictures", "--out", tmp_path / "out")
    assert status == 1
    assert "stopped by Ctrl-C: everything up to here is recorded" in err
    assert "error" not in err
