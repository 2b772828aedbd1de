"""The recorder: ticks in, `flight.rrd`, `ticks.csv`, `settings.toml` and `summary.json` out.

The loop never waits for it.  Rows of text are kept until they are written; images go to a worker thread through a
bounded queue that drops its oldest entry and counts the drops.  In a simulation the loop may wait for the queue
instead, because nothing is late there, and nothing is dropped.
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
from follow.recording.rows import LoggedTick, header, row, utc
from follow.recording.summary import Figures, Summary
from racf.box import Box

if TYPE_CHECKING:
    from follow.recording.rerun_log import RerunRecording


FILES = ("flight.rrd", "flight.tlog", "flight.png", "ticks.csv", "settings.toml", "summary.json")
"""What a flight leaves in its folder."""

REPLACED = ("flight.rrd", "flight.png")
"""What a new recording deletes: an old one would be taken for this flight's if this one breaks off."""

FLUSH_EVERY = 15
"""Ticks between two writes of the recording: a kill loses half a second at 30 frames/s."""


@dataclass(frozen=True, slots=True)
class RecordConfig:
    """How the recording is made.  Raises ValueError for a number out of its range."""

    jpeg_quality: int = 75  # JPEG quality, 1 to 100: at 75 a 640x360 image takes some 40 kB.
    pictures: bool = True  # Write flight.rrd with its images; ticks.csv and summary.json are always written.
    queue: int = 16  # Frames that may wait for the writer: half a second at 30 frames/s, 100 MB at full HD.

    def __post_init__(self) -> None:
        require_numbers("record setting", self)
        if self.jpeg_quality > 100:
            raise ValueError(f"record setting jpeg_quality must lie in 1..100, not {self.jpeg_quality}")


def set_aside(out: Path) -> Path | None:
    """Move the flight that a folder holds into a new folder inside it; None if the folder holds no flight."""
    files = [out / name for name in FILES if (out / name).exists()]
    if not files:
        return None
    folder = next(path for n in itertools.count(1) if not (path := out / f"earlier-{n}").exists())
    folder.mkdir()
    for file in files:
        file.rename(folder / file.name)
    return folder


