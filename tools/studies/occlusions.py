"""Behaviour of a tracker in slow occlusions: synthetic occlusions on the study's twenty sequences.

    python -m tools.studies.occlusions DATA [--tracker racf,robust] [--against racf] [--seed N]
                                       [--jobs N] [--dask ADDRESS]

DATA is that of `tools.studies.halves`.  It has few real occlusions, and a single one can dominate a figure.  Here a
piece of the sequence's own background passes over the annotated target, up to EVENTS times a sequence: fewer where it
is too short or the target is absent.  Each is a fresh start on the annotated box, LEAD frames before the piece touches
the target.  The piece takes FASTEST to SLOWEST frames to pass, from a random side and with a random size; AFTER frames
follow.  Its size and path are based on the target's first size, so that a target that grows is covered less and longer.
The piece may show another car or person.

A frame counts as false if the tracker calls the target found and its box has no overlap with the annotation.  An event
ends kept (found, overlap above 0.3), false, lost, or between (found, an overlap up to 0.3).  Intervals are 95 %, by
drawing sequences with replacement; differences are paired by event.
"""

import argparse
import sys
import zlib
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from racf.box import Box
from racf.commandline import guarded
from racf.evaluate.benchmarks import Sequence
from racf.evaluate.images import FrameCache
from racf.evaluate.metrics import overlaps
from racf.evaluate.runner import TrackerBuilder, warm_up
from racf.evaluate.trackers import TrackerSpec
from racf.parallel import each
from racf.threads import one_core
from tools.studies.halves import HALVES, processes, read_halves, tracker_label, whole
from tools.studies.reliability import ON_ABOVE, RESAMPLES, corner

EVENTS = 8  # of a sequence
LEAD, AFTER = 25, 30  # frames before and after the piece passes the target
FASTEST, SLOWEST = 10, 60  # frames in which it passes
SIZES = (0.7, 1.5)  # of the piece, in target's sides: half of its area to all of it for a while
CLEAR = 1.5  # times the target's box: where no piece is taken from
TRIES = 50  # at a piece of background
OUTCOMES = ("kept", "between", "lost", "false")

Image = NDArray[np.uint8]
Boxes = NDArray[np.float64]  # (frames, 4), 0-based pixels

_ONE_BASED = np.array([1.0, 1.0, 0.0, 0.0])  # an annotation's x, y, w, h less those of a box here
_IMAGES = FrameCache(max_bytes=900_000_000)  # the events of a sequence share its images


@dataclass(frozen=True, slots=True)
class Event:
    """A start and the piece that passes: `frames` of `sequence` beginning with number `first`.

    piece: a box in the first of these images; way: its centre's distance from the target's, px, when it touches the
    target, in x and y; crossing: frames in which it comes to the other side.
    """

    sequence: str
    first: int
    frames: tuple[Path, ...]
    piece: tuple[int, int, int, int]
    way: tuple[float, float]
    crossing: int

    def centre(self, frame: int, target: Boxes) -> tuple[float, float]:
        """Where the piece's centre is in a frame; target: its row of boxes."""
        passed = 1.0 - 2.0 * (frame - LEAD) / self.crossing  # 1 touches, 0 hides, -1 has left
        x, y, w, h = target
        return x + w / 2 + passed * self.way[0], y + h / 2 + passed * self.way[1]


@dataclass(frozen=True, slots=True)
class Judged:
    """Number of frames from the touch on, how many of them are false, and how the event ends."""

    frames: int
    false: int
    end: str


