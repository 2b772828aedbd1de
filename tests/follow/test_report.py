"""`follow report`: one page that holds everything, of any flight, a killed one included."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest

from follow.cli.program import main
from follow.messages import Cause, Decision, Mode, Reason, Setpoint
from follow.recording.exact import Setup
from follow.recording.flight_table import FlightTable
from follow.recording.recorder import RecordConfig, Recorder
from follow.recording.report import report
from tests.follow.test_record_flight import silent, tick
from tests.follow.test_refly import SETUP


def recorded(folder, *, setup: Setup | None = SETUP) -> None:
    """Three seconds: follow, a loss, a stale frame, follow."""
    with Recorder(folder, RecordConfig(pictures=False), silent, waits=True, setup=setup) as recorder:
        recorder.settings('[servo]\nmode = "chase"\nstandoff_m = 12.0\n[derived.camera]\ndown_deg = 45.0\n')
        for n in range(91):
            mode, notes, reason = Mode.FOLLOW, (), Reason(Cause.SEEN)
            if 30 <= n < 45:
                mode, reason = Mode.COAST, Reason(Cause.NOT_SEEN, seconds=0.3)
            if 60 <= n < 63:
                stale = f"frame is {0.2 + n / 100:.2f} s old"
                mode, notes, reason = Mode.BRAKE, (stale, "slower: limits.fence_m"), Reason(Cause.STALE, stale)
            round_ = tick(n, found=not 30 <= n < 45)
            recorder.tick(replace(round_, decision=Decision(Setpoint(), mode, notes, reason)))
            if n == 50:
                recorder.message("<b>somebody</b> & the pilot")


def test_the_report_tells_what_happened_and_is_self_contained(tmp_path):
    recorded(tmp_path)
    assert main(["report", str(tmp_path)]) == 0
    page = (tmp_path / "report.html").read_text()
    assert page.count("<svg") == 2
    assert not re.search(r'(?:src|href)="(?!#)', page.replace("xlink:href", ""))
    assert "http" not in re.sub(r'xmlns(:\w+)?="[^"]*"', "", page)
    text = re.sub(r"<svg.*?</svg>", "", page, flags=re.DOTALL)
    assert "3.0 s, of which 2.4 s in follow. The target was lost 1 times, 0.5 s in all. At the end: follow" in text
    assert "target not seen for 0.30 s" in text
    assert "frame is … s old" in text
    assert "slower: limits.fence_m" in text
    assert "&lt;b&gt;somebody&lt;/b&gt; &amp; the pilot" in text
    assert "standoff_m = 12.0" in text


def test_the_spans_are_those_of_the_rows(tmp_path):
    recorded(tmp_path)
    table = FlightTable(tmp_path)
    modes = [(s.what, round(s.start_s, 3), round(s.seconds, 3)) for s in table.spans(["mode"])]
    assert modes == [
        ("follow", 0.0, 1.0),
        ("coast", 1.0, 0.5),
        ("follow", 1.5, 0.5),
        ("brake", 2.0, 0.1),
        ("follow", 2.1, 0.9),
    ]
    assert [(round(s.start_s, 3), round(s.seconds, 3)) for s in table.losses()] == [(1.0, 0.5)]
    notes = table.notes()
    assert {note: len(times) for note, times in notes.items()} == {"frame is … s old": 3, "slower: limits.fence_m": 3}
    assert table.height_m() == pytest.approx(12 * np.tan(0.5))


@pytest.mark.parametrize("name", ["flight.rrd", "ticks.csv", "summary.json"])
def test_a_file_of_the_flight_names_its_folder(tmp_path, name):
    recorded(tmp_path)
    (tmp_path / name).touch()
    assert main(["report", str(tmp_path / name)]) == 0
    assert (tmp_path / "report.html").is_file()


def test_another_file_names_no_flight(tmp_path, capfd):
    recorded(tmp_path)
    (tmp_path / "clip.mp4").touch()
    assert main(["report", str(tmp_path / "clip.mp4")]) == 2
    assert "give the folder of a flight" in capfd.readouterr().err


def test_a_killed_flight_with_a_torn_row_and_no_summary_has_its_page(tmp_path):
    recorded(tmp_path, setup=None)
    (tmp_path / "summary.json").unlink()
    rows = (tmp_path / "ticks.csv").read_text()
    (tmp_path / "ticks.csv").write_text(rows[: len(rows) // 2])
    page = report(tmp_path)
    assert "it was killed" in page
    assert "which keeps it, is missing" in page
    assert len(FlightTable(tmp_path).t_s) < 50


@pytest.mark.parametrize("content", [None, "", "t_s,mode\n", "a,b\n1,2\n"])
def test_a_folder_without_a_flight_is_refused_in_one_line(tmp_path, capfd, content):
    if content is not None:
        (tmp_path / "ticks.csv").write_text(content)
    assert main(["report", str(tmp_path)]) == (2 if content is None else 1)
    err = capfd.readouterr().err
    assert "holds no" in err
    assert len(err.strip().splitlines()) == 1


def test_a_page_that_cannot_be_written_is_refused_by_its_name_and_leaves_nothing(tmp_path, capfd):
    (tmp_path / "flight").mkdir()
    (tmp_path / "folder").mkdir()
    recorded(tmp_path / "flight")
    for out in (tmp_path / "folder", tmp_path / "missing" / "page.html"):
        assert main(["report", str(tmp_path / "flight"), "--out", str(out)]) == 2
        err = capfd.readouterr().err
        assert repr(str(out)) in err
        assert ".new" not in err
    assert {path.name for path in tmp_path.iterdir()} == {"flight", "folder"}
    assert main(["report", str(tmp_path / "flight")]) == 0
    assert str(tmp_path / "flight" / "report.html") in capfd.readouterr().out


def test_a_report_overwrites_reports_alone(tmp_path, capfd):
    (flight := tmp_path / "flight").mkdir()
    recorded(flight)
    (tmp_path / "clip.txt").write_text("1,2,30,40\n")
    for out in (tmp_path / "clip.txt", flight / "ticks.csv"):
        before = out.read_bytes()
        assert main(["report", str(flight), "--out", str(out)]) == 2
        assert repr(str(out)) in capfd.readouterr().err
        assert out.read_bytes() == before
    for _time in range(2):
        assert main(["report", str(flight), "--out", str(tmp_path / "page.html")]) == 0
        assert main(["report", str(flight)]) == 0


def test_a_damaged_recording_has_its_page_or_is_refused_by_name(tmp_path, capfd):
    recorded(tmp_path)
    with (tmp_path / "ticks.csv").open("ab") as rows:
        rows.write(bytes(4096) + b"\xe9")
    (tmp_path / "settings.toml").write_bytes(b"# \xe9\n" + (tmp_path / "settings.toml").read_bytes())
    assert main(["report", str(tmp_path)]) == 0
    lines = (tmp_path / "ticks.csv").read_bytes().splitlines()
    lines[3] = lines[3].replace(b"0", b"x")
    (tmp_path / "ticks.csv").write_bytes(b"\n".join(lines))
    assert main(["report", str(tmp_path)]) == 1
    err = capfd.readouterr().err
    assert "ticks.csv" in err
    assert "must hold numbers" in err


def test_the_figures_of_the_summary_are_on_the_page(tmp_path):
    recorded(tmp_path)
    summary = json.loads((tmp_path / "summary.json").read_text())
    page = report(tmp_path)
    assert f'<td>lost_s</td><td class="n">{summary["lost_s"]:.4g}</td>' in page
