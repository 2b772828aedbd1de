"""The `racf` command: its options.  The work is done by `racf.evaluate`."""

import json
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import tyro
from rich import box
from rich.console import Console
from rich.table import Table as ScreenTable

from racf.box import Box
from racf.commandline import UsageError, run
from racf.evaluate import speed, studies, tracking
from racf.evaluate.benchmarks import read_benchmark
from racf.evaluate.evaluation import evaluate, select, to_stderr
from racf.evaluate.report import Table
from racf.evaluate.stored import with_results
from racf.evaluate.trackers import OPENCV, TrackerSpec, builders_of

FEW = 10  # sequences: over fewer a 95 % bootstrap interval holds the mean in less than 91 % of draws [simulated]
WIDTH_IN_A_PIPE = 160  # columns: wide enough that no line wraps where no terminal reports its width
OptionalPath = Annotated[Path | None, tyro.conf.arg(metavar="PATH")]
Many = tyro.conf.UseAppendAction[tuple[str, ...]]


@dataclass(frozen=True, slots=True)
class TrackCommand:
    """Follow one box through a video file or a folder of images."""

    source: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="SOURCE")]
    """Video file, or folder of numbered images."""
    out: Path
    """Text file for the boxes, a line x,y,w,h for each frame, 0-based pixels; a .csv beside it adds the confidence."""
    init: Annotated[str | None, tyro.conf.arg(metavar="x,y,w,h")] = None
    """The target in the first frame: x,y,w,h in 0-based pixels.  Not needed with --truth."""
    truth: OptionalPath = None
    """Annotation in 1-based pixels, a line for each frame: prints precision and AUC."""
    overlay: OptionalPath = None
    """Video file (.mp4, .avi or .mkv) to write, with the box, its confidence and the annotation drawn on each frame."""
    tracker: str = "racf"
    """racf, racf-, racf--, bacf, arcf-hc with settings; csrt, kcf, mil, nano, vit; or module:Class.
    The default is the paper's; follow flies with racf,robust."""
    set: Many = ()
    """A setting of the tracker, key=value (key alone: true).  Can be given several times."""


@dataclass(frozen=True, slots=True)
class EvalCommand:
    """One-pass evaluation on a benchmark, of trackers run here and of stored boxes."""

    root: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="ROOT")]
    """Folder of the benchmark."""
    benchmark: str = "folder"
    """Layout of ROOT: folder, uav123, uav123@10fps, dtb70, uavdt or visdrone2018."""
    tracker: Many = ()
    """A tracker to run.  Ours, with settings: racf, racf-, racf--, bacf, arcf-hc; for example racf,robust.
    OpenCV's: csrt, kcf, mil, nano,backbone=FILE,neckhead=FILE, vit,net=FILE.  Your own: module:Class.
    Can be given several times; paired differences are to the first.  By default racf, the paper's,
    unless boxes are imported; follow flies with racf,robust."""
    imports: Annotated[Many, tyro.conf.arg(name="import")] = ()
    """Stored boxes to compare with: NAME=DIR, DIR for all trackers in it, or the --out folder of an evaluation."""
    only: Many = ()
    """Use only the sequences that match this pattern, by name or benchmark/name.  Can be given several times."""
    jitter: int = 0
    """Start each sequence this many times more, from slightly wrong first boxes."""
    set: Many = ()
    """A setting of all trackers that are run, key=value (key alone: true).  Can be given several times."""
    table: Annotated[int | None, tyro.conf.arg(metavar="INT")] = None
    """Lay the results out as this table of the paper, 2 to 5, and run the trackers in it unless boxes are imported."""
    iterations: str = ",".join(map(str, studies.ITERATIONS))
    """ADMM iterations in tables 3 and 4."""
    etas: str = ",".join(map(str, studies.ETAS))
    """Weights of the residue in table 4."""
    images: int = 0
    """With --out: draw all boxes on frames of this many sequences, those that tell the trackers apart most."""
    json: bool = False
    """Print the figures as JSON on standard output, and nothing else there."""
    out: OptionalPath = None
    """Folder for boxes, tables and plots; an interrupted evaluation goes on from the boxes there."""
    jobs: int = 0
    """Number of processes; 0: one for each core."""
    dask: Annotated[str | None, tyro.conf.arg(metavar="ADDRESS")] = None
    """Run on the Dask cluster with this scheduler address instead (needs the extra `dask`)."""


@dataclass(frozen=True, slots=True)
class BenchCommand:
    """Frames per second of every variant and of OpenCV's trackers, stage by stage, on one core."""

    source: Annotated[tyro.conf.Positional[Path | None], tyro.conf.arg(metavar="[SOURCE]")] = None
    """Folder of sequences (as for `eval --benchmark folder`).  By default rendered images."""
    tracker: Many = ()
    """A tracker of ours to measure beside OpenCV's.  By default all variants, baselines and racf,robust."""
    only: Many = ()
    """Use only the sequences that match this pattern, by name or benchmark/name."""
    frames: int = 100
    """Frames of each sequence, at most."""
    no_first_call: bool = False
    """Leave out the times of a fresh process with a cold and a warm cache (it compiles all: some ten seconds)."""
    updates: int = 0
    """Run also this many updates in a fresh process, and show its memory after a tenth of them and after all."""
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
    """Run one command."""
    if isinstance(command, TrackCommand):
        track(command)
    elif isinstance(command, EvalCommand):
        evaluate_command(command)
    else:
        bench(command)


