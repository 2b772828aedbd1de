"""Trackers from other starts than a sequence's first frame: part of the way through, and backwards.

    python -m tools.studies.other_starts DATA --tracker racf --tracker racf,learning_rate=0.0192 [--jitter 2]

A check of settings that were chosen on the sequences' own starts: each sequence is run from a sixth and a third of its
frames on, and backwards from its end and from two thirds, always from the annotated box and from `--jitter` wrong ones.
Prints precision at 20 px / AUC in percent, the mean over all runs (strict convention: frames without a target do not
count).
"""

import argparse
import os
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from racf.commandline import guarded
from racf.evaluate.benchmarks import Sequence, read_benchmark
from racf.evaluate.metrics import Convention, score
from racf.evaluate.progress import bar
from racf.evaluate.runner import run_all, tasks
from racf.evaluate.trackers import TrackerSpec
from tools.studies.halves import tracker_label


def parts(sequence: Sequence) -> Iterator[Sequence]:
    """The sequence from its other starts, each moved on to the next frame in which the target is annotated."""
    count = min(len(sequence.frames), len(sequence.truth))
    forward, usable = np.arange(count), np.all(np.nan_to_num(sequence.truth)[:, 2:] > 0, axis=1)
    orders = {
        "from-a-sixth": forward[count // 6 :],
        "from-a-third": forward[count // 3 :],
        "backwards": forward[::-1],
        "backwards-from-two-thirds": forward[: 2 * count // 3][::-1],
    }
    for name, frames in orders.items():
        order = frames[np.argmax(usable[frames]) :]
        yield replace(
            sequence,
            name=f"{sequence.name}-{name}",
            truth=sequence.truth[order],
            frames=tuple(sequence.frames[k] for k in order),
        )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("data", type=Path)
    parser.add_argument("--tracker", type=tracker_label, action="append", default=None)
    parser.add_argument("--jitter", type=int, default=2)
    args = parser.parse_args()
    specs = [TrackerSpec.parse(name) for name in args.tracker or ["racf"]]
    sequences = [part for s in read_benchmark("folder", args.data) if s.frames for part in parts(s)]
    todo = [task for spec in specs for part in sequences for task in tasks(spec, part, args.jitter)]
    truth = {part.name: part.truth for part in sequences}
    with bar(todo) as progress:
        runs = run_all(todo, jobs=len(os.sched_getaffinity(0)), done=progress.done)
    for spec in specs:
        scores = [score(run.boxes, truth[n], Convention.STRICT) for (by, n, _), run in runs.items() if by == spec.label]
        precision, auc = np.mean([(s.precision_20px, s.auc) for s in scores], axis=0)
        print(f"{spec.label:<50} {precision:.1f} / {auc:.1f}, {len(scores)} runs")


if __name__ == "__main__":
    sys.exit(guarded(main, prog="other_starts"))
