"""The start of a flight: refusals before anything is moved, the previous recording, and Ctrl-C."""

import inspect
import json
import re
from dataclasses import replace

import pytest

from follow.cli.program import main
from follow.flight import vehicle_checks
from follow.flight.preflight import check_disk, check_time
from follow.flight.vehicle_checks import CHECKS
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


def test_a_simulation_overwrites_a_simulation_and_sets_other_recordings_aside(capfd, brief, tmp_path):
    words = ("sim", brief, "--record.no-pictures", "--out", tmp_path / "out")
    for _ in range(2):
        assert "is now in" not in follow(capfd, *words)[1]
    err = follow(capfd, *words, "--seed", 1)[1]
    assert f"is now in {tmp_path / 'out/earlier-1'}" in err
    assert json.loads((tmp_path / "out/earlier-1/summary.json").read_text())["seed"] == 0
    summary = tmp_path / "out/summary.json"
    summary.write_text(json.dumps({**json.loads(summary.read_text()), "started_utc": "2026-11-27T02:00:00Z"}))
    assert f"is now in {tmp_path / 'out/earlier-2'}" in follow(capfd, *words, "--seed", 1)[1]  # a person flew that one
    summary.unlink()  # that flight was killed: nobody knows what it was
    assert f"is now in {tmp_path / 'out/earlier-3'}" in follow(capfd, *words, "--seed", 1)[1]


def test_ctrl_c_in_a_flight_is_said_once(capfd, brief, tmp_path, monkeypatch):
    def stopped(_camera):
        raise KeyboardInterrupt

    monkeypatch.setattr("sim.camera.SceneCamera.frames", lambda camera: (stopped(camera) for _ in range(1)))
    status, err = follow(capfd, "sim", brief, "--record.no-pictures", "--out", tmp_path / "out")
    assert status == 1
    assert "stopped: everything up to here is recorded" in err
    assert "error" not in err


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (("--link", "udp:127.0.0.1:14540"), "not 'udp:127.0.0.1:14540'; did you mean udpin or udpout?"),
        (("--link", "pigeon:1:2"), "or (--link only) mavsdk+udpin://HOST:PORT, not 'pigeon:1:2'"),
        (("--link", "udpin://127.0.0.1:14540"), "a link is udpin:HOST:PORT"),
        (("--link", "udpin:127.0.0.1:70000"), "at most 65535"),
        (("--waive", "GF_MAX"), "did you mean GF_MAX_"),
        (("--waive", "batery"), "--waive batery is not a check; did you mean battery?"),
        (("--waive", "zzzz"), "zzzz is not a check; give a name that follow doctor prints in red"),
        (("--camera", "rtsp:127.0.0.1/x"), "rtsp:127.0.0.1/x"),
        (("--camera", "0?size=12x"), "size is WIDTHxHEIGHT in pixels, not '12x'"),
        (("--camera", "scene:walkr"), "there is no scenario 'walkr'; did you mean walker"),
        (("--camera", "exec:no-such-program -x"), "there is no program 'no-such-program' here"),
        (("--signing-key", "nokey"), "there is no signing key nokey"),
        (("--servo.standoff-m", "2"), "servo.standoff_m 2 lies below limits.min_standoff_m 4"),
    ],
)
def test_errors_that_need_no_vehicle_are_refused_before_anything_is_opened(capfd, tmp_path, monkeypatch, words, says):
    monkeypatch.setattr("follow.cli.run.warm_up", lambda: pytest.fail("the tracker was warmed"))
    given = {"--link": "udpin:127.0.0.1:0", "--camera": "0", "--target": "1,2,30,40", "--out": tmp_path / "out"}
    given |= dict([words])
    status, err = follow(capfd, "run", *(word for pair in given.items() for word in pair))
    assert status == 2
    assert err.count("\n") == 1
    assert says in err
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("checks", [vehicle_checks, check_disk, check_time])
def test_every_check_before_a_flight_can_be_waived_by_its_name(checks):
    found = re.findall(r'Finding\("([\w-]+)"', inspect.getsource(checks))
    assert found
    assert set(found) <= set(CHECKS)


def test_a_stand_off_below_the_gates_minimum_is_refused_until_that_is_lowered(capfd, brief, tmp_path):
    words = ("sim", brief, "--record.no-pictures", "--out", tmp_path / "out", "--servo.standoff-m", "3.5")
    status, err = follow(capfd, *words)
    assert status == 2
    assert "raise the one or lower the other" in err
    assert follow(capfd, *words, "--limits.min-standoff-m", "3")[0] == 0


def test_doctor_explains_a_scene_and_a_missing_key(capfd, tmp_path):
    _, err = follow(capfd, "doctor", "--camera", "scene:walker", "--out", tmp_path)
    assert "ok camera: a drawn scene" in err
    words = ("--link", "udpin:127.0.0.1:0", "--signing-key", tmp_path / "nokey")
    _, err = follow(capfd, "doctor", *words, "--out", tmp_path)
    assert f"red signing: there is no signing key {tmp_path / 'nokey'}: head -c 32" in err
    assert "; the link is not checked" in err


def test_the_version_is_printed(capfd):
    with pytest.raises(SystemExit) as stop:
        main(["--version"])
    assert stop.value.code == 0
    assert capfd.readouterr().out.startswith("follow 0.")
