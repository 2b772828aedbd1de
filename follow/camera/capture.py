"""One connection to a live source, by FFmpeg (PyAV): its newest images, each with the arrival time of its packet.

A thread only reads packets and stamps their arrival, so that a decoder that is slower than the source cannot make old
frames look new; a backlog is skipped up to the next key frame.  A frame has its packet's arrival time, however long the
decoder keeps it.
"""

import queue
import threading
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from fractions import Fraction
from typing import Any, Protocol

import av
import av.error
import numpy as np
from numpy.typing import NDArray

from follow.camera import CameraError
from follow.camera.names import CameraKind, CameraName
from follow.camera.stream_clock import AsItComes, FrameClock, SteadyArrivals, StreamClock
from follow.camera.v4l2 import check_mode, modes_of
from follow.messages import NEVER
from racf.orientation import Orientation
from racf.video import ANY_TEXT, deinterlacer, filtered, to_bgr

OPEN_S = 10.0  # connection timeout
SILENT_S = 2.0  # read timeout for a sender that died; the gate has stopped by then (0.2 s and 1 s)
WAITING_PACKETS = 3  # with a longer queue, images are decoded but not converted, and decoding skips to a key frame
MOST_PACKETS = 300  # longest queue, 10 s at 30 frames/s; beyond it all are dropped up to the next key frame
UNSTAMPED = frozenset({"mpjpeg", "mjpeg", "h264", "hevc", "rawvideo", "m4v", "image2pipe", "jpeg_pipe"})
HELD_PACKETS = {"mpegts": 2, "h264": 1, "hevc": 1, "mjpeg": 1, "m4v": 1, "rtsp": 1, "sdp": 1, "rtp": 1}
"""By format: how many more packets FFmpeg reads before it returns one, because only the next one's start ends it.

In a transport stream this holds for the packet (PES) and for the coded frame.  So a frame's arrival is the time at
which the packet was read that is this many before the one returned.
"""
WHOLE_IN_RTP = frozenset({"mjpeg"})  # codecs whose frame a marker ends in RTP
LOW_DELAY = 0x80000  # AV_CODEC_FLAG_LOW_DELAY
QUICK = {"fflags": "nobuffer", "flags": "low_delay", "analyzeduration": "500000", "fpsprobesize": "0"}
MAX_DELAY_US = "50000"  # RTP: timeout for a reordered packet; FFmpeg's default is 0.5 s

Image = NDArray[np.uint8]


class Capture(Protocol):
    """An open source of images.  `size` is its width and height; images are 1 / `shrink` of that."""

    size: tuple[int, int]
    shrink: int

    def images(self) -> Iterator[tuple[Image, float | None]]:
        """Yield each image with the time at which it was taken on our clock, or None if that is unknown.

        Raises CameraError, which says why, when the source breaks.
        """
        ...

    def interrupt(self) -> None:
        """Let `images` end soon; called by any thread."""
        ...

    def close(self) -> None:
        """Release the source; called by the thread that reads."""
        ...


@dataclass(slots=True)
class _Packets:
    """The reading thread's output: packets with their arrival, then the reason why it ended."""

    waiting: "queue.Queue[tuple[Any, float] | str]" = field(default_factory=queue.Queue)
    closing: threading.Event = field(default_factory=threading.Event)


