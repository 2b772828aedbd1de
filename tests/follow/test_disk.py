"""A disk that stalls or is full delays or loses the written data, but never blocks the caller."""

import errno
import json
import os
import threading
from dataclasses import replace

import pytest

from follow.cli.program import main
from follow.disk import BackgroundFile, BackgroundTask, unwritten
from follow.link.signing import Signing
from follow.link.tlog import Tlog
from follow.recording.recorder import RecordConfig, Recorder
from sim.scenarios import SCENARIOS
from tests.follow.test_record_flight import tick


class StalledFile:
    """A disk that blocks until `answers` is set."""

    def __init__(self) -> None:
        self.answers = threading.Event()
        self.asked = threading.Event()
        self.content = b""

    def write(self, data: bytes) -> None:
        self.asked.set()
        assert self.answers.wait(60)
        self.content += data

    def flush(self) -> None: ...

    def close(self) -> None: ...


def silent(text: str) -> None:
    raise AssertionError(text)


def test_a_stalled_disk_gets_everything_later_in_order(tmp_path):
    disk = StalledFile()
    file = BackgroundFile(tmp_path / "rows", silent, open_file=lambda _path: disk)
    file.write(b"0")
    assert disk.asked.wait(60)
    for n in range(1, 10):
        file.write(b"%d" % n)  # returns although the disk takes nothing: else the test would hang here
    assert disk.content == b""
    disk.answers.set()
    file.close()
    assert disk.content == b"0123456789"
    assert file.lost == 0


def test_what_does_not_fit_is_counted(tmp_path):
    disk = StalledFile()
    file = BackgroundFile(tmp_path / "rows", silent, waiting_bytes=10, open_file=lambda _path: disk)
    file.write(b"x")
    assert disk.asked.wait(60)
    for _ in range(15):
        file.write(b"y")
    disk.answers.set()
    file.close()
    assert disk.content == b"x" + 10 * b"y"
    assert file.lost == 5


def test_a_disk_that_never_answers_does_not_keep_the_program_from_ending(tmp_path):
    disk, lines = StalledFile(), list[str]()
    file = BackgroundFile(tmp_path / "rows", lines.append, open_file=lambda _path: disk)
    file.write(b"x")
    assert disk.asked.wait(60)
    file.write(b"y")
    file.close(timeout_s=0.0)
    disk.answers.set()
    assert file.lost == 1
    assert len(lines) == 1
    assert "did not answer" in lines[0]


def test_the_loop_goes_on_while_rows_packets_and_signing_time_wait_for_the_disk(tmp_path, monkeypatch):
    """Each call returns with the disk stalled; once it answers, all of it is there."""
    disks: dict[str, StalledFile] = {}

    def stalled(path):
        return disks.setdefault(path.name, StalledFile())

    def start(self, path, report, *_more, **_options):
        original(self, path, report, open_file=stalled)

    original = BackgroundFile.__init__
    key = tmp_path / "key"
    key.write_bytes(bytes(32))
    key.chmod(0o600)
    signing = Signing(key)
    stores = StalledFile()
    monkeypatch.setattr("follow.link.signing._write_time", lambda _path, value: stores.write(b"%d" % value))
    monkeypatch.setattr(BackgroundFile, "__init__", start)
    tlog = Tlog(tmp_path / "flight.tlog")
    recorder = Recorder(tmp_path, RecordConfig(pictures=False), silent, waits=False)
    clock = iter(range(1_800_000_000, 1_900_000_000, 11))  # each packet is due to store its time
    monkeypatch.setattr("time.time", lambda: next(clock))

    class Mav:
        class signing:  # noqa: N801 - pymavlink's name
            timestamp = 0

    for n in range(100):
        recorder.tick(tick(n))
        tlog.write(b"packet", float(n))
        signing.stamp(Mav)
    assert not any(disk.content for disk in [*disks.values(), stores])
    for disk in [*disks.values(), stores]:
        disk.answers.set()
    tlog.close()
    recorder._rows.close()
    assert disks["flight.tlog"].content.count(b"packet") == 100
    assert disks["ticks.csv"].content.count(b"\n") == 101
    for disk in disks.values():
        assert disk.asked.is_set()


def test_a_task_that_runs_is_not_started_again():
    goes, ran = threading.Event(), []
    task = BackgroundTask(lambda: (ran.append(1), goes.wait(60)), "task")
    assert task.start()
    assert not task.start()
    goes.set()
    assert task._thread is not None
    task._thread.join(60)
    assert task.start()
    task._thread.join(60)
    assert len(ran) == 2


