"""Size and quality of a recording: MB a minute, PSNR inside the target's box, and the recorder's cost in the loop.

    python -m benchmarks.recording_size [--seconds 20] [--sequence FOLDER ...] [--encoder jpeg]

Records drawn scenes (noise of the camera included) at 640x360 and 1280x720, and the images of the folders scaled to
both, each with its box.  The cost is the time of `Recorder.tick` in the thread that flies.  Exits 1 above 8 MB a minute
at 640x360, 20 at 1280x720, or when the mean PSNR of the brightness inside the box is below 36 dB.
"""

import argparse
import math
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from examples.read_a_recording import images
from follow.cli.sim import scene_camera
from follow.config import CameraConfig
from follow.messages import Autopilot, Decision, Estimate, Frame, Mode, Setpoint, Tick, VehicleState
from follow.recording.recorder import RecordConfig, Recorder
from follow.recording.video_encoder import Encoder
from racf import Racf
from racf.box import Box
from sim.scenarios import SCENARIOS, build

SIZES = ((640, 360), (1280, 720))
MOST_MB = {(640, 360): 8.0, (1280, 720): 20.0}
LEAST_DB = 36.0
RATE_HZ = 30.0

Clip = Iterator[tuple[NDArray[np.uint8], Box]]


def scene(name: str, size: tuple[int, int], seconds: float) -> Clip:
    """A drawn scene, enlarged to the size, seen from a vehicle that flies a gentle curve, with the target's boxes."""
    scenario = replace(SCENARIOS[name], duration_s=seconds)
    drawn = scene_camera(scenario, Autopilot.PX4, CameraConfig())
    scale = size[0] / drawn.intrinsics.width
    camera, link, _ = build(scenario, 0, Autopilot.PX4, drawn)
    with camera:
        for frame in camera.frames():
            link.send(Setpoint(1.4, 0.0, 0.0, 0.05))
            box = camera.truth(frame.index).box if frame is not None else None
            if frame is not None and box is not None:
                large = np.asarray(cv2.resize(frame.image, size, interpolation=cv2.INTER_CUBIC), np.uint8)
                yield large, Box(box.x * scale, box.y * scale, box.w * scale, box.h * scale)


def sequence(folder: Path, size: tuple[int, int], seconds: float) -> Clip:
    """The images of a benchmark's sequence, scaled, with the annotated boxes."""
    rows = (folder / "groundtruth_rect.txt").read_text().split("\n")
    for path, row in list(zip(sorted(folder.glob("*.jpg")), rows, strict=False))[: int(seconds * RATE_HZ)]:
        x, y, w, h = (float(v) for v in row.replace(",", " ").split())
        image = cv2.imread(str(path))
        across, down = size[0] / image.shape[1], size[1] / image.shape[0]
        small = np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8)
        yield small, Box((x - 1) * across, (y - 1) * down, w * across, h * down)


def record(clip: Clip, out: Path, encoder: Encoder) -> tuple[int, list[float], list[tuple[NDArray[np.uint8], Box]]]:
    """Track and record a clip: how many frames, the loop's times for the recorder, ms, and every tenth image."""
    tracker = Racf()
    took_ms: list[float] = []
    kept: list[tuple[NDArray[np.uint8], Box]] = []
    with Recorder(out, RecordConfig(encoder=encoder), print, waits=False) as recorder:
        count = 0
        for n, (image, box) in enumerate(clip):
            track = tracker.init(image, box) if n == 0 else tracker.update(image, box)
            t_s = n / RATE_HZ
            state = VehicleState(t_s, t_s, 0.01 * math.sin(t_s), 0.02, t_s / 7, position_t_s=t_s, north_m=t_s * 1.4)
            estimate = Estimate(t_s, 0.1 * math.sin(t_s), 0.5, 12 + math.sin(t_s), 1.0, seen_t_s=t_s)
            sent = Setpoint(math.sin(t_s), 0.1, 0.0, 0.1 * math.cos(t_s))
            tick = Tick(
                Frame(image, t_s, n), track, state, estimate, sent, Decision(sent, Mode.FOLLOW), {"tracker": 9.0}
            )
            before = time.perf_counter()
            recorder.tick(tick, box)
            took_ms.append(1e3 * (time.perf_counter() - before))
            time.sleep(max(1 / RATE_HZ - time.perf_counter() + before, 0.0))  # as a camera would
            if n % 10 == 0:
                kept.append((image, track.box))
            count = n + 1
        figures = recorder.close()
    if dropped := figures.get("recording_dropped", 0):
        print(f"  {dropped} frames were dropped: this machine is too busy to encode them")
    return count, took_ms, kept


def psnr(a: NDArray[np.uint8], b: NDArray[np.uint8]) -> float:
    """Peak signal-to-noise ratio of two images, dB."""
    return 10 * math.log10(255**2 / max(float(np.mean((a.astype(float) - b) ** 2)), 1e-9))


def inside(image: NDArray[np.uint8], box: Box) -> NDArray[np.uint8]:
    """The brightness of the pixels inside the box."""
    left, top = max(int(box.x), 0), max(int(box.y), 0)
    part = image[top : int(box.y + box.h), left : int(box.x + box.w)]
    return np.asarray(cv2.cvtColor(part, cv2.COLOR_BGR2GRAY), np.uint8)


def measure(name: str, clip: Clip, size: tuple[int, int], encoder: Encoder) -> bool:
    """Record one clip and print its line; returns whether it stays within the bounds."""
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder)
        count, took_ms, kept = record(clip, out, encoder)
        megabytes = (out / "flight.rrd").stat().st_size / 1e6 / (count / RATE_HZ) * 60
        times = {round(t_s * RATE_HZ): image for t_s, image in images(out)}
        decibels = [
            psnr(inside(image, box), inside(times[10 * n], box))
            for n, (image, box) in enumerate(kept)
            if 10 * n in times
            and box.x + box.w > 1
            and box.y + box.h > 1
            and box.x < size[0] - 1
            and box.y < size[1] - 1
        ]
    p50, p99 = np.percentile(took_ms, (50, 99))
    size_text = f"{size[0]}x{size[1]:<5} {count:>5} frames  {megabytes:6.1f} MB/min"
    box_text = f"box {np.mean(decibels):5.1f} dB (worst {min(decibels):.1f})"
    print(f"{name:<24} {size_text}  {box_text}  recorder in the loop {p50:.2f} ms, p99 {p99:.2f} ms", flush=True)
    return megabytes <= MOST_MB[size] and float(np.mean(decibels)) >= LEAST_DB


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--sequence", type=Path, nargs="*", default=[])
    parser.add_argument("--scene", nargs="*", default=["walker", "trees", "dusk"])
    parser.add_argument("--encoder", type=Encoder, default=Encoder.AUTO)
    options = parser.parse_args()
    good = True
    for size in SIZES:
        for name in options.scene:
            good &= measure(name, scene(name, size, options.seconds), size, options.encoder)
        for folder in options.sequence:
            good &= measure(folder.name, sequence(folder, size, options.seconds), size, options.encoder)
    return 0 if good or options.encoder is Encoder.JPEG else 1


if __name__ == "__main__":
    sys.exit(main())