class StreamCapture:
    """A device, stream or file that FFmpeg opens.

    `taken` computes when a frame was taken; by default the stream's stamps are used or, without stamps, the period of
    arrivals.  `clock` gives the arrival time of the data just read.
    """

    def __init__(
        self,
        container: Any,
        clock: Callable[[], float],
        taken: FrameClock | None = None,
    ) -> None:
        self._container, self._clock = container, clock
        stream = container.streams.best("video")
        if stream is None or stream.codec_context is None:
            container.close()
            raise CameraError("there is no video in it, or of a codec that FFmpeg does not know")
        self._stream: Any = stream
        context = stream.codec_context
        if not (context.width and context.height):
            container.close()
            raise CameraError("no image came: is it sending, and a key frame at least twice a second?")
        context.thread_type = "SLICE"  # frame threading would delay by one frame per thread
        if not context.has_b_frames:
            context.flags |= LOW_DELAY
        # Without stamps the clock must see each packet, also skipped ones; with stamps each decoded frame, in order.
        self._rhythm = SteadyArrivals() if taken is None and container.format.name in UNSTAMPED else None
        self._taken: FrameClock = taken or StreamClock()
        self._arrivals: dict[int | None, float] = {}
        self._graph: Any = None
        self._orientation: Orientation | None = None
        self._packets = _Packets()
        self._reader: threading.Thread | None = None
        self.size, self.shrink = (int(context.width), int(context.height)), 1

    def images(self) -> Iterator[tuple[Image, float | None]]:
        """Yield each image, except while many newer ones are waiting."""
        self._reader = threading.Thread(target=self._read, name="camera packets", daemon=True)
        self._reader.start()
        waiting = self._packets.waiting
        while not isinstance(item := waiting.get(), str):
            packet, arrived_t_s = item
            if waiting.qsize() > WAITING_PACKETS:
                packet, arrived_t_s = self._later_key_frame(packet, arrived_t_s)
            stamp = packet.pts if packet.pts is not None else packet.dts
            self._arrivals[stamp] = arrived_t_s
            try:
                decoded = self._stream.codec_context.decode(packet)
            except av.error.FFmpegError:
                continue  # a damaged packet: decoding recovers at the next key frame
            for frame in decoded:
                for shown in self._deinterlaced(frame):
                    taken_t_s = self._taken_at(shown)
                    if waiting.qsize() <= WAITING_PACKETS:
                        yield self._upright(shown), taken_t_s
        raise CameraError(item)

    def _read(self) -> None:
        """The reading thread: packets with their arrival until the source breaks."""
        why, held = "it ended", held_packets(self._container.format.name, self._stream.codec_context.name)
        read_t_s = deque([self._clock()], maxlen=held + 1)
        try:
            for packet in self._container.demux(self._stream):
                if self._packets.closing.is_set():
                    break
                read_t_s.append(self._clock())
                if packet.size:
                    self._packets.waiting.put((packet, self._came(read_t_s[0])))
                if self._packets.waiting.qsize() > MOST_PACKETS:
                    self._drop_waiting()
        except av.error.ExitError:
            why = f"nothing came for {SILENT_S:g} s"
        except CameraError as error:
            why = str(error)
        except Exception as error:  # noqa: BLE001  # whatever it is, `images` must not wait for ever
            why = getattr(error, "strerror", None) or str(error)
        self._packets.waiting.put(why)

    def _came(self, t_s: float) -> float:
        """The arrival of a packet, or without stamps the time when its frame was taken; NEVER: unknown."""
        if self._rhythm is None:
            return t_s
        taken_t_s = self._rhythm.taken_at(0.0, t_s)
        return NEVER if taken_t_s is None else taken_t_s

    def _drop_waiting(self) -> None:
        while not self._packets.waiting.empty():
            self._packets.waiting.get_nowait()

    def _later_key_frame(self, packet: Any, arrived_t_s: float) -> tuple[Any, float]:
        """The newest waiting key frame, skipping all packets before it; the given packet if no key frame waits."""
        held = [(packet, arrived_t_s)]
        while not self._packets.waiting.empty():
            item = self._packets.waiting.get_nowait()
            if isinstance(item, str):
                self._packets.waiting.put(item)
                break
            held.append(item)
        first = max((n for n, (waiting, _) in enumerate(held) if waiting.is_keyframe), default=0)
        for waiting in held[first + 1 :]:
            self._packets.waiting.queue.appendleft(waiting)
        return held[first]

    def _deinterlaced(self, frame: Any) -> Iterator[Any]:
        if self._graph is None and frame.interlaced_frame:
            self._graph = deinterlacer(frame, self._stream.time_base)
        yield from (frame,) if self._graph is None else filtered(self._graph, frame)

    def _taken_at(self, frame: Any) -> float | None:
        stamp = None if frame.pts is None else round(Fraction(frame.pts) * frame.time_base / self._stream.time_base)
        arrived_t_s = self._arrivals.pop(stamp, None)
        if arrived_t_s is None:  # a decoder that changes stamps: the oldest packet that may be its own
            arrived_t_s = min(self._arrivals.values(), default=self._clock())
        for old in [key for key, t_s in self._arrivals.items() if t_s < arrived_t_s]:
            del self._arrivals[old]
        if self._rhythm is not None:
            return None if arrived_t_s == NEVER else arrived_t_s
        stamp_s = arrived_t_s if stamp is None else float(stamp * self._stream.time_base)
        return self._taken.taken_at(stamp_s, arrived_t_s)

    def _upright(self, frame: Any) -> Image:
        self._orientation = self._orientation or Orientation.of(frame)
        return self._orientation.applied(to_bgr(frame, self.shrink))

    def interrupt(self) -> None:
        """Let `images` end now."""
        self._packets.closing.set()
        self._packets.waiting.put("closed")

    def close(self) -> None:
        """Stop the reading thread, which its read timeout ends, and close the source."""
        self._packets.closing.set()
        if self._reader is not None:
            self._reader.join(timeout=SILENT_S + 1.0)
        if self._reader is None or not self._reader.is_alive():
            self._container.close()