def drawn(sequence: Sequence, seed: int) -> Iterator[Event]:
    """The events of a sequence, the same for each tracker."""
    rng = np.random.default_rng([zlib.crc32(sequence.name.encode()), seed])
    boxes = truth_of(sequence)
    there = np.all(np.isfinite(boxes), axis=1) & np.all(boxes[:, 2:] > 0, axis=1)
    rows, cols = _IMAGES.read(sequence.frames[0]).shape[:2]
    for _ in range(EVENTS):
        crossing = int(rng.integers(FASTEST, SLOWEST + 1))
        length = min(LEAD + crossing + AFTER, len(boxes))
        crossing = length - LEAD - AFTER
        first = int(rng.integers(0, len(boxes) - length + 1))
        if crossing < FASTEST or not there[first : first + length].all():
            continue
        target = Box(*(float(v) for v in boxes[first]))
        w, h = (max(round(side * rng.uniform(*SIZES)), 3) for side in (target.w, target.h))
        angle = rng.uniform(0, 2 * np.pi)
        touch_px = 0.5 * min(
            (target.w + w) / max(abs(np.cos(angle)), 1e-9), (target.h + h) / max(abs(np.sin(angle)), 1e-9)
        )
        piece = _background(rng, target, (w, h), (rows, cols))
        if piece is not None:
            way = touch_px * float(np.cos(angle)), touch_px * float(np.sin(angle))
            yield Event(sequence.name, first, sequence.frames[first : first + length], piece, way, crossing)


def _background(
    rng: np.random.Generator, target: Box, size: tuple[int, int], shape: tuple[int, int]
) -> tuple[int, int, int, int] | None:
    """A box (x, y, w, h) of this size near the target but clear of it, in an image of (rows, columns).

    None if no draw fits.
    """
    w, h = size
    reach = 3.0 * max(target.w, target.h, w, h)
    for _ in range(TRIES):
        x, y = (round(c + rng.uniform(-reach, reach)) for c in (target.centre_x, target.centre_y))
        inside = min(x, y) >= 0 and x + w <= shape[1] and y + h <= shape[0]
        if inside and target.scaled(CLEAR).intersection(Box(x, y, w, h)) <= 0:
            return x, y, w, h
    return None


def truth_of(sequence: Sequence) -> Boxes:
    """The annotation in 0-based pixels, (frames, 4)."""
    return np.asarray(sequence.truth, np.float64) - _ONE_BASED


def hidden(image: Image, piece: Image, centre: tuple[float, float]) -> Image:
    """The image with the piece drawn at a centre, to a whole pixel; parts outside the image are not drawn."""
    (rows, cols), (h, w) = image.shape[:2], piece.shape[:2]
    left, top = round(centre[0] - w / 2), round(centre[1] - h / 2)
    x0, y0, x1, y1 = max(left, 0), max(top, 0), min(left + w, cols), min(top + h, rows)
    if x0 < x1 and y0 < y1:
        image[y0:y1, x0:x1] = piece[y0 - top : y1 - top, x0 - left : x1 - left]
    return image


def watch(event: Event, spec: TrackerBuilder, truth: Mapping[str, Boxes]) -> Judged:
    """Run one event."""
    one_core()
    warm_up(spec)
    cv2.setRNGSeed(0)
    target = truth[event.sequence][event.first : event.first + len(event.frames)]
    image = _IMAGES.read(event.frames[0])
    x, y, w, h = event.piece
    piece = image[y : y + h, x : x + w].copy()
    tracker = spec.build()
    tracker.init(hidden(image, piece, event.centre(0, target[0])), Box(*(float(v) for v in target[0])))
    tracks = [
        tracker.update(hidden(_IMAGES.read(path), piece, event.centre(k, target[k])))
        for k, path in enumerate(event.frames[1:], 1)
    ]
    overlap = overlaps(np.array([corner(track.box) for track in tracks]), target[1:] + _ONE_BASED)
    found = np.array([track.found for track in tracks])
    false = (overlap <= 0) & found
    touched = false[LEAD - 1 :]  # the first of `tracks` is of frame 1
    return Judged(len(touched), int(np.sum(touched)), _end(float(overlap[-1]), bool(found[-1])))


def _end(overlap: float, found: bool) -> str:
    if not found:
        return "lost"
    return "false" if overlap <= 0 else "kept" if overlap > ON_ABOVE else "between"


