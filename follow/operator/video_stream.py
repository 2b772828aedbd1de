"""An H.264 stream to ground stations: RTP over UDP [RFC 6184], or RTSP pushed to a server.  It runs in its own thread.

Each slice fits into one packet, so that a lost packet costs a strip of one frame; key frames with the stream's
parameters follow every `Coding.key_s`, so that the image soon recovers.  Payload type 96 and a clock of 90 kHz, as
QGroundControl expects.
"""

import os
import socket
import time
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import av
import av.error
import numpy as np
from av.bitstream import BitStreamFilterContext
from av.video.frame import PictureType, VideoFrame
from numpy.typing import NDArray

from follow.messages import NEVER, Notify
from follow.operator.rtsp import RtspPush
from follow.recording.video_encoder import BOARDS, Encoder, even

MARKER = 128  # in an RTP packet's second byte: the last one of a frame [RFC 6184, section 5.1]
CLOCK_HZ = 90_000  # RTP clock of video [RFC 6184, section 8.2.1]
KEY_S = 0.1  # at 10 % loss 95 % of spoilt stretches end in 0.7 s, with 0.25 s in 2.5 (benchmarks/video_loss.py)
PACKET_BYTES, SLICE_BYTES = 1300, 1200  # an Ethernet frame less the headers of IP, UDP, a VPN and radio links
BUFFER_S = 0.25  # the encoder keeps the bit rate over this time: a key frame must not fill a radio link
RETRY_S = 2.0  # delay between two attempts to open a stream

BOARD_OPTIONS = {Encoder.NVENC.value: {"preset": "p1", "tune": "ull", "zerolatency": "1", "delay": "0"}}
"""Options for no delay, by encoder: FFmpeg's documentation of nvenc."""


@dataclass(frozen=True, slots=True)
class Coding:
    """How frames are coded: `encoder` is never AUTO or JPEG; `rate_hz` is the highest rate.

    `key_s` is the time from one key frame to the next.  With `twice` each RTP packet is sent twice.
    """

    encoder: str
    rate_hz: float
    bit_s: int
    key_s: float = KEY_S
    twice: bool = False

    @property
    def key_frames(self) -> int:
        """Number of frames from one key frame to the next, at the highest rate."""
        return max(round(self.key_s * self.rate_hz), 1)


class Fanout:
    """Sends each RTP packet that FFmpeg writes to every address, without blocking.

    With `twice` the packets of a frame are sent again after its last one, and that one after the first of the next
    frame.  GStreamer's jitter buffer drops duplicates; FFmpeg's receiver does not cope with them.
    """

    def __init__(self, twice: bool = False) -> None:
        self.addresses: tuple[tuple[str, int], ...] = ()
        self.dropped = 0
        self._twice, self._frame, self._last = twice, list[bytes](), b""
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)

    def write(self, packet: bytes) -> int:
        """Send one packet; a packet that cannot be sent at once is dropped and counted."""
        self._send(packet)
        if self._twice:
            self._send_again(bytes(packet))
        return len(packet)

    def _send_again(self, packet: bytes) -> None:
        if self._last:
            self._send(self._last)
            self._last = b""
        self._frame.append(packet)
        if packet[1] & MARKER:
            for copy in self._frame[:-1]:
                self._send(copy)
            self._last, self._frame = packet, []

    def _send(self, packet: bytes) -> None:
        for address in self.addresses:
            try:
                self._socket.sendto(packet, address)
            except OSError:  # send buffer full, or no route yet: drop it, newer frames follow
                self.dropped += 1

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()