def test_an_error_of_the_disk_is_one_line_and_what_is_missing_is_counted(tmp_path):
    (tmp_path / "rows").symlink_to("/dev/full")
    lines: list[str] = []
    file = BackgroundFile(tmp_path / "rows", lines.append)
    for _ in range(7):
        file.write(b"row\n")
    file.close()
    assert file.lost == 7
    assert len(lines) == 1
    assert f"the disk of {tmp_path} is full" in lines[0]


class SmallFile(StalledFile):
    """A file on a disk with room for 20 kB."""

    def write(self, data: bytes) -> None:
        if len(self.content) + len(data) > 20_000:
            raise full_disk()
        self.content += data


def test_a_disk_that_is_gone_is_not_called_full_and_its_error_is_reported(tmp_path):
    gone = OSError(errno.EIO, "Input/output error")
    assert unwritten(tmp_path / "unplugged" / "ticks.csv", gone).endswith("Input/output error; the flight goes on")
    assert "is full" in unwritten(tmp_path / "ticks.csv", full_disk())


def full_disk(*_words: object) -> OSError:
    return OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def test_a_simulation_on_a_full_disk_says_so_once_is_scored_and_keeps_what_it_has(tmp_path, monkeypatch, capfd):
    disks: dict[str, SmallFile] = {}

    def start(self, path, report, *_more, **_options):
        original(self, path, report, open_file=lambda path: disks.setdefault(path.name, SmallFile()))

    def draw(*_words):
        raise full_disk()

    original = BackgroundFile.__init__
    monkeypatch.setattr(BackgroundFile, "__init__", start)
    monkeypatch.setattr("follow.cli.sim.draw", draw)
    monkeypatch.setitem(SCENARIOS, "brief", replace(SCENARIOS["walker"], duration_s=2.0))
    assert main(["sim", "brief", "--out", str(tmp_path), "--record.no-pictures", "--json"]) == 0
    out, err = capfd.readouterr()
    assert err.count(f"the disk of {tmp_path} is full") == 1
    assert "No space" not in err
    assert json.loads(out)["in_view"] > 0.9
    assert disks["ticks.csv"].content.count(b"\n") > 10


@pytest.mark.parametrize("act", ["write", "flush", "close", "open"])
def test_on_a_full_disk_the_summary_stands_whole_or_not_at_all(tmp_path, monkeypatch, act):
    """The rows stay, and one sentence tells of the disk, whichever call it is that finds it full."""

    class FullFile(SmallFile):
        def __init__(self, path):
            super().__init__()
            if act == "open":
                raise full_disk()
            self._file = path.open("wb")

        def write(self, data):
            self._file.write(data[:3])
            if act == "write":
                raise full_disk()
            self._file.write(data[3:])

        def flush(self):
            if act == "flush":
                raise full_disk()

        def close(self):
            self._file.close()
            if act == "close":
                raise full_disk()

    (tmp_path / "summary.json").write_text("of the flight before")
    lines: list[str] = []
    recorder = Recorder(tmp_path, RecordConfig(pictures=False), lines.append, waits=True)
    for n in range(5):
        recorder.tick(tick(n))
    monkeypatch.setattr("follow.disk.opened", FullFile)
    figures = recorder.close()
    assert figures["frames"] == 5
    assert [path.name for path in tmp_path.iterdir()] == ["ticks.csv"]
    assert len((tmp_path / "ticks.csv").read_text().splitlines()) == 6
    assert len(lines) == 1
    assert f"the disk of {tmp_path} is full" in lines[0]


def test_a_flight_that_is_killed_leaves_no_summary_of_the_one_before(tmp_path):
    with Recorder(tmp_path, RecordConfig(pictures=False), silent, waits=True) as recorder:
        recorder.tick(tick(0))
    assert json.loads((tmp_path / "summary.json").read_text())["frames"] == 1
    Recorder(tmp_path, RecordConfig(pictures=False), silent, waits=True)  # never closed
    assert not (tmp_path / "summary.json").exists()


def test_a_file_that_cannot_be_made_is_an_error_at_once(tmp_path):
    with pytest.raises(OSError, match="No such file"):
        BackgroundFile(tmp_path / "none" / "rows", silent)
