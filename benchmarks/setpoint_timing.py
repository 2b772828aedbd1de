"""Timing of setpoints: `follow run` at 30 frames/s, recording, against `python -m sim.autopilot` over UDP.

    python -m benchmarks.setpoint_timing --seconds 60 [--autopilot ardupilot] [--let-cores-sleep] [--disk-stall 5]
    python -m benchmarks.setpoint_timing --watchers 10 --clicks 1000 --ground --ground-clicks 1000

A relay between the two notes when each setpoint passes.  Prints the intervals and the time from a frame to its
setpoint; exits 1 when their p99 is above 60 ms, one is above 150 ms, or following ended early.  It also prints the
steal time (processor time that the host of this virtual machine took away) and the intervals without any: on a shared
machine it dominates.
Processes of the lowest priority keep the cores awake, because the host wakes an idle virtual machine late; a real
machine has its governor at performance (docs/service).

With `--watchers` and `--clicks` the operator's page is on, and another process loads it (`benchmarks.page_load`).
With `--ground` a ground station finds the camera, draws its box again every 5 s and gets the video; `--ground-clicks` a
second come from another one.
With `--detector model.onnx` a network looks at the frames in a process of its own.
With `--disk-stall SECONDS` the recording goes to a file system of its own that is frozen for that time repeatedly:
every write to it waits (needs root, mkfs.ext4 and fsfreeze).  Two stalls are as far apart as one is long, plus a second
to catch up, which counts as part of the stall.  Other load on this machine affects both, so the stalls are compared
with the time between them: exits 1 when more of their intervals are above 150 ms than of the others.
"""

import argparse
import contextlib
import csv
import itertools
import json
import os
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import nullcontext
from datetime import datetime
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

ROOT = Path(__file__).parents[1]
os.environ["MAVLINK20"] = "1"

from follow.messages import Autopilot  # noqa: E402
from sim.scenarios import SCENARIOS, build  # noqa: E402
from tests.support.ground_load import GroundLoad  # noqa: E402
from tests.support.machine import awake, processor_ticks, stolen  # noqa: E402
from tests.support.real_flight import free_ports, real_flight  # noqa: E402

P99_MS, LARGEST_MS = 60.0, 150.0
STALLS = 4
CATCH_UP_S = 1.0  # after a stall, when everything queued is written at once
ENDED_S = 1.0  # without a setpoint at the end: following ended early, and the figures cover only a part
WATCH_S = 0.01  # the resolution of the system's steal time

Readings = list[tuple[float, int]]
"""A time, and the steal time until then, in the system's ticks over all cores."""


def frame_to_setpoint_ms(rows: list[dict[str, str]], times: list[float]) -> list[float]:
    """From each frame to the first setpoint that passed after its round began, ms.

    `times` are on this machine's monotonic clock; the rows of ticks.csv count from the flight's start, whose time of
    day they have to a millisecond.
    """
    day_s = datetime.fromisoformat(rows[0]["utc"].replace("Z", "+00:00")).timestamp()
    start_s = day_s - float(rows[0]["t_s"]) - (time.time() - time.monotonic())
    found: list[float] = []
    for row in rows:
        after = int(np.searchsorted(times, start_s + float(row["t_s"])))
        if 0 < after < len(times):
            found.append(1e3 * (times[after] - start_s - float(row["frame_t_s"])))
    return found


def watched(seconds: float) -> Readings:
    """Read for this many seconds."""
    readings: Readings = []
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        readings.append((time.monotonic(), processor_ticks()[-1]))
        time.sleep(WATCH_S)
    return readings


@contextlib.contextmanager
def own_disk(folder: Path) -> Iterator[Path]:
    """An empty file system in an image file, mounted in `folder`."""
    image, mount = folder / "disk.img", folder / "disk"
    mount.mkdir()
    image.touch()
    os.truncate(image, 256_000_000)
    subprocess.run(["mkfs.ext4", "-q", str(image)], check=True)
    subprocess.run(["mount", "-o", "loop", str(image), str(mount)], check=True)
    try:
        yield mount
    finally:
        subprocess.run(["umount", str(mount)], check=True)


@contextlib.contextmanager
def frozen(mount: Path, seconds: float, count: int) -> Iterator[list[tuple[float, float]]]:
    """Freeze a file system `count` times after as long without; yields a list for the stalls' ends."""
    stalls: list[tuple[float, float]] = []

    def freeze() -> None:
        for _ in range(count):
            time.sleep(seconds)
            subprocess.run(["fsfreeze", "--freeze", str(mount)], check=True)
            began_s = time.monotonic()
            try:
                time.sleep(seconds)
            finally:
                subprocess.run(["fsfreeze", "--unfreeze", str(mount)], check=True)
                stalls.append((began_s, time.monotonic() + CATCH_UP_S))
            time.sleep(CATCH_UP_S)

    thread = threading.Thread(target=freeze)
    thread.start()
    try:
        yield stalls
    finally:
        thread.join()


@contextlib.contextmanager
def loaded(page: str, options: argparse.Namespace) -> Iterator[None]:
    """Another process that opens windows of the page and clicks into it."""
    numbers = ("--watchers", options.watchers, "--clicks", options.clicks, "--seconds", options.seconds)
    words = [sys.executable, "-m", "benchmarks.page_load", page, *map(str, numbers)]
    with subprocess.Popen(words) as load:
        yield
        load.wait()


