"""How much of this machine's time its host gave to others: what no real-time program on it can make up for."""

from pathlib import Path

STAT = Path("/proc/stat")
STOLEN = 0.02  # share above which a failure says nothing: single pauses are then tenths of seconds and more
COLUMNS = 8  # user nice system idle iowait irq softirq steal; what follows is counted in user already


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
