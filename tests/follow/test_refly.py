"""A recorded flight flows through estimate, servo and gate again, to the last bit; others are compared with it."""

import csv
import gzip
import json
import math
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from follow.camera.calibration import as_opencv_yaml
from follow.cli.program import main
from follow.geometry import Intrinsics, LensModel
from follow.messages import Cause, ImageMotion, Instruction, Landed, Order, Reason, VehicleState
from follow.recording.exact import ExactWriter, Setup, plain, read_exact, revive
from follow.recording.flight_table import FlightTable
from sim.clip import write
from sim.scenarios import SCENARIOS
from tests.follow.test_calibration import FIT
from tests.follow.test_record_flight import silent, tick
from tests.support.real_flight import real_flight

floats = st.floats(width=64)
states = st.builds(
    VehicleState,
    floats,
    north_m=floats,
    above_home_t_s=floats,
    landed=st.sampled_from(Landed),
    rc_healthy=st.sampled_from([None, True, False]),
    refusal=st.text(),
)
SETUP = Setup(Intrinsics(64, 36, 50.1, 50.2, 32.0, 18.0, (0.1, 0.2, 0.3, 0.4), LensModel.FISHEYE), 0.1, "a = 1\n", True)


def follow(capfd, *words: object) -> tuple[int, str, str]:
    status = main([str(word) for word in words])
    out, err = capfd.readouterr()
    return status, out, err


def same(a: object, b: object) -> bool:
    return repr(a) == repr(b)  # NaN is not equal to itself; repr tells every two numbers apart


@given(states, st.tuples(floats, floats), st.sampled_from(Cause), st.text())
def test_a_message_reads_back_to_the_last_bit(state, pair, cause, what):
    for message in (
        state,
        ImageMotion(0.1, 0.2, 30, *[1 / 3] * 6, box_seen_px=pair),
        Instruction(Order.LEAVE, Reason(cause, what, 0.1), what, aimed=True),
        SETUP,
    ):
        assert same(revive(type(message), json.loads(json.dumps(plain(message)))), message)


def recorded(folder: Path, count: int) -> list:
    folder.mkdir(exist_ok=True)
    ticks = [replace(tick(n), motion=ImageMotion(0, n / 7, *[n / 3] * 7) if n % 2 else None) for n in range(count)]
    ticks[3] = replace(ticks[3], frame=None, track=None, instruction=Instruction(Order.FOLLOW))
    writer = ExactWriter(folder / "messages.jsonl.gz", SETUP, silent)
    for t in ticks:
        writer.add(t, None, None)
    writer.message(1.5, "a line, with ümläuts")
    writer.close()
    return ticks


def test_a_recording_reads_back_every_message(tmp_path):
    ticks = recorded(tmp_path, 20)
    flight = read_exact(tmp_path / "messages.jsonl.gz")
    assert flight.setup == SETUP
    assert [r.state for r in flight.rounds] == [t.state for t in ticks]
    assert [r.motion for r in flight.rounds] == [t.motion for t in ticks]
    assert [r.instruction for r in flight.rounds] == [t.instruction for t in ticks]
    assert [r.frame for r in flight.rounds] == [t.frame and (t.frame.t_s, t.frame.index) for t in ticks]
    assert [r.track and r.track.box for r in flight.rounds] == [t.track and t.track.box for t in ticks]


