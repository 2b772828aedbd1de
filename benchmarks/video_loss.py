"""Effect of lost packets on the video to the ground station.  It works on the packets without a clock, on any machine.

    python -m benchmarks.video_loss [--loss 0.1] [--key-s 0.1 0.25] [--rate-bit-s 2000000] [--seconds 20]

A drawn scene with a number in each image is coded as `follow` sends it; of its RTP packets a part is lost at random.
FFmpeg's decoder, fed frame by frame, and GStreamer's elements of QGroundControl (depayloader, parser, decoder) decode
the rest.  An image is whole if it shows its number and each of its 64 tiles has WHOLE_DB; a spoilt stretch is the
time of the frames between two whole ones.  Exits 1 if 5 % of the stretches last longer than a second.
"""

import argparse
import contextlib
import os
import random
import shutil
import struct
import subprocess
import sys
import tempfile
from collections.abc import Iterable, Sequence
from typing import Any

import av
import numpy as np
from numpy.typing import NDArray

from benchmarks.recording_size import scene
from benchmarks.video_out import CLIP_S, RATE_HZ, WHOLE_DB, brightness, number_in, with_clock, worst_tile_db
from follow.operator import video_stream
from follow.operator.video_stream import Coding, VideoStream
from tests.support.rtp import by_frame, units

SIZE = 640, 360
LONGEST_S = 1.0
HEAD = """\
| key frame every, s | kbit/s | worst tile without loss, dB | viewer | whole images | \
spoilt for: median, s | p95, s | longest, s |
|---|---|---|---|---|---|---|---|"""

Image = NDArray[np.uint8]


class Kept:
    """Takes the place of the network: keeps the packets."""

    def __init__(self) -> None:
        self.addresses = (("kept", 1),)
        self.packets: list[bytes] = []

    def write(self, packet: bytes) -> int:
        self.packets.append(bytes(packet))
        return len(packet)

    def close(self) -> None:
        pass


def coded(clip: Sequence[Image], count: int, coding: Coding) -> list[bytes]:
    """The packets of `count` numbered images."""
    kept, plain = Kept(), video_stream.Fanout
    video_stream.Fanout = lambda _twice: kept
    try:
        stream = VideoStream(coding, "", print)
    finally:
        video_stream.Fanout = plain
    for n in range(count):
        stream.show(with_clock(clip[n % len(clip)], n), n / RATE_HZ)
    stream.close()
    return kept.packets


def by_libav(packets: Sequence[bytes]) -> Iterable[Image]:
    """The grey images that FFmpeg's decoder shows."""
    codec: Any = av.CodecContext.create("h264", "r")
    codec.thread_count = 1
    for frame in by_frame(packets):
        packet = av.Packet(b"".join(b"\0\0\0\1" + unit for unit in units(frame)))
        with contextlib.suppress(av.error.InvalidDataError):
            yield from [brightness(image) for image in codec.decode(packet)]


def by_gstreamer(packets: Sequence[bytes]) -> Iterable[Image]:
    """The grey images that GStreamer shows; the packets come framed [RFC 4571]."""
    caps = "application/x-rtp-stream,media=video,clock-rate=90000,encoding-name=H264"
    width, height = SIZE
    with tempfile.NamedTemporaryFile(suffix=".rtp") as file:
        for packet in packets:
            file.write(struct.pack(">H", len(packet)) + packet)
        file.flush()
        words = f"gst-launch-1.0 -q filesrc location={file.name} ! {caps} ! rtpstreamdepay ! parsebin ! decodebin ! "
        words += f"videoconvert ! video/x-raw,format=I420,width={width},height={height} ! fdsink fd=1 sync=false"
        environment = {**os.environ, "OMP_NUM_THREADS": "1"}
        with subprocess.Popen(words.split(), stdout=subprocess.PIPE, env=environment) as process:
            assert process.stdout is not None
            whole = width * height * 3 // 2
            while len(data := process.stdout.read(whole)) == whole:
                yield np.frombuffer(data, np.uint8)[: width * height].reshape(height, width)


def judged(images: Iterable[Image], sent: Sequence[Image], count: int) -> tuple[set[int], list[float]]:
    """The numbers of the images that are whole, and the worst tile of each that shows its number, dB."""
    inner = slice(SIZE[1] // 12 + 8, -(SIZE[1] // 12 + 8))
    whole, tiles = set[int](), list[float]()
    for image in images:
        n = number_in(image)
        if 0 <= n < count:
            tiles.append(worst_tile_db(image[inner], sent[n % len(sent)][inner]))
            whole |= {n} if tiles[-1] >= WHOLE_DB else set()
    return whole, tiles


def stretches_s(whole: set[int], count: int) -> list[float]:
    """The lengths of the spoilt stretches, s."""
    gaps = np.diff([-1, *sorted(whole), count]) - 1
    return [float(gap) / RATE_HZ for gap in gaps if gap > 0]


def arrived(packets: Sequence[bytes], loss: float, seed: int) -> list[bytes]:
    """The packets that are not lost."""
    dice = random.Random(seed)
    return [packet for packet in packets if dice.random() >= loss]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--loss", type=float, default=0.1, help="part of the packets that get lost")
    parser.add_argument("--key-s", type=float, nargs="+", default=[video_stream.KEY_S])
    parser.add_argument("--rate-bit-s", type=int, default=2_000_000)
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--seeds", type=int, default=3)
    options = parser.parse_args()
    viewers = {"FFmpeg": by_libav, "GStreamer": by_gstreamer}
    if shutil.which("gst-launch-1.0") is None:
        del viewers["GStreamer"]
        print("gst-launch-1.0 is not installed: without GStreamer")
    count = round(options.seconds * RATE_HZ)
    clip = [image for image, _ in scene("walker", SIZE, CLIP_S)]
    sent = [brightness(av.VideoFrame.from_ndarray(image, "bgr24")) for image in clip]
    print(HEAD)
    late = False
    for key_s in options.key_s:
        packets = coded(clip, count, Coding("libx264", RATE_HZ, options.rate_bit_s, key_s))
        kbit_s = sum(map(len, packets)) / 125 / options.seconds
        for name, viewer in viewers.items():
            _, tiles = judged(viewer(packets), sent, count)
            shares, stretches = list[float](), list[float]()
            for seed in range(options.seeds):
                whole, _ = judged(viewer(arrived(packets, options.loss, seed)), sent, count)
                shares.append(len(whole) / count)
                stretches += stretches_s(whole, count)
            middle, p95 = np.percentile(stretches, (50, 95))
            late |= bool(p95 > LONGEST_S)
            row = f"| {key_s:g} | {kbit_s:.0f} | {np.median(tiles):.1f} | {name}"
            print(f"{row} | {np.mean(shares):.0%} | {middle:.2f} | {p95:.2f} | {max(stretches):.2f} |", flush=True)
    return int(late)


if __name__ == "__main__":
    sys.exit(main())
