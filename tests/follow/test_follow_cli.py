"""`follow` from the command line: exit statuses, one-line errors, nothing but the summary on standard output."""

import json
import math
import os
import pty
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import cv2
import pytest

from follow.cli import replay as cli_replay
from follow.cli import run as cli_run
from follow.cli.program import main
from follow.cli.settings import read_settings, tomllib
from follow.config import Config
from follow.link import connection
from follow.messages import Autopilot
from follow.operator.terminal import listed, result
from follow.recording.exact import read_said
from follow.recording.folder import FILES
from follow.safety.limits import Limits
from sim.clip import clip, write
from sim.scenarios import SCENARIOS

DATA = Path(os.environ.get("RACF_DATA", "../shared/data"))
STILL = ("--servo.yaw.kp", "0", "--servo.climb.kp", "0", "--servo.feed-forward", "0")


@pytest.fixture(scope="module")
def footage(tmp_path_factory) -> Path:
    """Thirty frames as a video, and the walker's true boxes beside it."""
    path = tmp_path_factory.mktemp("clip") / "clip.mp4"
    write(path, 30)
    return path


def follow(capfd, *words: object) -> tuple[int, str, str]:
    status = main([str(word) for word in words])
    out, err = capfd.readouterr()
    return status, out, err


def replay(capfd, footage: Path, out: Path, *more: object) -> tuple[int, str, str]:
    truth = footage.with_suffix(".txt")
    return follow(capfd, "replay", footage, "--truth", truth, "--out", out, "--json", *more)


def lines_of(out: Path) -> int:
    return len((out / "ticks.csv").read_text().splitlines()) - 1


def test_replay_prints_its_summary_and_nothing_else(capfd, footage, tmp_path):
    status, out, err = replay(capfd, footage, tmp_path)
    assert status == 0, err
    summary = json.loads(out)
    assert summary == json.loads((tmp_path / "summary.json").read_text())
    assert summary["frames"] == summary["setpoints"] == lines_of(tmp_path) == 30
    assert summary["precision_20px"] == summary["precision_20px_strict"] == 100.0
    assert 50 < summary["auc"] <= 100
    assert set(summary["tick_ms"]) == set(summary["tracker_ms"]) == {"p50", "p99", "max"}
    assert f"follow inspect {tmp_path}" in " ".join(err.split())
    assert err.count(" s: follow (FOLLOW began), vehicle in OFFBOARD") == 1
    written = err + (tmp_path / "ticks.csv").read_text() + str(read_said(tmp_path / "messages.jsonl.gz"))
    assert "autopilot" not in written, "there is none in a replay"
    rerun = Path(sys.executable).with_name("rerun")
    subprocess.run([rerun, "rrd", "verify", tmp_path / "flight.rrd"], check=True, capture_output=True, timeout=60)


def test_replay_twice_gives_the_same_bytes(capfd, footage, tmp_path):
    for name in ("a", "b"):
        assert replay(capfd, footage, tmp_path / name)[0] == 0
    assert (tmp_path / "a" / "ticks.csv").read_bytes() == (tmp_path / "b" / "ticks.csv").read_bytes()


def test_a_replay_moves_an_earlier_recording_aside(capfd, footage, tmp_path):
    for _ in range(2):
        status, _, err = replay(capfd, footage, tmp_path, "--record.no-pictures")
        assert status == 0, err
    assert f"the flight that was in {tmp_path} is now in {tmp_path / 'earlier-1'}" in err
    assert (tmp_path / "earlier-1/ticks.csv").read_bytes() == (tmp_path / "ticks.csv").read_bytes()


def test_figures_for_a_person_have_four_digits_and_nothing_is_called_none():
    figures = {
        "seconds": 12345.678,
        "in_view": 0.923416,
        "modes": {"follow": 30.000001},
        "violations": {},
        "frames": 90123,
    }
    told = [line.split(maxsplit=1)[1] for line in listed(figures).splitlines()]
    assert told == ["12346", "0.9234", "follow 30", "none", "90123"]


