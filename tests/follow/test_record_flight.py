"""The recorder: complete rows, a bounded queue of images, and a flight that no disk error interrupts."""

import csv
import json
import os
import signal
import subprocess
import sys
import threading
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from follow.messages import NEVER, Cause, Decision, Estimate, Frame, Mode, Reason, Setpoint, Tick, VehicleState
from follow.recording.folder import claimed, set_aside
from follow.recording.recorder import RecordConfig, Recorder
from follow.recording.rows import COLUMNS, row
from follow.recording.summary import Summary
from follow.recording.video_encoder import Encoder
from follow.selection import Detection, Detections
from racf.box import Box
from racf.track import Track

IMAGE = np.random.default_rng(0).integers(0, 256, (36, 64, 3), dtype=np.uint8)


def tick(n: int, *, found: bool = True, mode: str = "follow", ms: float = 4.0) -> Tick:
    t_s = n / 30
    mask = np.ones((6, 8), np.uint8) if n % 3 == 0 else None
    track = Track(
        Box(10 + n, 8, 12, 14),
        Box(0, 0, 40, 30),
        psr=20.0,
        apce=50.0,
        confidence=0.9,
        found=found,
        response=np.ones((5, 5), np.float32),
        mask=mask,
        mask_box=Box(8, 6, 16, 18),
    )
    estimate = Estimate(t_s, 0.1, 0.5, 12.0, 1.0, seen_t_s=t_s)
    sent = Setpoint(1.0, 0.0, -0.1, 0.2)
    notes = ("frame is 0.30 s old, so", 'a "quoted" note') if n == 4 else ()
    stage_ms = {"tracker": ms, "control": 0.5, "send": 0.1}
    return Tick(
        Frame(IMAGE, t_s, n), track, VehicleState(t_s), estimate, sent, Decision(sent, Mode(mode), notes), stage_ms
    )


def silent(text: str) -> None:
    raise AssertionError(text)