class VideoStream:
    """Encodes images and sends them to `url`: rtsp://..., or empty for RTP to the addresses of `send_to`.

    A stream that breaks is opened again every RETRY_S and reported once.
    """

    def __init__(self, coding: Coding, url: str, report: Notify) -> None:
        self._coding, self._url, self._report = coding, url, report
        self._fanout, self._push = Fanout(coding.twice), RtspPush(url) if url else None
        self._size = (0, 0)
        self._container: Any = None
        self._stream: Any = None
        self._parameters: Any = None
        self._key_t_s = NEVER
        self._broken_t_s = NEVER
        self._trouble = ""

    def send_to(self, addresses: tuple[tuple[str, int], ...]) -> None:
        """Send RTP to these hosts and ports; a new one gets a key frame at once."""
        known: list[tuple[str, int]] = []
        for host, port in addresses:
            try:
                known.append((socket.gethostbyname(host), port))
            except OSError as error:
                self._say(f"video: the address of {host} is not known: {error.strerror}")
        if set(known) - set(self._fanout.addresses):
            self._key_t_s = NEVER
        self._fanout.addresses = tuple(known)

    def show(self, image: NDArray[np.uint8], t_s: float) -> bool:
        """Encode and send an image, (rows, columns, 3) BGR or (rows, columns) grey, at `t_s`; whether it was sent."""
        if not (self._push or self._fanout.addresses) or time.monotonic() - self._broken_t_s < RETRY_S:
            return False
        image = even(image)
        size = image.shape[1], image.shape[0]
        try:
            if self._push is not None and not self._push.is_open:
                self._push.open()
                self._key_t_s = NEVER
            container = self._container if size == self._size else self._open(size)
            for packet in self._stream.encode(self._frame(image, t_s)):
                for whole in self._parameters.filter(packet):
                    container.mux(whole)
        except (av.error.FFmpegError, OSError, ValueError) as error:
            self._broken_t_s = time.monotonic()
            self._end()
            self._say(f"video to {self._url or 'the ground station'} broke: {error}; trying again")
            return False
        self._trouble = ""
        return True

    def close(self) -> None:
        """End the stream."""
        self._end()
        self._fanout.close()

    def _frame(self, image: NDArray[np.uint8], t_s: float) -> VideoFrame:
        frame = VideoFrame.from_ndarray(image, format="gray" if image.ndim == 2 else "bgr24")
        frame = frame.reformat(format="yuv420p")
        frame.pts, frame.time_base = round(t_s * CLOCK_HZ), Fraction(1, CLOCK_HZ)
        due_s = (self._coding.key_frames - 0.5) / self._coding.rate_hz  # half a frame: times are not exact
        if not 0.0 <= t_s - self._key_t_s < due_s:
            frame.pict_type = PictureType.I
            self._key_t_s = t_s
        return frame

    def _open(self, size: tuple[int, int]) -> Any:
        """Begin a stream for images of this size."""
        options = {"packetsize": str(PACKET_BYTES), "rtpflags": "skip_rtcp"}
        container: Any = av.open(self._push or self._fanout, "w", format="rtp", options=options)
        self._stream = add_h264(container, self._coding, size)
        container.start_encoding()  # opens the encoder: only then its parameters are known
        self._parameters = BitStreamFilterContext("dump_extra", self._stream)
        self._container, self._size, self._key_t_s = container, size, NEVER
        return container

    def _end(self) -> None:
        self._container, self._size = None, (0, 0)  # RTP needs no trailer
        if self._push is not None:
            self._push.close()

    def _say(self, trouble: str) -> None:
        if trouble != self._trouble:
            self._trouble = trouble
            self._report(trouble)


def add_h264(container: Any, coding: Coding, size: tuple[int, int]) -> Any:
    """The container's stream of H.264 for images of this size.  Raises FFmpegError."""
    rate = round(coding.rate_hz)
    stream = container.add_stream(coding.encoder, rate=rate)
    codec = stream.codec_context
    codec.width, codec.height = size
    codec.pix_fmt = "yuv420p"
    codec.time_base = stream.time_base = Fraction(1, CLOCK_HZ)
    codec.bit_rate = coding.bit_s
    codec.max_b_frames = 0
    codec.gop_size = coding.key_frames
    if coding.encoder == Encoder.LIBX264.value:
        codec.thread_count = 1  # the other cores are the tracker's
        kbit = coding.bit_s // 1000
        buffer = f"vbv-maxrate={kbit}:vbv-bufsize={max(round(kbit * BUFFER_S), 1)}"
        codec.options = {
            "preset": "ultrafast",
            "tune": "zerolatency",
            "forced-idr": "1",
            "x264-params": f"repeat-headers=1:scenecut=0:slice-max-size={SLICE_BYTES}:{buffer}",
        }
    else:
        codec.options = {**BOARD_OPTIONS.get(coding.encoder, {}), "forced-idr": "1"}
    return stream


def encoder_for(kind: Encoder) -> str:
    """The encoder's name in FFmpeg; AUTO: the first of BOARDS that gives a packet for a grey image, else libx264."""
    if kind is not Encoder.AUTO:
        return kind.value
    return next((board.value for board in BOARDS if works(board.value)), Encoder.LIBX264.value)


def works(encoder: str) -> bool:
    """Whether this machine has the encoder: it gives a packet for a grey image."""
    try:
        with av.open(os.devnull, "w", format="h264") as container:
            stream = add_h264(container, Coding(encoder, 30.0, 1_000_000), (640, 360))
            frame = VideoFrame.from_ndarray(np.full((360, 640), 128, np.uint8), format="gray")
            return bool(stream.encode(frame.reformat(format="yuv420p")) + stream.encode(None))
    except (av.error.FFmpegError, OSError, ValueError):
        return False