def held_packets(format_: str, codec: str) -> int:
    """How many packets FFmpeg holds back of a format and codec."""
    whole = format_ in ("rtsp", "sdp", "rtp") and codec in WHOLE_IN_RTP
    return 0 if whole else HELD_PACKETS.get(format_, 0)


class KernelClock:
    """V4L2's stamps are the kernel's, of the start of the frame's transfer, on our clock or on an unknown one."""

    def __init__(self) -> None:
        self._stream = StreamClock()

    def taken_at(self, stamp_s: float, t_s: float) -> float | None:
        """The stamp itself if it is a recent time on our clock, else the same as for a stream."""
        return stamp_s if 0 <= t_s - stamp_s < SILENT_S else self._stream.taken_at(stamp_s, t_s)


def open_stream(name: CameraName, clock: Callable[[], float]) -> StreamCapture:
    """Connect to a device, a stream, an SDP file or a lavfi source.  Raises CameraError."""
    address, format_, options = _how(name)
    if name.kind is CameraKind.DEVICE:
        check_mode(name.address, modes_of(name.address), name.options.get("format"), name.size, name.fps)
    try:
        container = av.open(address, format=format_, options=options, timeout=(OPEN_S, SILENT_S), **ANY_TEXT)
    except av.error.ExitError:
        raise CameraError(f"camera {name.text!r} cannot be opened: nothing came for {OPEN_S:g} s") from None
    except (av.error.FFmpegError, OSError, ValueError) as error:
        why = getattr(error, "strerror", None) or str(error)
        raise CameraError(f"camera {name.text!r} cannot be opened: {why}") from None
    clocks: dict[CameraKind, FrameClock] = {CameraKind.DEVICE: KernelClock(), CameraKind.LAVFI: AsItComes()}
    try:
        return StreamCapture(container, clock, taken=clocks.get(name.kind))
    except CameraError as error:
        raise CameraError(f"camera {name.text!r} cannot be opened: {error}") from None


def _how(name: CameraName) -> tuple[str, str | None, dict[str, str]]:
    """Address, demuxer (None: FFmpeg finds out) and options for FFmpeg."""
    given = dict(name.options)
    if name.kind is CameraKind.DEVICE:
        named = {"size": "video_size", "fps": "framerate", "format": "input_format"}
        return name.address, "v4l2", {named[option]: value for option, value in given.items()}
    if name.kind is CameraKind.LAVFI:
        return f"{name.address},realtime", "lavfi", {}
    options = {**QUICK, "max_delay": MAX_DELAY_US}
    if name.kind is CameraKind.SDP:
        return f"file:{name.address}", "sdp", {**options, "protocol_whitelist": "file,udp,rtp", **given}
    format_ = given.pop("format", None)
    if name.address.lower().startswith("rtsp"):
        options["rtsp_transport"] = given.pop("transport", "tcp")
    if name.address.lower().startswith("udp"):
        options["overrun_nonfatal"] = "1"
    return name.address, format_, {**options, **given}
