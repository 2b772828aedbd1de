"""The outcome of an evaluation: scores of each tracker by sequence, means, tables and JSON, all in percent."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

import numpy as np

from racf.evaluate.benchmarks import Sequence
from racf.evaluate.figures import DifferenceFigures, DifferencesFigures, ScoreFigures, SequenceFigures, TrackerFigures
from racf.evaluate.metrics import Boxes, Convention, Score, interval_of_mean, mean_score, score
from racf.evaluate.runner import SequenceRun
from racf.evaluate.stored import Stored


@dataclass(frozen=True, slots=True, eq=False)
class Judged:
    """One tracker on one sequence from one start, in both conventions."""

    toolkit: Score
    strict: Score

    @classmethod
    def of(cls, boxes: Boxes, sequence: Sequence) -> "Judged":
        """Judge boxes against a sequence's annotation."""
        return cls(score(boxes, sequence.truth), score(boxes, sequence.truth, Convention.STRICT))


@dataclass(frozen=True, slots=True, eq=False)
class ResultRow:
    """One tracker's results by sequence name; `jittered` holds those from wrong first boxes, one for each start."""

    label: str
    nominal: dict[str, Judged]
    fps: dict[str, float] = field(default_factory=dict)
    jittered: dict[str, list[Judged]] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Table:
    """A table of text cells, for the screen, for Markdown and for notebooks."""

    title: str
    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]

    def markdown(self) -> str:
        """The table with its title as a heading."""
        lines = [f"## {self.title}", "", _bars(self.header), _bars(["---", *["---:"] * (len(self.header) - 1)])]
        return "\n".join([*lines, *(_bars(row) for row in self.rows), ""])

    _repr_markdown_ = markdown


