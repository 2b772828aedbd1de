"""The `racf` command: track a video, evaluate on benchmarks, measure speed."""

import fnmatch
import json
import os
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro
from rich import box
from rich.console import Console
from rich.table import Table as ScreenTable

from racf.box import Box
from racf.commandline import UsageError, run
from racf.evaluate import plots, progress, speed, studies
from racf.evaluate.benchmarks import BENCHMARKS, Sequence, is_known, read_benchmark
from racf.evaluate.boxfiles import write_boxes
from racf.evaluate.images import frames_of
from racf.evaluate.report import Report, Table, build_report
from racf.evaluate.runner import SequenceRun, run_all, tasks
from racf.evaluate.stored import Stored, read_stored, sequences_of_trackers, trackers_in, with_results
from racf.evaluate.trackers import OPENCV, TrackerSpec

WIDTH_IN_A_PIPE = 160  # columns, so that nothing is folded where no terminal says how wide it is
Many = tyro.conf.UseAppendAction[tuple[str, ...]]


@dataclass(frozen=True, slots=True)
class TrackCommand:
    """Follow one box through a video file or a folder of pictures."""

    source: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="SOURCE")]
    """Video file, or folder of numbered pictures."""
    init: str
    """The target in the first frame: x,y,w,h in 0-based pixels."""
    out: Path
    """Text file for the boxes, a line x,y,w,h a frame, in 0-based pixels."""
    tracker: str = "racf"
    """racf, racf-, racf--, bacf or arcf-hc; settings may follow: racf,robust,admm_iterations=3."""
    set: Many = ()
    """A setting of the tracker, key=value (key alone: true)."""


@dataclass(frozen=True, slots=True)
class EvalCommand:
    """One-pass evaluation on a benchmark, of trackers run here and of stored boxes."""

    root: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="ROOT")]
    """Folder of the benchmark."""
    benchmark: str = "folder"
    """folder, uav123, uav123@10fps, dtb70, uavdt or visdrone2018: the layout of ROOT."""
    tracker: Many = ()
    """A tracker to run; settings may follow: racf,robust,admm_iterations=3 (racf if nothing is imported either)."""
    imports: Annotated[Many, tyro.conf.arg(name="import")] = ()
    """Stored boxes to compare: NAME=DIR, or DIR for all trackers in it."""
    only: Many = ()
    """Only the sequences that match this pattern, by name or benchmark/name."""
    jitter: int = 0
    """Also start each sequence this many times from a slightly wrong box."""
    set: Many = ()
    """A setting of all trackers that are run, key=value (key alone: true)."""
    table: int | None = None
    """Lay the results out as this table of the paper, 2 to 5, and run what it shows unless boxes are imported."""
    iterations: str = ",".join(map(str, studies.ITERATIONS))
    """ADMM iterations in tables 3 and 4."""
    etas: str = ",".join(map(str, studies.ETAS))
    """Weights of the residue in table 4."""
    pictures: int = 0
    """With --out: draw all trackers' boxes on frames of so many sequences, those that tell the trackers apart most."""
    json: bool = False
    """Print the figures as JSON on standard output, and nothing else there."""
    out: Path | None = None
    """Folder for boxes, tables and plots; an interrupted evaluation goes on from what is there."""
    jobs: int = 0
    """Processes at once; 0: one for each core."""
    dask: str | None = None
    """Run on the Dask cluster with this scheduler address instead (needs the extra `dask`)."""


@dataclass(frozen=True, slots=True)
class BenchCommand:
    """Frames per second of every variant and of OpenCV's trackers, stage by stage, on one core."""

    source: Annotated[tyro.conf.Positional[Path | None], tyro.conf.arg(metavar="[SOURCE]")] = None
    """Folder of sequences (as for `eval --benchmark folder`); rendered pictures if not given."""
    tracker: Many = ()
    """What to measure beside OpenCV's trackers (all variants and baselines, and racf,robust, if none is named)."""
    only: Many = ()
    """Only the sequences that match this pattern, by name or benchmark/name."""
    frames: int = 100
    """At most so many frames of each sequence."""
    no_first_call: bool = False
    """Leave out the times of a fresh process with a cold and a warm cache (it compiles everything: half a minute)."""
    json: bool = False
    """Print the figures as JSON on standard output, and nothing else there."""


Command = (
    Annotated[TrackCommand, tyro.conf.subcommand("track")]
    | Annotated[EvalCommand, tyro.conf.subcommand("eval")]
    | Annotated[BenchCommand, tyro.conf.subcommand("bench")]
)


def main() -> None:
    """Entry point of `racf`."""
    description = "The RACF tracker: track, evaluate, measure."
    sys.exit(run(Command, execute, prog="racf", description=description, config=(tyro.conf.FlagCreatePairsOff,)))


