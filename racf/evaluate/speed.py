"""Speed on one core: every tracker and its OpenCV peers on the same frames in the same run.

Each image is handed to all trackers in turn, so that other load on the machine slows all of them equally, in an order
that is drawn for each image: what the tracker before left in the caches helps or hinders all of them alike.  A ratio
is taken within a sequence, and the median over the sequences is reported.  A frame's time is that of the processor,
where the system can tell (the tracker has one thread): another program's turn does not count.
"""

import json
import os
import platform
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from time import perf_counter, thread_time

import cv2
import numpy as np

from racf.box import Box
from racf.evaluate import roofline
from racf.evaluate.benchmarks import Sequence
from racf.evaluate.cost import cost_of, cost_table
from racf.evaluate.figures import BenchFigures, ClipFigures, MachineFigures, SpeedFigures
from racf.evaluate.images import Image, read_frame
from racf.evaluate.report import Table
from racf.evaluate.runner import warm_up
from racf.evaluate.trackers import PEERS, TrackerSpec, opencv_has
from racf.threads import one_core

OURS = ("racf", "racf-", "racf--", "bacf", "arcf-hc", "racf,robust")

# Windows counts a thread's time in steps of 16 ms.
_clock = perf_counter if sys.platform == "win32" else thread_time

# A fresh process tracks some frames and prints the processor time of its first init and update, and its memory.
FIRST_CALL = """
import json, resource, sys, time
began = time.process_time()
import numpy as np
import racf
from racf.box import Box
tracker_type, preset = racf.Racf, racf.preset
imported = time.process_time()
def resident_mb():
    with open("/proc/self/statm") as file:
        return int(file.read().split()[1]) * resource.getpagesize() / 1e6
before = resident_mb()
image = np.random.default_rng(0).integers(0, 256, (720, 1280, 3), dtype=np.uint8)
tracker = tracker_type(preset(sys.argv[1]).with_settings(json.loads(sys.argv[2])))
tracker.init(image, Box(600, 300, 60, 40))
begun = time.process_time()
tracker.update(image)
first = time.process_time()
for _ in range(30):
    tracker.update(image)
held = resident_mb() - before - image.nbytes / 1e6
seconds = {"import_s": imported - began, "init_s": begun - imported, "first_update_s": first - begun}
print(json.dumps({**seconds, "memory_mb": held}))
"""


# A fresh process tracks a target back and forth, and prints its resident memory after given numbers of updates.
GROWTH = """
import itertools, json, resource, sys
import racf
from racf.evaluate.speed import Box, rendered
racf.one_core()
images = list(rendered(Box(400, 300, 48, 36), 60))
there_and_back = itertools.cycle(images + images[-2:0:-1])
tracker = racf.Racf(racf.preset(sys.argv[1]).with_settings(json.loads(sys.argv[2])))
tracker.init(next(there_and_back), Box(400, 300, 48, 36))
held, done = {}, 0
for count in json.loads(sys.argv[3]):
    for image in itertools.islice(there_and_back, count - done):
        tracker.update(image)
    done = count
    with open("/proc/self/statm") as file:
        held[str(count)] = int(file.read().split()[1]) * resource.getpagesize() / 1e6
print(json.dumps(held))
"""


@dataclass(frozen=True, slots=True, eq=False)
class Clip:
    """A named list of images and the target in the first."""

    name: str
    target: Box
    frames: tuple[Path, ...] = ()  # empty: rendered ones
    count: int = 0

    def images(self) -> Iterator[Image]:
        """The images, one at a time."""
        if self.frames:
            yield from (read_frame(path) for path in self.frames[: self.count])
        else:
            yield from rendered(self.target, self.count)


@dataclass(frozen=True, slots=True, eq=False)
class Lap:
    """Times of one tracker on one clip: milliseconds a frame, and of its stages."""

    frame_ms: list[float]
    stage_ms: dict[str, list[float]]

    @property
    def fps(self) -> float:
        """Frames per second of the tracker's own time."""
        return 1000 * len(self.frame_ms) / sum(self.frame_ms)


def clips_of(sequences: list[Sequence], frames: int) -> list[Clip]:
    """The first `frames` images of each sequence; raises where a sequence has fewer than two."""
    for sequence in sequences:
        sequence.need_frames()
        if len(sequence.frames) < 2:
            raise ValueError(f"sequence {sequence.name} has one frame; a speed needs at least 2")
    return [Clip(s.name, s.first_box(), s.frames, min(frames, len(s.frames))) for s in sequences]


