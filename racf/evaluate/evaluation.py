"""The whole evaluation in one call: what `racf eval` does, for a notebook or a program."""

import fnmatch
import json
import os
import sys
from collections.abc import Callable, Collection, Iterable, Sized
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from racf.errors import UsageError
from racf.evaluate import plots, studies
from racf.evaluate.arguments import address, directory, images_of, sweep_of, table_number, texts, whole
from racf.evaluate.benchmarks import BENCHMARKS, Sequence, is_known, read_benchmark
from racf.evaluate.figures import TrackerFigures
from racf.evaluate.imports import import_boxes
from racf.evaluate.metrics import Boxes
from racf.evaluate.own import OwnSpec
from racf.evaluate.progress import bar
from racf.evaluate.report import Report, Table, build_report
from racf.evaluate.runner import SequenceRun, TrackerBuilder, run_all, tasks
from racf.evaluate.stored import Stored, with_results
from racf.evaluate.trackers import builders_of

Runs = dict[str, dict[str, list[SequenceRun]]]
WRITTEN = ("report.json", "tables.md", "precision*", "success*", "images.*", "pictures.*", "table[2-5].*")
WRITTEN_KINDS = {".json", ".md", ".png", ".svg"}


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Evaluation:
    """The result of an evaluation.

    report: the scores by benchmark, attribute or sequence (`racf.evaluate.report.Report`).
    summary: tables of all trackers over all sequences, shown as such by a notebook; `summary[0].markdown()` is text.
    details: tables by benchmark, attribute and sequence.
    boxes: by label and sequence, (frames, 4) `x, y, w, h` in the benchmarks' 1-based pixels, from the annotated start.
    """

    report: Report
    summary: tuple[Table, ...]
    details: tuple[Table, ...]
    boxes: dict[str, dict[str, Boxes]]

    def __repr__(self) -> str:
        """The summary's tables: arrays and paths would be hundreds of lines."""
        return "\n".join(table.markdown() for table in self.summary)

    _repr_markdown_ = __repr__

    def figures(self) -> dict[str, TrackerFigures]:
        """Every figure by tracker: what `racf eval --json` prints (docs/evaluation.md)."""
        return self.report.as_json()

    def write(self, folder: Path, images: int = 0) -> list[Path]:
        """Write report.json, tables.md and the plots, and draw all boxes on frames of `images` sequences.

        Files of an earlier evaluation with these names are deleted; boxes in `folder/runs` stay.  Raises UsageError
        for files with these names of anybody else.
        """
        require_ours(folder)
        folder.mkdir(parents=True, exist_ok=True)
        for old in _named_as_ours(folder):
            old.unlink()
        written = [folder / "report.json", folder / "tables.md"]
        written[0].write_text(json.dumps(self.figures(), indent=1) + "\n")
        written[1].write_text("\n".join(table.markdown() for table in (*self.summary, *self.details)))
        written += [*plots.draw_curves(self.report, folder), *plots.draw_attributes(self.report, folder)]
        if images:
            chosen = self.report.telling_apart(images)
            shown = [s for s in self.report.sequences if s.name in chosen]
            written += plots.draw_images(shown, self.boxes, folder / "images")
        return written


def require_ours(folder: Path) -> None:
    """Raise UsageError if writing an evaluation would delete files in a folder that no evaluation has written."""
    others = [path.name for path in _named_as_ours(folder)]
    if others and not (folder / "runs").is_dir() and not _is_report(folder / "report.json"):
        shown = ", ".join(others[:3]) + (", ..." if len(others) > 3 else "")
        raise UsageError(
            f"{folder} holds {shown}, which no evaluation wrote and this one would replace: give another folder"
        )


def _named_as_ours(folder: Path) -> list[Path]:
    """The files of a folder that have the name of one that an evaluation writes."""
    found = {path for pattern in WRITTEN for path in folder.glob(pattern)}
    return sorted(path for path in found if path.suffix in WRITTEN_KINDS)