@dataclass(frozen=True, slots=True, eq=False)
class Report:
    """All rows over the same sequences.

    `counted` names the sequences that the means are over: those that every row has.
    """

    sequences: tuple[Sequence, ...]
    rows: tuple[ResultRow, ...]
    counted: tuple[str, ...]

    def names(self, benchmark: str | None = None, attribute: str | None = None) -> list[str]:
        """Counted sequences, of one benchmark or with one attribute."""
        return [
            s.name
            for s in self.sequences
            if s.name in self.counted
            and (benchmark is None or s.benchmark == benchmark)
            and (attribute is None or attribute in s.attributes)
        ]

    def benchmarks(self) -> list[str]:
        """Benchmarks that have counted sequences."""
        return sorted({s.benchmark for s in self.sequences if s.name in self.counted})

    def attributes(self) -> list[str]:
        """Attributes that at least two counted sequences have, as in the toolkits' plots."""
        every = sorted({a for s in self.sequences for a in s.attributes})
        return [a for a in every if len(self.names(attribute=a)) >= 2]

    def telling_apart(self, count: int) -> list[str]:
        """The counted sequences on which the trackers' AUCs differ most, those with frames only."""
        spread = {s.name: float(np.ptp([row.nominal[s.name].toolkit.auc for row in self.rows]))
                  for s in self.sequences if s.name in self.counted and s.frames}  # fmt: skip
        return sorted(spread, key=lambda name: -spread[name])[:count]

    def as_json(self) -> dict[str, TrackerFigures]:
        """The contract of `racf eval --json`: see docs/evaluation.md."""
        return {row.label: self._row_json(row) for row in self.rows}

    def _row_json(self, row: ResultRow) -> TrackerFigures:
        counted = [row.nominal[name] for name in self.counted]
        out: TrackerFigures = {
            **_figures(counted),
            "interval_95": {
                "precision_20px": _rounded(interval_of_mean([j.toolkit.precision_20px for j in counted])),
                "auc": _rounded(interval_of_mean([j.toolkit.auc for j in counted])),
            },
            "sequences": {s.name: self._sequence_json(row, s) for s in self.sequences if s.name in row.nominal},
        }
        fps = [row.fps[name] for name in self.counted if name in row.fps]
        if fps:
            out["fps"] = round(float(np.mean(fps)), 2)
        if row is not self.rows[0]:
            out["difference"] = self.difference(row)
        starts = [judged for name in self.counted for judged in row.jittered.get(name, ())]
        if starts:
            out["jittered"] = {"starts": len(starts) // len(self.counted), **_figures(starts)}
        if len(self.benchmarks()) > 1:
            out["benchmarks"] = {b: _figures([row.nominal[n] for n in self.names(b)]) for b in self.benchmarks()}
        if self.attributes():
            out["attributes"] = {
                a: _figures([row.nominal[n] for n in self.names(attribute=a)]) for a in self.attributes()
            }
        return out

    def _sequence_json(self, row: ResultRow, sequence: Sequence) -> SequenceFigures:
        out: SequenceFigures = {
            **_figures([row.nominal[sequence.name]]),
            "frames": len(sequence.truth),
            "benchmark": sequence.benchmark,
            "counted": sequence.name in self.counted,
        }
        if sequence.name in row.fps:
            out["fps"] = round(row.fps[sequence.name], 2)
        if sequence.name in row.jittered:
            out["jittered"] = _figures(row.jittered[sequence.name])
        return out

    def difference(self, row: ResultRow) -> DifferencesFigures:
        """A row minus the first one, paired by sequence: the sequences' own difficulty cancels."""
        first = self.rows[0]
        pairs = [([row.nominal[name]], [first.nominal[name]]) for name in self.counted]
        out: DifferencesFigures = {**_difference(first.label, pairs)}
        starts = {len(r.jittered.get(name, ())) for r in (row, first) for name in self.counted}
        if len(starts) == 1 and starts != {0}:
            out["jittered"] = _difference(
                first.label, [(row.jittered[name], first.jittered[name]) for name in self.counted]
            )
        return out

    def differences(self) -> Table | None:
        """The differences of all rows to the first, or None if there is one row."""
        if len(self.rows) < 2:
            return None
        found = {row.label: self.difference(row) for row in self.rows[1:]}
        shaken = any("jittered" in of for of in found.values())
        header = ["tracker", "precision", "95 %", "AUC", "95 %"]
        header += ["jittered precision", "95 %", "jittered AUC", "95 %"] * shaken
        rows: list[tuple[str, ...]] = []
        for label, of in found.items():
            cells = [label, *self._difference_cells(of)]
            if shaken:
                cells += self._difference_cells(of["jittered"]) if "jittered" in of else ["-"] * 4
            rows.append(tuple(cells))
        title = f"Difference to {self.rows[0].label}, paired over {self._count()}, percentage points"
        return Table(title, tuple(header), tuple(rows))

    def overall(self) -> Table:
        """A row a tracker: both figures with their intervals, the strict ones, speed, and the jittered mean."""
        summary = self.as_json()
        timed, shaken = any(row.fps for row in self.rows), any(row.jittered for row in self.rows)
        header = ["tracker", "precision", "95 %", "AUC", "95 %", "strict precision", "strict AUC"]
        header += ["fps"] * timed + ["jittered precision", "jittered AUC"] * shaken
        rows: list[tuple[str, ...]] = []
        for label, figures in summary.items():
            low, high = figures["interval_95"]["precision_20px"], figures["interval_95"]["auc"]
            cells = [label, _two(figures["precision_20px"]), self._interval(low)]
            cells += [_two(figures["auc"]), self._interval(high)]
            cells += [_two(figures["precision_20px_strict"]), _two(figures["auc_strict"])]
            cells += [_two(figures.get("fps"))] * timed
            jittered = figures.get("jittered")
            cells += [_two(jittered and jittered["precision_20px"]), _two(jittered and jittered["auc"])] * shaken
            rows.append(tuple(cells))
        title = f"One-pass evaluation, mean over {self._count()}, percent"
        return Table(title, tuple(header), tuple(rows))

    def _count(self) -> str:
        return "1 sequence" if len(self.counted) == 1 else f"{len(self.counted)} sequences"

    def _interval(self, ends: list[float], sign: str = "") -> str:
        """An interval's cell; one sequence has no spread from which to estimate it."""
        return f"{ends[0]:{sign}.1f}..{ends[1]:{sign}.1f}" if len(self.counted) > 1 else "-"

    def _difference_cells(self, of: DifferenceFigures) -> list[str]:
        precision, auc = of["interval_95"]["precision_20px"], of["interval_95"]["auc"]
        return [
            f"{of['precision_20px']:+.2f}", self._interval(precision, "+"),
            f"{of['auc']:+.2f}", self._interval(auc, "+"),
        ]  # fmt: skip

    def by_sequence(self) -> Table:
        """Precision / AUC of each tracker on each sequence, toolkit convention."""
        rows: list[tuple[str, ...]] = []
        for sequence in self.sequences:
            mark = "" if sequence.name in self.counted else " (not in the mean)"
            cells = [_pair([row.nominal[sequence.name]] if sequence.name in row.nominal else []) for row in self.rows]
            rows.append((sequence.name + mark, str(len(sequence.truth)), *cells))
        header = ("sequence", "frames", *(row.label for row in self.rows))
        return Table("By sequence: precision / AUC, percent", header, tuple(rows))

    def by_group(self) -> list[Table]:
        """The same by benchmark and by attribute, if there are any."""
        labels = tuple(row.label for row in self.rows)
        groups = {"benchmark": {b: self.names(b) for b in self.benchmarks()}} if len(self.benchmarks()) > 1 else {}
        if self.attributes():
            groups["attribute"] = {a: self.names(attribute=a) for a in self.attributes()}
        return [
            Table(
                f"By {kind}: precision / AUC, percent",
                (kind, "sequences", *labels),
                tuple(
                    (key, str(len(n)), *(_pair([r.nominal[x] for x in n]) for r in self.rows)) for key, n in g.items()
                ),
            )
            for kind, g in groups.items()
        ]


def build_report(
    sequences: Iterable[Sequence],
    runs: Mapping[str, Mapping[str, list[SequenceRun]]],
    stored: Mapping[str, Stored],
    reference: Iterable[str] = (),
) -> Report:
    """Judge runs (by label and sequence: the nominal one first, then the jittered) and stored boxes.

    The means are over the sequences that every row has; if `reference` names some of them (those with published
    results), over these only.  Raises ValueError when no sequence is left.
    """
    sequences = tuple(sequences)
    rows = [_judge_runs(label, sequences, by_sequence) for label, by_sequence in runs.items()]
    for label, left in stored.items():
        judged = {s.name: Judged.of(left.boxes[s.name], s) for s in sequences if s.name in left.boxes}
        starts = {
            s.name: [Judged.of(boxes, s) for boxes in left.jittered[s.name]]
            for s in sequences
            if s.name in left.jittered
        }
        rows.append(ResultRow(label, judged, left.fps, starts))
    common = [s.name for s in sequences if all(s.name in row.nominal for row in rows)]
    published = set(reference)
    counted = [name for name in common if name in published] or common
    if not counted:
        raise ValueError(f"no sequence has a result of each of {', '.join(row.label for row in rows)}")
    return Report(sequences, tuple(rows), tuple(counted))


def _judge_runs(label: str, sequences: tuple[Sequence, ...], by_sequence: Mapping[str, list[SequenceRun]]) -> ResultRow:
    row = ResultRow(label, {})
    for sequence in sequences:
        runs = by_sequence.get(sequence.name, [])
        if runs:
            nominal, *others = (Judged.of(run.boxes, sequence) for run in runs)
            row.nominal[sequence.name] = nominal
            row.fps[sequence.name] = runs[0].fps
            if others:
                row.jittered[sequence.name] = others
    return row


def _figures(judged: list[Judged]) -> ScoreFigures:
    toolkit, strict = mean_score([j.toolkit for j in judged]), mean_score([j.strict for j in judged])
    return {
        "precision_20px": round(toolkit.precision_20px, 6),
        "auc": round(toolkit.auc, 6),
        "precision_20px_strict": round(strict.precision_20px, 6),
        "auc_strict": round(strict.auc, 6),
    }


def _difference(to: str, pairs: list[tuple[list[Judged], list[Judged]]]) -> DifferenceFigures:
    """Each pair: the starts of one sequence, of the tracker and of the one that it is compared with."""
    means = [(mean_score([j.toolkit for j in ours]), mean_score([j.toolkit for j in theirs])) for ours, theirs in pairs]
    precision = [ours.precision_20px - theirs.precision_20px for ours, theirs in means]
    auc = [ours.auc - theirs.auc for ours, theirs in means]
    return {
        "to": to,
        "precision_20px": round(float(np.mean(precision)), 6),
        "auc": round(float(np.mean(auc)), 6),
        "interval_95": {
            "precision_20px": _rounded(interval_of_mean(precision)),
            "auc": _rounded(interval_of_mean(auc)),
        },
    }


def _pair(judged: list[Judged]) -> str:
    if not judged:
        return "-"
    figures = _figures(judged)
    return f"{figures['precision_20px']:.1f} / {figures['auc']:.1f}"


def _two(value: float | None) -> str:
    return "-" if value is None else f"{value:.2f}"


def _rounded(pair: tuple[float, float]) -> list[float]:
    return [round(pair[0], 2), round(pair[1], 2)]


def _bars(cells: Iterable[str]) -> str:
    return f"| {' | '.join(cells)} |"