def rendered_clips(frames: int) -> list[Clip]:
    """A small, a medium and a large target in rendered images of 1280x720."""
    return [Clip(f"rendered {w}x{h}", Box(400, 300, w, h), count=frames) for w, h in ((20, 16), (48, 36), (120, 90))]


def rendered(target: Box, frames: int) -> Iterator[Image]:
    """A textured rectangle that drifts over textured ground; the same images each time."""
    rng = np.random.default_rng(0)
    ground = cv2.resize(rng.integers(40, 160, (90, 160, 3), dtype=np.uint8), (1280, 720), interpolation=cv2.INTER_CUBIC)
    w, h = round(target.w), round(target.h)
    texture = cv2.resize(rng.integers(90, 255, (6, 6, 3), dtype=np.uint8), (w, h), interpolation=cv2.INTER_CUBIC)
    for step in range(frames):
        image = np.array(ground, dtype=np.uint8)
        x, y = round(target.x + 40 * np.sin(step / 12)), round(target.y + 25 * np.sin(step / 9))
        image[y : y + h, x : x + w] = texture
        yield image


def peers() -> list[TrackerSpec]:
    """The OpenCV trackers that are installed, for comparison."""
    return [TrackerSpec.parse(name) for name in PEERS if opencv_has(name)]


def floors_ms(specs: list[TrackerSpec], clips: list[Clip]) -> dict[str, dict[str, float]]:
    """The least time of each stage on this machine, by label and stage: the median over the clips."""
    one_core()
    best = roofline.machine()
    out: dict[str, dict[str, float]] = {}
    for spec in specs:
        works = [roofline.work_of_stages(spec.params(), clip.target) for clip in clips]
        out[spec.label] = {stage: round(median(best.ms(work[stage]) for work in works), 4) for stage in works[0]}
    return out


