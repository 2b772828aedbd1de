"""Video files read by FFmpeg (PyAV): images in display order with the stream's own time stamps.

A row of an annotation belongs to a frame, a time to its stamp: `VideoImage.index` counts the frames in the file, also
those that cannot be decoded, and `t_s` is the stamp relative to the first frame's.  So both are right for variable
frame rate, transport streams that start at 10 h, and lost frames.  Interlaced frames are deinterlaced, a display matrix
is applied, every pixel format becomes 8-bit BGR.
"""

import heapq
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from types import TracebackType
from typing import Any

import av
import av.error
import av.filter
import numpy as np
from numpy.typing import NDArray
from typing_extensions import Self

from racf.errors import VideoError
from racf.orientation import Orientation

Image = NDArray[np.uint8]  # (rows, columns, 3), BGR

USUAL_FPS = 30.0  # default for a file without a rate
LONGEST_GAP_S = 10.0  # a longer gap in the time stamps is a cut, not lost frames
NOT_VIDEO = frozenset({"tty", "txd", "bin", "xbin", "adf", "idf"})  # text formats, which FFmpeg renders as video
DEINTERLACE = "mode=send_frame:deint=interlaced"  # one output frame for each input; progressive ones are unchanged
MAJOR = int(av.__version__.split(".")[0])
ANY_TEXT: dict[str, Any] = {"metadata_errors": "replace"} if MAJOR < 19 else {}
"""Makes `av.open` accept a title that is not UTF-8, as it does by itself from version 19 on."""
THREADS = "AUTO" if MAJOR >= 18 else "SLICE"  # in older versions an error loses the frames of all decoding threads
BLOCKING = (BlockingIOError, EOFError)  # a filter graph or decoder that needs more input, or has ended


@dataclass(frozen=True, slots=True, eq=False)
class VideoImage:
    """One frame of a file: BGR image, seconds after the first frame's stamp, and its number from 0."""

    image: Image
    t_s: float
    index: int


@dataclass(slots=True)
class MissingFrames:
    """Counts of a source's missing frames; `str()` is one sentence without its subject, "" if nothing is missing."""

    undecoded: int = 0
    after_end: int = 0
    resized: int = 0
    cuts: int = 0
    absent: int = 0
    first: str = ""
    cut_off_s: float = 0.0

    @property
    def frames(self) -> int:
        """Number of the source's frames that were not delivered."""
        return self.undecoded + self.after_end + self.resized + self.absent

    def __str__(self) -> str:
        kinds = (
            (self.absent, "not there"),
            (self.undecoded, "not decodable"),
            (self.resized, "of another size"),
            (self.after_end, "after the end of the file"),
        )
        counts = [f"{count} {kind}" for count, kind in kinds if count]
        first = f", first {self.first}" if self.first else ""
        several = "frames are" if self.frames > 1 else "frame is"
        parts = [f"{self.frames} {several} missing ({', '.join(counts)}{first})"] if counts else []
        parts += [f"it ends {self.cut_off_s:.1f} s before the length that it says"] if self.cut_off_s else []
        parts += [f"its time jumps {self.cuts} time{'s' if self.cuts > 1 else ''}"] if self.cuts else []
        return "; ".join(parts)

    def add(self, kind: str, count: int, first: str) -> None:
        """Count missing frames of a kind, which is a field's name; keep the name of the first one."""
        if count > 0:
            setattr(self, kind, getattr(self, kind) + count)
            self.first = self.first or first


