"""One box through one video or folder of images: what `racf track` does."""

import csv
from collections.abc import Callable, Generator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from time import perf_counter

import cv2
import numpy as np
from numpy.typing import NDArray

from racf.box import Box, tiny_line
from racf.errors import UsageError
from racf.evaluate.boxfiles import read_boxes, write_boxes
from racf.evaluate.images import rows_of
from racf.evaluate.metrics import Boxes, Convention, Score, score
from racf.evaluate.runner import TrackerBuilder, naming
from racf.texture import is_featureless
from racf.track import Track
from racf.video import Video
from racf.video_writer import SUFFIXES, VideoWriter

COLUMNS = ("frame", "x_px", "y_px", "w_px", "h_px", "confidence", "found", "refined", "psr", "apce", "tracker_ms")
OVERLAY_FPS = 30.0  # for a folder of images, whose rate is unknown
FOUND, LOST, ANNOTATION = (0, 220, 0), (0, 0, 255), (255, 255, 255)  # BGR


@dataclass(frozen=True, slots=True, eq=False)
class Tracked:
    """The tracker's results, one for each frame (the first is the start), and the milliseconds that each took."""

    tracks: list[Track]
    ms: list[float]

    @property
    def boxes(self) -> Boxes:
        """(frames, 4): x, y, w, h in 0-based pixels."""
        return np.array([[t.box.x, t.box.y, t.box.w, t.box.h] for t in self.tracks], dtype=np.float64)

    @property
    def fps(self) -> float:
        """Frames per second of the tracker's own time."""
        return 1000 * (len(self.ms) - 1) / sum(self.ms[1:]) if sum(self.ms[1:]) else 0.0

    def score(self, truth: Boxes, convention: Convention = Convention.TOOLKIT) -> Score:
        """Judge the boxes by an annotation in 1-based pixels, over the frames that it has."""
        frames = min(len(truth), len(self.tracks))
        return score(self.boxes[:frames] + np.array([1, 1, 0, 0]), truth[:frames], convention)

    def write(self, out: Path) -> Path:
        """Write the boxes to `out`, and beside it, as .csv, the same with confidence and found; returns that file."""
        out.parent.mkdir(parents=True, exist_ok=True)
        write_boxes(out, self.boxes)
        beside = out.with_suffix(".csv")
        with beside.open("w", newline="") as file:
            rows = csv.writer(file)
            rows.writerow(COLUMNS)
            for frame, (t, ms) in enumerate(zip(self.tracks, self.ms, strict=True)):
                place = (f"{v:.3f}" for v in (t.box.x, t.box.y, t.box.w, t.box.h))
                sharp = (*("" if np.isnan(v) else f"{v:.3f}" for v in (t.psr, t.apce)), f"{ms:.3f}")
                rows.writerow([frame, *place, f"{t.confidence:.4f}", int(t.found), int(t.refined), *sharp])
        return beside


def require_outputs(source: Path, truth: Path | None, out: Path, overlay: Path | None) -> None:
    """Raise UsageError if boxes, their .csv or the overlay would overwrite an input, each other, or another's file.

    An earlier run's files alone may be overwritten: its .csv beside the boxes has our columns.  So an annotation stays.
    """
    beside = out.with_suffix(".csv")
    written = {"--out": out, "the .csv beside --out": beside, "--overlay": overlay}
    for option, path in written.items():
        for what, given in (("source", source), ("annotation", truth)):
            if path is not None and given is not None and _is_same(path, given):
                raise UsageError(f"{option} would overwrite the {what}, {given}: give another name")
    if overlay is not None and (_is_same(overlay, out) or overlay.absolute() == out.absolute()):
        raise UsageError(f"--out and --overlay are one file, {out}: give another name")
    for path in (out, beside, overlay):
        if path is not None and path.is_file() and not _is_ours(beside):
            raise UsageError(f"{path} exists and was not written by racf track: delete it, or give another name")


def _is_same(one: Path, other: Path) -> bool:
    """Whether both name the same file, links resolved."""
    return one.exists() and other.exists() and one.samefile(other)


def _is_ours(beside: Path) -> bool:
    try:
        with beside.open(encoding="utf-8", errors="replace") as file:
            return file.readline().strip() == ",".join(COLUMNS)
    except OSError:
        return False


