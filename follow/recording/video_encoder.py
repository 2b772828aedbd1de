"""The frames of a recording as compressed images: an H.264 stream, or one JPEG for each frame.

An H.264 stream is in Annex B form without B-frames, so that each packet holds one frame, in order.  A key frame with
the stream's parameters follows every `KEY_S`: a viewer can seek to it, and a truncated file loses at most that much.
"""

import contextlib
from collections.abc import Iterator
from dataclasses import dataclass
from enum import Enum
from fractions import Fraction
from typing import Protocol

import av
import av.error
import av.filter
import cv2
import numpy as np
from av.video.codeccontext import VideoCodecContext
from av.video.frame import PictureType, VideoFrame
from numpy.typing import NDArray

from racf.box import Box

KEY_S = 2.0  # between two key frames
CLOCK_HZ = 90_000  # time base of the stream, as in MPEG transport streams
RATE_HZ = 30  # nominal; the time stamps say when a frame was taken
CRF = 27  # libx264's constant quality: 36 dB over the whole image (benchmarks/recording_size.py)
BOX_OFFSET = -0.25  # of the quantiser's range, inside the target's box: 39 dB there for 3 % more bytes
BOX_MARGIN_PX = 8  # half a macroblock, so that the box's edge has the box's quality
USUAL_PX, USUAL_BITS_S = 640 * 360, 600_000  # 4.5 MB a minute at most; the other rows take up to 3.3
LARGER_POWER = 0.7  # exponent for larger images, with less detail per pixel: 1.6 Mbit/s, 12 MB a minute, for 1280x720


class Encoder(str, Enum):
    """How frames are compressed for the recording."""

    AUTO = "auto"  # the board's own H.264 encoder if it opens, else libx264
    LIBX264 = "libx264"
    V4L2 = "h264_v4l2m2m"  # Raspberry Pi 4 and other boards with a V4L2 encoder
    NVENC = "h264_nvenc"  # NVIDIA graphics cards and Jetsons
    JPEG = "jpeg"


BOARDS = (Encoder.NVENC, Encoder.V4L2)
"""Encoders in hardware, in the order in which `auto` tries them."""


@dataclass(frozen=True, slots=True)
class Sample:
    """One compressed frame and the time at which it was taken; `is_key`: it can be decoded by itself."""

    t_s: float
    data: bytes
    is_key: bool = True


class FrameEncoder(Protocol):
    """Compresses the frames of one recording."""

    def encode(self, image: NDArray[np.uint8], t_s: float, box: Box | None = None) -> Iterator[Sample]:
        """Yield the samples that are ready after this image, (rows, columns, 3) BGR or (rows, columns) grey.

        `box` is the region that needs enough quality to judge the tracker.
        """
        ...

    def finish(self) -> Iterator[Sample]:
        """Yield the samples that are still in the encoder."""
        ...


class JpegEncoder:
    """A JPEG for each frame, of quality 1 to 100."""

    def __init__(self, quality: int) -> None:
        self._options = [int(cv2.IMWRITE_JPEG_QUALITY), quality]

    def encode(self, image: NDArray[np.uint8], t_s: float, box: Box | None = None) -> Iterator[Sample]:
        """Yield the image's JPEG."""
        good, jpeg = cv2.imencode(".jpg", image, self._options)
        if good:
            yield Sample(t_s, jpeg.tobytes())

    def finish(self) -> Iterator[Sample]:
        """Yield nothing."""
        return iter(())


class H264Encoder:
    """An H.264 stream by one of FFmpeg's encoders.  An image of another size restarts the stream.

    Odd sizes are padded with their last row or column, because H.264 stores colour for two by two pixels.
    """

    def __init__(self, name: str) -> None:
        self._name = name
        self._codec: VideoCodecContext | None = None
        self._size = (0, 0)
        self._times: dict[int, float] = {}
        self._key_t_s = 0.0

    def encode(self, image: NDArray[np.uint8], t_s: float, box: Box | None = None) -> Iterator[Sample]:
        """Yield the packets that are ready.  Raises OSError if the encoder does not open or breaks."""
        image = even(image)
        size = image.shape[1], image.shape[0]
        starts = size != self._size
        if starts:
            yield from self.finish()
            self._codec, self._size = opened(self._name, size), size
        assert self._codec is not None
        frame = VideoFrame.from_ndarray(image, format="gray" if image.ndim == 2 else "bgr24")
        frame = frame.reformat(format="yuv420p")
        frame.pts = round(t_s * CLOCK_HZ)
        frame.time_base = Fraction(1, CLOCK_HZ)
        if starts or not 0.0 <= t_s - self._key_t_s < KEY_S:
            frame.pict_type = PictureType.I
            self._key_t_s = t_s
        self._times[frame.pts] = t_s
        if box is not None:
            frame = finer_inside(frame, box)
        yield from self._samples(self._codec.encode(frame))

    def finish(self) -> Iterator[Sample]:
        """Yield the samples that are still in the encoder, and close it."""
        if self._codec is not None:
            yield from self._samples(self._codec.encode(None))
            self._codec, self._size = None, (0, 0)
        self._times.clear()

    def _samples(self, packets: list[av.Packet]) -> Iterator[Sample]:
        for packet in packets:
            if packet.pts is not None and packet.pts in self._times:
                yield Sample(self._times.pop(packet.pts), bytes(packet), packet.is_keyframe)


