"""What of this machine's time its host gave to others, how to lose less of it, and which assertions that excuses."""

import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

STAT = Path("/proc/stat")
STOLEN = 0.02  # share above which a failure says nothing: single pauses are then tenths of seconds and more
COLUMNS = 8  # user nice system idle iowait irq softirq steal; what follows is counted in user already
SPIN = """
import os, sys
parent = os.getppid()
os.sched_setaffinity(0, {int(sys.argv[1])})
os.sched_setscheduler(0, os.SCHED_IDLE, os.sched_param(0))
while os.getppid() == parent:
    pass
"""


@contextmanager
def awake() -> Iterator[list[int]]:
    """Keep the cores from sleeping, by processes (their ids are given) that take only the time which nobody wants.

    A virtual machine's sleeping core is woken when its host comes to it, on a busy one tens of milliseconds late, and
    programs that wait for frames sleep and wake all the time.  In eight pairs of runs side by side the host took 1 to
    37 % of the time with the cores awake, and 17 to 51 % with them asleep.
    """
    cores = sorted(os.sched_getaffinity(0)) if hasattr(os, "SCHED_IDLE") else []
    spinners = [subprocess.Popen([sys.executable, "-S", "-c", SPIN, str(core)]) for core in cores]
    try:
        yield [spinner.pid for spinner in spinners]
    finally:
        for spinner in spinners:
            spinner.kill()
        for spinner in spinners:
            spinner.wait()


class LateError(AssertionError):
    """Something did not happen in time.  Nothing else is excused on a stolen machine: no rule of safety is."""


@contextmanager
def against_the_clock() -> Iterator[None]:
    """What is asserted in here holds only where the programs get their time: its failures are late."""
    try:
        yield
    except (AssertionError, subprocess.TimeoutExpired) as error:
        raise LateError(str(error)) from error


def processor_ticks() -> tuple[int, ...]:
    """Ticks of all cores since the start, by what they went to; all zero where the system does not say."""
    if not STAT.is_file():
        return (0,) * COLUMNS
    return parsed(STAT.read_text())


def parsed(text: str) -> tuple[int, ...]:
    """The first line of /proc/stat."""
    return tuple(int(word) for word in text.splitlines()[0].split()[1 : 1 + COLUMNS])


def stolen(before: tuple[int, ...], after: tuple[int, ...]) -> float:
    """The share of the time between two readings that the host took away."""
    spent = [b - a for a, b in zip(before, after, strict=True)]
    return spent[-1] / sum(spent) if sum(spent) else 0.0
