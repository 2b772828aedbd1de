"""The reliability diagram of a tracker's confidence, on the study's twenty sequences from several starts each.

    python -m tools.studies.reliability DATA [--tracker racf,robust] [--starts five] [--draw FILE.svg]
                                        [--jobs N] [--dask ADDRESS]

DATA and the starts are those of `tools.studies.halves`.  Every frame after the first gives the confidence, the
tracker's verdict (found or lost) and the overlap with the annotation.  A frame counts as on the target above an overlap
of 0.3, and as off it without any overlap, also if the annotation says that the target is absent.

Prints the share of frames off the target that are called found, and of those on it that are called lost, each with a
95 % bootstrap interval over sequences (all frames of a sequence are one draw); the diagram as a table; and the
sequences with false positives.
"""

import argparse
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import cv2
import numpy as np
from matplotlib.figure import Figure

from racf.box import Box
from racf.commandline import guarded
from racf.evaluate import plots
from racf.evaluate.benchmarks import Sequence
from racf.evaluate.images import FrameCache
from racf.evaluate.metrics import overlaps
from racf.evaluate.runner import Task, warm_up
from racf.evaluate.trackers import TrackerSpec
from racf.parallel import each
from racf.threads import one_core
from tools.studies.halves import (
    HALVES,
    STARTS,
    Starts,
    inner_starts,
    processes,
    read_halves,
    todo,
    tracker_label,
)

ON_ABOVE = 0.3  # overlap: certainly on the target; as in docs/confidence.md
BINS = np.round(np.arange(0.0, 1.01, 0.1), 1)
RESAMPLES = 2000
_IMAGES = FrameCache(max_bytes=900_000_000)  # the starts of a sequence share its images


@dataclass(frozen=True, slots=True, eq=False)
class Frames:
    """Frames after the first, each array (n,).

    confidence: 0..1; overlap: 0..1, 0 if the target is absent; found: the tracker's verdict.
    """

    confidence: np.ndarray
    overlap: np.ndarray
    found: np.ndarray

    @property
    def on(self) -> np.ndarray:
        return self.overlap > ON_ABOVE

    @property
    def off(self) -> np.ndarray:
        return self.overlap <= 0

    @classmethod
    def joined(cls, parts: list["Frames"]) -> "Frames":
        """All frames of several runs."""
        names = ("confidence", "overlap", "found")
        return cls(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))


def watch(task: Task, truth: Mapping[str, np.ndarray]) -> Frames:
    """Run one task and judge each frame after the first; `truth` by sequence name, (frames, 4), 1-based pixels."""
    one_core()
    warm_up(task.spec)
    cv2.setRNGSeed(0)  # GrabCut's mixtures begin from random numbers, as in racf.evaluate.runner
    tracker = task.spec.build()
    tracker.init(_IMAGES.read(task.frames[0]), task.first_box)
    tracks = [tracker.update(_IMAGES.read(path)) for path in task.frames[1:]]
    boxes = np.array([corner(track.box) for track in tracks])
    annotated = truth[task.sequence][1:]
    there = np.all(np.nan_to_num(annotated)[:, 2:] > 0, axis=1)
    overlap = np.zeros(len(boxes))
    overlap[there] = overlaps(boxes[there], annotated[there])
    confidence, found = (np.array([getattr(track, name) for track in tracks]) for name in ("confidence", "found"))
    return Frames(confidence, overlap, found.astype(bool))


def corner(box: Box) -> tuple[float, float, float, float]:
    """A box in the annotations' 1-based pixels."""
    return box.x + 1, box.y + 1, box.w, box.h


def shares(frames: Frames) -> tuple[float, float, float]:
    """Percent: of all frames, off the target and called found; of those off it, called found; of those on it, lost."""
    false = frames.off & frames.found
    off_found = np.sum(false) / max(np.sum(frames.off), 1)
    on_lost = np.sum(frames.on & ~frames.found) / max(np.sum(frames.on), 1)
    return 100 * float(np.mean(false)), 100 * float(off_found), 100 * float(on_lost)


def interval(by_sequence: Mapping[str, Frames]) -> np.ndarray:
    """95 % bootstrap interval of `shares`, by drawing sequences with replacement; shape (2, 3)."""
    parts, rng = list(by_sequence.values()), np.random.default_rng(0)
    draws = [
        shares(Frames.joined([parts[k] for k in rng.integers(0, len(parts), len(parts))])) for _ in range(RESAMPLES)
    ]
    return np.percentile(draws, [2.5, 97.5], axis=0)


def diagram(frames: Frames) -> list[tuple[float, float, int, float, float, float]]:
    """A row a bin that has frames: its ends, frames, mean confidence, share on the target and share off it (0..1)."""
    rows: list[tuple[float, float, int, float, float, float]] = []
    for low, high in zip(BINS[:-1].tolist(), BINS[1:].tolist(), strict=True):
        inside = (frames.confidence >= low) & ((frames.confidence < high) | (high >= 1.0))
        if inside.any():
            mean, on, off = (float(np.mean(of[inside])) for of in (frames.confidence, frames.on, frames.off))
            rows.append((low, high, int(np.sum(inside)), mean, on, off))
    return rows


