"""Video files written: H.264 in .mp4 and .mkv, Motion JPEG in .avi."""

from fractions import Fraction
from pathlib import Path
from types import TracebackType
from typing import Any

import av
import av.error
import numpy as np
from numpy.typing import NDArray
from typing_extensions import Self

from racf.errors import VideoError

FORMATS = {".mp4": "mp4", ".avi": "avi", ".mkv": "matroska"}
SUFFIXES = tuple(FORMATS)
QUALITY = "18"  # x264's constant rate factor: visually almost lossless
JPEG_QUALITY = "3"  # of 2 (best) to 31
TICKS_S = 90_000  # time base of written stamps, 1/s, as in MPEG


class VideoWriter:
    """A video file that takes its size from its first image.  Raises VideoError for one that cannot be written."""

    def __init__(self, path: Path, fps: float) -> None:
        if path.suffix.lower() not in SUFFIXES:
            raise VideoError(f"a video file ends in {', '.join(SUFFIXES)}, not {path}")
        self._path, self._fps = path, fps
        self._container: Any = None
        self._stream: Any = None
        self._count = 0

    def put(self, image: NDArray[np.uint8], t_s: float | None = None) -> None:
        """Append a BGR image of (rows, columns, 3), shown from `t_s` on; without it at the constant rate."""
        if self._container is None:
            self._open(image)
        frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(image), format="bgr24")
        at_s = self._count / self._fps if t_s is None else t_s
        frame.pts, frame.time_base = round(at_s / float(self._stream.time_base)), self._stream.time_base
        self._count += 1
        self._write(frame)

    def _write(self, frame: av.VideoFrame | None) -> None:
        """Encode a frame (None: flush the encoder); the first packet creates the file."""
        try:
            self._container.mux(self._stream.encode(frame))
        except (av.error.FFmpegError, OSError) as error:
            self._container = None
            raise VideoError(f"{self._path} cannot be written as a video: {error.strerror}") from None

    def _open(self, image: NDArray[np.uint8]) -> None:
        rows, columns = image.shape[:2]
        rate = Fraction(self._fps).limit_denominator(1001)
        suffix = self._path.suffix.lower()
        self._path.parent.mkdir(parents=True, exist_ok=True)
        self._container = av.open(f"file:{self._path}", "w", format=FORMATS[suffix])
        if suffix == ".avi":
            quality = {"qmin": JPEG_QUALITY, "qmax": JPEG_QUALITY}
            stream: Any = self._container.add_stream("mjpeg", rate=rate, options=quality)
            stream.pix_fmt, stream.time_base = "yuvj420p", 1 / rate
        else:
            stream = self._container.add_stream("libx264", rate=rate, options={"crf": QUALITY, "preset": "veryfast"})
            stream.pix_fmt = "yuv444p" if rows % 2 or columns % 2 else "yuv420p"  # halved colour needs even sizes
            stream.time_base = Fraction(1, TICKS_S)
        stream.width, stream.height = columns, rows
        stream.codec_context.time_base = stream.time_base
        self._stream = stream

    def close(self) -> None:
        """Flush the encoder and finish the file."""
        if self._container is not None:
            self._write(None)
            self._container.close()
            self._container = None

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
