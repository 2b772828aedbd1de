"""Do a tracker's settings hold on footage they were not chosen on?  Two halves of twenty sequences, either way round.

    python -m tools.studies.halves DATA [--starts five] [--out OUT] [--jobs N] [--dask ADDRESS]
    python -m tools.studies.halves DATA --tracker racf- --tracker racf-,ridge=0.01 [--against arcf-hc]

DATA holds the twenty sequences named in HALVES, as folders, with the authors' boxes in DATA/results.  Each sequence is
run from five starts: its annotated first box, two that are a little wrong (`racf.evaluate.runner.jittered`), and the
annotated boxes a third and two thirds of the way.  `--starts seven` has four others that are a little wrong and the
annotated boxes after a sixth, a half and five sixths; `--starts eight` four more, a quarter, three quarters, five and
seven twelfths; `fifteen` both, `twenty` all.  A sequence counts once, with the mean over its starts.  Shares are
percent, in the toolkits' convention (docs/evaluation.md).

Two-fold cross-validation: of each family of candidates the best on one half (by the sum of AUC and precision) is
reported on the other half, and vice versa.  Both together cover all twenty sequences, and no sequence took part in
choosing the settings that it evaluates.  Differences are paired by sequence, with a 95 % bootstrap interval over
sequences.

Without `--tracker` it runs FAMILIES and prints every table of docs/study.md; with it, only the trackers named.
Finished runs are kept in OUT; a later call with other trackers reuses them.
"""

import argparse
import os
import sys
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path

import numpy as np

from racf.commandline import guarded
from racf.evaluate.benchmarks import Sequence, read_benchmark
from racf.evaluate.metrics import interval_of_mean, score
from racf.evaluate.progress import bar
from racf.evaluate.runner import SequenceRun, Task, run_all, tasks
from racf.evaluate.stored import read_stored
from racf.evaluate.trackers import TrackerSpec