def read_truth(path: Path) -> tuple[Boxes, Box]:
    """An annotation in 1-based pixels, and the target that its first row shows, in 0-based ones."""
    truth = read_boxes(path)
    x, y, w, h = (float(v) for v in truth[0])
    try:
        return truth, Box(x - 1, y - 1, w, h)
    except ValueError as error:
        raise ValueError(f"{path}: the first annotation cannot start a tracker: {error}") from None


def track(
    source: Path,
    target: Box,
    spec: TrackerBuilder,
    truth: Boxes | None = None,
    overlay: Path | None = None,
    notify: Callable[[str], None] = lambda _line: None,
    into: Tracked | None = None,
) -> Tracked:
    """Follow `target` from the first image of a video file or folder of images to the last.

    `overlay` names a video to write, in which the tracker's box (green, red while it is not found), its confidence
    and the annotation `truth` (white, 1-based) are drawn.  `notify` is told if the target reaches out of the image,
    once if it is tiny, and what a video lacks: a frame that does not decode has the last box, not found.  The answers
    go `into` an empty Tracked, where they stay when something is raised.
    Raises ValueError or OSError for what cannot be read, TrackerError if the tracker fails.
    """
    done = Tracked([], []) if into is None else into
    tracker, tracks, times, tiny = spec.build(), done.tracks, done.ms, ""
    with _writer(overlay, source) as write:
        for image in rows_of(source, notify):
            if image is None:  # a frame that does not decode keeps its row
                tracks.append(replace(tracks[-1], found=False))
                times.append(0.0)
                continue
            if not tracks and (line := _start(target, image)):
                notify(line)
            with naming(spec.label, f"{source}, frame {len(tracks)}"):
                began = perf_counter()
                answer = tracker.update(image) if tracks else tracker.init(image, target)
                spent_ms = 1000 * (perf_counter() - began)
            if not tiny and answer.found and (tiny := tiny_line(answer.box)):
                notify(f"frame {len(tracks)}: {tiny}")
            if write is not None:
                row = truth[len(tracks)] if truth is not None and len(tracks) < len(truth) else None
                write.put(drawn(image, answer, row))
            tracks.append(answer)
            times.append(spent_ms)
    return done


def _start(target: Box, image: NDArray[np.uint8]) -> str:
    try:
        line = target.as_start(image.shape[1], image.shape[0])
    except ValueError as error:
        raise UsageError(str(error)) from None
    if is_featureless(image, target):
        return f"target {target} has no edges in one direction or in both: nothing that is found there can be believed"
    return line


def drawn(image: NDArray[np.uint8], track: Track, truth: NDArray[np.float64] | None) -> NDArray[np.uint8]:
    """A copy of a BGR image with the tracker's box and confidence, and the annotation (x, y, w, h, 1-based) if any."""
    copy = np.array(image, dtype=np.uint8)
    if truth is not None and np.isfinite(truth).all():
        _rectangle(copy, (truth[0] - 1, truth[1] - 1, truth[2], truth[3]), ANNOTATION)
    box, colour = track.box, FOUND if track.found else LOST
    _rectangle(copy, (box.x, box.y, box.w, box.h), colour)
    text = f"{track.confidence:.2f}" + ("" if track.found else " lost")
    cv2.putText(copy, text, (round(box.x), max(round(box.y) - 4, 12)), cv2.FONT_HERSHEY_SIMPLEX, 0.5, colour, 1)
    return copy


def _rectangle(image: NDArray[np.uint8], box: tuple[float, float, float, float], colour: tuple[int, int, int]) -> None:
    x, y, w, h = box
    cv2.rectangle(image, (round(x), round(y)), (round(x + w), round(y + h)), colour, 1)


@contextmanager
def _writer(overlay: Path | None, source: Path) -> Generator[VideoWriter | None]:
    if overlay is None:
        yield None
        return
    if overlay.suffix.lower() not in SUFFIXES:
        raise UsageError(f"an overlay is a video file ({', '.join(SUFFIXES)}), not {overlay}")
    with VideoWriter(overlay, _fps_of(source)) as video:
        yield video


def _fps_of(source: Path) -> float:
    if source.is_dir():
        return OVERLAY_FPS
    with Video(source) as video:
        return video.fps
