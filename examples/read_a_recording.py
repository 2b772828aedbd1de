"""A recording as arrays: the columns of ticks.csv, and the images of flight.rrd.

    python examples/read_a_recording.py out/demo

docs/after_a_flight.md describes every column.
"""

import csv
import sys
from collections import deque
from collections.abc import Iterator
from itertools import islice
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np
from numpy.typing import NDArray

WORDS = ("utc", "vehicle_mode", "target_contradiction", "mode", "reason", "notes")


def columns(folder: Path) -> dict[str, NDArray[Any]]:
    """The ticks by column, `ticks["t_s"]` for one: numbers, NaN for an empty field, and texts in those of WORDS."""
    with (folder / "ticks.csv").open(newline="", encoding="utf-8") as file:
        names, *rows = csv.reader(file)
    fields = dict(zip(names, zip(*rows, strict=True), strict=bool(rows)))
    return {
        name: np.array(of) if name in WORDS else np.array([float(field or "nan") for field in of])
        for name, of in fields.items()
    }


def images(folder: Path) -> Iterator[tuple[float, NDArray[np.uint8]]]:
    """Time since the flight's start, s, and image (rows, columns, 3) in BGR, of each recorded frame.

    The frames are an H.264 stream, a packet for each, or with `--record.encoder jpeg` a JPEG for each.
    """
    decoder = av.CodecContext.create("h264", "r")
    waiting: deque[float] = deque()  # times of the packets whose frames are still in the decoder
    for time_s, stream, data in packets(folder):
        if stream:
            waiting.append(time_s)
            for frame in decoder.decode(av.Packet(data)):
                yield waiting.popleft(), frame.to_ndarray(format="bgr24")
        else:
            yield time_s, np.asarray(cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR), np.uint8)
    if waiting:
        for frame in decoder.decode(None):
            yield waiting.popleft(), frame.to_ndarray(format="bgr24")


def packets(folder: Path) -> Iterator[tuple[float, bool, bytes]]:
    """Time, whether it belongs to an H.264 stream, and the bytes of each recorded frame, in the order of time."""
    from rerun.chunk import RrdReader  # noqa: PLC0415 - the columns can be read without Rerun

    found: list[tuple[float, bool, bytes]] = []
    if not (folder / "flight.rrd").exists():  # not every flight records images
        return
    for chunk in RrdReader(folder / "flight.rrd").stream():
        if chunk.entity_path == "/image" and not chunk.is_static:
            batch = chunk.to_record_batch()
            stream = "VideoStream:sample" in batch.schema.names
            blobs = batch.column("VideoStream:sample" if stream else "EncodedImage:blob")
            for time, blob in zip(batch.column("seconds"), blobs, strict=True):
                data = blob.values.flatten().to_numpy(zero_copy_only=False).astype(np.uint8)
                found.append((time.value / 1e9, stream, data.tobytes()))
    yield from sorted(found, key=lambda packet: packet[0])


def main(folder: Path) -> None:
    """Print a summary of a flight."""
    ticks = columns(folder)
    if not ticks:
        sys.exit(f"{folder} holds a recording without a round")
    print(f"{len(ticks['t_s'])} rounds in {ticks['t_s'][-1]:.1f} s, modes {', '.join(sorted(set(ticks['mode'])))}")
    print(f"range {np.nanmean(ticks['target_range_m']):.1f} m on average")
    for name in ("forward_m_s", "right_m_s", "down_m_s", "yaw_rate_rad_s"):
        off = ticks[f"setpoint_{name}"] - ticks[f"desired_{name}"]
        if np.isfinite(off).any():  # else nothing was sent
            print(f"the gate changed {name} by {np.nanmax(np.abs(off)):.2f} at most")
    for t_s, image in islice(images(folder), 1):
        print(f"the first image, at {t_s:.2f} s, is {image.shape[1]}x{image.shape[0]}")


if __name__ == "__main__":
    recording = Path(sys.argv[1] if len(sys.argv) > 1 else "out/demo")
    if not (recording / "ticks.csv").is_file():
        sys.exit(f"usage: read_a_recording.py FOLDER; there is no {recording / 'ticks.csv'}")
    main(recording)