def test_every_tick_is_a_row_that_any_reader_of_csv_reads_back(tmp_path):
    with Recorder(tmp_path, RecordConfig(), silent, waits=True) as recorder:
        for n in range(20):
            recorder.tick(tick(n))
    with (tmp_path / "ticks.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [int(r["tick"]) for r in rows] == list(range(20))
    assert all(None not in r and tuple(r) == COLUMNS for r in rows)
    assert float(rows[7]["track_x_px"]) == 17
    assert rows[4]["notes"] == "frame is 0.30 s old; so | a 'quoted' note"
    read = np.genfromtxt(tmp_path / "ticks.csv", delimiter=",", names=True, dtype=None, encoding="utf-8")
    assert read["notes"][4] == rows[4]["notes"]


def test_column_names_carry_their_units():
    bare = {
        "tick",
        "utc",
        "frame",
        "mode",
        "reason",
        "notes",
        "track_found",
        "track_refined",
        "track_confidence",
        "track_psr",
    }
    bare |= {"track_apce", "vehicle_mode", "vehicle_in_control", "vehicle_armed", "target_contradiction"}
    for name in set(COLUMNS) - bare:
        assert name.endswith(("_s", "_m", "_rad", "_px")), name


def test_the_same_ticks_give_the_same_bytes_however_long_they_took():
    assert row(3, tick(3, ms=1.0)) == row(3, tick(3, ms=99.0))


def test_times_count_from_the_first_tick_and_the_wall_clock_stands_beside(tmp_path):
    boot_s, unix_s = 7800.0, 1_700_000_000.25
    late = [replace(tick(n), state=VehicleState(boot_s + n / 30, attitude_t_s=boot_s)) for n in range(31)]
    late = [replace(t, frame=Frame(IMAGE, boot_s + t.frame.t_s, t.frame.index)) for t in late]
    clock = iter([unix_s])
    with Recorder(tmp_path, RecordConfig(pictures=False), silent, waits=True, clock=lambda: next(clock)) as recorder:
        for t in late:
            recorder.tick(t)
        summary = recorder.close()
    rows = list(csv.DictReader((tmp_path / "ticks.csv").read_text().splitlines()))
    assert [float(r["t_s"]) for r in rows] == pytest.approx([n / 30 for n in range(31)], abs=1e-6)
    assert all(float(r["frame_t_s"]) == pytest.approx(float(r["t_s"]), abs=1e-6) for r in rows)
    assert {r["vehicle_attitude_t_s"] for r in rows} == {"0"}
    assert {r["vehicle_heartbeat_t_s"] for r in rows} == {""}
    assert rows[30]["utc"] == "2023-11-14T22:13:21.250Z"
    assert summary["started_utc"] == rows[0]["utc"] == "2023-11-14T22:13:20.250Z"


def test_a_simulated_flight_holds_no_wall_clock(tmp_path):
    with Recorder(tmp_path, RecordConfig(pictures=False), silent, waits=True) as recorder:
        recorder.tick(tick(0))
        assert "started_utc" not in recorder.close()
    (first,) = csv.DictReader((tmp_path / "ticks.csv").read_text().splitlines())
    assert first["utc"] == ""


def test_a_note_is_logged_once_however_its_number_changes(monkeypatch):
    from follow.recording import rerun_log  # noqa: PLC0415

    said: list[str] = []
    monkeypatch.setattr(
        rerun_log.RerunRecording, "_say", lambda _self, t_s, text, *_more: said.append(f"{t_s:g} {text}")
    )
    recording = rerun_log.to_file(Path("/dev/null"), "", Encoder.JPEG, 75)
    notes = [(), *[(f"frame is {0.2 + n / 100:.2f} s old",) for n in range(150)], (), ("frame is 0.50 s old", "fence")]
    for n, lines in enumerate(notes):
        decision = Decision(None, Mode.BRAKE, lines, Reason(Cause.STALE, "frame is old"))
        recording.tick(rerun_log.LoggedTick(n, float(n), replace(tick(n), decision=decision)))
    recording.close()
    assert said == ["1 frame is 0.20 s old", "152 frame is 0.50 s old", "152 fence"]


def test_a_note_that_is_the_reason_for_the_mode_is_not_repeated(monkeypatch):
    from follow.recording import rerun_log  # noqa: PLC0415

    said: list[str] = []
    monkeypatch.setattr(rerun_log.RerunRecording, "_say", lambda _self, _t_s, text, *_more: said.append(text))
    recording = rerun_log.to_file(Path("/dev/null"), "", Encoder.JPEG, 75)
    reason = Reason(Cause.STALE, "frame is 0.20 s old")
    decision = Decision(None, Mode.BRAKE, ("frame is 0.31 s old", "held by fence"), reason)
    recording.tick(rerun_log.LoggedTick(0, 0.0, replace(tick(0), decision=decision)))
    recording.close()
    assert said == ["held by fence"]


def test_every_mode_has_a_colour_by_its_meaning():
    from follow.recording.layout import GREEN, GREY, MODE_COLOURS, RED  # noqa: PLC0415

    assert set(MODE_COLOURS) == set(Mode)
    assert [MODE_COLOURS[m] for m in (Mode.FOLLOW, Mode.BRAKE, Mode.ENDED)] == [GREEN, RED, GREY]
    assert [m for m, colour in MODE_COLOURS.items() if colour == RED] == [Mode.BRAKE]


def test_columns_without_a_value_are_empty():
    assert str(NEVER) not in row(0, tick(0))


def test_what_is_not_a_number_is_empty():
    beside = tick(0)
    assert beside.track is not None
    nothing = replace(beside.track, psr=float("nan"), apce=float("nan"))
    cells = dict(zip(COLUMNS, row(0, replace(beside, track=nothing)).strip().split(","), strict=True))
    assert (cells["track_psr"], cells["track_apce"]) == ("", "")
    assert cells["track_confidence"] == "0.9"


def test_what_a_detector_found_is_recorded_with_its_age_and_cleared_when_it_is_too_old(tmp_path):
    from rerun.chunk import RrdReader  # noqa: PLC0415

    boxes = tuple(Detection(Box(10.0 * k, 5.0, 8.0, 20.0), 0.9 - k / 10) for k in range(2))
    seen = {n: Detections(0.1, 3, boxes) for n in range(9, 15)} | {n: Detections(0.5, 15, boxes[:1]) for n in (18, 19)}
    with Recorder(tmp_path, RecordConfig(), silent, waits=True) as recorder:
        for n in range(22):
            recorder.tick(replace(tick(n), found=seen.get(n)))
    chunks = [c for c in RrdReader(tmp_path / "flight.rrd").stream() if not c.is_static]
    batches = [c.to_record_batch() for c in chunks if c.entity_path == "/image/found"]
    times = [time.value / 1e9 for batch in batches for time in batch.column("seconds")]
    assert times == pytest.approx([9 / 30, 15 / 30, 18 / 30, 20 / 30], abs=1e-6), "when it is new, and when it is gone"
    labels = [label or [] for batch in batches for label in batch.column("Boxes2D:labels").to_pylist()]
    assert labels == [["0.90, 0.2 s old", "0.80, 0.2 s old"], [], ["0.90, 0.1 s old"], []]
    sizes = [size or [] for batch in batches for size in batch.column("Boxes2D:half_sizes").to_pylist()]
    assert sizes[0] == [[4.0, 10.0]] * 2
    assert [len(size) for size in sizes] == [2, 0, 1, 0]


def test_rerun_verifies_the_recording(tmp_path):
    with Recorder(tmp_path, RecordConfig(), silent, waits=True, about="# A flight") as recorder:
        for n in range(20):
            recorder.tick(tick(n, found=n != 5), Box(9, 8, 12, 14) if n % 2 else None)
        recorder.message("a line for a person")
        recorder.settings("[limits]\n")
    rerun = Path(sys.executable).with_name("rerun")
    subprocess.run([rerun, "rrd", "verify", tmp_path / "flight.rrd"], check=True, capture_output=True, timeout=60)
    shown = subprocess.run(
        [rerun, "rrd", "print", tmp_path / "flight.rrd"], check=True, capture_output=True, text=True, timeout=60
    ).stdout
    entities = (
        "/image",
        "/image/target",
        "/image/search",
        "/image/truth",
        "/image/mask",
        "/response",
    )
    entities += ("/track/confidence", "/desired/velocity", "/setpoint/velocity", "/mode", "/messages", "/settings")
    entities += ("/timings",)
    for entity in entities:
        assert f"{entity} " in shown or f"{entity}\n" in shown or f"{entity}'" in shown, entity


def test_a_slow_writer_costs_images_and_no_row(tmp_path, monkeypatch):
    from follow.recording import rerun_log as explain  # noqa: PLC0415 - Rerun only where it is needed

    gate = threading.Event()
    monkeypatch.setattr(explain.RerunRecording, "images", lambda _self, _scene: gate.wait(30))
    recorder = Recorder(tmp_path, RecordConfig(queue=4), silent, waits=False)
    for n in range(50):
        recorder.tick(tick(n))
    gate.set()
    summary = recorder.close()
    assert 45 <= summary["recording_dropped"] <= 46
    assert len((tmp_path / "ticks.csv").read_text().splitlines()) == 51


def test_a_recorder_that_waits_drops_nothing(tmp_path):
    recorder = Recorder(tmp_path, RecordConfig(queue=1), silent, waits=True)
    for n in range(30):
        recorder.tick(tick(n))
    assert "recording_dropped" not in recorder.close()


def test_a_full_disk_is_one_line_and_the_flight_goes_on(tmp_path):
    for name in ("ticks.csv", "summary.json.new"):
        (tmp_path / name).symlink_to("/dev/full")
    lines: list[str] = []
    with Recorder(tmp_path, RecordConfig(pictures=False), lines.append, waits=True) as recorder:
        for n in range(20):
            recorder.tick(tick(n))
    assert len(lines) == 1
    assert f"the disk of {tmp_path} is full" in lines[0]


def test_a_recording_that_cannot_be_written_is_one_line_and_the_rows_are_whole(tmp_path, monkeypatch):
    from follow.recording import rerun_log as explain  # noqa: PLC0415

    def fail(_self):
        raise OSError("flight.rrd is no longer written: disk full")

    monkeypatch.setattr(explain.RerunRecording, "flush", fail)
    lines: list[str] = []
    with Recorder(tmp_path, RecordConfig(), lines.append, waits=True) as recorder:
        for n in range(40):
            recorder.tick(tick(n))
    assert lines == ["flight.rrd is no longer written: disk full"]
    assert len((tmp_path / "ticks.csv").read_text().splitlines()) == 41


def test_a_folder_that_cannot_be_made_is_refused_before_the_flight(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(OSError, match="file"), claimed(tmp_path / "file" / "out"):
        pass


def test_a_second_program_in_a_folder_is_refused_until_the_first_ends(tmp_path):
    with claimed(tmp_path / "out"):
        hold = "import sys, pathlib, follow.recording.folder as f\nwith f.claimed(pathlib.Path(sys.argv[1])): pass"
        second = subprocess.run(
            [sys.executable, "-c", hold, tmp_path / "out"], check=False, capture_output=True, text=True
        )
        assert second.returncode == 1
        assert "is being written by another process: give another folder" in second.stderr
        with pytest.raises(OSError, match="is being written"), claimed(tmp_path / "out"):
            pass
    with claimed(tmp_path / "out"):
        pass


@pytest.mark.parametrize(
    ("name", "rule"),
    [("~nobody/flights", "did not expand"), (b"caf\xe9", "must be UTF-8"), ("a" * 300, "too long"), ("f/g", "Not a")],
)
def test_a_folder_with_a_bad_name_is_refused_in_one_line(tmp_path, monkeypatch, name, rule):
    monkeypatch.chdir(tmp_path)
    Path("f").write_text("")
    with pytest.raises(OSError, match=rule) as error, claimed(Path(os.fsdecode(name))):
        pass
    assert str(error.value).startswith("--out ")
    assert "\n" not in str(error.value)
    assert [path.name for path in tmp_path.iterdir()] == ["f"]


def test_an_error_of_ours_in_the_recording_is_named_and_the_rows_are_whole(tmp_path, monkeypatch):
    from follow.recording import rerun_log  # noqa: PLC0415

    def broken(_self, _scene):
        raise TypeError("not an\narray")

    monkeypatch.setattr(rerun_log.RerunRecording, "images", broken)
    lines: list[str] = []
    with Recorder(tmp_path, RecordConfig(), lines.append, waits=True) as recorder:
        for n in range(40):
            recorder.tick(tick(n))
    assert recorder.failure == "the recording ended by an error: TypeError: not an array"
    assert lines == [recorder.failure]
    assert len((tmp_path / "ticks.csv").read_text().splitlines()) == 41


@pytest.mark.filterwarnings("ignore:RRD file has no footer")
def test_the_recording_of_a_killed_flight_opens_with_its_frames(tmp_path):
    """The process is killed while it flies; Rerun reads what had been flushed."""
    flying = """
import os, signal, sys, pathlib
from follow.recording.recorder import RecordConfig, Recorder
from tests.follow.test_record_flight import tick
recorder = Recorder(pathlib.Path(sys.argv[1]), RecordConfig(), print, waits=True)
for n in range(200):
    recorder.tick(tick(n))
os.kill(os.getpid(), signal.SIGKILL)
"""
    killed = subprocess.run([sys.executable, "-c", flying, tmp_path], check=False, timeout=120)
    assert killed.returncode == -signal.SIGKILL
    from rerun.chunk import RrdReader  # noqa: PLC0415

    chunks = [c for c in RrdReader(tmp_path / "flight.rrd").stream() if not c.is_static]
    rows = {path: sum(c.num_rows for c in chunks if c.entity_path == path) for path in ("/image", "/range")}
    assert 90 <= rows["/image"] <= 200
    assert 90 <= rows["/range"] <= 200
    assert len((tmp_path / "ticks.csv").read_text().splitlines()) > 150


def test_summary_times_add_up():
    summary = Summary()
    for n in range(61):
        summary.add(tick(n, found=not 10 <= n < 25, mode="coast" if 10 <= n < 25 else "follow"))
    figures = summary.figures()
    assert figures["seconds"] == pytest.approx(2.0)
    assert figures["lost_s"] == pytest.approx(0.5)
    assert figures["modes"] == pytest.approx({"follow": 1.5, "coast": 0.5})
    assert figures["frames"] == figures["setpoints"] == 61
    assert figures["fps_tracker"] == pytest.approx(250.0)
    assert figures["tracker_ms"] == {"p50": 4.0, "p99": 4.0, "max": 4.0}


def test_the_summary_on_disk_is_the_summary_returned(tmp_path):
    recorder = Recorder(tmp_path, RecordConfig(pictures=False), silent, waits=True)
    recorder.tick(tick(0))
    returned = recorder.close({"auc": 50.0})
    assert json.loads((tmp_path / "summary.json").read_text()) == returned
    assert returned["auc"] == 50.0


def test_an_earlier_flight_is_set_aside_and_never_written_over(tmp_path):
    assert set_aside(tmp_path) is None
    for n in (1, 2):
        (tmp_path / "ticks.csv").write_text(f"flight {n}")
        (tmp_path / "flight.png").write_text(f"plot {n}")
        (tmp_path / "camera.png").write_text("no flight's")
        assert set_aside(tmp_path) == tmp_path / f"earlier-{n}"
    assert [(tmp_path / f"earlier-{n}/ticks.csv").read_text() for n in (1, 2)] == ["flight 1", "flight 2"]
    assert (tmp_path / "earlier-2/flight.png").read_text() == "plot 2"
    assert not (tmp_path / "ticks.csv").exists()
    assert (tmp_path / "camera.png").exists()


def test_a_flight_that_breaks_off_leaves_no_plot_of_the_one_before(tmp_path):
    for name in ("flight.png", "flight.rrd"):
        (tmp_path / name).write_text("the flight before")
    recorder = Recorder(tmp_path, RecordConfig(pictures=False), silent, waits=True)
    assert not [path for path in tmp_path.iterdir() if path.name != "ticks.csv"]
    recorder.close()
