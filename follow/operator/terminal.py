"""Output for a person at the terminal: messages and progress on standard error, the result on standard output."""

import errno
import json
import math
import os
import select
import sys
from collections.abc import Callable, Iterable, Iterator
from typing import TypeVar

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, ProgressColumn, Task, TextColumn, TimeRemainingColumn
from rich.text import Text

from follow.operator.background import FLUSH_S, BackgroundWriter
from follow.recording.summary import Figures

ItemT = TypeVar("ItemT")


class Terminal:
    """Standard error for a person.  Each message also goes to every listener (the recording is one).

    In a live flight `waits` is false: writing never blocks, because a stopped terminal must not stop the control loop.
    """

    def __init__(self, *, waits: bool = True) -> None:
        self.listeners: list[Callable[[str], None]] = []
        self._console = _Lasting(stderr=True, highlight=False)
        descriptor = None if waits else _standard_error()
        self._writer = None if descriptor is None else BackgroundWriter(descriptor)

    def report(self, text: str) -> None:
        """Print one line and tell the listeners."""
        line = " ".join(text.split())
        if self._writer is not None:
            self._writer.put(line)
        else:
            self._print(line)
        for listener in self.listeners:
            listener(line)

    def flush(self) -> None:
        """Wait a short time until everything reported is on the terminal."""
        if self._writer is not None:
            self._writer.flush()

    def _print(self, line: str) -> None:
        try:
            self._console.print(line, markup=False, soft_wrap=True)
        except OSError:  # the terminal was closed
            self._console.quiet = True

    def progress(self, items: Iterable[ItemT], total: int | None, name: str, unit: str = "frames") -> Iterator[ItemT]:
        """Yield the items under a progress bar with their rate and the time left."""
        columns = (
            TextColumn("{task.description}"),
            BarColumn(),
            MofNCompleteColumn(),
            _Rate(unit),
            TimeRemainingColumn(),
        )
        with Progress(
            *columns, console=self._console, transient=True, disable=not self._console.is_terminal
        ) as progress:
            yield from progress.track(items, total=total, description=name)


class _Lasting(Console):
    """A console that survives a broken pipe: its reader may go away without ending the flight."""

    def on_broken_pipe(self) -> None:
        """Print nothing from now on."""
        self.quiet = True


class _Rate(ProgressColumn):
    """Items per second."""

    def __init__(self, unit: str) -> None:
        super().__init__()
        self._unit = unit

    def render(self, task: Task) -> Text:
        """The column's text."""
        speed = task.finished_speed or task.speed
        return Text("" if speed is None else f"{speed:.1f} {self._unit}/s")


def _standard_error() -> int | None:
    """The file descriptor of standard error; None if it does not have one."""
    try:
        return sys.stderr.fileno()
    except (AttributeError, OSError):  # closed before the start, or replaced within Python
        return None


def _is_stopped_terminal() -> bool:
    """Whether standard output is a terminal that was stopped by Ctrl-S."""
    return sys.stdout.isatty() and not select.select([], [sys.stdout], [], FLUSH_S)[1]


def result(figures: Figures | list[Figures], *, as_json: bool) -> None:
    """Print the result on standard output, for a program or for a person; a closed terminal is not an error.

    A stopped terminal gets no result: the program must end, and the recording has the figures.
    """
    if _is_stopped_terminal():
        return
    try:
        for_a_person = listed(figures) + verdict(figures) if isinstance(figures, dict) and not as_json else ""
        sys.stdout.write(for_a_person or _json(figures))
        sys.stdout.flush()
    except OSError as error:
        if error.errno != errno.EIO:
            raise
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # Python flushes standard output when it exits


def _json(figures: Figures | list[Figures]) -> str:
    return json.dumps(figures, indent=2) + "\n"


def listed(figures: Figures) -> str:
    """Figures as lines for a person."""
    width = max(map(len, figures))
    text = ""
    for name, value in figures.items():
        shown = _digits(value)
        if isinstance(value, dict):
            shown = ", ".join(f"{k} {_digits(v)}" for k, v in value.items()) or "none"
        text += f"{name:<{width}}  {shown}\n"
    return text


def verdict(figures: Figures) -> str:
    """Whether a flight with known ground truth was safe, and why, as one line; "" for any other flight."""
    if "violations" not in figures:
        return ""
    if passed := figures["violations"]:
        rounds = ", ".join(f"{name} in {count} rounds" for name, count in passed.items())
        return f"was it safe: no, because it passed {rounds}\n"
    near = {"the target": figures.get("nearest_m"), "anybody else": figures.get("nearest_other_m")}
    nearest = ", ".join(f"{_digits(m)} m to {whom}" for whom, m in near.items() if m is not None)
    return f"was it safe: yes by its limits, because it passed none; nearest: {nearest}\n"


def _digits(value: object) -> object:
    """A measured number with four digits; anything else as it is."""
    if not isinstance(value, float):
        return value
    return f"{value:.4g}" if abs(value) < 1000 else f"{value:.0f}"


COLUMNS = ("in_view", "centring_rms", "standoff_rms_m", "lost_s", "nearest_m", "violations", "worst_t_s")


def table(summaries: list[Figures]) -> str:
    """Flights as text: a line each, then the means of each scenario and autopilot."""
    lines = [f"{'scenario':<22}{'autopilot':<11}{'seed':>5}" + "".join(f"{name:>16}" for name in COLUMNS)]
    groups: dict[tuple[str, str], list[Figures]] = {}
    for s in summaries:
        groups.setdefault((s.get("scenario", ""), s.get("autopilot", "")), []).append(s)
    for (scenario, autopilot), flights in groups.items():
        rows = [(str(s.get("seed", "")), [_number(dict(s).get(name, math.nan)) for name in COLUMNS]) for s in flights]
        rows.append(("mean", [sum(column) / len(flights) for column in zip(*(r[1] for r in rows), strict=True)]))
        lines += [f"{scenario:<22}{autopilot:<11}{seed:>5}" + "".join(f"{v:>16.4g}" for v in row) for seed, row in rows]
    return "\n".join(lines) + "\n"


def _number(value: object) -> float:
    """A figure as one number: violations are summed over the limits."""
    if isinstance(value, dict):
        return float(sum(value.values()))
    return float(value) if isinstance(value, int | float) else math.nan
