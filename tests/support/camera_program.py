"""Stands in for rpicam-vid and gst-launch: numbered frames on standard output at the pace of a camera.

python -m tests.support.camera_program h264|mjpeg|yuv420p|mpegts [--frames N] [--fail TEXT] [--child FILE] [--log FILE]
"""

import argparse
import os
import subprocess
import sys
import time
from fractions import Fraction

import av

from tests.support.clips import numbered

FPS = 30.0
FAST = {"preset": "ultrafast", "tune": "zerolatency", "x264-params": "repeat-headers=1:keyint=15"}


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("form")
    parser.add_argument("--frames", type=int, default=1 << 30)
    parser.add_argument("--fail", default="")
    parser.add_argument("--child")
    parser.add_argument(
        "--log", help="gets a line with our process id and one with when the first frame was due, at each start"
    )
    options = parser.parse_args()
    sys.stderr.write("starting the camera\n")
    if options.child:
        child = subprocess.Popen(["sleep", "1000"])
        with open(options.child, "w") as file:
            file.write(f"{os.getpid()} {child.pid}")
    out = sys.stdout.buffer
    container = av.open(out, "w", format="mpegts") if options.form == "mpegts" else None
    codec = "mjpeg" if options.form == "mjpeg" else "libx264"
    maker = container.add_stream(codec, rate=30, options=FAST) if container else av.CodecContext.create(codec, "w")
    if codec == "libx264" and not container:
        maker.options = FAST
    maker.width, maker.height, maker.pix_fmt = 192, 120, "yuvj420p" if codec == "mjpeg" else "yuv420p"
    if not container:
        maker.time_base, maker.framerate = Fraction(1, 30), Fraction(30)
    began_s = time.monotonic()
    if options.log:
        with open(options.log, "a") as file:
            file.write(f"{os.getpid()}\n{began_s}\n")
    for n in range(options.frames):
        time.sleep(max(began_s + n / FPS - time.monotonic(), 0.0))
        frame = av.VideoFrame.from_ndarray(numbered(n), format="bgr24").reformat(format=maker.pix_fmt)
        frame.pts = n
        if options.form == "yuv420p":
            out.write(frame.to_ndarray().tobytes())
        elif container:
            container.mux(maker.encode(frame))
        else:
            for packet in maker.encode(frame):
                out.write(bytes(packet))
        out.flush()
    if options.fail:
        sys.stderr.write(f"{options.fail}\n")
        sys.exit(3)


if __name__ == "__main__":
    main()