def execute(command: TrackCommand | EvalCommand | BenchCommand) -> None:
    """Do what was asked."""
    if isinstance(command, TrackCommand):
        track(command)
    elif isinstance(command, EvalCommand):
        evaluate(command)
    else:
        bench(command)


def track(command: TrackCommand) -> None:
    """`racf track`."""
    spec = _specs((command.tracker,), command.set)[0]
    try:
        target = Box.parse(command.init)
    except ValueError as error:
        raise UsageError(f"--init: {error}") from None
    if not command.source.exists():
        raise UsageError(f"{command.source} is neither a folder of pictures nor a video file")
    tracker, boxes = spec.build(), list[Box]()
    for image in frames_of(command.source):
        boxes.append(tracker.update(image).box if boxes else tracker.init(image, target).box)
    command.out.parent.mkdir(parents=True, exist_ok=True)
    write_boxes(command.out, np.array([[b.x, b.y, b.w, b.h] for b in boxes]))
    _say(f"{len(boxes)} boxes written to {command.out}")


def evaluate(command: EvalCommand) -> None:
    """`racf eval`."""
    grid = _grid(command)
    usual = ("racf",) if command.table is None else studies.trackers_of(command.table, grid)
    specs = _specs(command.tracker or (() if command.imports else usual), command.set)
    sequences = _sequences(command.root, command.benchmark, command.only)
    if command.pictures and not any(s.frames for s in sequences):
        raise UsageError(f"--pictures needs frames to draw on; the sequences of {command.root} have none")
    stored = _stored(command.imports, sequences, {spec.label for spec in specs})
    runs = _run(command, specs, sequences)
    report = build_report(sequences, runs, stored, with_results(command.root / "results", sequences))
    tables = [report.overall()] if command.table is None else [studies.lay_out(command.table, report, grid)]
    if command.out is not None:
        _write(report, [*tables, *report.by_group(), report.by_sequence()], command.out)
        if command.table is not None:
            studies.draw(command.table, report, grid, command.out)
        if command.pictures:
            boxes = {label: {name: of[0].boxes for name, of in runs[label].items()} for label in runs}
            boxes |= {label: left.boxes for label, left in stored.items()}
            chosen = report.telling_apart(command.pictures)
            plots.draw_pictures([s for s in sequences if s.name in chosen], boxes, command.out / "pictures")
    if command.json:
        print(json.dumps(report.as_json(), indent=1))
    else:
        _show(tables[0])


def _grid(command: EvalCommand) -> studies.Sweep:
    """The settings of tables 3 and 4, after a look at all numbers of the command."""
    if command.jitter < 0 or command.jobs < 0 or command.pictures < 0:
        raise UsageError(
            f"--jitter, --jobs, --pictures: no negative {min(command.jitter, command.jobs, command.pictures)}"
        )
    if command.table not in {None, 2, 3, 4, 5}:
        raise UsageError(f"--table is 2, 3, 4 or 5, not {command.table}")
    if command.table in {3, 4} and (command.tracker or command.imports):
        raise UsageError(f"--table {command.table} names its own trackers; leave out --tracker and --import")
    if command.pictures and command.out is None:
        raise UsageError("--pictures needs --out, the folder to draw into")
    try:
        iterations = tuple(int(n) for n in command.iterations.split(","))
        return studies.Sweep(iterations, tuple(float(eta) for eta in command.etas.split(",")))
    except ValueError:
        raise UsageError(f"--iterations and --etas: {command.iterations} / {command.etas} are not 1,2,3") from None


def bench(command: BenchCommand) -> None:
    """`racf bench`."""
    specs, others = _specs(command.tracker or speed.OURS, ()), speed.peers()
    if theirs := [spec.label for spec in specs if spec.name in OPENCV]:
        raise UsageError(f"--tracker names one of ours to compare with OpenCV's CSRT and KCF, not {', '.join(theirs)}")
    if command.frames < 2:
        raise UsageError(f"--frames is at least 2, not {command.frames}")
    if command.source is None:
        clips = speed.rendered_clips(command.frames)
    else:
        sequences = _sequences(command.source, "folder", command.only)
        published = with_results(command.source / "results", sequences)
        clips = speed.clips_of([s for s in sequences if not published or s.name in published], command.frames)
    if not others:
        _say("OpenCV here has neither CSRT nor KCF; `make bench` builds an environment that has")
    laps: dict[str, dict[str, speed.Lap]] = {}
    for clip in clips:
        laps[clip.name] = of = speed.measure([*specs, *others], clip)
        _say(f"{clip.name}: " + ", ".join(f"{label} {lap.fps:.0f}" for label, lap in of.items()) + " frames/s")
    figures = speed.summary(laps, [spec.label for spec in others])
    for label, floors in speed.floors_ms(specs, clips).items():
        figures["tracker"][label]["floor_ms"] = floors
    if not command.no_first_call:
        figures["first_call"] = speed.first_calls(specs[0])
    if command.json:
        print(json.dumps(figures, indent=1))
    else:
        for table in speed.tables(figures):
            _show(table)


