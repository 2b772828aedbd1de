"""The camera's video to the ground station: encoded outside the loop, only the newest frame, never blocking.

Frames are sent without a box, because a ground station draws its own; `video.overlay` draws one for a viewer that does
not.
"""

import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from statistics import median
from urllib.parse import urlsplit

import cv2
import numpy as np
from numpy.typing import NDArray

from follow.messages import NEVER, Notify, Tick
from follow.operator.consoles import NOTHING, shown
from follow.operator.ground_camera import StreamDescription
from follow.operator.video_stream import KEY_S, Coding, VideoStream, encoder_for
from follow.ranges import require_numbers
from follow.recording.video_encoder import Encoder
from follow.recording.worker import Worker
from follow.selection import TrackingState, TrackingStatus

PORT = 5600  # QGroundControl's own for RTP over UDP
CLOSE_S = 2.0  # maximum wait at the end for a server that does not answer
DELAYS = 30  # frames whose delay is kept: a second
GREEN, AMBER, WHITE = (80, 220, 60), (0, 170, 255), (255, 255, 255)  # BGR


@dataclass(frozen=True, slots=True)
class VideoConfig:
    """The video to the ground station.  Raises ValueError for implausible values."""

    width: int = 640
    """Width of the stream, pixels, at most the camera's; the height follows by its aspect."""
    rate_hz: float = 30.0
    """Highest frame rate, 1/s."""
    rate_bit_s: int = 2_000_000
    """Highest bit rate: 2 Mbit/s shows a 640x360 scene at 37 dB in its worst part (docs/ground_station.md)."""
    key_s: float = KEY_S
    """Time between key frames, s: a short one recovers sooner from a loss, a long one looks better at a low rate."""
    twice: bool = False
    """Send each RTP packet twice, for a radio that loses many; half of rate_bit_s each. Not for FFmpeg."""
    encoder: Encoder = Encoder.AUTO
    """Encoder: auto (the board's own H.264 encoder if it opens, else libx264), libx264, h264_v4l2m2m, h264_nvenc."""
    overlay: bool = False
    """Draw box, state and range into the image. A ground station draws its own box."""

    def __post_init__(self) -> None:
        require_numbers("video setting", self)
        if not 160 <= self.width <= 1920:
            raise ValueError(f"video.width lies in 160..1920 pixels, not {self.width}")
        if not 1 <= self.rate_hz <= 60:
            raise ValueError(f"video.rate_hz lies in 1..60, not {self.rate_hz:g}")
        if not 100_000 <= self.rate_bit_s <= 20_000_000:
            raise ValueError(f"video.rate_bit_s lies in 100000..20000000, not {self.rate_bit_s}")
        if not 0.03 <= self.key_s <= 10:
            raise ValueError(f"video.key_s lies in 0.03..10 s, not {self.key_s:g}")
        if self.encoder is Encoder.JPEG:
            raise ValueError("video.encoder is an H.264 encoder: jpeg is for recordings")


@dataclass(frozen=True, slots=True)
class VideoAddress:
    """Where to send the video: RTP to `host` ("": the connected ground stations) and `port`, or RTSP to `url`."""

    host: str = ""
    port: int = PORT
    url: str = ""


def parse_video(uri: str) -> VideoAddress:
    """The address that `uri` names: rtp://HOST:PORT, or rtsp://SERVER:PORT/PATH.  Raises ValueError."""
    form = f"a video address is rtp://HOST:{PORT} or rtsp://SERVER:8554/PATH, not {uri!r}"
    try:
        parts = urlsplit(uri)
        host, port = parts.hostname, parts.port
    except ValueError:
        raise ValueError(form) from None
    if parts.scheme == "rtsp" and host and parts.path.strip("/"):
        return VideoAddress(url=uri)
    if parts.scheme != "rtp" or not host or parts.path.strip("/") or port == 0:
        raise ValueError(form)
    return VideoAddress(host, PORT if port is None else port)


def stream_size(camera: tuple[int, int], width: int) -> tuple[int, int]:
    """Width and height of the stream, both even, with the camera's aspect and not larger than the camera's."""
    width = min(width, camera[0]) // 2 * 2
    return width, max(round(width * camera[1] / camera[0] / 2) * 2, 2)


def description_of(
    address: VideoAddress, config: VideoConfig, camera: tuple[int, int], hfov_deg: float
) -> StreamDescription:
    """The description for ground stations: for RTP the bare port, because they only listen."""
    size = stream_size(camera, config.width)
    uri = address.url or str(address.port)
    return StreamDescription(uri, not address.url, config.rate_hz, size, config.rate_bit_s, hfov_deg)