def run(
    label: str, events: list[Event], truth: Mapping[str, Boxes], jobs: int, dask: str | None
) -> dict[Event, Judged]:
    """All events of one tracker."""
    judge = partial(watch, spec=TrackerSpec.parse(label), truth=truth)
    done = dict(each(judge, events, jobs, dask))
    return {event: done[event] for event in events}


def false_share(judged: list[Judged]) -> float:
    """Percent of the frames from the touch on that are false."""
    return 100 * sum(j.false for j in judged) / max(sum(j.frames for j in judged), 1)


def ends(judged: list[Judged], outcome: str) -> float:
    """Percent of the events that end in this way."""
    return 100 * sum(j.end == outcome for j in judged) / max(len(judged), 1)


MEASURES: dict[str, Callable[[list[Judged]], float]] = {
    "false frames": false_share, **{f"end {outcome}": partial(ends, outcome=outcome) for outcome in OUTCOMES}
}  # fmt: skip


def differences(ours: dict[Event, Judged], theirs: dict[Event, Judged] | None, name: str) -> tuple[float, float, float]:
    """A measure, or its difference from theirs, with its 95 % interval, over sequences."""
    names, measure, rng = sorted({event.sequence for event in ours}), MEASURES[name], np.random.default_rng(0)
    by_name = {n: [event for event in ours if event.sequence == n] for n in names}

    def value(chosen: list[str]) -> float:
        events = [event for n in chosen for event in by_name[n]]
        less = measure([theirs[event] for event in events]) if theirs is not None else 0.0
        return measure([ours[event] for event in events]) - less

    draws = [value([names[k] for k in rng.integers(0, len(names), len(names))]) for _ in range(RESAMPLES)]
    low, high = np.percentile(draws, [2.5, 97.5])
    return value(names), float(low), float(high)


def table(ours: dict[Event, Judged], theirs: dict[Event, Judged] | None) -> str:
    """All measures over all sequences with their intervals, and over either half."""
    sign = "+" if theirs is not None else ""
    lines = ["| percent | all | half A | half B |", "|---|---|---|---|"]
    for name in MEASURES:
        mean, low, high = differences(ours, theirs, name)
        halves = []
        for inside in HALVES.values():
            part = {event: judged for event, judged in ours.items() if event.sequence in inside}
            halves.append(f"{differences(part, theirs, name)[0]:{sign}.1f}" if part else "-")
        lines.append(f"| {name} | {mean:{sign}.1f} ({low:{sign}.1f}..{high:{sign}.1f}) | {' | '.join(halves)} |")
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description="What a tracker does when something slowly hides its target.")
    parser.add_argument("data", type=Path)
    parser.add_argument("--only", action="append", help="only this sequence; can be given several times")
    parser.add_argument("--tracker", type=tracker_label, action="append", help="default: racf,robust")
    parser.add_argument("--against", type=tracker_label, help="print the differences from this tracker too")
    parser.add_argument("--seed", type=whole, default="0", help="other events with another number")
    parser.add_argument("--jobs", type=processes, default="0", help="number of processes; 0: one for each core")
    parser.add_argument("--dask", help="address of a running Dask scheduler")
    args = parser.parse_args()
    try:
        sequences = read_halves(args.data, args.only)
    except (OSError, ValueError) as error:
        parser.error(str(error))
    truth = {sequence.name: truth_of(sequence) for sequence in sequences}
    events = [event for sequence in sequences for event in drawn(sequence, args.seed)]
    if not events:
        parser.error(f"no sequence of {args.data} is long enough for an occlusion")
    print(f"{len(events)} events of {len({event.sequence for event in events})} sequences")
    theirs = run(args.against, events, truth, args.jobs, args.dask) if args.against else None
    for label in args.tracker or ["racf,robust"]:
        ours = run(label, events, truth, args.jobs, args.dask)
        print(f"\n{label}\n{table(ours, None)}")
        if theirs is not None:
            print(f"\n{label} less {args.against}\n{table(ours, theirs)}", flush=True)


if __name__ == "__main__":
    sys.exit(guarded(main, prog="occlusions"))
