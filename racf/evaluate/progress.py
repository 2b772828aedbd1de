"""A progress bar on standard error with frames per second and the time left."""

import sys
from collections.abc import Generator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, ProgressColumn, Task, TextColumn, TimeRemainingColumn
from rich.text import Text

from racf.evaluate import runner


class FramesPerSecond(ProgressColumn):
    """Frames of all processes together, per second."""

    def render(self, task: Task) -> Text:
        """The speed so far, or nothing before the first sequence ends."""
        return Text(f"{task.speed:.0f} frames/s" if task.speed else "")


class Bar:
    """Counts the frames of finished tasks; those found on disk reduce the total instead of counting as speed."""

    def __init__(self, progress: Progress, frames: int) -> None:
        self._progress = progress
        self._task = progress.add_task("tracking", total=frames)
        self._frames = frames

    def done(self, task: runner.Task, run: runner.SequenceRun, stored: bool) -> None:
        """Count a finished task."""
        if stored:
            self._frames -= len(task.frames)
            self._progress.update(self._task, total=self._frames)
        else:
            text = f"{task.spec.label} {task.sequence}" + (f" start {task.start}" if task.start else "")
            self._progress.update(self._task, description=text, advance=len(run.boxes))


@contextmanager
def bar(todo: list[runner.Task]) -> Generator[Bar]:
    """A bar while tasks run."""
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("frames"),
        FramesPerSecond(),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=Console(file=sys.stderr)) as progress:
        yield Bar(progress, sum(len(task.frames) for task in todo))
