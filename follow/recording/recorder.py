"""The recorder: ticks in, `flight.rrd`, `ticks.csv`, `settings.toml` and `summary.json` out.

The loop never waits for it.  A row of text is made at once and kept until written; pictures go to a worker through a
bounded queue that drops its oldest and counts the drops.  Where time is simulated nothing is late, so there the queue
may make the loop wait instead, and nothing is dropped.
"""

import itertools
import json
import threading
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, BinaryIO

from typing_extensions import Self

from follow.messages import Notify, Tick
from follow.ranges import require_numbers
from follow.recording.rows import header, row
from follow.recording.summary import Figures, Summary
from racf.box import Box

if TYPE_CHECKING:
    from follow.recording.rerun_log import LoggedTick, RerunRecording


FILES = ("flight.rrd", "flight.tlog", "ticks.csv", "settings.toml", "summary.json")
"""What a flight leaves in its folder."""

FLUSH_EVERY = 15
"""Ticks between two writes of the recording: a kill loses half a second at 30 pictures/s."""


@dataclass(frozen=True, slots=True)
class RecordConfig:
    """How the recording is made.  Raises ValueError for a number out of its range."""

    jpeg_quality: int = 75  # of 100; box and texture stay readable, a 640x360 picture takes some 40 kB
    pictures: bool = True  # write flight.rrd; without it ticks.csv and summary.json remain
    queue: int = 16  # pictures waiting for the writer: half a second at 30 pictures/s, 100 MB at full HD

    def __post_init__(self) -> None:
        require_numbers("record setting", self)
        if self.jpeg_quality > 100:
            raise ValueError(f"record setting jpeg_quality must lie in 1..100, not {self.jpeg_quality}")


def set_aside(out: Path) -> Path | None:
    """Move the flight that is in a folder into a new folder within it; None when there is none."""
    files = [out / name for name in FILES if (out / name).exists()]
    if not files:
        return None
    folder = next(path for n in itertools.count(1) if not (path := out / f"earlier-{n}").exists())
    folder.mkdir()
    for file in files:
        file.rename(folder / file.name)
    return folder


class Recorder:
    """Writes one flight into `out`.  Raises OSError when the folder or a file in it cannot be made."""

    def __init__(self, out: Path, config: RecordConfig, report: Notify, *, waits: bool, about: str = "") -> None:
        try:
            out.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise OSError(f"--out {str(out)!r} must be a folder that can be written: {error.strerror}") from None
        self.out = out
        self.summary = Summary()
        self.dropped = 0
        self._config, self._report, self._waits, self._about = config, report, waits, about
        self._rows = _File(out / "ticks.csv", report)
        self._flight = out / "flight.rrd"
        self._flight.unlink(missing_ok=True)
        self._rows.write(header().encode())
        self._change = threading.Condition()
        self._texts: deque[str] = deque()
        self._scenes: deque[tuple[int, Tick, Box | None]] = deque()
        self._said: deque[Callable[[RerunRecording], None]] = deque()
        self._closing = False
        self._count = 0
        self._worker = threading.Thread(target=self._work, name="recorder", daemon=True)
        self._worker.start()

    def tick(self, tick: Tick, truth: Box | None = None) -> None:
        """Record one round; `truth` is the target's annotated box in this picture, if known."""
        self.summary.add(tick)
        text = row(self._count, tick)
        with self._change:
            if self._waits:
                self._change.wait_for(lambda: len(self._scenes) < self._config.queue or not self._worker.is_alive())
            while len(self._scenes) >= self._config.queue:
                self._scenes.popleft()
                self.dropped += 1
            self._texts.append(text)
            self._scenes.append((self._count, tick, truth))
            self._change.notify_all()
        self._count += 1

    def message(self, text: str) -> None:
        """Record one line for a person."""
        self._say(lambda explanation: explanation.message(text))

    def settings(self, toml: str) -> None:
        """Record what the flight is flown with, also as a file that `--settings` takes."""
        file = _File(self.out / "settings.toml", self._report)
        file.write(toml.encode())
        file.close()
        self._say(lambda explanation: explanation.settings(toml))

    def close(self, figures: Figures | None = None) -> Figures:
        """Write what waits and the summary, with `figures` added; returns the summary."""
        with self._change:
            self._closing = True
            self._change.notify_all()
        self._worker.join()
        self._rows.write("".join(self._texts).encode())  # what a worker that broke has left
        self._rows.close()
        whole = {**self.summary.figures(), **(figures or {})}
        if self.dropped:
            whole["recording_dropped"] = self.dropped
        file = _File(self.out / "summary.json", self._report)
        file.write((json.dumps(whole, indent=2) + "\n").encode())
        file.close()
        return whole

    def _say(self, say: "Callable[[RerunRecording], None]") -> None:
        with self._change:
            self._said.append(say)
            self._change.notify_all()

    def _work(self) -> None:
        from follow.recording.rerun_log import RerunRecording  # noqa: PLC0415 - Rerun takes a second to load; the loop goes on

        explanation: RerunRecording | None = None
        if self._config.pictures:
            explanation = RerunRecording(self._flight, self._about, self._config.jpeg_quality)
        going = True
        while going:
            texts, scene, said, going = self._next()
            self._rows.write("".join(texts).encode())
            try:
                if explanation is not None:
                    self._explain(explanation, scene, said, close=not going)
            except OSError as error:
                self._report(str(error))
                explanation = None

    def _next(self) -> "tuple[list[str], LoggedTick | None, list[Callable[[RerunRecording], None]], bool]":
        """Wait for something to write: rows, a scene, what else was said, and whether more may come."""
        from follow.recording.rerun_log import LoggedTick  # noqa: PLC0415 - as above

        with self._change:
            self._change.wait_for(lambda: self._texts or self._scenes or self._said or self._closing)
            texts, said = list(self._texts), list(self._said)
            self._texts.clear()
            self._said.clear()
            scene = LoggedTick(*self._scenes.popleft()) if self._scenes else None
            self._change.notify_all()
            return texts, scene, said, not self._closing or scene is not None

    @staticmethod
    def _explain(
        explanation: "RerunRecording",
        scene: "LoggedTick | None",
        said: "list[Callable[[RerunRecording], None]]",
        *,
        close: bool,
    ) -> None:
        if scene is not None:
            explanation.tick(scene)
        for say in said:
            say(explanation)
        if close:
            explanation.close()
        elif scene is not None and scene.n % FLUSH_EVERY == 0:
            explanation.flush()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if not self._closing:
            self.close()


class _File:
    """A file whose failure is one line, once; after it nothing more is written, and the flight goes on."""

    def __init__(self, path: Path, report: Notify) -> None:
        self._path, self._report = path, report
        self._file: BinaryIO | None = path.open("wb")

    def write(self, data: bytes) -> None:
        """Write and flush."""
        if self._file is None or not data:
            return
        try:
            self._file.write(data)
            self._file.flush()
        except OSError as error:
            self._fail(error)

    def close(self) -> None:
        """Close it; what was written stays."""
        if self._file is not None:
            try:
                self._file.close()
            except OSError as error:
                self._fail(error)

    def _fail(self, error: OSError) -> None:
        self._report(f"{self._path} is no longer written: {error.strerror or error}")
        broken, self._file = self._file, None
        if broken is not None:
            try:
                broken.close()
            except OSError:
                return  # its last bytes could not be flushed: said above