class Recorder:
    """Writes one flight into `out`.  Raises OSError if it cannot make the folder or a file in it.

    `waits` lets the loop wait for the queue.  `clock` is the wall clock, seconds since 1970, read once, at the first
    tick; None in a simulation, whose recording then holds no wall-clock time.
    """

    def __init__(
        self,
        out: Path,
        config: RecordConfig,
        report: Notify,
        *,
        waits: bool,
        about: str = "",
        clock: Callable[[], float] | None = None,
    ) -> None:
        try:
            out.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise OSError(f"--out {str(out)!r} must be a folder that can be written: {error.strerror}") from None
        self.out = out
        self.summary = Summary()
        self.dropped = 0
        self._config, self._report, self._waits, self._about = config, report, waits, about
        self._clock = clock
        self._start_s: float | None = None
        self._start_unix_s: float | None = None
        self._t_s = 0.0
        self._rows = _File(out / "ticks.csv", report)
        self._flight = out / "flight.rrd"
        for name in REPLACED:
            (out / name).unlink(missing_ok=True)
        self._rows.write(header().encode())
        self._change = threading.Condition()
        self._texts: deque[str] = deque()
        self._scenes: deque[LoggedTick] = deque()
        self._said: deque[Callable[[RerunRecording], None]] = deque()
        self._closing = False
        self._count = 0
        self._worker = threading.Thread(target=self._work, name="recorder", daemon=True)
        self._worker.start()

    def tick(self, tick: Tick, truth: Box | None = None) -> None:
        """Record one round; `truth` is the target's annotated box in this image, if known."""
        start_s = self._started(tick.state.t_s)
        self._t_s = tick.state.t_s - start_s
        self.summary.add(tick)
        text = row(self._count, tick, start_s, self._start_unix_s)
        with self._change:
            if self._waits:
                self._change.wait_for(lambda: len(self._scenes) < self._config.queue or not self._worker.is_alive())
            while len(self._scenes) >= self._config.queue:
                self._scenes.popleft()
                self.dropped += 1
            self._texts.append(text)
            self._scenes.append(LoggedTick(self._count, self._t_s, tick, truth))
            self._change.notify_all()
        self._count += 1

    def message(self, text: str) -> None:
        """Record one line for a person, at the present time of the flight."""
        t_s = self._t_s
        self._say(lambda recording: recording.message(t_s, text))

    def settings(self, toml: str) -> None:
        """Record the flight's settings, also as a file that `--settings` takes."""
        file = _File(self.out / "settings.toml", self._report)
        file.write(toml.encode())
        file.close()
        self._say(lambda recording: recording.settings(toml))

    def close(self, figures: Figures | None = None) -> Figures:
        """Write what is still queued and the summary with `figures` added; returns the summary."""
        with self._change:
            self._closing = True
            self._change.notify_all()
        self._worker.join()
        self._rows.write("".join(self._texts).encode())  # anything left by a worker that failed
        self._rows.close()
        whole = self.summary.figures()
        if self._start_unix_s is not None:
            whole["started_utc"] = utc(self._start_unix_s)
        whole.update(figures or Figures())
        if self.dropped:
            whole["recording_dropped"] = self.dropped
        file = _File(self.out / "summary.json", self._report)
        file.write((json.dumps(whole, indent=2) + "\n").encode())
        file.close()
        return whole

    def _started(self, t_s: float) -> float:
        """The first tick's time, which is `t_s` if this is the first."""
        if self._start_s is None:
            self._start_s = t_s
            if self._clock is not None:
                self._start_unix_s = self._clock()
                self.message(f"the recording starts at {utc(self._start_unix_s)}")
        return self._start_s

    def _say(self, say: "Callable[[RerunRecording], None]") -> None:
        with self._change:
            self._said.append(say)
            self._change.notify_all()

    def _work(self) -> None:
        from follow.recording.rerun_log import RerunRecording  # noqa: PLC0415 - Rerun takes a second to load; the loop goes on

        recording: RerunRecording | None = None
        if self._config.pictures:
            recording = RerunRecording(self._flight, self._about, self._config.jpeg_quality)
        going = True
        while going:
            texts, scene, said, going = self._next()
            self._rows.write("".join(texts).encode())
            try:
                if recording is not None:
                    self._log(recording, scene, said, close=not going)
            except OSError as error:
                self._report(str(error))
                recording = None

    def _next(self) -> "tuple[list[str], LoggedTick | None, list[Callable[[RerunRecording], None]], bool]":
        """Wait for something to write: rows, a tick, messages, and whether more may come."""
        with self._change:
            self._change.wait_for(lambda: self._texts or self._scenes or self._said or self._closing)
            texts, said = list(self._texts), list(self._said)
            self._texts.clear()
            self._said.clear()
            scene = self._scenes.popleft() if self._scenes else None
            self._change.notify_all()
            return texts, scene, said, not self._closing or scene is not None

    @staticmethod
    def _log(
        recording: "RerunRecording",
        scene: LoggedTick | None,
        said: "list[Callable[[RerunRecording], None]]",
        *,
        close: bool,
    ) -> None:
        if scene is not None:
            recording.tick(scene)
        for say in said:
            say(recording)
        if close:
            recording.close()
        elif scene is not None and scene.n % FLUSH_EVERY == 0:
            recording.flush()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if not self._closing:
            self.close()


class _File:
    """A file that reports its first error in one line and then writes nothing more; the flight goes on."""

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
        self._report(f"{self._path} is no longer written: {error.strerror or error}; the flight goes on")
        broken, self._file = self._file, None
        if broken is not None:
            try:
                broken.close()
            except OSError:
                return  # the report above covers its last bytes