def test_a_folder_with_a_gap_and_a_broken_image_is_flown_to_its_end(capfd, tmp_path):
    frames = tmp_path / "frames"
    frames.mkdir()
    for n, (image, box) in enumerate(clip(20)):
        if n == 0:
            start = str(box)
        if n not in (7, 8):
            cv2.imwrite(str(frames / f"{n:04d}.jpg"), image)
    (frames / "0012.jpg").write_bytes(b"\xff\xd8 not a frame")
    status, out, err = follow(capfd, "replay", frames, "--target", start, "--out", tmp_path / "out", "--json")
    assert status == 0
    assert json.loads(out)["frames"] == 17
    assert lines_of(tmp_path / "out") == 20
    told = [line for line in err.splitlines() if "vehicle in" not in line]
    assert len(told) == 2
    assert "frames: 3 frames are missing (2 not there, 1 not decodable, first before 0009.jpg)" in err


def test_ctrl_c_writes_everything_up_to_there(capfd, footage, tmp_path, monkeypatch):
    class Stopped:
        """Footage during which a person presses Ctrl-C."""

        def __init__(self, source, fps, report, shrink):
            self._footage = open_replay(source, fps, report, shrink)
            self.fps, self.rounds, self.size = self._footage.fps, self._footage.rounds, self._footage.size
            self.t_s, self.scale = 0.0, self._footage.scale

        def frames(self):
            for frame in self._footage.frames():
                if frame.index == 12:
                    raise KeyboardInterrupt
                self.t_s = frame.t_s
                yield frame

        def __enter__(self):
            return self

        def __exit__(self, *error):
            self._footage.close()

    open_replay = cli_replay.open_replay
    monkeypatch.setattr(cli_replay, "open_replay", Stopped)
    status, out, err = replay(capfd, footage, tmp_path)
    assert status == 1
    assert json.loads(out)["frames"] == lines_of(tmp_path) == 12
    assert "everything up to here is recorded" in err
    assert "annotated rows" in err


