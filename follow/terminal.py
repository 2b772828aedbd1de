"""What a person at the terminal sees: messages and progress on standard error, the result on standard output."""

import json
import sys
from collections.abc import Callable, Iterable, Iterator
from typing import TypeVar

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, ProgressColumn, Task, TextColumn, TimeRemainingColumn
from rich.text import Text

from follow.summary import Figures

ItemT = TypeVar("ItemT")


class Terminal:
    """Standard error for a person.  `listeners` hear each message too (the recording is one)."""

    def __init__(self) -> None:
        self.listeners: list[Callable[[str], None]] = []
        self._console = Console(stderr=True, highlight=False)

    def report(self, text: str) -> None:
        """Print one line and tell the listeners."""
        line = " ".join(text.split())
        self._console.print(line, markup=False, soft_wrap=True)
        for listener in self.listeners:
            listener(line)

    def progress(self, items: Iterable[ItemT], total: int | None, name: str, unit: str = "frames") -> Iterator[ItemT]:
        """Pass the items on under a bar with their rate and the time left."""
        columns = (
            TextColumn("{task.description}"),
            BarColumn(),
            MofNCompleteColumn(),
            _Rate(unit),
            TimeRemainingColumn(),
        )
        with Progress(*columns, console=self._console, transient=True) as progress:
            yield from progress.track(items, total=total, description=name)


class _Rate(ProgressColumn):
    """Items per second."""

    def __init__(self, unit: str) -> None:
        super().__init__()
        self._unit = unit

    def render(self, task: Task) -> Text:
        """The column's text."""
        speed = task.finished_speed or task.speed
        return Text("" if speed is None else f"{speed:.1f} {self._unit}/s")


def result(figures: Figures | list[Figures], *, as_json: bool) -> None:
    """Print the result on standard output, for a program or for a person."""
    if as_json or isinstance(figures, list):
        sys.stdout.write(json.dumps(figures, indent=2) + "\n")
        return
    width = max(map(len, figures))
    for name, value in figures.items():
        shown = ", ".join(f"{k} {v:g}" for k, v in value.items()) if isinstance(value, dict) else value
        sys.stdout.write(f"{name:<{width}}  {shown}\n")