# Balanced over benchmarks (seven of UAV123@10fps, one of DTB70, two of UAVDT each), over the nine that the first
# defaults were chosen by (five and four) and over the authors' own precision (87.5 and 87.7); sequences that were cut
# out of one video (car16_1 and car16_2) are on one side.
HALVES = {
    "A": ("MountainBike6", "S0310", "S0601", "boat5", "car16_1", "car16_2", "group1_2", "person12_2", "truck4_1",
          "wakeboard10"),
    "B": ("S1001", "S1606", "Surfing06", "building4", "building5", "group2_2", "group3_2", "person11", "truck2",
          "wakeboard7"),
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class Starts:
    """Where the runs of a sequence begin: 0 its first box, 1, 2, ... jittered ones; and within, by share of its way."""

    first: tuple[int, ...]
    inner: dict[str, float]

    def __or__(self, other: "Starts") -> "Starts":
        return Starts((*self.first, *other.first), {**self.inner, **other.inner})


_FIVE = Starts((0, 1, 2), {"from-a-third": 1 / 3, "from-two-thirds": 2 / 3})
_SEVEN = Starts((3, 4, 5, 6), {"from-a-sixth": 1 / 6, "from-half": 1 / 2, "from-five-sixths": 5 / 6})
_EIGHT = Starts(
    (7, 8, 9, 10),
    {
        "from-a-quarter": 1 / 4,
        "from-three-quarters": 3 / 4,
        "from-five-twelfths": 5 / 12,
        "from-seven-twelfths": 7 / 12,
    },
)
STARTS = {
    "five": _FIVE, "seven": _SEVEN, "eight": _EIGHT, "fifteen": _SEVEN | _EIGHT, "twenty": _FIVE | _SEVEN | _EIGHT,
}  # fmt: skip

AUTHORS = "RACF, the authors' boxes"


@dataclass(frozen=True, slots=True)
class Family:
    """Settings that answer one question; `default` is the one that the tracker has by default."""

    default: str
    others: tuple[str, ...]


PRESENTED = ("racf", "racf,robust", "racf-", "racf--", "bacf", "arcf-hc", "arcf-hc,refine")
CLAIMS = (
    ("racf", "arcf-hc"),
    ("racf--", "bacf"),
    ("racf-", "racf--"),
    ("racf", "racf-"),
    ("arcf-hc,refine", "arcf-hc"),
    ("racf", AUTHORS),
    ("racf,robust", AUTHORS),
)
_KIN = "learning_rate=0.013,label_sigma=0.0625"  # BACF's rate and the label of BACF and ARCF
FAMILIES = {
    "The paper's regularisation and its kin's label and rate": Family(
        "racf-",
        (
            f"racf-,{_KIN},ridge=0.1,temporal=1",
            f"racf-,{_KIN},ridge=0.01,spatial=0.05,temporal=1",
            f"racf-,{_KIN},ridge=0.01,spatial=0.05",
            f"racf-,{_KIN},ridge=0.01,spatial=0,temporal=0",
        ),
    ),
    "The same without the spatial and temporal terms": Family("racf--", (f"racf--,{_KIN},ridge=0.01",)),
    "The residue": Family(f"racf-,{_KIN},ridge=0.01", (f"racf-,{_KIN},ridge=0.01,residue=0",)),
}

Pair = tuple[float, float]  # precision at 20 px and AUC, percent
Figures = Mapping[str, Pair]  # of each sequence


@dataclass(frozen=True, slots=True)
class Difference:
    """Mean and 95 % interval of a paired difference over sequences, in precision and AUC."""

    precision: tuple[float, float, float]
    auc: tuple[float, float, float]

    def __str__(self) -> str:
        return " / ".join(f"{mean:+.1f} ({low:+.1f}..{high:+.1f})" for mean, low, high in (self.precision, self.auc))


@dataclass(frozen=True, slots=True)
class Fold:
    """The best candidate on one half, and its figures on the other."""

    chosen_on: str
    label: str
    reported_on: str


def inner_starts(sequence: Sequence, starts: Starts) -> Iterator[Sequence]:
    """The sequence from within: from the first frame at or after each share of its way whose annotation is a box."""
    usable = np.all(np.nan_to_num(sequence.truth)[:, 2:] > 0, axis=1)
    for name, share in starts.inner.items():
        first = int(len(usable) * share)
        first += int(np.argmax(usable[first:]))
        yield replace(
            sequence,
            name=f"{sequence.name}-{name}",
            truth=sequence.truth[first:],
            frames=sequence.frames[first:],
        )


def todo(spec: TrackerSpec, sequence: Sequence, starts: Starts) -> list[Task]:
    """All starts of one tracker on one sequence."""
    first = [task for task in tasks(spec, sequence, max(starts.first)) if task.start in starts.first]
    return [*first, *(task for part in inner_starts(sequence, starts) for task in tasks(spec, part, 0))]


def figures(
    label: str, sequences: Iterable[Sequence], runs: Mapping[tuple[str, str, int], SequenceRun], starts: Starts
) -> Figures:
    """Of each sequence the mean over its starts."""
    means: dict[str, Pair] = {}
    for sequence in sequences:
        begun = [(sequence.name, start, sequence.truth) for start in starts.first]
        begun += [(part.name, 0, part.truth) for part in inner_starts(sequence, starts)]
        scores = [score(runs[label, name, start].boxes, truth) for name, start, truth in begun]
        means[sequence.name] = mean_pair([(s.precision_20px, s.auc) for s in scores])
    return means


def mean_pair(pairs: Iterable[Pair]) -> Pair:
    """The mean of both."""
    precision, auc = np.mean(list(pairs), axis=0)
    return float(precision), float(auc)


def over(figures_of: Figures, names: Iterable[str]) -> Pair:
    """The mean over these sequences."""
    return mean_pair(figures_of[name] for name in names)


def difference(first: Figures, second: Figures, names: Iterable[str]) -> Difference:
    """First minus second, paired by sequence."""
    differences = np.array([np.subtract(first[name], second[name]) for name in names])
    ends = [interval_of_mean(column.tolist()) for column in differences.T]
    precision, auc = ((float(mean), *end) for mean, end in zip(differences.mean(axis=0), ends, strict=True))
    return Difference(precision, auc)


def two_fold(candidates: Mapping[str, Figures]) -> tuple[list[Fold], Figures]:
    """The best of the candidates on each half, and the figures of all sequences, each under the other half's choice."""
    folds, reported = list[Fold](), dict[str, Pair]()
    for chosen_on, reported_on in (("A", "B"), ("B", "A")):
        best = max(candidates, key=lambda label: sum(over(candidates[label], HALVES[chosen_on])))
        folds.append(Fold(chosen_on, best, reported_on))
        reported |= {name: candidates[best][name] for name in HALVES[reported_on]}
    return folds, reported


def read_halves(data: Path, only: Iterable[str] | None = None) -> list[Sequence]:
    """The twenty sequences, or `only` some of them; raises ValueError naming those that are missing or not of them."""
    every = {name for half in HALVES.values() for name in half}
    wanted = every if only is None else set(only)
    if others := wanted - every:
        raise ValueError(f"--only names sequences of the study, {', '.join(sorted(every))}; not {', '.join(others)}")
    found = [s for s in read_benchmark("folder", data) if s.name in wanted and s.frames]
    if missing := wanted - {s.name for s in found}:
        raise ValueError(
            f"{data} lacks {', '.join(sorted(missing))} of the study's twenty sequences; --only runs some of them"
        )
    return found


def authors(data: Path, sequences: list[Sequence], tracker: str) -> Figures:
    """The authors' own boxes, from their one start; raises ValueError naming the sequences that have none."""
    stored = read_stored(data / "results", tracker, sequences)
    if missing := [s for s in sequences if s.name not in stored.boxes]:
        one = missing[0]
        looked_for = data / "results" / one.benchmark / tracker / f"{one.name}.txt"
        raise ValueError(f"{one.name}, in a folder {one.benchmark}, has no boxes of {tracker} in {looked_for}")
    judged = {s.name: score(stored.boxes[s.name], s.truth) for s in sequences}
    return {name: (s.precision_20px, s.auc) for name, s in judged.items()}


def measure(
    labels: Iterable[str], sequences: list[Sequence], starts: Starts, out: Path | None, jobs: int, dask: str | None
) -> dict[str, Figures]:
    """Run the tasks that have no results in `out` yet."""
    specs = {(spec := TrackerSpec.parse(text)).label: spec for text in labels}
    for spec in specs.values():
        spec.check()
    work = [task for spec in specs.values() for sequence in sequences for task in todo(spec, sequence, starts)]
    with bar(work) as progress:
        runs = run_all(work, jobs=jobs, folder=out, dask=dask, done=progress.done)
    return {label: figures(label, sequences, runs, starts) for label in specs}


def table(measured: Mapping[str, Figures], against: Figures, name: str) -> str:
    """A row a tracker: both halves, all sequences, and the paired difference from `against` over all."""
    halves = [[name for name in half if name in against] for half in HALVES.values()]
    every = list(chain(*halves))
    count = "all twenty" if len(every) == sum(map(len, HALVES.values())) else f"all {len(every)}"
    lines = [f"| tracker | half A | half B | {count} | less `{name}`, with 95 % |", "|---|---|---|---|---|"]
    for label, of in measured.items():
        pairs = [over(of, names) if names else None for names in (*halves, every)]
        cells = ["-" if pair is None else f"{pair[0]:.1f} / {pair[1]:.1f}" for pair in pairs]
        lines.append(f"| `{label}` | {' | '.join(cells)} | {difference(of, against, every)} |")
    return "\n".join(lines)


def choice(family: Family, measured: Mapping[str, Figures]) -> str:
    """The best on each half, its figures on the other half beside the family's default, and both together."""
    every = [*HALVES["A"], *HALVES["B"]]
    default = measured[family.default]
    folds, reported = two_fold({label: measured[label] for label in (family.default, *family.others)})
    lines = [
        "| chosen on | best there | reported on | there | less the default, with 95 % |",
        "|---|---|---|---|---|",
    ]
    for fold in folds:
        names = HALVES[fold.reported_on]
        precision, auc = over(measured[fold.label], names)
        delta = difference(measured[fold.label], default, names)
        cells = (fold.chosen_on, f"`{fold.label}`", fold.reported_on, f"{precision:.1f} / {auc:.1f}", str(delta))
        lines.append(f"| {' | '.join(cells)} |")
    precision, auc = over(reported, every)
    lines.append(f"| the other half | | all | {precision:.1f} / {auc:.1f} | {difference(reported, default, every)} |")
    return "\n".join(lines)


def claims(measured: Mapping[str, Figures]) -> str:
    """The paper's claims, term by term, over all twenty."""
    every = [*HALVES["A"], *HALVES["B"]]
    lines = ["| | less | precision / AUC, with 95 % |", "|---|---|---|"]
    for first, second in CLAIMS:
        if first in measured and second in measured:
            lines.append(f"| `{first}` | `{second}` | {difference(measured[first], measured[second], every)} |")
    return "\n".join(lines)


def tracker_label(label: str) -> str:
    """A tracker's label, for argparse; refused in one line if there is no such tracker."""
    try:
        TrackerSpec.parse(label).check()
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from None
    return label


def whole(text: str) -> int:
    """A whole number of at least 0, for argparse."""
    if not text.isdecimal():
        raise argparse.ArgumentTypeError(f"a whole number of at least 0, not {text!r}")
    return int(text)


def processes(text: str) -> int:
    """A number of processes, for argparse; 0 is one for each core."""
    return whole(text) or len(os.sched_getaffinity(0))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("data", type=Path)
    parser.add_argument("--out", type=Path, default=Path("out/study"), help="finished runs are kept here")
    parser.add_argument(
        "--tracker", type=tracker_label, action="append", help="run only these, instead of the study's families"
    )
    parser.add_argument("--against", type=tracker_label, default="arcf-hc", help="differences are to this tracker")
    parser.add_argument("--starts", choices=STARTS, default="five", help="which starts, by how many there are")
    parser.add_argument("--only", action="append", help="only this sequence; can be given several times")
    parser.add_argument("--jobs", type=processes, default="0", help="number of processes; 0: one for each core")
    parser.add_argument("--dask", help="address of a running Dask scheduler")
    args = parser.parse_args()
    chosen = args.tracker or [
        *PRESENTED, *(label for family in FAMILIES.values() for label in (family.default, *family.others)),
    ]  # fmt: skip
    labels = list(dict.fromkeys([args.against, *chosen]))
    if args.only and not args.tracker:
        parser.error("--only goes with --tracker: without it the best of each half is chosen, over whole halves")
    try:
        sequences = read_halves(args.data, args.only)
    except (OSError, ValueError) as error:
        parser.error(str(error))
    try:
        published = {AUTHORS: authors(args.data, sequences, "RACF")}
    except ValueError as error:
        if not args.tracker:
            parser.error(str(error))
        print(f"without the authors' row: {error}", file=sys.stderr)
        published = dict[str, Figures]()
    measured = measure(labels, sequences, STARTS[args.starts], args.out, args.jobs, args.dask)
    against = TrackerSpec.parse(args.against).label
    shown = {**published, **measured}
    print(table(shown, measured[against], against))
    if not args.tracker:
        print("\n" + claims(shown))
        for title, family in FAMILIES.items():
            print(f"\n{title}\n\n{choice(family, measured)}")


if __name__ == "__main__":
    sys.exit(guarded(main, prog="halves"))