@pytest.mark.parametrize(
    ("words", "status", "names"),
    [
        (("replay", "nothing.mp4", "--target", "1,2,3,4"), 2, "nothing.mp4"),
        (("replay", "nothing.mp4"), 2, "--target x,y,w,h (0-based pixels) or --truth FILE (1-based pixels)"),
        (("replay", "nothing.mp4", "--target", "1,2,3"), 2, "0-based pixels): a box is written x,y,w,h, not '1,2,3'"),
        (("replay", "0", "--target", "1,2,3,4"), 2, "follow run"),
        (("replay", "x", "--target", "1,2,3,4", "--limits.speed-m-s", "-1"), 2, "speed"),
        (("replay",), 2, "SOURCE"),
        (("fly",), 2, "there is no command 'fly'; the commands are replay, sim, run, doctor, inspect"),
        (("sim", "brief", "twice"), 2, "'twice'"),
        (("sim", "--camera.fov", "30"), 2, "there is no option --camera.fov; the nearest is --camera.fov-deg"),
        (("sim", "--camera.fov-deg", "abc"), 2, "--camera.fov-deg must be a number, not 'abc'"),
        (("sim", "--seed", "1.5"), 2, "--seed must be a whole number, not '1.5'"),
        (("sim", "--autopilot", "pixhawk"), 2, "--autopilot must be one of ardupilot, px4, not 'pixhawk'"),
        (("replay", "x", "--truth", "."), 2, "--truth must be a file of annotations, x,y,w,h in 1-based pixels"),
        (("sim", "--out", __file__), 2, f"--out {__file__!r} must be a folder that can be written: it is a file"),
        (("doctor", "--link", "udpin:127.0.0.1:0", "--out", __file__), 2, f"--out {__file__!r} must be a folder"),
        (("sim", "--tracker", "racff"), 2, "there is no tracker 'racff'; did you mean racf"),
        ((), 2, "replay"),
        (("sim", "--seed", "-1"), 2, "--seed"),
        (("sim", "--all", "--seeds", "0"), 2, "--seeds"),
        (("sim", "walker", "--seeds", "3"), 2, "--seeds needs --all"),
        (("run", "--link", "udpin:127.0.0.1:0"), 2, "--target"),
        (("run", "--link", "udpin:127.0.0.1:0", "--target", "1,2,3"), 2, "1,2,3"),
        (("run", "--link", "udpin:127.0.0.1:0", "--camera", "scene:nowhere"), 2, "nowhere"),
        (
            ("run", "--link", "udpin:127.0.0.1:0", "--camera", "/dev/video97", "--target", "1,2,30,40"),
            2,
            "/dev/video97",
        ),
        (("run", "--link", "udpin:127.0.0.1:0", "--rc-channel", "0"), 2, "--rc-channel"),
        (("run", "--link", "udpin:127.0.0.1:0", "--seconds", "nan"), 2, "--seconds"),
        (("doctor", "--system-id", "256"), 2, "--system-id"),
        (("sim", "nowhere"), 2, "nowhere"),
        (("inspect", "nowhere"), 2, "nowhere"),
        (("inspect", __file__), 2, "not a recording"),
    ],
)
def test_an_error_is_one_line_that_names_the_thing(capfd, words, status, names, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    got, out, err = follow(capfd, *words)
    assert (got, out) == (status, "")
    assert err.count("\n") == 1
    assert names.lower() in err.lower()


def test_an_unknown_tracker_and_a_box_outside_are_refused(capfd, footage, tmp_path):
    words = ("replay", footage, "--out", tmp_path)
    assert follow(capfd, *words, "--target", "1,2,3,4", "--tracker", "nonsense")[0] == 2
    status, _, err = follow(capfd, *words, "--target", "9000,9000,10,10")
    assert status == 2
    assert "9000" in err


def test_inspect_without_a_display_says_what_to_do(capfd, tmp_path, monkeypatch):
    (tmp_path / "flight.rrd").write_bytes(b"")
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(sys, "platform", "linux")
    status, _, err = follow(capfd, "inspect", tmp_path)
    assert status == 1
    assert "no display" in err
    assert ":9090/?url=rerun%2Bhttp%3A//" in err, "without it the page shows no recording"
    assert "rerun flight.rrd" in err


@pytest.fixture
def brief(monkeypatch) -> str:
    """A scenario of a second and a half."""
    monkeypatch.setitem(SCENARIOS, "brief", replace(SCENARIOS["walker"], name="brief", duration_s=1.5))
    return "brief"


def test_the_same_scenario_and_seed_twice_gives_the_same_bytes(capfd, brief, tmp_path):
    for name in ("a", "b"):
        status, out, err = follow(capfd, "sim", brief, "--seed", 3, "--out", tmp_path / name, "--json")
        assert status == 0, err
        summary = json.loads(out)
    assert (tmp_path / "a/ticks.csv").read_bytes() == (tmp_path / "b/ticks.csv").read_bytes()
    assert summary["in_view"] == 1.0
    assert summary["violations"] == {}
    assert (summary["scenario"], summary["seed"], summary["autopilot"]) == ("brief", 3, "px4")
    assert (tmp_path / "a/flight.png").stat().st_size > 10_000
    assert "flight.png" in err.split("recorded in")[1]


def test_the_settings_flown_with_are_recorded_and_fly_the_same_again(capfd, brief, tmp_path):
    chosen = tmp_path / "mine.toml"
    chosen.write_text("[servo]\nstandoff_m = 20.0\n[record]\npictures = false\n")
    words = ("sim", brief, "--limits.speed-m-s", "3", "--settings")
    assert follow(capfd, *words, chosen, "--out", tmp_path / "a")[0] == 0
    flown = read_settings(tmp_path / "a/settings.toml")
    assert (flown.servo.standoff_m, flown.limits.speed_m_s) == (20.0, 3.0)
    assert flown.target.size_m == Config().target.size_m != SCENARIOS[brief].size_m  # the scene's, which nobody chose
    words = ("sim", brief, "--settings", tmp_path / "a/settings.toml", "--out", tmp_path / "b")
    assert follow(capfd, *words)[0] == 0
    for name in ("settings.toml", "ticks.csv"):
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes()
    assert not (tmp_path / "b/flight.rrd").exists()


def test_a_recorded_file_flown_with_another_lens_and_delay_pins_nothing_that_follows_from_them(capfd, brief, tmp_path):
    """Derived settings are recorded but not chosen: the gate's view cone and delay are those of the new camera."""
    first, other = tmp_path / "first/settings.toml", tmp_path / "other/settings.toml"
    words = ("sim", brief, "--record.no-pictures", "--out")
    assert follow(capfd, *words, first.parent)[0] == 0
    told = tomllib.loads(first.read_text())["derived"]
    assert set(told) == {"camera", "target", "servo", "limits"}
    assert told["limits"]["half_view_rad"] == pytest.approx(SCENARIOS[brief].fov_rad / 2)
    camera = ("--camera.fov-deg", "120", "--camera.delay-s", "0.2", "--autopilot", "ardupilot")
    assert follow(capfd, *words, other.parent, "--settings", first, *camera)[0] == 0
    told = tomllib.loads(other.read_text())["derived"]
    mount = SCENARIOS[brief].camera_settings(Autopilot.ARDUPILOT)
    assert told["limits"]["half_view_rad"] == pytest.approx(math.radians(60))
    assert told["limits"]["latency_s"] == 0.2
    assert told["camera"]["down_deg"] == pytest.approx(math.degrees(mount.down_rad))


def test_a_target_outside_the_first_image_leaves_no_folder_and_the_message_says_what_helps(capfd, brief, tmp_path):
    status, out, err = follow(capfd, "sim", brief, "--camera.down-deg", "-30", "--out", tmp_path / "out")
    assert (status, out) == (1, "")
    assert "raise camera.down_deg only with a smaller servo.standoff_m" in err
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("command", ["sim", "replay"])
def test_a_refused_start_leaves_the_last_flight_as_it_is(capfd, brief, footage, tmp_path, command):
    what = (brief,) if command == "sim" else (footage, "--target", "309,192,22,48")
    words = (command, *what, "--record.no-pictures", "--out", tmp_path / "out")
    assert follow(capfd, *words)[0] == 0
    before = {path.name: path.read_bytes() for path in (tmp_path / "out").iterdir()}
    assert follow(capfd, *words, "--tracker", "rafc")[0] == 2
    assert {path.name: path.read_bytes() for path in (tmp_path / "out").iterdir()} == before


@pytest.mark.parametrize("command", ["sim", "replay"])
def test_a_live_flights_recording_is_not_written_over(capfd, brief, footage, tmp_path, command):
    for name in ("flight.tlog", "ticks.csv"):
        (tmp_path / name).write_text(f"a live flight's {name}")
    what = (brief,) if command == "sim" else (footage, "--target", "309,192,22,48")
    status, _, err = follow(capfd, command, *what, "--record.no-pictures", "--out", tmp_path)
    assert status == 0
    assert f"the flight that was in {tmp_path} is now in {tmp_path / 'earlier-1'}" in err
    assert (tmp_path / "earlier-1/ticks.csv").read_text() == "a live flight's ticks.csv"
    assert not (tmp_path / "flight.tlog").exists()


def test_settings_of_the_user_override_those_of_the_scenario(capfd, brief, tmp_path):
    words = ("sim", brief, "--out", tmp_path, "--json", "--servo.standoff-m", "20", "--record.no-pictures")
    status, out, err = follow(capfd, *words)
    assert status == 0, err
    assert json.loads(out)["standoff_rms_m"] > 5  # it starts 9 m behind
    assert not (tmp_path / "flight.rrd").exists()


def test_a_limit_given_by_the_user_counts_although_it_equals_the_default(capfd, brief, tmp_path, monkeypatch):
    monkeypatch.setitem(SCENARIOS, brief, replace(SCENARIOS[brief], limits={"speed_m_s": 12.0, "fence_m": 600.0}))
    mine = tmp_path / "mine.toml"
    mine.write_text(f"[limits]\nfence_m = {Limits().fence_m}\n")
    typed = ("--limits.speed-m-s", Limits().speed_m_s, "--settings", mine)
    for words, wanted in (((), (12.0, 600.0)), (typed, (Limits().speed_m_s, Limits().fence_m))):
        status, _, err = follow(capfd, "sim", brief, "--out", tmp_path, "--json", "--record.no-pictures", *words)
        assert status == 0, err
        recorded = tomllib.loads((tmp_path / "settings.toml").read_text())
        limits = {**recorded["limits"], **recorded["derived"]["limits"]}  # what only the scene gave is derived
        assert (limits["speed_m_s"], limits["fence_m"]) == wanted


def test_more_images_than_annotated_rows_are_reported(capfd, footage, tmp_path):
    truth = footage.with_suffix(".txt")
    short = tmp_path / "short.txt"
    short.write_text("".join(truth.read_text().splitlines(keepends=True)[:5]))
    status, _, err = follow(capfd, "replay", footage, "--truth", short, "--out", tmp_path, "--record.no-pictures")
    assert status == 0
    assert "but 5 annotated rows" in err


def test_an_annotation_file_that_is_no_text_is_named(capfd, footage, tmp_path):
    status, _, err = follow(capfd, "replay", footage, "--truth", footage, "--out", tmp_path)
    assert status == 1
    assert str(footage) in err
    assert err.count("\n") == 1


def ptz_in_view(capfd, source: Path, truth: Path, out: Path, *more: str) -> float:
    words = ("replay", source, "--truth", truth, "--ptz", "--out", out, "--json", "--record.no-pictures", *more)
    status, stdout, err = follow(capfd, *words)
    assert status == 0, err
    return json.loads(stdout)["in_view"]


def test_the_virtual_camera_keeps_a_target_in_view_only_by_good_control(capfd, tmp_path):
    path = tmp_path / "clip.mp4"
    truth = write(path, 110)
    assert ptz_in_view(capfd, path, truth, tmp_path / "good") >= 0.95
    assert ptz_in_view(capfd, path, truth, tmp_path / "still", *STILL) < 0.8


def test_the_virtual_camera_keeps_a_real_building_in_view_only_by_good_control(capfd, tmp_path):
    folder = DATA / "UAV123_10fps" / "building5"
    if not folder.is_dir():
        pytest.skip(f"{folder} is not there; set RACF_DATA")
    truth = folder / "groundtruth_rect.txt"
    assert ptz_in_view(capfd, folder, truth, tmp_path / "good") >= 0.95
    assert ptz_in_view(capfd, folder, truth, tmp_path / "still", *STILL) < 0.8


def test_a_terminal_that_was_closed_is_no_failure(monkeypatch):
    ours, theirs = pty.openpty()
    with open(theirs, "w") as closed:
        os.close(ours)
        monkeypatch.setattr("sys.stdout", closed)
        for as_json in (False, True):
            result({"frames": 3}, as_json=as_json)


def test_a_refused_start_keeps_the_last_flight_and_names_what_it_waits_for(capfd, tmp_path, monkeypatch):
    monkeypatch.setattr(cli_run, "VEHICLE_S", 0.3)
    monkeypatch.setattr(connection, "WAITING_EVERY_S", 0.1)
    left = {name: f"the last flight's {name}" for name in FILES}
    for name, text in left.items():
        (tmp_path / name).write_text(text)
    words = ("run", "--link", "udpin:127.0.0.1:0", "--camera", "scene:walker", "--out", tmp_path)
    status, _, err = follow(capfd, *words)
    assert status == 1
    assert {path.name: path.read_text() for path in tmp_path.iterdir()} == left
    assert "waiting up to 0.3 s for a vehicle on udpin:127.0.0.1:0" in err
    assert "waiting: no heartbeat of a PX4 or ArduPilot multirotor and no attitude and no local position yet" in err
    assert err.splitlines()[-1].startswith("follow: error: no heartbeat")


@pytest.mark.parametrize(
    ("more", "said"),
    [
        (
            ("--camera.down-deg", "5"),
            "camera.down_deg 5 (in degrees) and servo.standoff_m 12 mean 1.0 m above the target",
        ),
        (
            ("--camera.down-deg", "75", "--servo.standoff-m", "40"),
            "149.3 m above the target, above limits.ceiling_m 100",
        ),
    ],
)
def test_a_stand_off_that_contradicts_the_altitude_band_is_refused_before_anything_is_opened(capfd, more, said):
    status, _, err = follow(capfd, "run", "--link", "udpin:127.0.0.1:0", "--target", "1,2,3,4", *more)
    assert status == 2
    assert said in err
    assert err.count("\n") == 1
