"""The video to the ground station as received: rate, glass-to-glass delay, CPU, and the effect of 10 % packet loss.

    python -m benchmarks.video_out [--seconds 10] [--size 640x360 1280x720] [--viewer libav gstreamer gstreamer-fast]

A camera shows a drawn scene with a clock in each image (the frame's number, in blocks).  `VideoOut` sends it to a
viewer in a process of its own, which notes when each image has been decoded, which number it shows and how it differs
from what was sent.  From the drawing of the clock to the decoded image is the delay; a camera's exposure and the
refresh of a screen come on top.  Three phases: nothing lost, 10 % of the packets lost, and bursts of such
losses with a clean time after each.

An image is whole if each of its 64 tiles is (WHOLE_DB).  A spoilt stretch is the time from one whole image to the next
where at least one between them was spoilt or never shown.  Recovery from a burst ends with the first of IN_A_ROW whole
images in a row; it is counted from the burst's end, less the stream's delay.

The viewers: `libav` is FFmpeg's RTP receiver by PyAV; `gstreamer` the pipeline of QGroundControl (its caps, its jitter
buffer of 200 ms, in step with the stream's clock), `gstreamer-fast` the same in its low-latency mode; both need
gst-launch-1.0 with gstreamer1.0-plugins-good, -bad and -libav.  Exits 1 if after a burst the images are not whole again
within RECOVERS_S.
"""

import argparse
import contextlib
import json
import os
import random
import shutil
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import av
import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.recording_size import scene
from follow.messages import Frame
from follow.operator.video_out import VideoAddress, VideoConfig, VideoOut
from tests.follow.test_record_flight import tick
from tests.support.rtp import SDP

ROOT = Path(__file__).parents[1]
RATE_HZ, CLIP_S = 30.0, 5.0
LOSS = 0.1
BITS = 12
TILE = 8  # tiles across and down: an image is whole if each of them is
WHOLE_DB = 25.0  # of each tile; a strip that was lost or moved is below 20
GREY = 48, 208
CAPS = "application/x-rtp, media=(string)video, clock-rate=(int)90000, encoding-name=(string)H264"

BURST_S, CLEAN_S = 0.5, 1.5
IN_A_ROW = 10
RECOVERS_S = 1.0

HEAD = """\
| size | viewer | frames/s | kbit/s | delay: median, ms | p95, ms | CPU of a core | worst tile, dB | at 10 % loss: \
whole images | spoilt for: median, s | p95, s | longest, s | after a burst whole again in: median, s | longest, s |
|---|---|---|---|---|---|---|---|---|---|---|---|---|---|"""

ROW = """\
| {0} | {1} | {rate:.1f} | {kbit_s:.0f} | {median_ms:.0f} | {p95_ms:.0f} | {cpu:.0%} | {db:.0f} | {whole:.0%} | \
{spoilt_s:.2f} | {spoilt_p95_s:.2f} | {longest_s:.2f} | {recovers_s:.2f} | {slowest_s:.2f} |"""

Shown = tuple[int, float, float]
"""Number of an image, when it was decoded, and the PSNR of its worst tile, dB."""


def with_clock(image: NDArray[np.uint8], n: int) -> NDArray[np.uint8]:
    """A copy of the image with the number in blocks across its first rows and, inverted, across its last ones."""
    rows, columns = image.shape[0] // 12, image.shape[1] // BITS
    image = image.copy()
    bits = np.array([n >> bit & 1 for bit in range(BITS)])
    for strip, lit in ((image[:rows], bits), (image[-rows:], 1 - bits)):
        strip[:, : BITS * columns] = np.array(GREY, np.uint8)[lit].repeat(columns)[:, None]
    return image


