"""Are camera, tracker and machine fit to fly?  Each check returns findings; one that is not ok says how to fix it."""

import itertools
import shutil
import statistics
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from follow.camera import Camera, CameraError
from follow.flight.finding import Finding, Health
from follow.messages import Frame
from follow.recording.recorder import RecordConfig
from follow.recording.video_encoder import Encoder, bits_per_s

FRAME_AGE_S = 0.2  # the gate's limit (follow/safety/limits.py)
LEAST_FPS = 10.0  # two frames within the gate's limit
KEPT_FRAMES = 30  # for timing the tracker: a second of a usual camera
TRACKER_FRACTION = 0.7  # of the time between two frames: the rest is for the loop and the recording
FLIGHT_S = 1800.0  # assumed length of a flight without a time limit: a battery's time
USUAL_SIZE = (1280, 720)  # assumed frame size before the first frame
ROWS_BYTES_S = 55_000.0  # response, mask, rows and messages: 3.3 MB a minute at dusk, less in light
JPEG_BYTES_PX = 0.17  # of a frame as JPEG of quality 75: 40 kB at 640x360
SPARE_FLIGHTS = 3  # fewer than these is a warning
SENSIBLE_UNIX_S = 1.7e9  # November 2023: a clock before this was never set


def check_camera(
    camera: Camera, now: Callable[[], float] | None, kept: list[Frame], seconds: float = 3.0
) -> list[Finding]:
    """Read an open camera for `seconds` and put its first frames into `kept`.

    `now` is the clock of a live camera's frames, None for a file.
    """
    times: list[float] = []
    ages: list[float] = []
    began_s = time.monotonic()
    try:
        for frame in camera.frames():
            if frame is not None:
                times.append(frame.t_s)
                if len(kept) < KEPT_FRAMES:
                    kept.append(frame)
                ages.append(now() - frame.t_s if now else 0.0)
            if time.monotonic() - began_s > seconds:
                break
    except CameraError as error:
        return [Finding("camera", Health.RED, str(error), "check that the source delivers")]
    if len(times) < 3 or times[-1] <= times[0]:
        return [Finding("camera", Health.RED, f"{len(times)} frames in {seconds:g} s", "check cable and power")]
    rate = (len(times) - 1) / (times[-1] - times[0])
    gap_ms = 1e3 * max(after - before for before, after in itertools.pairwise(times))
    text = f"{rate:.1f} frames/s, longest gap {gap_ms:.0f} ms"
    slow = rate < LEAST_FPS
    findings = [Finding("camera", Health.RED if slow else Health.OK, text, "choose a faster mode" if slow else "")]
    if now:
        age_s = statistics.median(ages)
        old = age_s > FRAME_AGE_S
        fix = "a shorter buffer, or a lower resolution" if old else ""
        text = f"frames are {1e3 * age_s:.0f} ms old when they arrive"
        findings.append(Finding("latency", Health.RED if old else Health.OK, text, fix))
    return findings


def check_tracker(update: Callable[[NDArray[np.uint8]], object], frames: Sequence[Frame], fps: float) -> Finding:
    """Time the tracker on this machine, on real images, against the time between two frames."""
    took_ms: list[float] = []
    for frame in frames:
        began_s = time.perf_counter()
        update(frame.image)
        took_ms.append(1e3 * (time.perf_counter() - began_s))
    took_ms.sort()
    usual, worst = statistics.median(took_ms), took_ms[min(len(took_ms) - 1, int(0.99 * len(took_ms)))]
    period_ms = 1e3 / fps
    text = f"{usual:.1f} ms per frame, 99 % within {worst:.1f} ms, of {period_ms:.1f} ms"
    if usual > period_ms:
        return Finding("tracker", Health.RED, text, "a smaller image, or a lower frame rate")
    if worst > TRACKER_FRACTION * period_ms:
        return Finding("tracker", Health.WARN, f"{text}: little headroom", "a smaller image, or a lower frame rate")
    return Finding("tracker", Health.OK, text)


def flight_bytes(size: tuple[int, int], config: RecordConfig, seconds: float = FLIGHT_S, fps: float = 30.0) -> float:
    """How much a flight's recording takes at most, for frames of this size, width and height."""
    frames = 0.0
    if config.pictures:
        jpeg = JPEG_BYTES_PX * size[0] * size[1] * fps
        frames = jpeg if config.encoder is Encoder.JPEG else bits_per_s(size) / 8
    return seconds * (frames + ROWS_BYTES_S)


def check_disk(
    folder: Path, size: tuple[int, int] | None = None, config: RecordConfig | None = None, seconds: float = 0.0
) -> Finding:
    """Free space against what a flight of `seconds` (0: a battery's time) with frames of this size takes."""
    existing = next(path for path in (folder.absolute(), *folder.absolute().parents) if path.exists())
    free = shutil.disk_usage(existing).free
    size, seconds = size or USUAL_SIZE, seconds or FLIGHT_S
    needed = flight_bytes(size, config or RecordConfig(), seconds)
    flight = f"{seconds / 60:.0f} min at {size[0]}x{size[1]} take {needed / 1e9:.2f} GB"
    text = f"{free / 1e9:.1f} GB free for {folder}; {flight}"
    if free < needed:
        return Finding("disk", Health.RED, text, "free some space, or use another --out")
    few = free < SPARE_FLIGHTS * needed
    return Finding("disk", Health.WARN if few else Health.OK, text, "free some space" if few else "")


def check_time(signs: bool, unix_s: float) -> Finding:
    """The machine's date: recordings show it, and signatures are refused if it is wrong."""
    if unix_s > SENSIBLE_UNIX_S:
        return Finding("clock", Health.OK, time.strftime("%Y-%m-%d %H:%M:%S UTC", time.gmtime(unix_s)))
    verdict = Health.RED if signs else Health.WARN
    return Finding("clock", verdict, "the machine's clock was never set", "timedatectl set-ntp true")
