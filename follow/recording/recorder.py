"""The recorder: ticks in, `flight.rrd`, `ticks.csv`, `settings.toml` and `summary.json` out.

The loop never waits for it.  One thread writes rows, another one images and curves, each behind a bounded queue that
drops its oldest entry and counts the drops.  In a simulation the loop may wait for the queues instead, because nothing
is late there, and nothing is dropped.
"""

import json
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING

import numpy as np
from typing_extensions import Self

from follow.disk import BackgroundFile, OnceEach, WholeFile, unwritten
from follow.messages import Notify, Tick
from follow.ranges import require_numbers
from follow.recording.exact import ExactWriter, Setup
from follow.recording.folder import CALIBRATION
from follow.recording.rows import Desired, LoggedTick, header, row, utc
from follow.recording.summary import Figures, Summary
from follow.recording.video_encoder import Encoder
from follow.recording.worker import Worker
from racf.box import Box

if TYPE_CHECKING:
    from follow.recording.rerun_log import RerunRecording

REPLACED = ("flight.rrd", "flight.png", "report.html", "refly.html", "settings.toml", "summary.json", CALIBRATION)
"""Files that a new recording deletes first: if this flight breaks off, old ones would pass for its own."""

VIEW_QUEUE = 2  # queue of frames for a viewer: only the newest matter
VIEW_CLOSE_S = 5.0  # timeout for a viewer at the end

NO_IMAGE = np.empty((0, 0, 3), np.uint8)


@dataclass(frozen=True, slots=True)
class RecordConfig:
    """How the recording is made.  Raises ValueError for a number out of its range."""

    encoder: Encoder = Encoder.AUTO
    """Compression of the frames: auto (the board's own H.264 encoder, else libx264), libx264, h264_v4l2m2m, h264_nvenc,
    or jpeg, which takes ten times the space."""
    jpeg_quality: int = 75  # JPEG quality, 1 to 100: at 75 a 640x360 image takes some 40 kB.
    pictures: bool = True  # Write flight.rrd with its images; ticks.csv and summary.json are always written.
    queue: int = 16  # Frames that may wait for the writer: half a second at 30 frames/s, 100 MB at full HD.

    def __post_init__(self) -> None:
        require_numbers("record setting", self)
        if self.jpeg_quality > 100:
            raise ValueError(f"record setting jpeg_quality must lie in 1..100, not {self.jpeg_quality}")


class RecordingError(RuntimeError):
    """The recording broke by a bug; the message is one sentence for a person."""


class Rows:
    """`ticks.csv`, a row for each tick."""

    def __init__(self, path: Path, report: Notify) -> None:
        self._file = BackgroundFile(path, report)
        self._file.write(header().encode())

    def add(self, scene: LoggedTick, start_s: float, started_unix_s: float | None) -> None:
        """Write one row."""
        self._file.write(row(scene.n, scene.tick, start_s, started_unix_s).encode())

    @property
    def lost(self) -> int:
        """Number of rows that are not in the file."""
        return self._file.lost

    def close(self) -> None:
        """Write the rest."""
        self._file.close()