def calibration_error(frames: Frames) -> float:
    """Mean distance of a bin's confidence from its share on the target, weighted by frames, 0..1."""
    rows = diagram(frames)
    return sum(count * abs(mean - on) for _, _, count, mean, on, _ in rows) / len(frames.overlap)


def draw(frames: Frames, place: Path, label: str) -> None:
    """The diagram: share of frames on the target over confidence, and how many frames each bin has."""
    rows = diagram(frames)
    figure = Figure(figsize=(5.6, 4.4), layout="constrained")
    top, bottom = figure.subplots(2, 1, sharex=True, height_ratios=(3, 1))
    middles = [(low + high) / 2 for low, high, *_ in rows]
    top.plot([0, 1], [0, 1], color="grey", lw=0.8, ls=":", label="confidence = share on the target")
    top.plot(
        [row[3] for row in rows], [row[4] for row in rows], marker="o", label=f"on the target (overlap > {ON_ABOVE})"
    )
    top.plot([row[3] for row in rows], [row[5] for row in rows], marker="x", label="off it (no overlap)")
    top.set(ylabel="share of frames", ylim=(0, 1), xlim=(0, 1), title=f"{label}, {len(frames.overlap)} frames")
    top.legend(fontsize=8)
    bottom.bar(middles, [row[2] for row in rows], width=0.09, color="grey")
    bottom.set(xlabel="confidence", ylabel="frames", yscale="log")
    plots.save(figure, place.with_suffix(""))
    place.with_suffix(".png").unlink()


def text(by_sequence: Mapping[str, Frames]) -> str:
    """Everything that docs/confidence.md quotes."""
    every = Frames.joined(list(by_sequence.values()))
    ends = interval(by_sequence)
    names = ("off the target and called found, of all frames", "called found, of those off the target",
             "called lost, of those on the target")  # fmt: skip
    on, off = (100 * float(np.mean(of)) for of in (every.on, every.off))
    lines = [f"{len(every.overlap)} frames, {on:.1f} % on the target, {off:.1f} % off it"]
    for name, share, low, high in zip(names, shares(every), *ends, strict=True):
        lines.append(f"{share:.1f} % ({low:.1f}..{high:.1f}) {name}")
    for half, inside in HALVES.items():
        parts = [frames for name, frames in by_sequence.items() if name in inside]
        if parts:
            lines.append(f"half {half}: " + ", ".join(f"{share:.1f} %" for share in shares(Frames.joined(parts))))
    lines.append(f"calibration error {100 * calibration_error(every):.1f} percentage points")
    lines += ["", "| confidence | frames | mean confidence | on the target | off it |", "|---|---|---|---|---|"]
    lines += [
        f"| {a:.1f}..{b:.1f} | {n} | {mean:.2f} | {on:.0%} | {off:.0%} |" for a, b, n, mean, on, off in diagram(every)
    ]
    false = {name: int(np.sum(frames.off & frames.found)) for name, frames in by_sequence.items()}
    worst = sorted((name for name in false if false[name]), key=lambda name: -false[name])
    return "\n".join([*lines, "", "false positives: " + ", ".join(f"{name} {false[name]}" for name in worst)])


def measure(label: str, sequences: list[Sequence], starts: Starts, jobs: int, dask: str | None) -> dict[str, Frames]:
    """The frames of each sequence, of all its starts together."""
    spec = TrackerSpec.parse(label)
    truth = {part.name: part.truth for s in sequences for part in (s, *inner_starts(s, starts))}
    sequence_of = {part.name: s.name for s in sequences for part in (s, *inner_starts(s, starts))}
    work = [task for sequence in sequences for task in todo(spec, sequence, starts)]
    gathered: dict[str, dict[tuple[str, int], Frames]] = {s.name: {} for s in sequences}
    judge = partial(watch, truth=truth)
    answers = ((task, judge(task)) for task in work) if jobs == 1 and dask is None else each(judge, work, jobs, dask)
    for task, frames in answers:
        gathered[sequence_of[task.sequence]][task.sequence, task.start] = frames
    return {name: Frames.joined([parts[key] for key in sorted(parts)]) for name, parts in gathered.items()}


def main() -> None:
    parser = argparse.ArgumentParser(description="The reliability diagram of a tracker's confidence.")
    parser.add_argument("data", type=Path)
    parser.add_argument("--only", action="append", help="only this sequence; can be given several times")
    parser.add_argument("--tracker", type=tracker_label, default="racf,robust")
    parser.add_argument("--starts", choices=STARTS, default="five", help="which starts, by how many there are")
    parser.add_argument("--jobs", type=processes, default="0", help="number of processes; 0: one for each core")
    parser.add_argument("--dask", help="address of a running Dask scheduler")
    parser.add_argument("--draw", type=Path, help="draw the diagram into this .svg file")
    args = parser.parse_args()
    try:
        sequences = read_halves(args.data, args.only)
    except (OSError, ValueError) as error:
        parser.error(str(error))
    by_sequence = measure(args.tracker, sequences, STARTS[args.starts], args.jobs, args.dask)
    print(text(by_sequence))
    if args.draw:
        draw(Frames.joined(list(by_sequence.values())), args.draw, args.tracker)


if __name__ == "__main__":
    sys.exit(guarded(main, prog="reliability"))