def test_a_recording_that_ends_anywhere_reads_to_there(tmp_path):
    recorded(tmp_path, 60)
    whole = (tmp_path / "messages.jsonl.gz").read_bytes()
    before = 0
    for length in range(len(whole) // 3, len(whole), len(whole) // 12):
        (tmp_path / "cut.gz").write_bytes(whole[:length])
        rounds = len(read_exact(tmp_path / "cut.gz").rounds)
        assert before <= rounds <= 60
        before = rounds
    assert before > 30


def test_what_a_power_cut_leaves_behind_the_last_flush_is_left_out(tmp_path):
    recorded(tmp_path, 60)
    whole = (tmp_path / "messages.jsonl.gz").read_bytes()
    flushed = whole.rfind(bytes((0, 0, 0xFF, 0xFF))) + 4  # zlib's mark of a flush
    (tmp_path / "cut.gz").write_bytes(whole[:flushed] + bytes(4096))
    assert len(read_exact(tmp_path / "cut.gz").rounds) > 30


@pytest.mark.parametrize(
    ("content", "rule"),
    [
        (b"", "holds nothing: the flight broke off"),
        (b"plain text", "not a gzip file"),
        (gzip.compress(b"[1]\n"), "not a JSON object"),
        (gzip.compress(b'{"version":7}\n'), "not a recording of version"),
        (gzip.compress(b'{"version":1,"setup":{}}\n'), "setup cannot be read"),
        (gzip.compress(b"no json\n"), "cannot be read"),
    ],
    ids=["empty", "plain text", "a list", "another version", "no setup", "no JSON"],
)
def test_a_file_that_is_no_recording_is_refused_in_one_line(capfd, tmp_path, content, rule):
    (tmp_path / "messages.jsonl.gz").write_bytes(content)
    status, _, err = follow(capfd, "refly", tmp_path)
    assert status == 2
    assert "cannot be read" in err
    assert rule in err or rule == "cannot be read"
    assert len(err.strip().splitlines()) == 1


@pytest.fixture
def brief(monkeypatch) -> str:
    monkeypatch.setitem(SCENARIOS, "brief", replace(SCENARIOS["wall"], duration_s=2.0))
    return "brief"


def test_a_simulated_flight_flown_again_is_equal_to_the_last_bit_and_others_are_compared(capfd, brief, tmp_path):
    first, again, other = tmp_path / "first", tmp_path / "again", tmp_path / "other"
    assert follow(capfd, "sim", brief, "--out", first)[0] == 0
    status, out, err = follow(capfd, "refly", first, "--out", again, "--json")
    assert status == 0, err
    figures = json.loads(out)
    assert figures["refly_differs"] == 0
    assert not {"fps_tracker", "tracker_ms"} & figures.keys()  # no tracker ran
    assert "is equal to the last bit" in err
    assert (again / "ticks.csv").read_bytes() == (first / "ticks.csv").read_bytes()
    status, out, err = follow(capfd, "refly", first, "--out", other, "--json", "--servo.standoff-m", "14")
    assert status == 0, err
    assert json.loads(out)["refly_differs"] == 61
    page = (other / "refly.html").read_text()
    assert "servo.standoff_m" in page
    assert "<td>14.0</td>" in page
    assert page.count("<svg") == 1
    rows = list(csv.DictReader((other / "ticks.csv").read_text().splitlines()))
    before = list(csv.DictReader((first / "ticks.csv").read_text().splitlines()))
    assert [r["vehicle_north_m"] for r in rows] == [r["vehicle_north_m"] for r in before]
    assert [r["target_range_m"] for r in rows] == [r["target_range_m"] for r in before]  # the servo moves no target
    assert rows[-1]["desired_forward_m_s"] != before[-1]["desired_forward_m_s"]
    status, _, err = follow(capfd, "refly", again, "--out", tmp_path / "twice")  # and what was flown again, once more
    assert status == 0, err


def test_with_other_settings_it_is_flown_to_the_end_and_says_that_the_vehicle_did_not_fly_them(
    capfd, monkeypatch, tmp_path
):
    monkeypatch.setitem(SCENARIOS, "brief", replace(SCENARIOS["runner"], duration_s=6.0))
    first, other, words = tmp_path / "first", tmp_path / "other", ("--record.no-pictures", "--json")
    status, out, err = follow(capfd, "sim", "brief", "--out", first, *words)
    assert (status, "did not fly" in err) == (0, False), err
    count = json.loads(out)["setpoints"]
    status, out, err = follow(capfd, "refly", first, "--out", other, "--servo.standoff-m", "30", *words)
    assert (status, json.loads(out)["setpoints"]) == (0, count), err
    assert err.count("the recorded vehicle did not fly what is sent now") == 1
    status, out, err = follow(capfd, "refly", other, *words)  # what was switched off is recorded
    assert (status, json.loads(out)["refly_differs"]) == (0, 0), err


def test_an_outcome_that_is_not_the_recorded_one_is_an_error(capfd, brief, tmp_path):
    assert follow(capfd, "sim", brief, "--out", tmp_path, "--record.no-pictures")[0] == 0
    path = tmp_path / "messages.jsonl.gz"
    lines = gzip.decompress(path.read_bytes()).decode().splitlines()
    place = next(n for n, line in enumerate(lines) if n > 20 and '"north_m":' in line)
    lines[place] = re.sub(
        r'"north_m":([-\d.e]+)', lambda m: f'"north_m":{math.nextafter(float(m[1]), 9e9)!r}', lines[place]
    )
    path.write_bytes(gzip.compress("\n".join(lines).encode() + b"\n"))
    status, _, err = follow(capfd, "refly", tmp_path, "--record.no-pictures")
    assert status == 1
    assert "do not give the recorded outcome" in err


@pytest.mark.parametrize("ptz", [(), ("--ptz",)])
def test_a_replay_flown_again_is_equal_to_the_last_bit(capfd, tmp_path, ptz):
    write(tmp_path / "clip.mp4", 20)
    words = ("--truth", tmp_path / "clip.txt", "--out", tmp_path / "first", "--record.no-pictures", *ptz)
    assert follow(capfd, "replay", tmp_path / "clip.mp4", *words)[0] == 0
    status, out, err = follow(capfd, "refly", tmp_path / "first", "--json", "--record.no-pictures")
    assert status == 0, err
    assert json.loads(out)["refly_differs"] == 0
    assert json.loads(out)["frames"] == 20


def test_a_shrunk_source_keeps_its_pixels_and_a_recording_without_rows_has_no_page(capfd, tmp_path):
    images = tmp_path / "images"
    images.mkdir()
    blocks = np.random.default_rng(0).integers(0, 255, (68, 120, 3), np.uint8)
    for n in range(5):
        cv2.imwrite(str(images / f"{n}.png"), np.kron(blocks, np.ones((16, 16, 1), np.uint8)))
    out = tmp_path / "out"
    words = ("replay", images, "--target", "500,300,200,200", "--out", out, "--record.no-pictures")
    assert follow(capfd, *words)[0] == 0
    assert follow(capfd, "refly", out)[0] == 0
    columns = [f"track_{name}_px" for name in "xywh"]
    was, again = FlightTable(out), FlightTable(out / "refly")
    assert was.numbers("track_w_px")[0] == 200
    for name in columns:
        assert again.numbers(name) == pytest.approx(was.numbers(name))
    rows = (out / "ticks.csv").read_text()
    (out / "ticks.csv").write_text(rows + rows.splitlines()[-1] + "\n")
    assert "holds 5 of 6 rounds" in follow(capfd, "refly", out)[2]
    (out / "ticks.csv").unlink()
    status, _, err = follow(capfd, "refly", out / "messages.jsonl.gz")
    assert status == 0
    assert (out / "refly").is_dir()
    assert "refly.html is not written" in err


def test_a_flight_is_not_flown_into_its_own_folder_nor_with_another_camera(capfd, brief, tmp_path):
    assert follow(capfd, "sim", brief, "--out", tmp_path, "--record.no-pictures")[0] == 0
    status, _, err = follow(capfd, "refly", tmp_path, "--out", tmp_path)
    assert (status, "is the recorded flight itself" in err) == (2, True)
    status, _, err = follow(capfd, "refly", tmp_path, "--camera.fov-deg", "50")
    assert (status, "camera.fov_deg cannot be changed" in err) == (2, True)
    status, _, err = follow(capfd, "refly", tmp_path / "nothing")
    assert (status, "holds no messages.jsonl.gz" in err) == (2, True)


def test_a_recording_holds_its_calibration_and_is_flown_again_without_the_original(capfd, monkeypatch, tmp_path):
    monkeypatch.setitem(SCENARIOS, "brief", replace(SCENARIOS["lens"], duration_s=1.0))
    lens, first = tmp_path / "lens.yaml", tmp_path / "first"
    lens.write_text(as_opencv_yaml(Intrinsics(640, 360, 250.0, 250.0, 320.0, 180.0, (-0.18, 0.03, 0.0, 0.0, 0.0)), FIT))
    words = ("--camera.calibration", lens, "--record.no-pictures")
    assert follow(capfd, "sim", "brief", "--out", first, *words)[0] == 0
    assert (first / "camera.yaml").read_bytes() == lens.read_bytes()
    lens.unlink()
    status, out, err = follow(capfd, "refly", first, "--json", "--record.no-pictures")
    assert (status, json.loads(out)["refly_differs"]) == (0, 0), err
    assert "is equal to the last bit" in err
    status, _, err = follow(capfd, "refly", first / "refly", "--record.no-pictures")  # it has its own copy
    assert status == 0, err
    other = tmp_path / "other.yaml"
    other.write_bytes((first / "camera.yaml").read_bytes())
    status, _, err = follow(capfd, "refly", first, "--camera.calibration", other)
    assert (status, "camera.calibration cannot be changed" in err) == (2, True)
    assert follow(capfd, "sim", "brief", "--out", first, "--record.no-pictures")[0] == 0
    assert not (first / "camera.yaml").exists(), "it would be taken for this flight's"


@pytest.mark.realtime
def test_a_live_flight_flown_again_is_equal_to_the_last_bit(tmp_path):
    """With the order, the flight, and the ramp after Ctrl-C: all of it is the recorded outcome."""
    out = tmp_path / "live"
    with real_flight("px4", out, options=["--aim", "--record.no-pictures"]) as real:
        real.order()
        real.application.wait_until_said("follow", 20.0)
        assert real.application.end() == 0
    call = [sys.executable, "-m", "follow.cli", "refly", str(out), "--json", "--record.no-pictures"]
    flown = subprocess.run(call, check=False, capture_output=True, text=True, timeout=120)
    assert flown.returncode == 0, flown.stderr
    summary = json.loads(flown.stdout)
    assert summary["refly_differs"] == 0
    assert summary["modes"]["follow"] > 0
    assert (out / "refly" / "ticks.csv").read_bytes() == (out / "ticks.csv").read_bytes()
