"""Run trackers over sequences: in this process, in several, or on a Dask cluster; the boxes are the same.

A task is one tracker on one sequence from one start.  Each begins from a fresh tracker and a fixed random seed, so its
boxes depend on nothing else.  With a folder, finished tasks are left there and found again by the next run.
"""

import hashlib
import sys
import zlib
from collections import Counter
from collections.abc import Callable, Generator, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from time import perf_counter, thread_time
from typing import Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from racf.box import Box
from racf.errors import TrackerError
from racf.evaluate import outcomes
from racf.evaluate.benchmarks import Sequence
from racf.evaluate.images import FrameCache
from racf.evaluate.metrics import Boxes
from racf.evaluate.own import OwnTracker
from racf.parallel import each
from racf.threads import one_core
from racf.track import Track

# Jittered starts: the shift of the toolkits' spatial robustness evaluation (a tenth of the target's size) and half of
# its change of size (0.8 to 1.2), drawn evenly and separately for both axes.
JITTER_SHIFT = 0.1
JITTER_SIZE = 0.1
# Decoding a JPEG takes as long as tracking in it.  For each process: some 500 images of 1024 x 540.
_FRAMES = FrameCache(max_bytes=900_000_000)


class Tracker(Protocol):
    """Follows one box through images."""

    def init(self, image: NDArray[np.uint8], box: Box) -> Track:
        """Learn the target inside `box`."""
        ...

    def update(self, image: NDArray[np.uint8]) -> Track:
        """Find it in the next image."""
        ...


class TrackerBuilder(Protocol):
    """Builds one tracker.  It is pickled for the processes that run it, so it does not contain the tracker itself."""

    @property
    def label(self) -> str:
        """The row's name in tables."""
        ...

    def build(self) -> Tracker:
        """A fresh tracker."""
        ...

    def fingerprint(self) -> str:
        """Changes whenever the boxes could."""
        ...


@dataclass(frozen=True, slots=True)
class Task:
    """One tracker on one sequence.  `start` is 0 from the annotated first box, 1, 2, ... from jittered ones."""

    spec: TrackerBuilder
    benchmark: str
    sequence: str
    frames: tuple[Path, ...]
    first_box: Box
    start: int = 0

    def key(self) -> str:
        """Identifies the outcome: the same key means the same boxes."""
        what = (self.spec.fingerprint(), self.benchmark, self.sequence, str(self.frames[0].resolve()))
        numbers = (len(self.frames), str(self.first_box), self.start)
        return hashlib.sha256(repr((what, numbers)).encode()).hexdigest()[:16]


@dataclass(frozen=True, slots=True, eq=False)
class SequenceRun:
    """The outcome of a task: boxes in 1-based pixels like the annotations', and the time inside `update`."""

    boxes: Boxes
    fps: float
    stage_ms: dict[str, float]  # median over the frames, by stage


def tasks(spec: TrackerBuilder, sequence: Sequence, jitter: int) -> list[Task]:
    """The nominal task and `jitter` ones from jittered first boxes; raises where the sequence cannot be run."""
    sequence.need_frames()
    box = sequence.first_box()
    starts = [box, *(jittered(box, sequence.name, start) for start in range(1, jitter + 1))]
    return [Task(spec, sequence.benchmark, sequence.name, sequence.frames, b, i) for i, b in enumerate(starts)]


def jittered(box: Box, sequence: str, start: int) -> Box:
    """A first box that is a little wrong; the same for each tracker, drawn by the sequence's name and the start."""
    rng = np.random.default_rng([zlib.crc32(sequence.encode()), start])
    dx, dy = rng.uniform(-JITTER_SHIFT, JITTER_SHIFT, 2)
    w, h = box.w * (1 + rng.uniform(-JITTER_SIZE, JITTER_SIZE)), box.h * (1 + rng.uniform(-JITTER_SIZE, JITTER_SIZE))
    return Box.around(box.centre_x + dx * box.w, box.centre_y + dy * box.h, w, h)