class VideoOut:
    """Takes each tick with `see` and sends its frame to the hosts of `send_to`.

    `clock` is the clock of the frames' times.
    """

    def __init__(
        self, address: VideoAddress, config: VideoConfig, report: Notify, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._address, self._config, self._clock = address, config, clock
        self._hosts: tuple[str, ...] = ()
        self._next_t_s = NEVER
        self._status = NOTHING
        self._delays: deque[float] = deque(maxlen=DELAYS)
        twice = config.twice and not address.url  # RTSP goes by TCP
        bit_s = config.rate_bit_s // 2 if twice else config.rate_bit_s
        coding = Coding(encoder_for(config.encoder), config.rate_hz, bit_s, config.key_s, twice)
        self._worker = Worker("the video", lambda: VideoStream(coding, address.url, report), report, 1, waits=False)
        self.send_to((address.host,) if address.host else ())

    @property
    def delay_s(self) -> float:
        """Median time from a frame's exposure to its sending; NaN in the first second, while the encoder starts."""
        delays = list(self._delays)
        return median(delays) if len(delays) == DELAYS else float("nan")

    @property
    def dropped(self) -> int:
        """Number of frames that a newer one replaced before they were sent."""
        return self._worker.dropped

    def send_to(self, hosts: tuple[str, ...]) -> None:
        """Send to these hosts from now on, if the address does not name one."""
        if hosts != self._hosts and not self._address.url:
            self._hosts = hosts
            addresses = tuple((host, self._address.port) for host in hosts)
            self._worker.put(lambda stream: stream.send_to(addresses))

    def hear_stations(self, hosts: tuple[str, ...]) -> None:
        """Send to the connected ground stations, unless the address names a host."""
        if not self._address.host:
            self.send_to(hosts)

    def see(self, tick: Tick) -> None:
        """Take one round; its frame replaces one that still waits."""
        self._status = shown(tick, self._status)
        frame = tick.frame
        if frame is None or not (self._hosts or self._address.url) or frame.t_s < self._next_t_s:
            return
        every_s = 1.0 / self._config.rate_hz
        late_s = frame.t_s - self._next_t_s
        self._next_t_s = self._next_t_s + every_s if late_s < every_s else frame.t_s + 0.9 * every_s
        about = overlay(tick, self._status) if self._config.overlay else None
        self._worker.put(nothing, partial(self._send, image=frame.image, t_s=frame.t_s, about=about))

    def _send(self, stream: VideoStream, image: NDArray[np.uint8], t_s: float, about: "Overlay | None") -> None:
        size = stream_size((image.shape[1], image.shape[0]), self._config.width)
        if size != (image.shape[1], image.shape[0]):
            image = np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8)
        if about is not None:
            image = drawn(image, about)
        if stream.show(image, t_s):
            self._delays.append(self._clock() - t_s)

    def close(self) -> None:
        """End the stream."""
        self._worker.close(CLOSE_S)


def nothing(_stream: VideoStream) -> None:
    """Do nothing: the frame is the heavy part."""


@dataclass(frozen=True, slots=True)
class Overlay:
    """The overlay of a frame: the box in fractions of the image, and a text."""

    status: TrackingStatus
    words: str


def overlay(tick: Tick, status: TrackingStatus) -> Overlay:
    """The box, the gate's mode, and the range of the target once it was seen."""
    seen, words = tick.estimate, tick.decision.mode.value
    if status.state is not TrackingState.IDLE and seen.seen_t_s > NEVER:
        words = f"{words}  {seen.range_m:.0f} m"
    return Overlay(status, words)


def drawn(image: NDArray[np.uint8], about: Overlay) -> NDArray[np.uint8]:
    """A copy of the image with the overlay: the box is green while the target is found, else amber."""
    image = np.ascontiguousarray(image).copy()
    rows, columns = image.shape[:2]
    scale = columns / 640
    thick = max(round(2 * scale), 1)
    if about.status.box is not None:
        left, top, width, height = about.status.box
        corner = round(left * columns), round(top * rows)
        opposite = round((left + width) * columns), round((top + height) * rows)
        colour = GREEN if about.status.state is TrackingState.ACTIVE else AMBER
        cv2.rectangle(image, corner, opposite, colour, thick)
    corner = round(8 * scale), rows - round(10 * scale)
    for colour, width_px in ((0, 0, 0), 3 * thick), (WHITE, thick):
        cv2.putText(image, about.words, corner, cv2.FONT_HERSHEY_SIMPLEX, 0.6 * scale, colour, width_px, cv2.LINE_AA)
    return image