def bench(
    specs: list[TrackerSpec], clips: list[Clip], notify: Callable[[str], None], *, first_call: bool = True,
    updates: int = 0,
) -> BenchFigures:  # fmt: skip
    """Measure ours and OpenCV's CSRT and KCF on every clip; `notify` is given a line for each.

    `first_call` adds the times of fresh processes with cold and warm caches of compiled kernels, `updates` the memory
    of one after a tenth of them and after all.
    """
    others = peers()
    if not others:
        notify("OpenCV here has neither CSRT nor KCF; `make bench` builds an environment that has")
    laps: dict[str, dict[str, Lap]] = {}
    for clip in clips:
        laps[clip.name] = of = measure([*specs, *others], clip)
        notify(f"{clip.name}: " + ", ".join(f"{label} {lap.fps:.0f}" for label, lap in of.items()) + " frames/s")
    figures = summary(laps, [spec.label for spec in others])
    for label, floors in floors_ms(specs, clips).items():
        ours = figures["tracker"][label]
        ours["floor_ms"] = floors
        params = next(spec.params() for spec in specs if spec.label == label)
        ours["cost"] = cost_of(params, ours["fps"], [clip.target for clip in clips])
    if first_call:
        figures["first_call"] = first_calls(specs[0])
    if updates:
        figures["memory_mb"] = memory_after(specs[0], [max(updates // 10, 1), updates])
    return figures


def measure(specs: list[TrackerSpec], clip: Clip) -> dict[str, Lap]:
    """Laps by label, of trackers that see each image one after the other."""
    one_core()
    cv2.setRNGSeed(0)
    for spec in specs:
        warm_up(spec)
    running = [(spec.label, spec.build()) for spec in specs]
    laps = {spec.label: Lap([], {}) for spec in specs}
    rng = np.random.default_rng(0)
    for index, image in enumerate(clip.images()):
        if index == 0:
            for _, tracker in running:
                tracker.init(image, clip.target)
            continue
        for label, tracker in (running[i] for i in rng.permutation(len(running))):
            began = _clock()
            track = tracker.update(image)
            laps[label].frame_ms.append(1000 * (_clock() - began))
            for stage, ms in track.stage_ms.items():
                laps[label].stage_ms.setdefault(stage, []).append(ms)
    return laps


def first_calls(spec: TrackerSpec) -> dict[str, dict[str, float]]:
    """Processor seconds of import, first init and first update in a fresh process, and its resident memory.

    Cold without compiled kernels, but with Python's bytecode, as pip leaves a package; then warm.
    """
    written = {"PYTHONDONTWRITEBYTECODE": ""}
    first_call(spec, written)  # writes the bytecode cache where the installer did not
    with tempfile.TemporaryDirectory() as cache:
        cold, warm = (first_call(spec, {**written, "NUMBA_CACHE_DIR": cache}) for _ in range(2))
    return {"cold": cold, "warm": warm}


def first_call(spec: TrackerSpec, environment: dict[str, str]) -> dict[str, float]:
    """The same for one fresh process, with this added to its environment."""
    return _in_a_fresh_process(FIRST_CALL, spec, environment)


def memory_after(spec: TrackerSpec, updates: list[int]) -> dict[str, float]:
    """The resident MB of a fresh process after each of these numbers of updates, by number."""
    return _in_a_fresh_process(GROWTH, spec, {}, json.dumps(updates))


def _in_a_fresh_process(
    program: str, spec: TrackerSpec, environment: dict[str, str], *arguments: str
) -> dict[str, float]:  # fmt: skip
    command = [sys.executable, "-c", program, spec.name, json.dumps(dict(spec.settings)), *arguments]
    environment = {**os.environ, **environment}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise RuntimeError(f"a fresh process with {spec.label} failed: {done.stderr.strip().splitlines()[-1]}")
    return {key: round(value, 3) for key, value in json.loads(done.stdout).items()}


def summary(laps: dict[str, dict[str, Lap]], peer_labels: list[str]) -> BenchFigures:
    """Medians over the clips, from laps by clip and label."""
    ours: dict[str, SpeedFigures] = {}
    theirs: dict[str, SpeedFigures] = {}
    for label in next(iter(laps.values())):
        of = [lap[label] for lap in laps.values()]
        fps = round(median(lap.fps for lap in of), 2)
        if label in peer_labels:
            theirs[label] = {"fps": fps}
            continue
        stages = list(dict.fromkeys(stage for lap in of for stage in lap.stage_ms))
        ours[label] = {
            "fps": fps,
            "ms": {stage: round(median(median(lap.stage_ms.get(stage, [0.0])) for lap in of), 3) for stage in stages},
            "times_as_fast_as": {
                peer: round(median(lap[label].fps / lap[peer].fps for lap in laps.values()), 2) for peer in peer_labels
            },
        }
    clips: dict[str, dict[str, ClipFigures]] = {
        name: {label: {"fps": round(lap.fps, 2), "frames": len(lap.frame_ms) + 1} for label, lap in of.items()}
        for name, of in laps.items()
    }
    machine: MachineFigures = {
        "cpu": _cpu(), "python": platform.python_version(), "opencv": cv2.__version__, "threads": 1,
    }  # fmt: skip
    return {"tracker": ours, "peers": theirs, "clips": clips, "machine": machine}


def tables(figures: BenchFigures) -> list[Table]:
    """The same for the screen."""
    ours, peer_rows = figures["tracker"], figures["peers"]
    speeds = [
        (label, f"{of['fps']:.1f}", *(f"{of.get('times_as_fast_as', {})[peer]:.2f}" for peer in peer_rows))
        for label, of in ours.items()
    ]
    speeds += [(peer, f"{of['fps']:.1f}", *("" for _ in peer_rows)) for peer, of in peer_rows.items()]
    stages = list(dict.fromkeys(stage for of in ours.values() for stage in of.get("ms", {})))
    out = [
        Table(
            f"Frames per second, one thread, median of {len(figures['clips'])} sequences ({figures['machine']['cpu']})",
            ("tracker", "fps", *(f"times {peer}" for peer in peer_rows)),
            tuple(speeds),
        ),
        Table(
            "Milliseconds by stage, median (and the least that arithmetic and memory allow)",
            ("stage", *ours),
            tuple((stage, *(_with_floor(of, stage) for of in ours.values())) for stage in stages),
        ),
    ]
    out.append(cost_table(figures))
    if "first_call" in figures:
        rows = tuple(
            (kind, *(f"{of[part]:.2f}" for part in ("import_s", "init_s", "first_update_s")), f"{of['memory_mb']:.0f}")
            for kind, of in figures["first_call"].items()
        )
        header = ("caches", "import s", "init s", "first update s", "memory beyond imports MB")
        out.append(Table(f"A fresh process with {next(iter(ours))}, in processor time", header, rows))
    if "memory_mb" in figures:
        rows = tuple((updates, f"{held:.1f}") for updates, held in figures["memory_mb"].items())
        out.append(Table(f"What a process with {next(iter(ours))} holds", ("updates", "resident MB"), rows))
    return out


def _with_floor(figures: SpeedFigures, stage: str) -> str:
    least = figures.get("floor_ms", {}).get(stage)
    return f"{figures.get('ms', {}).get(stage, 0.0):.2f}" + (f" ({least:.2f})" if least is not None else "")


def _cpu() -> str:
    cpus = Path("/proc/cpuinfo")
    if cpus.is_file():
        for line in cpus.read_text().splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.machine()