def number_in(grey: NDArray[np.uint8]) -> int:
    """The number that the brightness of an image shows; -1 if its two strips disagree, because one was lost."""
    rows, columns = grey.shape[0] // 12, grey.shape[1] // BITS
    found: list[NDArray[np.bool_]] = []
    for strip in (grey[:rows], grey[-rows:]):
        blocks = strip[rows // 4 : -(-rows * 3 // 4), : BITS * columns].mean(axis=0).reshape(BITS, columns)
        found.append(blocks[:, columns // 4 : -columns // 4].mean(axis=1) > sum(GREY) / 2)
    return int(found[0] @ (1 << np.arange(BITS))) if (found[0] ^ found[1]).all() else -1


def worst_tile_db(a: NDArray[np.uint8], b: NDArray[np.uint8]) -> float:
    """PSNR of the tile that differs most."""
    error = (a.astype(np.float32) - b) ** 2
    tiles = cv2.resize(error, (TILE, TILE), interpolation=cv2.INTER_AREA)
    return float(10 * np.log10(255**2 / max(float(tiles.max()), 1e-6)))


def brightness(frame: av.VideoFrame) -> NDArray[np.uint8]:
    """The brightness of a frame as H.264 codes it, without a conversion."""
    return np.asarray(frame.to_ndarray(format="yuv420p")[: frame.height], np.uint8)


def grey_images(viewer: str, port: int, size: tuple[int, int]) -> Iterator[NDArray[np.uint8]]:
    """The images that a viewer decodes, as they come."""
    if viewer == "libav":
        with tempfile.NamedTemporaryFile("w", suffix=".sdp") as file:
            file.write(SDP.format(port=port))
            file.flush()
            options = {"protocol_whitelist": "file,udp,rtp", "fflags": "nobuffer", "reorder_queue_size": "0"}
            with av.open(file.name, options=options, timeout=(20.0, 5.0)) as container:
                container.streams.video[0].thread_count = 1
                for frame in container.decode(video=0):
                    yield brightness(frame)
        return
    buffer, sync = ("rtpjitterbuffer !", "true") if viewer == "gstreamer" else ("", "false")
    line = f'udpsrc port={port} caps="{CAPS}" ! {buffer} parsebin ! queue ! decodebin ! videoconvert ! '
    line += f"video/x-raw,format=I420,width={size[0]},height={size[1]} ! fdsink fd=1 sync={sync}"
    with subprocess.Popen(f"exec gst-launch-1.0 -q {line}", shell=True, stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        whole = size[0] * size[1] * 3 // 2
        while len(data := process.stdout.read(whole)) == whole:
            yield np.frombuffer(data, np.uint8)[: size[0] * size[1]].reshape(size[1], size[0])


def view(viewer: str, port: int, clip: Path) -> None:
    """The viewer's process: prints each image's number, time and worst tile as JSON until it is ended."""
    sent = np.load(clip)
    size = sent.shape[2], sent.shape[1]
    with contextlib.suppress(av.error.FFmpegError, BrokenPipeError):
        for grey in grey_images(viewer, port, size):
            now, n = time.monotonic(), number_in(grey)
            inner = slice(size[1] // 12 + 8, -(size[1] // 12 + 8))
            worst = worst_tile_db(grey[inner], sent[n % len(sent)][inner]) if n >= 0 else 0.0
            print(json.dumps((n, now, round(worst, 1))), flush=True)


class Lossy:
    """Forwards datagrams from `port` to `to` and drops the fraction `loss`."""

    def __init__(self, to: int) -> None:
        self.loss = 0.0
        self._dice = random.Random(1)
        self._in = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._in.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4_000_000)
        self._in.bind(("127.0.0.1", 0))
        self.port = self._in.getsockname()[1]
        self.bytes = 0
        self._to = ("127.0.0.1", to)
        threading.Thread(target=self._run, daemon=True).start()

    def _run(self) -> None:
        while True:
            data = self._in.recv(2048)
            self.bytes += len(data)
            if self._dice.random() >= self.loss:
                self._in.sendto(data, self._to)


def free_port() -> int:
    """An unused even port."""
    while True:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            probe.bind(("127.0.0.1", 0))
            if (port := probe.getsockname()[1]) % 2 == 0:
                return port


def run(
    viewer: str, clip: list[NDArray[np.uint8]], file: Path, seconds: float, config: VideoConfig
) -> dict[str, object]:
    """Send the clip to one viewer in three phases; returns what the viewer decoded."""
    port = free_port()
    air = Lossy(port)
    command = [sys.executable, "-m", "benchmarks.video_out", "--view", viewer, str(port), str(file)]
    process = subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, text=True, start_new_session=True)
    shown: list[Shown] = []
    assert process.stdout is not None
    lines = process.stdout
    reader = threading.Thread(target=lambda: shown.extend(tuple(json.loads(line)) for line in lines), daemon=True)
    reader.start()
    video = VideoOut(VideoAddress("127.0.0.1", air.port), config, print)
    drawn_s: dict[int, float] = {}
    n, begin = 0, time.monotonic()

    def show_until(end: float) -> None:
        nonlocal n
        while (due := begin + n / RATE_HZ) < end:
            time.sleep(max(due - time.monotonic(), 0.0))
            drawn_s[n] = time.monotonic()
            image = with_clock(clip[n % len(clip)], n)
            video.see(replace(tick(0), frame=Frame(image, drawn_s[n], n)))
            n += 1

    while not shown and n < 60 * RATE_HZ:
        show_until(begin + (n + 30) / RATE_HZ)  # until the viewer is there
    show_until(begin + (n + 60) / RATE_HZ)  # and has shown what waited meanwhile
    cpu, wall, sent_bytes = thread_cpu_s(video), time.monotonic(), air.bytes
    clean = n, begin + n / RATE_HZ
    show_until(clean[1] + seconds)
    cpu, sent_bytes = (thread_cpu_s(video) - cpu) / (time.monotonic() - wall), air.bytes - sent_bytes
    lossy = n, time.monotonic()
    air.loss = LOSS
    show_until(lossy[1] + seconds)
    air.loss, again = 0.0, (n, time.monotonic())
    show_until(again[1] + CLEAN_S)
    ends: list[float] = []
    for _ in range(round(seconds)):
        air.loss = LOSS
        show_until(time.monotonic() + BURST_S)
        air.loss = 0.0
        ends.append(time.monotonic())
        show_until(ends[-1] + CLEAN_S)
    time.sleep(1.0)
    video.close()
    os.killpg(process.pid, 15)
    process.wait()
    reader.join(5.0)
    return {**figures(shown, drawn_s, (clean, lossy, again), ends), "cpu": cpu, "kbit_s": sent_bytes / 125 / seconds}


def thread_cpu_s(video: VideoOut) -> float:
    """CPU time of the thread that encodes and sends."""
    return time.clock_gettime(time.pthread_getcpuclockid(video._worker._thread.ident))


def figures(
    shown: list[Shown], drawn_s: dict[int, float], phases: tuple[tuple[int, float], ...], ends: list[float]
) -> dict[str, object]:
    """The figures of what the viewer decoded; each phase begins with a number at a time, bursts end at `ends`."""
    clean, lossy, again = phases
    # An image whose number cannot be read counts as spoilt.
    known = [(n, at, db) for n, at, db in shown if n < 0 or (n in drawn_s and 0.0 < at - drawn_s[n] < 3.0)]
    delays = [at - drawn_s[n] for n, at, _ in known if clean[0] <= n < lossy[0]]
    delay_s = float(np.median(delays))
    whole_s = [at for n, at, db in known if lossy[0] <= n < again[0] and db >= WHOLE_DB]
    spells = np.diff([lossy[1] + delay_s, *whole_s, again[1] + delay_s])
    spoilt = spells[spells > 1.5 / RATE_HZ]
    after = [recovery_s(known, end + delay_s) for end in ends]
    return {
        "rate": len(delays) / (lossy[1] - clean[1]),
        "median_ms": 1e3 * delay_s,
        "p95_ms": 1e3 * float(np.percentile(delays, 95)),
        "db": float(np.median([db for n, _, db in known if clean[0] <= n < lossy[0]])),
        "whole": len(whole_s) / (again[0] - lossy[0]),
        "spoilt_s": float(np.median(spoilt)),
        "spoilt_p95_s": float(np.percentile(spoilt, 95)),
        "longest_s": float(spoilt.max()),
        "recovers_s": float(np.median(after)),
        "slowest_s": max(after),
    }


def recovery_s(known: list[Shown], end_s: float) -> float:
    """Time from `end_s` to the first of IN_A_ROW whole images in a row; CLEAN_S if there is none."""
    until = [(at, db >= WHOLE_DB) for _, at, db in known if end_s <= at < end_s + CLEAN_S]
    for first in range(len(until) - IN_A_ROW + 1):
        if all(is_whole for _, is_whole in until[first : first + IN_A_ROW]):
            return until[first][0] - end_s
    return CLEAN_S


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--view", nargs=3, metavar=("VIEWER", "PORT", "CLIP"), help=argparse.SUPPRESS)
    parser.add_argument("--seconds", type=float, default=10.0, help="of each of the first two phases")
    parser.add_argument("--size", nargs="+", default=["640x360", "1280x720"])
    parser.add_argument("--viewer", nargs="+", default=["libav", "gstreamer", "gstreamer-fast"])
    parser.add_argument("--rate-bit-s", type=int, nargs="+", default=[2_000_000, 4_000_000], help="one for each size")
    parser.add_argument("--key-s", type=float, default=VideoConfig().key_s)
    parser.add_argument("--twice", action="store_true", help="each packet twice, within the same bit rate")
    options = parser.parse_args()
    if options.view:
        view(options.view[0], int(options.view[1]), Path(options.view[2]))
        return 0
    if shutil.which("gst-launch-1.0") is None:
        options.viewer = [viewer for viewer in options.viewer if not viewer.startswith("gstreamer")]
        print("gst-launch-1.0 is not installed: without GStreamer")
    print(HEAD)
    worst_s = 0.0
    with tempfile.TemporaryDirectory() as folder:
        for size, rate in zip(options.size, options.rate_bit_s, strict=False):
            width, height = (int(side) for side in size.split("x"))
            clip = [image for image, _ in scene("walker", (width, height), CLIP_S)]
            file = Path(folder) / "clip.npy"
            np.save(file, np.stack([brightness(av.VideoFrame.from_ndarray(image, "bgr24")) for image in clip]))
            for viewer in options.viewer:
                config = VideoConfig(width=width, rate_bit_s=rate, key_s=options.key_s, twice=options.twice)
                f = run(viewer, clip, file, options.seconds, config)
                print(ROW.format(size, viewer, **f), flush=True)
                worst_s = max(worst_s, float(f["slowest_s"]))
    return 1 if worst_s > RECOVERS_S else 0


if __name__ == "__main__":
    sys.exit(main())