def _is_report(path: Path) -> bool:
    """Whether a file has the figures of trackers, as `Evaluation.figures`."""
    try:
        known = json.loads(path.read_text())
    except (OSError, ValueError):
        return False
    rows = known.values() if isinstance(known, dict) else ()
    return any(isinstance(row, dict) and "auc_strict" in row for row in rows)


def to_stderr(text: str) -> None:
    """Print a line on standard error."""
    print(text, file=sys.stderr)  # noqa: T201 - the user must learn what an evaluation leaves out


def evaluate(
    root: str | Path,
    *,
    benchmark: str = "folder",
    trackers: Any = None,
    settings: str | Collection[str] = (),
    imports: str | Collection[str] = (),
    only: str | Collection[str] = (),
    jitter: int = 0,
    table: int | None = None,
    sweep: studies.Sweep | None = None,
    images: int = 0,
    out: str | Path | None = None,
    jobs: int = 0,
    dask: str | None = None,
    progress: bool = True,
    notify: Callable[[str], None] | None = None,
) -> Evaluation:
    """Run trackers over a benchmark's sequences once each and compare their boxes with the annotation.

        evaluation = racf.evaluate.evaluate("DATA", trackers=["racf", "bacf", MyTracker], jitter=5, out="results")
        evaluation.summary[0], evaluation.figures()["racf"]["auc"]     # a table, a figure in percent
        evaluation.boxes["MyTracker"]["car1"]                          # (frames, 4)

    root, benchmark: folder and its layout: folder, uav123, uav123@10fps, dtb70, uavdt or visdrone2018.
    trackers: names (racf, racf-, racf--, bacf, arcf-hc and settings; OpenCV's csrt, kcf, mil, nano, vit; module:Class),
        classes of your own (see `racf.evaluate.own`), or a mapping of labels to these; racf unless boxes are imported.
    settings: key=value for all trackers that are named; this, imports and only are one text or several.
    imports: stored boxes to compare with: NAME=DIR, DIR for all trackers in it, or the `out` folder of an evaluation.
    only: patterns of the sequences to use, by name or benchmark/name.
    jitter: start each sequence this many times more, from slightly wrong first boxes.
    table, sweep: lay the results out as this table of the paper, 2 to 5, over these iterations and weights.
    out: folder for boxes, tables and plots; a later call with the same `out` goes on from the boxes there.
    images: with out, draw all boxes on frames of this number of sequences, those that tell the trackers apart most.
    jobs: processes (0: one for each core; unless 1, a script calls this below `if __name__ == "__main__":`).
    dask: address of a scheduler to run on.  progress: bar on standard error.  notify: gets what is left out, in lines.
    Paired differences are to the first tracker.  Raises ValueError for wrong arguments before anything runs.
    """
    root, folder = directory("root", root), _folder(out)
    jitter, jobs, images = whole("jitter", jitter), whole("jobs", jobs), images_of(images, folder)
    settings, imports, only = texts("settings", settings), texts("imports", imports), texts("only", only)
    table, sweep, dask, notify = table_number(table), sweep_of(sweep), address("dask", dask), notify or to_stderr
    builders = _builders(_chosen(trackers, imports, table, sweep), settings)
    sequences = _sequences(root, benchmark, only, need_frames=images > 0)
    stored = import_boxes(imports, sequences, [b.label for b in builders], notify)
    runs = _run(builders, sequences, jitter, jobs=jobs, folder=folder, dask=dask, progress=progress)
    evaluation = _judge(root, sequences, runs, stored, table, sweep)
    if folder is not None:
        notify(_written(evaluation, folder, images, table, sweep))
    return evaluation


def _folder(out: str | Path | None) -> Path | None:
    """The folder for results, if any, in which nobody else's files would go."""
    if out is None or out == "":
        return None
    folder = directory("out", out)
    require_ours(folder)
    return folder


