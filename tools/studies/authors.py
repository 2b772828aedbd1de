"""How the program of RACF's authors implements the paper, inferred from their stored boxes.

    python -m tools.studies.authors DATA [--tracker racf-] [--tracker racf-,warm_start=false] [--only boat5]

DATA is that of `tools.studies.halves`.  Two questions:

Whole cells: does the target move by whole cells of the sample (4 of its pixels), that is, is the response's maximum
taken without a step between cells?  Printed for each sequence: the share of the moves along one axis, of at least 0.6
of a cell, that are within 0.15 of a whole number of cells, for the authors and for `--other`, stored boxes of a tracker
that interpolates.  Stored boxes are whole pixels, so sequences with cells below 4 px are not used.

Agreement: our filter is led along the authors' boxes (it searches around their last box and learns at their next one)
and picks a cell in each frame.  Printed for each `--tracker`: the share of frames in which it is the authors' cell, the
mean over the sequences of each half, and the paired difference to the first tracker with its 95 % interval.
"""

import argparse
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from racf.box import Box
from racf.evaluate.benchmarks import Sequence
from racf.evaluate.images import FrameCache
from racf.evaluate.metrics import Boxes, interval_of_mean
from racf.evaluate.stored import read_stored
from racf.params import Params, preset
from racf.threads import one_core
from racf.translation import TranslationFilter
from tools.studies.halves import HALVES, read_halves, tracker_label

LEAST_CELL_PX = 4.0  # below it the rounding of stored boxes to pixels hides a cell's fraction
MOVED_CELLS, NEAR_CELLS = 0.6, 0.15
KNOWN_CELLS = 0.3  # a move that is further than this from a whole number of cells is not used (rounding, new centre)
_IMAGES = FrameCache(max_bytes=900_000_000)


def cell_px(boxes: Boxes, params: Params) -> np.ndarray:
    """(frames,) side of a sample's cell in the frame's pixels; boxes (frames, 4), the first one the first frame's."""
    sides = np.sqrt(boxes[:, 2] * boxes[:, 3]) * params.search_area
    cells = round(min(max(sides[0], params.sample_min_px), params.sample_max_px) / params.cell_px)
    return sides / cells


def moves(boxes: Boxes, params: Params) -> np.ndarray:
    """(frames - 1, 2): the centre's move from frame to frame, in cells of the sample that was searched."""
    centres = boxes[:, :2] + boxes[:, 2:] / 2
    return np.diff(centres, axis=0) / cell_px(boxes, params)[:-1, None]


def whole_cells(boxes: Boxes, params: Params) -> tuple[float, int]:
    """The share of moves by whole cells along one axis, and how many moves there are; frames of a new size apart."""
    same_size = np.all(boxes[1:, 2:] == boxes[:-1, 2:], axis=1)
    cells = moves(boxes, params)[same_size].ravel()
    cells = cells[np.abs(cells) > MOVED_CELLS]
    return float(np.mean(np.abs(cells - np.round(cells)) < NEAR_CELLS)) if len(cells) else np.nan, len(cells)


def led(sequence: Sequence, boxes: Boxes, params: Params) -> Iterator[tuple[float, float]]:
    """Our moves in cells, frame by frame, of a filter that is led along `boxes` (1-based pixels)."""
    first = sequence.first_box()
    tracker = TranslationFilter(params, first, colour=params.colour_names)
    tracker.learn(_IMAGES.read(sequence.frames[0]), first)
    before = first
    for path, (x, y, w, h) in zip(sequence.frames[1:], boxes[1:].tolist(), strict=True):
        image = _IMAGES.read(path)
        found = tracker.locate(image, before).box
        cell = float(cell_px(np.array([[0, 0, first.w, first.h], [0, 0, before.w, before.h]]), params)[1])
        yield (found.centre_x - before.centre_x) / cell, (found.centre_y - before.centre_y) / cell
        before = Box(x - 1, y - 1, w, h)
        tracker.learn(image, before)


def agreement(sequence: Sequence, boxes: Boxes, params: Params) -> float:
    """The share of frames in which our filter picks the same cell."""
    theirs = moves(boxes, params)
    ours = np.array(list(led(sequence, boxes, replace(params, newton_iterations=0))))
    known = np.max(np.abs(theirs - np.round(theirs)), axis=1) < KNOWN_CELLS
    return float(np.mean(np.all(np.round(ours) == np.round(theirs), axis=1)[known]))


def main() -> None:
    one_core()
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data", type=Path)
    parser.add_argument("--tracker", type=tracker_label, action="append", default=None)
    parser.add_argument("--only", action="append", help="use only this sequence for the agreement; several times")
    parser.add_argument("--other", default="ARCF-HC", help="stored boxes of a tracker that interpolates")
    args = parser.parse_args()
    sequences, params = read_halves(args.data), Params()
    stored, other = (read_stored(args.data / "results", name, sequences).boxes for name in ("RACF", args.other))
    print(f"| sequence | cell px | authors' RACF: whole cells (moves) | {args.other} |\n|---|---|---|---|")
    known: list[Sequence] = []
    for sequence in sequences:
        boxes = stored[sequence.name]
        cell = float(np.median(cell_px(boxes, params)))
        if cell >= LEAST_CELL_PX:
            known.append(sequence)
            shares = (whole_cells(b[sequence.name], params) for b in (stored, other))
            cells = " | ".join(f"{share:.2f} ({count})" if count else "no move" for share, count in shares)
            print(f"| {sequence.name} | {cell:.1f} | {cells} |", flush=True)
    labels = args.tracker or ["racf-"]
    agreed: dict[str, dict[str, float]] = {label: {} for label in labels}
    known = [s for s in known if args.only is None or s.name in args.only]
    for sequence in known:  # all trackers on one sequence in a row: its images are decoded once
        for label in labels:
            agreed[label][sequence.name] = agreement(sequence, stored[sequence.name], preset(label))
    print("\n| led along the authors' boxes | half A | half B | less the first, with 95 % |\n|---|---|---|---|")
    for label, of in agreed.items():
        halves = (np.mean([of[name] for name in of if name in HALVES[half]]) for half in ("A", "B"))
        deltas = [of[name] - agreed[labels[0]][name] for name in of]
        low, high = interval_of_mean(deltas)
        cells = " | ".join(f"{100 * mean:.1f} %" for mean in halves)
        print(
            f"| `{label}` | {cells} | {100 * np.mean(deltas):+.1f} ({100 * low:+.1f}..{100 * high:+.1f}) |", flush=True
        )


if __name__ == "__main__":
    main()