class Recorder:
    """Writes one flight into `out`.  Raises OSError if it cannot make a file there.

    `waits` lets the loop wait for the queues.  `clock` is the wall clock, seconds since 1970, read once, at the first
    tick; None in a simulation, whose recording then holds no wall-clock time.  With `setup` the flight can be flown
    again (`follow refly`); `view` shows it while it flies (`follow.recording.view`).  `failure` describes a bug that
    broke the recording: the run must then not count as good.
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
        desired: Desired | None = None,
        setup: Setup | None = None,
        view: str | None = None,
    ) -> None:
        self.out = out
        self.summary = Summary()
        self._report = report = OnceEach(report)
        self._clock = clock
        self._start_s: float | None = None
        self._start_unix_s: float | None = None
        self._t_s = 0.0
        self._closed = False
        self._count = 0
        self._flight = out / "flight.rrd"
        try:
            for name in REPLACED:
                (out / name).unlink(missing_ok=True)
            self._rows = Rows(out / "ticks.csv", report)
            self._exact = ExactWriter(out / "messages.jsonl.gz", setup, report) if setup is not None else None
        except OSError as error:
            raise OSError(f"--out {str(out)!r} must be a folder that can be written: {error.strerror}") from None

        def make() -> "RerunRecording":
            from follow.recording.rerun_log import to_file  # noqa: PLC0415 - Rerun takes a second to load: not in the loop

            return to_file(self._flight, about, config.encoder, config.jpeg_quality, desired)

        self._images: Worker[RerunRecording] | None = None
        if config.pictures:
            self._images = Worker("the recording", make, report, config.queue, waits=waits)
        self._view: Worker[RerunRecording] | None = None
        if view is not None:

            def show() -> "RerunRecording":
                from follow.recording.view import to_viewer  # noqa: PLC0415 - as above

                return to_viewer(view, about, desired, report)

            self._view = Worker("the view", show, report, VIEW_QUEUE, waits=False)

    @property
    def _workers(self) -> "list[Worker[RerunRecording]]":
        return [worker for worker in (self._images, self._view) if worker is not None]

    @property
    def failure(self) -> str:
        """The bug that broke the recording; empty if there was none."""
        return self._images.failure if self._images is not None else ""

    def tick(self, tick: Tick, truth: Box | None = None) -> None:
        """Record one round; `truth` is the target's annotated box in this image, if known."""
        start_s = self._started(tick.state.t_s)
        self._t_s = tick.state.t_s - start_s
        self.summary.add(tick)
        scene = LoggedTick(self._count, self._t_s, tick, truth)
        light = replace(scene, tick=without_images(tick))
        self._rows.add(light, start_s, self._start_unix_s)
        if self._exact is not None:
            self._exact.add(light.tick, truth, self._start_unix_s)
        for worker in self._workers:
            worker.put(lambda recording: recording.tick(light), lambda recording: recording.images(scene))
        self._count += 1

    def message(self, text: str) -> None:
        """Record one line for a person, at the present time of the flight."""
        t_s = self._t_s
        if self._exact is not None:
            self._exact.message(t_s, text)
        for worker in self._workers:
            worker.put(lambda recording: recording.message(t_s, text))

    def settings(self, toml: str, calibration: str = "") -> None:
        """Record the flight's settings, also as a file that `--settings` takes, and a copy of its calibration file."""
        self._write("settings.toml", toml.encode())
        if calibration:
            try:
                self._write(CALIBRATION, Path(calibration).read_bytes())
            except OSError as error:  # it could be read before the flight, but not any more
                self._report(f"{calibration} is not copied into the recording: {error.strerror}")
        for worker in self._workers:
            worker.put(lambda recording: recording.settings(toml))

    def _write(self, name: str, data: bytes) -> None:
        """Write a whole file, or none and report why."""
        path = self.out / name
        try:
            file = BackgroundFile(path, self._report, open_file=WholeFile)
        except OSError as error:
            self._report(unwritten(path, error))
            return
        file.write(data)
        file.close()

    def close(self, figures: Figures | None = None) -> Figures:
        """Write the rest of the queues and the summary with `figures` added; returns the summary."""
        self._closed = True
        if self._images is not None:
            self._images.close()
        if self._view is not None:
            self._view.close(VIEW_CLOSE_S)
        self._rows.close()
        if self._exact is not None:
            self._exact.close()
        whole = self.summary.figures()
        if self._start_unix_s is not None:
            whole["started_utc"] = utc(self._start_unix_s)
        whole.update(figures or Figures())
        if self._images is not None and self._images.dropped:
            whole["recording_dropped"] = self._images.dropped
        if self._rows.lost:
            whole["rows_lost"] = self._rows.lost
        self._write("summary.json", (json.dumps(whole, indent=2) + "\n").encode())
        return whole

    def _started(self, t_s: float) -> float:
        """The first tick's time, which is `t_s` if this is the first."""
        if self._start_s is None:
            self._start_s = t_s
            if self._clock is not None:
                self._start_unix_s = self._clock()
                self.message(f"the recording starts at {utc(self._start_unix_s)}")
        return self._start_s

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if not self._closed:
            self.close()


def without_images(tick: Tick) -> Tick:
    """The same round without its large arrays: the image, the response and the mask."""
    frame = tick.frame and replace(tick.frame, image=NO_IMAGE)
    track = tick.track and replace(tick.track, response=None, mask=None, mask_box=None)
    return replace(tick, frame=frame, track=track)
