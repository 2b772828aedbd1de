"""The referee of the real-time tests: only time that the host took away excuses a failure."""

import os
import re
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from tests.support.machine import LateError, against_the_clock, awake, parsed, processor_ticks, stolen
from tests.support.real_flight import free_ports, is_free, program, until

LINE = "cpu  100 0 50 800 10 0 5 {steal} 7 0\ncpu0 1 2 3 4 5 6 7 8 0 0\n"


def test_the_share_of_stolen_time_is_of_all_time_in_between():
    before, after = parsed(LINE.format(steal=5)), parsed("cpu  140 0 60 835 10 0 5 20 9 0\n")
    assert stolen(before, after) == pytest.approx(15 / 100)


def test_a_machine_without_steal_time_excuses_nothing():
    assert stolen((0,) * 8, (0,) * 8) == 0.0


def test_ticks_only_grow():
    first, second = processor_ticks(), processor_ticks()
    assert all(a <= b for a, b in zip(first, second, strict=True))
    assert 0.0 <= stolen(first, second) <= 1.0


@pytest.mark.skipif(not hasattr(os, "SCHED_IDLE"), reason="Linux only")
def test_the_processes_that_keep_cores_awake_have_idle_priority_and_end():
    with awake() as spinners:
        assert len(spinners) == len(os.sched_getaffinity(0))
        end = time.monotonic() + 10.0
        while any(os.sched_getscheduler(pid) != os.SCHED_IDLE for pid in spinners):
            assert time.monotonic() < end
            time.sleep(0.01)
        assert sorted(core for pid in spinners for core in os.sched_getaffinity(pid)) == sorted(os.sched_getaffinity(0))
    for pid in spinners:
        with pytest.raises(ProcessLookupError):
            os.kill(pid, 0)


@pytest.mark.parametrize("failure", [AssertionError("slow"), subprocess.TimeoutExpired("follow", 2.0)])
def test_a_failed_time_bound_raises_late_error(failure):
    with pytest.raises(LateError), against_the_clock():
        raise failure


def test_any_other_failure_stays_what_it_is():
    with pytest.raises(ValueError, match="a bug"), against_the_clock():
        raise ValueError("a bug")


@pytest.mark.parametrize(("last", "state"), [("", "ended with 0"), ("; time.sleep(60)", "runs")])
def test_a_late_error_contains_the_output_of_the_program(last, state):
    def waits() -> None:
        with program([sys.executable, "-c", f"import sys, time; sys.stderr.write('no such port\\n'){last}"]) as running:
            running.wait_until_said("no such port")
            until("ended", lambda: last or running.process.poll() is not None)
            until("up", lambda: False, 0.1)

    with pytest.raises(LateError, match=rf"not up within 0.1 s; -c .* {state} and said \['no such port'\]"):
        waits()


def test_what_a_program_said_last_counts_though_it_is_read_after_the_end():
    call = [sys.executable, "-c", "import sys; sys.stdin.read(); sys.stderr.write('the last word\n')"]
    with program(call) as running:
        running.asleep.set()
        running.process.wait(20.0)
        threading.Timer(0.3, running.asleep.clear).start()
        running.wait_until_said("the last word")


def test_a_free_port_can_be_had_and_a_taken_one_is_not_free():
    (port,) = free_ports(1)
    for kind in (socket.SOCK_DGRAM, socket.SOCK_STREAM):
        with socket.socket(socket.AF_INET, kind) as taken:
            taken.bind(("127.0.0.1", port))
            assert not is_free(port)


SUITE = """
import pytest
from tests.support.machine import LateError

def test_late():
    raise LateError("slow")

def test_wrong():
    assert not "a setpoint after the takeover"
"""


@pytest.mark.parametrize(("steal", "outcome"), [(0, {"failed": 2}), (50, {"failed": 1, "skipped": 1})])
def test_steal_time_excuses_a_late_error_and_nothing_else(steal, outcome, tmp_path):
    """A suite of two failures under this suite's own conftest, with a /proc/stat that says what was stolen."""
    here = Path(__file__).parent
    (tmp_path / "conftest.py").write_text(
        (here / "conftest.py").read_text() + f"\nticks = iter(range(99))\n"
        f"def processor_ticks():\n    n = next(ticks)\n    return (n * {100 - steal}, 0, 0, 0, 0, 0, 0, n * {steal})\n"
    )
    (tmp_path / "test_both.py").write_text(SUITE)
    call = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", str(tmp_path)]
    path = str(here.parent)
    done = subprocess.run(
        call, capture_output=True, text=True, check=False, cwd=tmp_path, env={**os.environ, "PYTHONPATH": path}
    )
    counted = {word: int(n) for n, word in re.findall(r"(\d+) (failed|skipped|passed)", done.stdout.splitlines()[-1])}
    assert counted == outcome, done.stdout
