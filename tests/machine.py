"""How much of this machine's time its host gave to others, and which assertions that can excuse."""

import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

STAT = Path("/proc/stat")
STOLEN = 0.02  # share above which a failure says nothing: single pauses are then tenths of seconds and more
COLUMNS = 8  # user nice system idle iowait irq softirq steal; what follows is counted in user already


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
