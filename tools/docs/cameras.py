"""The table of docs/cameras.md: rate, delay and time errors of each kind of source, over loopback, with real encoders.

    python -m tools.docs.cameras [--seconds 6]

Every frame shows its number, so that rate, delay and time are measured from the image itself.  Delay is the time from
when a frame was due at the encoder until the loop would get it; time error is the error of the frame's own time.  A
stream is then broken for 3 s; reconnect is the time from its return to the next frame.  A program is killed; reconnect
is the time from then to the next frame.
"""

import argparse
import contextlib
import glob
import os
import signal
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from follow.camera import CameraError
from follow.camera.live import LiveVideo
from follow.camera.video import open_replay
from tests.support.clips import encode, number_in, numbered
from tests.support.senders import FPS, MjpegServer, RtspServer, rtp_with_sdp, udp_ts

HEADER = ("source", "opens", "frames kept", "delay, median / 95 %", "time error, median / 95 %", "reconnect")
PROGRAM = f"{sys.executable} -m tests.support.camera_program"
COUNT = 60
INTERLACED = {"codec_options": {"x264-params": "interlaced=1:tff=1", "flags": "+ildct+ilme"}}
FILES: dict[str, tuple[str, dict]] = {
    "file H.264": ("a.mp4", {}),
    "file H.265": ("a.mkv", {"codec": "libx265", "codec_options": {"x265-params": "log-level=0"}}),
    "file MJPEG": ("a.avi", {"codec": "mjpeg", "pix_fmt": "yuvj420p"}),
    "file AV1": ("av1.mp4", {"codec": "libsvtav1", "codec_options": {"preset": "12"}}),
    "file H.264, interlaced": ("i.mp4", INTERLACED),
    "file H.264, variable rate": ("v.mp4", {"stamps_s": list(np.cumsum([0.03, 0.09, 0.03, 0.3] * (COUNT // 4)))}),
}
PROGRAMS = {
    "exec:, MJPEG": f"exec:{PROGRAM} mjpeg",
    "exec:, H.264": f"exec:{PROGRAM} h264",
    "exec:, raw YUV 4:2:0": f"exec?format=yuv420p&size=192x120:{PROGRAM} yuv420p",
    "exec:, MPEG-TS": f"exec:{PROGRAM} mpegts",
}


def file_row(label: str, folder: Path) -> tuple[str, ...]:
    """Decode a file; count the frames with the right number, row and time."""
    name, how = FILES[label]
    stamps_s = how.get("stamps_s", [n / FPS for n in range(COUNT)])
    path = encode(folder / name, map(numbered, range(COUNT)), **how)
    began_s = time.perf_counter()
    with open_replay(str(path), None, print) as camera:
        opened_s = time.perf_counter() - began_s
        frames = [frame for frame in camera.frames() if frame is not None]
    kept = [n for n, frame in enumerate(frames) if number_in(frame.image) == frame.index == n]
    errors = [abs(frame.t_s - (stamps_s[frame.index] - stamps_s[0])) for frame in frames]
    time_error = f"{1e3 * np.median(errors):.1f} / {1e3 * np.percentile(errors, 95):.1f} ms"
    return label, f"{1e3 * opened_s:.0f} ms", f"{len(kept)} of {COUNT}", "", time_error, ""


def live_row(
    label: str,
    name: str,
    open_: Callable[[], None],
    break_: Callable[[], None],
    due_s: Callable[[int], float | None],
    seconds: float,
    absent_s: float = 3.0,
) -> tuple[str, ...]:
    """Watch a stream for `seconds`, break it for `absent_s`, and wait for it."""
    again = "no"
    open_()
    began_s = time.monotonic()
    try:
        with LiveVideo(name, lambda _line: None) as camera:
            opened_s = time.monotonic() - began_s
            got: list[tuple[float, int, float]] = []
            broken_s = back_s = 0.0
            for frame in camera.frames():
                now_s = time.monotonic()
                if frame is not None and not broken_s:
                    got.append((now_s, number_in(frame.image), frame.t_s))
                if not broken_s and now_s > began_s + opened_s + 1.0 + seconds:
                    broken_s = now_s
                    break_()
                if broken_s and not back_s and now_s > broken_s + absent_s:
                    back_s = now_s
                    open_()
                if back_s and (frame is not None or now_s > back_s + 15.0):
                    again = "no" if frame is None else f"{now_s - back_s:.1f} s"
                    break
    finally:
        break_()
    first, last = got[0][1], got[-1][1]
    timed = [(now, due, t) for now, n, t in got if (due := due_s(n)) is not None]
    delay = np.percentile([now - due for now, due, _ in timed], (50, 95)) if timed else None
    error = np.percentile([abs(t - due) for _, due, t in timed], (50, 95)) if timed else None
    cells = ["" if of is None else f"{1e3 * of[0]:.0f} / {1e3 * of[1]:.0f} ms" for of in (delay, error)]
    return label, f"{opened_s:.1f} s", f"{len(got)} of {last - first + 1}", *cells, again


def streams(folder: Path, seconds: float) -> list[tuple[str, ...]]:
    """The rows of streams over loopback."""
    rtsp, http = RtspServer(), MjpegServer()
    senders = {
        "RTSP over TCP, H.264": (rtsp.url, rtsp),
        "RTSP over UDP, H.264": (f"{rtsp.url}#transport=udp", rtsp),
        "RTP by an SDP file, H.264": rtp_with_sdp(folder),
        "MPEG-TS over UDP, H.264": udp_ts(),
        "HTTP MJPEG": (http.url, http),
    }
    rows = []
    for label, (name, sender) in senders.items():
        rows.append(live_row(label, name, sender.open, sender.close, sender.frames.sent_t_s.get, seconds))
        print(rows[-1], file=sys.stderr)
    return rows


def programs(folder: Path, seconds: float) -> list[tuple[str, ...]]:
    """The rows of a program's output; it writes when each frame is due, and is killed to break it."""
    rows = []
    for label, name in PROGRAMS.items():
        log = folder / f"due {len(rows)}"

        def kill(log: Path = log) -> None:
            if log.exists():
                with contextlib.suppress(ProcessLookupError):
                    os.kill(int(log.read_text().splitlines()[-2]), signal.SIGKILL)

        def due_s(n: int, log: Path = log) -> float | None:
            lines = log.read_text().splitlines()
            return float(lines[1]) + n / FPS if len(lines) > 1 else None

        rows.append(live_row(label, f"{name} --log '{log}'", lambda: None, kill, due_s, seconds, 0.0))
        print(rows[-1], file=sys.stderr)
    return rows


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=6.0)
    seconds = parser.parse_args().seconds
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        rows = [file_row(label, folder) for label in FILES]
        rows += streams(folder, seconds)
        rows += programs(folder, seconds)
    devices = glob.glob("/dev/video*")
    for device in devices:
        try:
            with LiveVideo(device, print) as camera:
                rows.append((f"V4L2 {device}", "yes", f"{camera.size}", "", "", ""))
        except CameraError as error:
            rows.append((f"V4L2 {device}", str(error), "", "", "", ""))
    if not devices:
        rows.append(("V4L2", "not tried: this kernel has no video device and no loopback module", "", "", "", ""))
    for row in (HEADER, ("---",) * len(HEADER), *rows):
        print(f"| {' | '.join(row)} |")


if __name__ == "__main__":
    main()