def _specs(names: tuple[str, ...], settings: tuple[str, ...]) -> list[TrackerSpec]:
    try:
        specs = [TrackerSpec.parse(name).with_settings(list(settings)) for name in names]
        for spec in specs:
            spec.check()
    except ValueError as error:
        raise UsageError(str(error)) from None
    if len({spec.label for spec in specs}) < len(specs):
        raise UsageError(f"each --tracker is named once, not {', '.join(names)}")
    return specs


def _sequences(root: Path, benchmark: str, only: tuple[str, ...]) -> list[Sequence]:
    if not root.is_dir():
        raise UsageError(f"a folder of sequences is needed; {root} is not a folder")
    if not is_known(benchmark):
        raise UsageError(f"--benchmark is one of {', '.join(BENCHMARKS)}, not {benchmark!r}")
    sequences = read_benchmark(benchmark, root)
    chosen = [s for s in sequences if not only or any(_matches(s, pattern) for pattern in only)]
    if not chosen:
        raise UsageError(f"--only {' '.join(only)} leaves none of {len(sequences)} sequences")
    return chosen


def _matches(sequence: Sequence, pattern: str) -> bool:
    names = (sequence.name, f"{sequence.benchmark}/{sequence.name}")
    return any(fnmatch.fnmatchcase(name, pattern) for name in names)


def _stored(imports: tuple[str, ...], sequences: list[Sequence], taken: set[str]) -> dict[str, Stored]:
    """What `--import` asks for, by label."""
    found: dict[str, Stored] = {}
    for text in imports:
        label, equals, place = text.partition("=")
        folder = Path(place if equals else text)
        if not folder.is_dir():
            raise UsageError(f"--import {text}: {folder} is not a folder")
        for name in [label] if equals else _whole(text, folder, sequences):
            stored = read_stored(folder, name, sequences)
            if not stored.boxes:
                raise UsageError(f"--import {text}: {folder} has no boxes of {name} for any of the sequences")
            row = name if name not in taken else f"{name} (stored)"
            if row in found:
                raise UsageError(f"--import {text}: {row} is imported already; NAME=DIR gives it another name")
            if len(stored.boxes) < len(sequences):
                _say(
                    f"--import {text}: {name} has boxes for {len(stored.boxes)} of {len(sequences)} sequences; "
                    "the others are left out of the mean"
                )
            found[row] = stored
    if imports and not found:
        raise UsageError(f"--import {' '.join(imports)}: no boxes for any of the sequences")
    return found


def _whole(text: str, folder: Path, sequences: list[Sequence]) -> list[str]:
    """The trackers of a folder that have the most sequences; which ones are left out is said."""
    names = trackers_in(folder, sequences)
    for name, has in sequences_of_trackers(folder, sequences).items():
        if has and name not in names:
            _say(f"--import {text}: {name} is left out, for it has boxes for only {len(has)} of the sequences")
    return names


def _run(
    command: EvalCommand, specs: list[TrackerSpec], sequences: list[Sequence]
) -> dict[str, dict[str, list[SequenceRun]]]:
    todo = [task for spec in specs for sequence in sequences for task in tasks(spec, sequence, command.jitter)]
    if not todo:
        return {}
    jobs = command.jobs or len(os.sched_getaffinity(0))
    with progress.bar(todo) as bar:
        runs = run_all(todo, jobs=jobs, folder=command.out, dask=command.dask, done=bar.done)
    return {
        spec.label: {s.name: [runs[spec.label, s.name, i] for i in range(1 + command.jitter)] for s in sequences}
        for spec in specs
    }


def _write(report: Report, tables: list[Table], folder: Path) -> None:
    """Leave tables and figures in `folder`."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "report.json").write_text(json.dumps(report.as_json(), indent=1) + "\n")
    (folder / "tables.md").write_text("\n".join(table.markdown() for table in tables))
    drawn = [*plots.draw_curves(report, folder), *plots.draw_attributes(report, folder)]
    _say(f"report.json, tables.md and {len(drawn)} figures are in {folder}")


def _show(table: Table) -> None:
    """Print a table on standard output."""
    screen = ScreenTable(title=table.title, title_justify="left", box=box.SIMPLE, padding=(0, 1, 0, 0))
    for i, name in enumerate(table.header):
        screen.add_column(name, justify="right" if i else "left", overflow="fold")
    for row in table.rows:
        screen.add_row(*row)
    Console(width=None if sys.stdout.isatty() else WIDTH_IN_A_PIPE).print(screen)


def _say(text: str) -> None:
    print(text, file=sys.stderr)
