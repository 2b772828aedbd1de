"""First boxes that are too large, too small or beside the target, on the study's twenty sequences.

    python -m tools.studies.first_boxes DATA [--tracker racf,robust] [--frames 200] [--jobs N] [--dask ADDRESS]

DATA is that of `tools.studies.halves`.  Each sequence is started at its first frame, a third and two thirds of its way,
each time from the annotated box and from each of `BOXES`, and runs for `--frames` frames.  A frame
counts as on the target if the tracker's centre lies in the annotated box, grown by a tenth of its sides.

Prints the percent of frames on the target, and off it but called found, for each of `BOXES`: by half and by sequence.
"""

import argparse
import sys
from functools import partial
from pathlib import Path

import cv2
import numpy as np

from racf.box import Box
from racf.commandline import guarded
from racf.evaluate.images import FrameCache
from racf.evaluate.runner import Task, warm_up
from racf.evaluate.trackers import TrackerSpec
from racf.parallel import each
from racf.threads import one_core
from tools.studies.halves import HALVES, Starts, inner_starts, processes, read_halves, todo, tracker_label, whole

STARTS = Starts((0,), {"a-third": 1 / 3, "two-thirds": 2 / 3})
BOXES = ((1.0, 0.0, 0.0), (1.5, 0.0, 0.0), (2.0, 0.0, 0.0), (1.5, 0.35, 0.2), (1.5, -0.35, -0.2), (0.7, 0.0, 0.0))
"""How many times as wide and high as the target, and how far beside it in its widths and heights."""
GROWN = 0.1  # of the annotated box's sides, on each side
_IMAGES = FrameCache(max_bytes=900_000_000)  # the starts of a sequence share its images

Shares = np.ndarray  # (len(BOXES), 2): percent of frames on the target, and off it but called found


def misplaced(box: Box, change: tuple[float, float, float]) -> Box:
    """One of `BOXES` around a target's box."""
    times, right, down = change
    centre = box.centre_x + right * box.w, box.centre_y + down * box.h
    return Box.around(*centre, times * box.w, times * box.h)


def watch(task: Task, truth: dict[str, np.ndarray], frames: int) -> Shares:
    """Run one start from each of `BOXES`; `truth` by sequence name, (frames, 4), 1-based pixels."""
    one_core()
    warm_up(task.spec)
    annotated = truth[task.sequence][1 : frames + 1]
    there = np.all(np.nan_to_num(annotated)[:, 2:] > 0, axis=1)
    shares = []
    for change in BOXES:
        cv2.setRNGSeed(0)  # GrabCut's mixtures begin from random numbers, as in racf.evaluate.runner
        tracker = task.spec.build()
        tracker.init(_IMAGES.read(task.frames[0]), misplaced(task.first_box, change))
        tracks = [tracker.update(_IMAGES.read(path)) for path in task.frames[1 : frames + 1]]
        centres = np.array([(track.box.centre_x + 1, track.box.centre_y + 1) for track in tracks])[there]
        found = np.array([bool(track.found) for track in tracks])[there]
        on = inside(centres, annotated[there])
        shares.append((100 * np.mean(on), 100 * np.mean(found & ~on)))
    return np.array(shares)


def inside(centres: np.ndarray, boxes: np.ndarray) -> np.ndarray:
    """(n,): whether centres (n, 2) lie in boxes (n, 4), grown by `GROWN`."""
    low, high = boxes[:, :2] - GROWN * boxes[:, 2:], boxes[:, :2] + (1 + GROWN) * boxes[:, 2:]
    return np.all((centres >= low) & (centres <= high), axis=1)


def line(name: str, shares: Shares) -> str:
    """A row of the table."""
    return f"| {name} | " + " | ".join(f"{on:.1f} / {false:.1f}" for on, false in shares) + " |"


def main() -> None:
    parser = argparse.ArgumentParser(description="First boxes that are too large, too small or beside the target.")
    parser.add_argument("data", type=Path)
    parser.add_argument("--only", action="append", help="only this sequence; can be given several times")
    parser.add_argument("--tracker", type=tracker_label, default="racf,robust")
    parser.add_argument("--frames", type=whole, default=200, help="number of frames of each start")
    parser.add_argument("--jobs", type=processes, default="0", help="number of processes; 0: one for each core")
    parser.add_argument("--dask", help="address of a running Dask scheduler")
    args = parser.parse_args()
    if args.frames < 1:
        parser.error(f"argument --frames: at least 1, not {args.frames}")
    try:
        sequences = read_halves(args.data, args.only)
    except (OSError, ValueError) as error:
        parser.error(str(error))
    spec = TrackerSpec.parse(args.tracker)
    tasks = [task for sequence in sequences for task in todo(spec, sequence, STARTS)]
    parts = {part.name: (s.name, part.truth) for s in sequences for part in (s, *inner_starts(s, STARTS))}
    truth = {name: annotated for name, (_, annotated) in parts.items()}
    by_name: dict[str, list[Shares]] = {}
    for task, shares in each(partial(watch, truth=truth, frames=args.frames), tasks, args.jobs, args.dask):
        by_name.setdefault(parts[task.sequence][0], []).append(shares)
    mean = {name: np.mean(parts, axis=0) for name, parts in by_name.items()}
    print("| on the target / off it, called found, percent | " + " | ".join(str(box) for box in BOXES) + " |")
    print("|---" * (len(BOXES) + 1) + "|")
    for half, names in [*HALVES.items(), ("all", tuple(mean))]:
        if known := [mean[name] for name in names if name in mean]:
            print(line(f"half {half}" if half in HALVES else half, np.mean(known, axis=0)))
    for name, shares in mean.items():
        print(line(name, shares))


if __name__ == "__main__":
    sys.exit(guarded(main, prog="first_boxes"))