def judge_stalls(times: list[float], stalls: list[tuple[float, float]]) -> bool:
    """Print the intervals in the stalls and between them; whether the stalls made none longer than `LARGEST_MS`."""
    during = np.array([any(a <= end and b >= began for began, end in stalls) for a, b in itertools.pairwise(times)])
    intervals = 1e3 * np.diff(times)
    over = {}
    for name, part in (("in the stalls", intervals[during]), ("between them", intervals[~during])):
        over[name] = int(np.sum(part > LARGEST_MS))
        p50, p99 = np.percentile(part, (50, 99)) if len(part) else (0.0, 0.0)
        seconds = part.sum() / 1e3
        print(
            f"{name}: {len(part)} intervals in {seconds:.0f} s, p50 {p50:.1f} ms, p99 {p99:.1f}, largest "
            f"{part.max(initial=0.0):.1f}; {over[name]} above {LARGEST_MS:g} ms"
        )
    because = max(over["in the stalls"] - over["between them"], 0)
    print(f"because of the disk: {because}")
    return because == 0


def undisturbed(times: list[float], readings: Readings) -> NDArray[np.bool_]:
    """For each interval between `times`, whether there was no steal time from two readings before to two after it."""
    when, taken = np.array([t for t, _ in readings]), np.array([ticks for _, ticks in readings])
    place = np.searchsorted(when, times)
    last = len(readings) - 1
    before, after = np.clip(place[:-1] - 2, 0, last), np.clip(place[1:] + 2, 0, last)
    return np.asarray(taken[after] == taken[before])


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--autopilot", choices=("px4", "ardupilot"), default="px4")
    parser.add_argument("--let-cores-sleep", action="store_true")
    parser.add_argument("--watchers", type=int, default=0, help="windows of the page")
    parser.add_argument("--clicks", type=float, default=0.0, help="into the page, 1/s")
    parser.add_argument("--ground", action="store_true", help="ground camera and video")
    parser.add_argument("--ground-clicks", type=float, default=0.0, help="of another ground station, 1/s")
    parser.add_argument("--detector", type=Path, help="ONNX file of a network that looks at the frames beside the loop")
    parser.add_argument("--disk-stall", type=float, default=0.0, metavar="SECONDS")
    options = parser.parse_args()
    with contextlib.ExitStack() as stack:
        out = stack.enter_context(tempfile.TemporaryDirectory())
        if not options.let_cores_sleep:
            stack.enter_context(awake())
        if options.disk_stall:
            out = str(stack.enter_context(own_disk(Path(out))))
        flags, page = ["--seconds", "600"], ""
        ground = GroundLoad(options.ground_clicks) if options.ground else None
        box = build(SCENARIOS["walker"], 0, Autopilot(options.autopilot))[0].first()[1]
        if options.watchers or options.clicks:
            page = f"127.0.0.1:{free_ports(1)[0]}"
            flags += ["--page", page]
        flags += ["--detector", str(options.detector)] if options.detector else []
        flags += ground.options if ground is not None else []
        if page or ground is not None:
            flags += ["--target", f"{box.x:.0f},{box.y:.0f},{box.w:.0f},{box.h:.0f}"]
        with real_flight(options.autopilot, Path(out), options=flags) as real:
            real.order()
            if page:
                stack.enter_context(loaded(page, options))
            if ground is not None:
                stack.enter_context(ground.beside(real.pilot))
            began, ticks = time.monotonic(), processor_ticks()
            seconds = options.seconds
            stall = nullcontext([])
            if options.disk_stall:
                seconds = STALLS * (2 * options.disk_stall + CATCH_UP_S)
                stall = frozen(Path(out), options.disk_stall, STALLS)
            with stall as stalls:
                readings = watched(seconds)
            end, taken = time.monotonic(), stolen(ticks, processor_ticks())
            times = [p.t_s for p in real.relay.setpoints() if began <= p.t_s <= end]
            said = list(real.application.lines)
            real.application.end()
        with (Path(out) / "ticks.csv").open() as file:
            rows = [row for row in csv.DictReader(file) if row["frame"] and row["setpoint_forward_m_s"]]
        summary = json.loads((Path(out) / "summary.json").read_text())
    intervals = 1e3 * np.diff(times)
    latency = frame_to_setpoint_ms(rows, times)
    p50, p99 = np.percentile(intervals, (50, 99))
    if ground is not None:
        video_mb = ground.received / 1e6
        print(f"ground: {ground.clicked} clicks, {ground.boxes} boxes shown, {video_mb:.1f} MB of video")
    print(f"{len(times)} setpoints in {seconds:g} s")
    unharmed = end - times[-1] < ENDED_S
    if not unharmed:
        print(f"setpoints ended {end - times[-1]:.1f} s before the measurement did:", *said[-12:], sep="\n  ")
    if options.disk_stall:
        lost = ", ".join(
            f"{name} {summary.get(name, 0)}" for name in ("recording_dropped", "rows_lost", "packets_lost")
        )
        print(f"the disk stood still {STALLS} times for {options.disk_stall:g} s: {lost}")
        unharmed = judge_stalls(times, stalls) and unharmed
    print(f"{os.cpu_count()} cores, {taken:.0%} of their time taken by the host")
    print(f"interval ms: p50 {p50:.1f}, p99 {p99:.1f}, largest {intervals.max():.1f}")
    quiet = intervals[undisturbed(times, readings)]
    if len(quiet):
        p99_quiet = np.percentile(quiet, 99)
        print(f"the {len(quiet)} while the host took nothing: p99 {p99_quiet:.1f}, largest {quiet.max():.1f}")
    print("frame to setpoint ms: p50 {:.1f}, p99 {:.1f}".format(*np.percentile(latency, (50, 99))))
    over = sum(1 for a, b in itertools.pairwise(times) if 1e3 * (b - a) > LARGEST_MS)
    if options.disk_stall:
        return 0 if unharmed else 1
    return 0 if unharmed and p99 <= P99_MS and not over else 1


if __name__ == "__main__":
    sys.exit(main())