def even(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """The image with an even number of rows and columns, its last ones repeated where needed."""
    odd = image.shape[0] % 2, image.shape[1] % 2
    if any(odd):
        image = np.pad(image, [(0, odd[0]), (0, odd[1]), (0, 0)][: image.ndim], mode="edge")
    return np.ascontiguousarray(image)


def finer_inside(frame: VideoFrame, box: Box) -> VideoFrame:
    """The frame with a hint for the encoder: a finer quantiser inside the box.  Hardware encoders ignore it."""
    left, top = max(int(box.x) - BOX_MARGIN_PX, 0), max(int(box.y) - BOX_MARGIN_PX, 0)
    right = min(int(box.x + box.w) + BOX_MARGIN_PX, frame.width)
    bottom = min(int(box.y + box.h) + BOX_MARGIN_PX, frame.height)
    if right <= left or bottom <= top:
        return frame
    graph = av.filter.Graph()
    source = graph.add_buffer(
        width=frame.width, height=frame.height, format=frame.format, time_base=Fraction(1, CLOCK_HZ)
    )
    region = graph.add("addroi", f"x={left}:y={top}:w={right - left}:h={bottom - top}:qoffset={BOX_OFFSET}")
    sink = graph.add("buffersink")
    source.link_to(region)
    region.link_to(sink)
    graph.configure()
    graph.push(frame)
    noted = graph.pull()
    assert isinstance(noted, VideoFrame)
    noted.pict_type = frame.pict_type
    return noted


def bits_per_s(size: tuple[int, int]) -> float:
    """The largest mean bit rate of a stream of images of this size, width and height."""
    larger = size[0] * size[1] / USUAL_PX
    return USUAL_BITS_S * (larger**LARGER_POWER if larger > 1 else larger)


def opened(name: str, size: tuple[int, int]) -> VideoCodecContext:
    """An open encoder for images of this size.  Raises OSError if it cannot be opened."""
    rate = round(bits_per_s(size))
    try:
        codec = av.CodecContext.create(name, "w")
        assert isinstance(codec, VideoCodecContext)
        codec.width, codec.height = size
        codec.pix_fmt = "yuv420p"
        codec.time_base, codec.framerate = Fraction(1, CLOCK_HZ), Fraction(RATE_HZ)
        codec.max_b_frames = 0
        codec.gop_size = round(KEY_S * RATE_HZ)
        if name == Encoder.LIBX264.value:
            codec.thread_count = 1  # the other cores are the tracker's
            codec.options = {
                "preset": "superfast",
                "tune": "zerolatency",
                "crf": str(CRF),
                "maxrate": str(rate),
                "bufsize": str(rate),
                "forced-idr": "1",
            }
        else:
            codec.bit_rate = rate
        codec.open()
    except (av.error.FFmpegError, ValueError) as error:
        raise OSError(f"the encoder {name} does not open: {error}") from None
    return codec


def encoder(kind: Encoder, jpeg_quality: int) -> FrameEncoder:
    """The encoder of that kind; `auto` is the board's own if it encodes a grey test image, else libx264."""
    if kind is Encoder.JPEG:
        return JpegEncoder(jpeg_quality)
    for board in BOARDS if kind is Encoder.AUTO else ():
        with contextlib.suppress(OSError, av.error.FFmpegError):
            trial = H264Encoder(board.value)
            if [*trial.encode(np.full((360, 640), 128, np.uint8), 0.0), *trial.finish()]:
                return H264Encoder(board.value)
    return H264Encoder(Encoder.LIBX264.value if kind is Encoder.AUTO else kind.value)