class Video:
    """An open video file.  Raises VideoError for a file without a decodable frame.

    shrink(size): the whole number by which images of that (width, height) are shrunk; `scale` is its value.
    size: width and height of its images; fps: its nominal rate, 1/s; frames, length_s: the number of frames and the
    length that its header states, or None; missing: the missing frames so far, complete after the last image.
    """

    def __init__(self, path: str | Path, shrink: Callable[[tuple[int, int]], int] = lambda _size: 1) -> None:
        self._container = _opened(path)
        try:
            self._stream: Any = self._container.streams.best("video")
            if self._stream is None or self._container.format.name in NOT_VIDEO:
                raise VideoError(f"{path} cannot be opened as a video: FFmpeg finds no video stream in it")
            if self._stream.codec_context is None:
                raise VideoError(f"{path} cannot be opened as a video: FFmpeg does not know its codec")
            self._stream.thread_type = THREADS
            self.missing = MissingFrames()
            self.fps = nominal_fps(self._stream)
            self.length_s = _length_s(self._stream, self._container)
            by_length = round(self.length_s * self.fps) if self.length_s else None
            self.frames: int | None = self._stream.frames or by_length
            context = self._stream.codec_context
            self.scale = shrink((context.width, context.height))
            self._decoded = _Decoded(self._container, self._stream, self.missing, self.scale)
            self._images = self._numbered()
            self._first = next(self._images, None)
        except BaseException:  # also Ctrl-C: the file is closed, and the error goes on
            self._container.close()
            raise
        if self._first is None:
            self._container.close()
            raise VideoError(f"no frame of {path} can be decoded ({self._stream.codec_context.name})")

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the images, turned as the file says."""
        assert self._first is not None
        return self._first.image.shape[1], self._first.image.shape[0]

    def images(self) -> Iterator[VideoImage]:
        """Yield each image once, in display order."""
        assert self._first is not None
        shape, last = self._first.image.shape, self._first
        yield self._first
        for shown in self._images:
            last = shown
            if shown.image.shape == shape:
                yield shown
            else:
                self.missing.add("resized", 1, f"{shown.index}")
        if self.frames and self._stream.frames:
            held = self.frames - self._decoded.discarded - self._decoded.leading
            self.missing.add("after_end", held - self._decoded.rows, f"{self._decoded.rows}")
        elif self.length_s is not None and not self.missing.cuts:
            short_s = self.length_s - last.t_s - 1 / self.fps
            self.missing.cut_off_s = short_s if short_s > 1.0 else 0.0

    def _numbered(self) -> Iterator[VideoImage]:
        """Each decoded image with its number and a time that only grows; a jump of the stamps is a cut."""
        period_s, shift_s, last_s = 1 / self.fps, 0.0, -1 / self.fps
        began: float | None = None
        for image, stamp_s, index in self._decoded:
            began = stamp_s if began is None else began
            t_s = last_s + period_s if stamp_s is None or began is None else stamp_s - began - shift_s
            if began is not None and not 0 < t_s - last_s <= LONGEST_GAP_S + period_s:
                self.missing.cuts += abs(t_s - last_s) > LONGEST_GAP_S
                shift_s += t_s - last_s - period_s
                t_s = last_s + period_s
            last_s = t_s
            yield VideoImage(image, t_s, index)

    def close(self) -> None:
        """Release the file."""
        self._container.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


class _Decoded:
    """Iterates over a stream's images, each with its stamp in seconds (None: it has none) and its row.

    A row is a packet: one whose stamp no frame bears was lost.  Fields of interlaced frames and the hidden frames of
    VP8 have packets of their own, AVI's stamps count frames shown: there frames are counted instead.
    """

    def __init__(self, container: Any, stream: Any, missing: MissingFrames, shrink: int) -> None:
        self._container, self._stream, self._missing, self._shrink = container, stream, missing, shrink
        self._waiting: list[int] = []  # stamps of packets whose frame has not come, a heap
        self._counts_packets = stream.codec_context.name != "vp8"
        self._avi = container.format.name == "avi"
        self._stamped = not (self._avi and stream.codec_context.has_b_frames)
        self._graph: Any = None
        self._orientation: Orientation | None = None
        self._first_stamp: int | None = None
        self.rows = self.leading = self.discarded = 0

    def __iter__(self) -> Iterator[tuple[Image, float | None, int]]:
        for frame in self._frames():
            self._orientation = self._orientation or Orientation.of(frame)
            for shown in self._deinterlaced(frame):
                yield self._shown(shown)
        for shown in self._deinterlaced(None):
            yield self._shown(shown)
        if self.rows and self._counts_packets and self._stamped:
            self._missing.add("undecoded", len(self._waiting), f"{self.rows}")
            self.rows += len(self._waiting)

    def _frames(self) -> Iterator[Any]:
        """The decoder's frames; a packet that it refuses is passed over."""
        try:
            for packet in self._container.demux(self._stream):
                if packet.dts is None and packet.size == 0:
                    break  # the demuxer's end
                if packet.is_discard:
                    self.discarded += 1
                elif packet.pts is not None:
                    heapq.heappush(self._waiting, packet.pts)
                if packet.size:
                    yield from self._decode(packet)
        except (av.error.FFmpegError, OSError):
            pass  # the file breaks off here: what is missing is counted
        yield from self._decode(None)

    def _decode(self, packet: Any) -> Iterator[Any]:
        try:
            yield from self._stream.codec_context.decode(packet)
        except (av.error.FFmpegError, EOFError):
            return

    def _deinterlaced(self, frame: Any) -> Iterator[Any]:
        if self._graph is None and frame is not None and frame.interlaced_frame:
            self._graph = deinterlacer(frame, self._stream.time_base)
            self._counts_packets = False
        if self._graph is None:
            yield from () if frame is None else (frame,)
            return
        yield from filtered(self._graph, frame)

    def _shown(self, frame: Any) -> tuple[Image, float | None, int]:
        assert self._orientation is not None
        image = self._orientation.applied(to_bgr(frame, self._shrink))
        stamp = frame.pts if self._stamped else None
        stamp_s = None if stamp is None else float(stamp * Fraction(frame.time_base or self._stream.time_base))
        index = self._row(None if stamp_s is None else round(Fraction(stamp_s) / self._stream.time_base))
        return image, stamp_s, index

    def _row(self, stamp: int | None) -> int:
        """The row of the frame with this stamp (in the stream's time base); the lost ones before it are counted."""
        earlier = self._drop_until(stamp)
        index = self.rows
        if self.rows == 0:
            self._first_stamp, self.leading = stamp, earlier  # before the first frame there are no rows
            self._missing.add("undecoded", earlier, "0")
        elif stamp is not None and self._first_stamp is not None and self._avi:
            index = max(index, round((stamp - self._first_stamp) * float(self._stream.time_base) * self._rate))
        elif stamp is not None and self._counts_packets:
            index += earlier
        self._missing.add("undecoded", index - self.rows, f"{self.rows}")
        self.rows = index + 1
        return index

    @property
    def _rate(self) -> float:
        return float(self._stream.average_rate or self._stream.guessed_rate or USUAL_FPS)

    def _drop_until(self, stamp: int | None) -> int:
        """Forget the packets up to this stamp; returns how many of them had an earlier one."""
        earlier = 0
        while stamp is not None and self._waiting and self._waiting[0] <= stamp:
            earlier += heapq.heappop(self._waiting) < stamp
        return earlier


