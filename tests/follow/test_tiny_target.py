"""Commands report a target with too few pixels once, with its size, wherever a person starts to follow or track."""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from follow.cli.program import main
from follow.control.acquire import Acquire
from follow.messages import Autopilot
from racf import cli as racf_cli
from racf.box import CLEAR_PX, Box, tiny_line
from racf.track import Track
from sim.clip import write
from sim.scenarios import SCENARIOS
from tests.support.fault_rig import Rig

SAID = "the target is only "


@pytest.fixture(scope="module")
def footage(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("clip") / "clip.mp4"
    write(path, 8)
    return path


def follow(capfd, *words: object) -> str:
    status = main([str(word) for word in words])
    err = " ".join(capfd.readouterr().err.split())
    assert status == 0, err
    return err


@pytest.mark.parametrize(("w", "h", "said"), [(9.975, 24.15, "9x24"), (1200, 8.6, "1200x9"), (10, 10, "")])
def test_the_warning_names_thing_value_rule_and_remedy_and_only_below_the_bound(w, h, said):
    line = tiny_line(Box(5, 5, w, h))
    assert bool(line) == bool(said)
    if said:
        assert line.startswith(f"{SAID}{said} pixels; it needs at least {CLEAR_PX:g} on each side")
        assert "go closer" in line


def test_a_replay_warns_once(capfd, footage, tmp_path):
    words = ("replay", footage, "--out", tmp_path, "--record.no-pictures", "--target")
    assert follow(capfd, *words, "318,219,8,22").count(f"0.0 s: {SAID}8x22 pixels") == 1
    assert SAID not in follow(capfd, *words, "309,192,22,48")


def test_a_replay_warns_also_of_a_target_that_is_never_found(capfd, footage, tmp_path):
    assert (
        main(["replay", str(footage), "--out", str(tmp_path), "--record.no-pictures", "--target", "318,219,2,3"]) == 1
    )
    lines = capfd.readouterr().err.splitlines()
    assert [n for n, line in enumerate(lines) if SAID in line] == [0]
    assert lines[0].startswith(f"0.0 s: {SAID}2x3 pixels; it needs at least 10 on each side")
    assert not [line for line in lines if "refused" in line or "no setpoint came" in line], "the order was void"


def test_a_simulation_warns_once(capfd, tmp_path, monkeypatch):
    monkeypatch.setitem(SCENARIOS, "brief", replace(SCENARIOS["walker"], name="brief", duration_s=0.7))
    words = ("sim", "brief", "--out", tmp_path, "--record.no-pictures", "--camera.fov-deg")
    assert follow(capfd, *words, 140).count(SAID) == 1
    assert SAID not in follow(capfd, *words, 80)


@pytest.mark.parametrize("tiny_from", [0, 40, None])
def test_a_live_flight_warns_once_at_its_start_or_when_the_target_becomes_tiny(tiny_from):
    rig = Rig(Autopilot.PX4, lambda _rig: None, fault_t_s=99.0, end_t_s=4.0)
    seen = 0

    def track(_image: np.ndarray, _prior: Box | None) -> Track:
        nonlocal seen
        w = 8.5 if tiny_from is not None and seen >= tiny_from else 20.0
        box, seen = Box.around(320, 180, w, 50), seen + 1
        return Track(box, box.scaled(3), 15.0, 60.0, 1.0)

    rig.update = Acquire(lambda image, _box: track(image, None), track, Box(310, 150, 20, 60)).update
    rig.fly()
    told = [line for line in rig.lines if SAID in line]
    assert len(told) == (tiny_from is not None), rig.lines
    if told:
        assert told[0].endswith("higher resolution")
        assert told[0].startswith("0.0 s:") == (tiny_from == 0)


def test_a_lost_targets_box_causes_no_warning():
    rig = Rig(Autopilot.PX4, lambda _rig: None, fault_t_s=99.0, end_t_s=2.0)
    box = Box(310, 150, 5, 5)
    rig.update = lambda _image, _prior=None: Track(box, box.scaled(3), 2.0, 5.0, 0.0, found=False)
    rig.fly()
    assert rig.lines
    assert not [line for line in rig.lines if SAID in line]


@pytest.mark.parametrize(("start", "told"), [("318,219,8,22", f"frame 0: {SAID}8x22 pixels"), ("309,192,22,48", "")])
def test_racf_track_warns_once(capfd, footage, tmp_path, monkeypatch, start, told):
    words = ["racf", "track", footage, "--init", start, "--out", tmp_path / "boxes.txt", "--tracker", "racf-"]
    monkeypatch.setattr(sys, "argv", [str(word) for word in words])
    with pytest.raises(SystemExit) as stop:
        racf_cli.main()
    err = capfd.readouterr().err
    assert not stop.value.code, err
    assert err.count(SAID) == bool(told)
    assert err.startswith(told)


def test_racf_track_names_the_frame_in_which_the_target_becomes_tiny(capfd, footage, tmp_path, monkeypatch):
    class Shrinking:
        def init(self, _image, box):
            self.box = box
            return Track(box, box, 15.0, 60.0, 1.0)

        def update(self, _image):
            self.box = self.box.scaled(0.8)
            return Track(self.box, self.box, 15.0, 60.0, 1.0)

    monkeypatch.setattr("racf.evaluate.trackers.TrackerSpec.build", lambda _spec: Shrinking())
    words = ["racf", "track", footage, "--init", "309,192,22,48", "--out", tmp_path / "boxes.txt"]
    monkeypatch.setattr(sys, "argv", [str(word) for word in words])
    with pytest.raises(SystemExit):
        racf_cli.main()
    err = capfd.readouterr().err
    assert err.count(SAID) == 1
    assert f"frame 4: {SAID}9x20 pixels" in err