def run_task(task: Task) -> SequenceRun:
    """Track one sequence; raises ValueError naming a frame that cannot be read, TrackerError for a failed tracker."""
    one_core()  # figures are those of one core, and the sums in the boxes do not depend on how many there are
    warm_up(task.spec)
    cv2.setRNGSeed(0)  # GrabCut's mixtures begin from random numbers
    tracker, boxes, seconds, stages = task.spec.build(), [task.first_box], 0.0, dict[str, list[float]]()
    # Processor time, which other programs hardly change; a tracker of yours may use several threads or a graphics card.
    clock = perf_counter if isinstance(tracker, OwnTracker) or sys.platform == "win32" else thread_time
    image = _FRAMES.read(task.frames[0])
    with naming(task.spec.label, f"{task.benchmark}/{task.sequence}, {task.frames[0].name}"):
        tracker.init(image, task.first_box)
    for path in task.frames[1:]:
        image = _FRAMES.read(path)
        with naming(task.spec.label, f"{task.benchmark}/{task.sequence}, {path.name}"):
            began = clock()
            track = tracker.update(image)
            seconds += clock() - began
        boxes.append(track.box)
        for stage, ms in track.stage_ms.items():
            stages.setdefault(stage, []).append(ms)
    rows = np.array([[b.x + 1, b.y + 1, b.w, b.h] for b in boxes], dtype=np.float64)
    # Rounded as they are written, so that a resumed evaluation is judged on the same boxes.
    return SequenceRun(
        boxes=rows.round(3),
        fps=(len(boxes) - 1) / seconds if seconds else 0.0,
        stage_ms={stage: float(np.median(ms)) for stage, ms in stages.items()},
    )


@contextmanager
def naming(label: str, frame: str) -> Generator[None]:
    """Raise TrackerError, which names the tracker and its source and frame, for an error of a tracker within."""
    try:
        yield
    except (ValueError, cv2.error) as error:
        who = "" if isinstance(error, TrackerError) else f"tracker {label}: "
        raise TrackerError(f"{frame}: {who}{' '.join(str(error).split())}") from error


@cache
def warm_up(spec: TrackerBuilder) -> None:
    """Compile or load the tracker's kernels, once a process, so that no frame's time includes it.

    A tracker of yours that fails on noise may yet do on images.
    """
    noise = np.random.default_rng(0).integers(0, 256, (120, 160, 3), dtype=np.uint8)
    tracker = spec.build()
    with suppress(TrackerError):
        tracker.init(noise, Box(60, 40, 40, 40))
        tracker.update(noise)


def run_all(
    todo: list[Task],
    *,
    jobs: int = 1,
    folder: Path | None = None,
    dask: str | None = None,
    done: Callable[[Task, SequenceRun, bool], None] = lambda task, run, stored: None,
) -> dict[tuple[str, str, int], SequenceRun]:
    """Outcomes by (label, sequence, start), from `jobs` processes (1: this one) or from a Dask cluster.

    `done` is called after each, and told whether it was found in `folder`.
    """
    runs: dict[tuple[str, str, int], SequenceRun] = {}
    left: list[Task] = []
    for task in todo:
        run = _stored(folder, task)
        if run is None:
            left.append(task)
        else:
            runs[task.spec.label, task.sequence, task.start] = run
            done(task, run, True)
    # Long sequences first, so that all processes end together; one sequence's tasks in a row decode it once.
    total = Counter[Path]()
    for task in left:
        total[task.frames[0].parent] += len(task.frames)
    left.sort(key=lambda task: (-total[task.frames[0].parent], task.frames[0].parent, -len(task.frames)))
    for task, run in _outcomes(left, jobs, dask):
        if folder is not None:
            outcomes.store(folder, task, run)
        runs[task.spec.label, task.sequence, task.start] = run
        done(task, run, False)
    return runs


def _outcomes(todo: list[Task], jobs: int, dask: str | None) -> Iterator[tuple[Task, SequenceRun]]:
    if dask is not None:
        yield from each(run_task, todo, dask=dask)  # the workers must see the frames under the same paths
    elif jobs == 1:
        for task in todo:
            yield task, run_task(task)
    else:
        # Compile the kernels in this process first: otherwise each process would compile them and print so.
        for spec in {type(task.spec.build()): task.spec for task in todo}.values():
            warm_up(spec)
        yield from each(run_task, todo, jobs)


def _stored(folder: Path | None, task: Task) -> SequenceRun | None:
    found = None if folder is None else outcomes.find(folder, task)
    if found is None:
        return None
    boxes, known = found
    return SequenceRun(boxes, known["fps"], known["stage_ms"])
