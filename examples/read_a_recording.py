"""A recording as arrays: the columns of ticks.csv, and the images of flight.rrd.

    python examples/read_a_recording.py out/demo

docs/after_a_flight.md describes every column.
"""

import csv
import sys
from collections.abc import Iterator
from pathlib import Path

import av
import cv2
import numpy as np
from numpy.typing import NDArray


def columns(folder: Path) -> NDArray[np.void]:
    """The ticks as a structured array: `ticks["t_s"]` is a column; what is empty in the file is NaN or ''."""
    with (folder / "ticks.csv").open(newline="") as file:
        lines = ["\t".join(cells) for cells in csv.reader(file)]  # a reason with a comma in it is quoted
    return np.genfromtxt(lines, delimiter="\t", names=True, dtype=None, encoding="utf-8", comments=None)


def images(folder: Path) -> Iterator[tuple[float, NDArray[np.uint8]]]:
    """Time since the flight's start, s, and image (rows, columns, 3) in BGR, of each recorded frame.

    The frames are an H.264 stream, a packet for each, or with `--record.encoder jpeg` a JPEG for each.
    """
    decoder = av.CodecContext.create("h264", "r")
    for time_s, stream, data in packets(folder):
        if stream:
            for frame in decoder.decode(av.Packet(data)):
                yield time_s, frame.to_ndarray(format="bgr24")
        else:
            yield time_s, np.asarray(cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR), np.uint8)


def packets(folder: Path) -> Iterator[tuple[float, bool, bytes]]:
    """Time, whether it belongs to an H.264 stream, and the bytes of each recorded frame, in the order of time."""
    from rerun.chunk import RrdReader  # noqa: PLC0415 - the columns can be read without Rerun

    found: list[tuple[float, bool, bytes]] = []
    for chunk in RrdReader(folder / "flight.rrd").stream():
        if chunk.entity_path == "/image" and not chunk.is_static:
            batch = chunk.to_record_batch()
            stream = "VideoStream:sample" in batch.schema.names
            blobs = batch.column("VideoStream:sample" if stream else "EncodedImage:blob")
            for time, blob in zip(batch.column("seconds"), blobs, strict=True):
                data = blob.values.values.to_numpy(zero_copy_only=False).astype(np.uint8)
                found.append((time.value / 1e9, stream, data.tobytes()))
    yield from sorted(found, key=lambda packet: packet[0])


def main(folder: Path) -> None:
    """Print what a flight came to."""
    ticks = columns(folder)
    print(f"{len(ticks)} rounds in {ticks['t_s'][-1]:.1f} s, modes {', '.join(sorted(set(ticks['mode'])))}")
    print(f"range {np.nanmean(ticks['target_range_m']):.1f} m on average")
    for name in ("forward_m_s", "right_m_s", "down_m_s", "yaw_rate_rad_s"):
        off = ticks[f"setpoint_{name}"] - ticks[f"desired_{name}"]
        print(f"the gate changed {name} by {np.nanmax(np.abs(off)):.2f} at most")
    t_s, image = next(images(folder))
    print(f"the first image, at {t_s:.2f} s, is {image.shape[1]}x{image.shape[0]}")


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "out/demo"))