def track(command: TrackCommand) -> None:
    """`racf track`."""
    if command.out.suffix == ".csv":
        raise UsageError(f"--out is the text file of boxes (boxes.txt); {command.out} is where the confidence goes")
    if command.out.is_dir():
        raise UsageError(f"--out must be a file for the boxes; {command.out} is a folder")
    if not command.source.exists():
        raise UsageError(f"{command.source} is neither a folder of images nor a video file")
    if command.truth is not None and not command.truth.is_file():
        raise UsageError(f"--truth must be a file of annotations; {command.truth} is not a file")
    tracking.require_outputs(command.source, command.truth, command.out, command.overlay)
    truth, target = (None, None) if command.truth is None else tracking.read_truth(command.truth)
    try:
        (spec,) = builders_of(command.tracker, command.set)
        target = target if command.init is None else Box.parse(command.init)
    except ValueError as error:
        raise UsageError(str(error)) from None
    if target is None:
        raise UsageError("a target is needed: --init x,y,w,h, or --truth with its annotation")
    tracked = tracking.Tracked([], [])
    try:
        tracking.track(command.source, target, spec, truth, command.overlay, to_stderr, tracked)
    except BaseException:  # a frame that cannot be read, or Ctrl-C: what was tracked before it stays
        if tracked.tracks:
            beside = tracked.write(command.out)
            to_stderr(f"the {len(tracked.tracks)} boxes before that are written to {command.out} and {beside}")
        raise
    beside = tracked.write(command.out)
    lost = sum(not t.found for t in tracked.tracks)
    to_stderr(
        f"{len(tracked.tracks)} boxes written to {command.out} and {beside}: "
        f"{tracked.fps:.0f} frames/s, not found in {lost} frames"
    )
    if truth is not None:
        if len(truth) != len(tracked.tracks):
            judged = min(len(truth), len(tracked.tracks))
            to_stderr(
                f"{command.truth} has {len(truth)} rows, the source {len(tracked.tracks)} frames: {judged} are judged"
            )
        score = tracked.score(truth)
        to_stderr(f"precision at 20 px {score.precision_20px:.1f} %, AUC {score.auc:.1f} %")


def evaluate_command(command: EvalCommand) -> None:
    """`racf eval`."""
    if command.out is not None and command.out.exists() and not command.out.is_dir():
        raise UsageError(f"--out must be a folder; {command.out} is a file")
    evaluation = evaluate(
        command.root,
        benchmark=command.benchmark,
        trackers=command.tracker,
        settings=command.set,
        imports=command.imports,
        only=command.only,
        jitter=command.jitter,
        table=command.table,
        sweep=_sweep(command),
        images=command.images,
        out=command.out,
        jobs=command.jobs,
        dask=command.dask,
    )
    if command.json:
        print(json.dumps(evaluation.figures(), indent=1))
    else:
        for table in evaluation.summary:
            _show(table)
        if 1 < (counted := len(evaluation.report.counted)) < FEW:
            to_stderr(f"over {counted} sequences a 95 % interval is too narrow: {FEW} or more make it one")


def _sweep(command: EvalCommand) -> studies.Sweep:
    try:
        iterations = tuple(int(n) for n in command.iterations.split(","))
        return studies.Sweep(iterations, tuple(float(eta) for eta in command.etas.split(",")))
    except ValueError:
        raise UsageError(f"--iterations and --etas: {command.iterations} / {command.etas} are not 1,2,3") from None


def bench(command: BenchCommand) -> None:
    """`racf bench`."""
    specs = _specs(command.tracker or speed.OURS)
    if command.frames < 2:
        raise UsageError(f"--frames is at least 2, not {command.frames}")
    if command.updates < 0:
        raise UsageError(f"--updates is at least 0, not {command.updates}")
    figures = speed.bench(
        specs, _clips(command), to_stderr, first_call=not command.no_first_call, updates=command.updates
    )
    if command.json:
        print(json.dumps(figures, indent=1))
    else:
        for table in speed.tables(figures):
            _show(table)


def _specs(names: tuple[str, ...]) -> list[TrackerSpec]:
    try:
        specs: list[Any] = builders_of(names)
    except ValueError as error:
        raise UsageError(str(error)) from None
    if theirs := [spec.label for spec in specs if spec.name in OPENCV or ":" in spec.name]:
        raise UsageError(f"--tracker names one of ours to compare with OpenCV's CSRT and KCF, not {', '.join(theirs)}")
    return specs


def _clips(command: BenchCommand) -> list[speed.Clip]:
    if command.source is None:
        return speed.rendered_clips(command.frames)
    if not command.source.is_dir():
        raise UsageError(f"a folder of sequences is needed; {command.source} is not a folder")
    sequences = select(command.source, command.only, read_benchmark("folder", command.source))
    published = with_results(command.source / "results", sequences)
    return speed.clips_of([s for s in sequences if not published or s.name in published], command.frames)


def _show(table: Table) -> None:
    """Print a table on standard output."""
    screen = ScreenTable(title=table.title, title_justify="left", box=box.SIMPLE, padding=(0, 1, 0, 0))
    for i, name in enumerate(table.header):
        screen.add_column(name, justify="right" if i else "left", overflow="fold")
    for row in table.rows:
        screen.add_row(*row)
    Console(width=None if sys.stdout.isatty() else WIDTH_IN_A_PIPE).print(screen)