def _opened(path: str | Path) -> Any:
    if not Path(path).is_file():
        what = "is a folder: read its images one by one, with cv2.imread" if Path(path).is_dir() else "is not a file"
        raise VideoError(f"{path} {what}")
    try:
        # `file:`, because FFmpeg would take a colon in the name for a protocol.
        return av.open(f"file:{path}", **ANY_TEXT)
    except (av.error.FFmpegError, OSError, ValueError) as error:
        why = getattr(error, "strerror", None) or str(error)
        raise VideoError(f"{path} cannot be opened as a video: {why}") from None


def nominal_fps(stream: Any) -> float:
    """The nominal rate of a stream: the guessed one, unless it is far from the average."""
    average, guessed = float(stream.average_rate or 0), float(stream.guessed_rate or 0)
    if guessed and (stream.duration is None or not average or average <= guessed <= 4 * average):
        average = guessed
    return average if 0 < average <= 1000 else USUAL_FPS


def _length_s(stream: Any, container: Any) -> float | None:
    if stream.duration is not None:
        return float(stream.duration * stream.time_base)
    if container.duration is None:
        return None
    # Matroska's header holds the time of the end, not the duration.
    began = container.start_time or 0 if container.format.name.startswith("matroska") else 0
    return (container.duration - began) / av.time_base


def deinterlacer(frame: Any, time_base: Fraction, name: str = "bwdif") -> Any:
    """A filter graph that makes each interlaced frame progressive, for frames like `frame`."""
    graph: Any = av.filter.Graph()
    source = graph.add_buffer(width=frame.width, height=frame.height, format=frame.format, time_base=time_base)
    graph.link_nodes(source, graph.add(name, DEINTERLACE), graph.add("buffersink")).configure()
    return graph


def filtered(graph: Any, frame: Any) -> Iterator[Any]:
    """Push a frame (None: the end) into a graph and yield its output."""
    try:
        graph.vpush(frame)
        while True:
            yield graph.vpull()
    except BLOCKING:
        return


def to_bgr(frame: Any, shrink: int = 1) -> Image:
    """The (rows, columns, 3) BGR image of a decoded frame of any pixel format and depth, 1 / `shrink` of its size."""
    if shrink > 1:
        size = {"width": max(frame.width // shrink, 1), "height": max(frame.height // shrink, 1)}
        frame = frame.reformat(**size, format="bgr24", interpolation="AREA", threads=1)
    return np.asarray(frame.to_ndarray(format="bgr24"), dtype=np.uint8)