def _written(evaluation: Evaluation, folder: Path, images: int, table: int | None, sweep: studies.Sweep) -> str:
    """Write the files of an evaluation to its folder; returns a message about them."""
    figures = len(evaluation.write(folder, images)) - 2 + len(studies.draw(table, evaluation.report, sweep, folder))
    return f"report.json, tables.md and {figures} figures are in {folder}"


def select(root: Path, only: Iterable[str], sequences: list[Sequence]) -> list[Sequence]:
    """The sequences that match one of the patterns, by name or benchmark/name; all where there is no pattern."""
    only = list(only)
    chosen = [s for s in sequences if not only or any(_matches(s, pattern) for pattern in only)]
    if not chosen:
        raise UsageError(f"only {' '.join(only)} leaves none of the {len(sequences)} sequences of {root}")
    return chosen


def _chosen(trackers: Any, imports: Collection[str], table: int | None, sweep: studies.Sweep) -> Any:
    """The trackers to run: those given, else the table's, else racf; none where boxes are imported."""
    given = not (trackers is None or (isinstance(trackers, Sized) and not trackers))
    if table in {3, 4} and (given or imports):
        raise UsageError(f"table {table} names its own trackers; leave out trackers and imports")
    if given:
        return trackers
    return () if imports else ("racf",) if table is None else studies.trackers_of(table, sweep)


def _builders(trackers: Any, settings: Collection[str]) -> list[TrackerBuilder]:
    try:
        return builders_of(trackers, settings)
    except ValueError as error:
        raise UsageError(str(error)) from None


def _sequences(root: Path, benchmark: str, only: Iterable[str], *, need_frames: bool) -> list[Sequence]:
    if not root.is_dir():
        raise UsageError(f"a folder of sequences is needed; {root} is not a folder")
    if not isinstance(benchmark, str) or not is_known(benchmark):  # pyright: ignore[reportUnnecessaryIsInstance]
        raise UsageError(f"benchmark is one of {', '.join(BENCHMARKS)}, not {benchmark!r}")
    sequences = select(root, only, read_benchmark(benchmark, root))
    if need_frames and not any(s.frames for s in sequences):
        raise UsageError(f"images need frames to draw on; the sequences of {root} have none")
    return sequences


def _matches(sequence: Sequence, pattern: str) -> bool:
    names = (sequence.name, f"{sequence.benchmark}/{sequence.name}")
    return any(fnmatch.fnmatchcase(name, pattern) for name in names)


def _run(
    builders: list[TrackerBuilder],
    sequences: list[Sequence],
    jitter: int,
    *,
    jobs: int,
    folder: Path | None,
    dask: str | None,
    progress: bool,
) -> Runs:
    todo = [task for b in builders for sequence in sequences for task in tasks(b, sequence, jitter)]
    if not todo:
        return {}
    # A class from a notebook or a prompt cannot be imported by other processes: it runs in this one.
    here = any(isinstance(b, OwnSpec) and not b.travels for b in builders)
    processes = 1 if here else jobs or len(os.sched_getaffinity(0))
    with bar(todo) if progress else nullcontext() as shown:
        done = shown.done if shown else lambda *_: None
        runs = run_all(todo, jobs=processes, folder=folder, dask=None if here else dask, done=done)
    return {
        b.label: {s.name: [runs[b.label, s.name, i] for i in range(1 + jitter)] for s in sequences} for b in builders
    }


def _judge(
    root: Path,
    sequences: list[Sequence],
    runs: Runs,
    stored: dict[str, Stored],
    table: int | None,
    sweep: studies.Sweep,
) -> Evaluation:
    report = build_report(sequences, runs, stored, with_results(root / "results", sequences))
    if table is None:
        difference = report.differences()
        summary = (report.overall(), *([difference] if difference else []))
    else:
        summary = (studies.lay_out(table, report, sweep),)
    boxes = {label: {name: of[0].boxes for name, of in by_name.items()} for label, by_name in runs.items()}
    boxes |= {label: left.boxes for label, left in stored.items()}
    return Evaluation(report, summary, (*report.by_group(), report.by_sequence()), boxes)
