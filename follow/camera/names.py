"""The values of `--camera`: devices, streams, programs, each with its options.

/dev/video0?size=1280x720&fps=30&format=mjpeg    a V4L2 device with its mode; 0 is /dev/video0
rtsp://HOST/PATH#transport=udp                   a stream; its options follow `#`, because `?` belongs to the server
udp://:5600  http://HOST/PATH  FILE.sdp          MPEG transport stream, MJPEG over HTTP, RTP as an SDP file says
exec?format=yuv420p&size=640x360&fps=30:PROGRAM  a program's standard output
picamera2?size=1280x720&fps=30                   a Raspberry Pi's camera by picamera2
lavfi:testsrc=size=640x360:rate=30               a test source of FFmpeg
"""

import re
from dataclasses import dataclass, field
from enum import Enum
from pathlib import Path
from urllib.parse import parse_qsl

import av
import av.error

from follow.camera import CameraError


class CameraKind(Enum):
    """How a live camera is read."""

    DEVICE = "a V4L2 device"
    STREAM = "a stream"
    SDP = "an SDP file"
    PROGRAM = "a program"
    PICAMERA2 = "picamera2"
    LAVFI = "a source of FFmpeg's lavfi"


OPTIONS: dict[CameraKind, tuple[str, ...]] = {
    CameraKind.DEVICE: ("size", "fps", "format"),
    CameraKind.STREAM: ("transport", "format", "buffer_size", "max_delay", "reorder_queue_size", "user_agent"),
    CameraKind.SDP: ("buffer_size", "max_delay", "reorder_queue_size"),
    CameraKind.PROGRAM: ("size", "fps", "format"),
    CameraKind.PICAMERA2: ("size", "fps", "camera"),
    CameraKind.LAVFI: (),
}
"""The options of each kind; those of a stream and an SDP file, except `transport`, have FFmpeg's names and meaning."""
TRANSPORTS = ("tcp", "udp", "udp_multicast", "http")  # FFmpeg's rtsp_transport
RAW_FORMATS = ("yuv420p", "nv12", "yuyv422", "uyvy422", "rgb24", "bgr24", "gray")  # a program's, need size and fps
SCHEMES = frozenset({"rtsp", "rtsps", "udp", "tcp", "http", "https", "rtp", "rtmp", "srt"})
_URL = re.compile(r"^([a-z][a-z0-9+.-]*)://", re.IGNORECASE)
_PROGRAM = re.compile(r"^exec(\?[^:]*)?:(.*)$", re.DOTALL)


@dataclass(frozen=True, slots=True)
class CameraName:
    """A live camera: its kind, its address (path, URL, command line, graph), and its options as they were typed."""

    text: str
    kind: CameraKind
    address: str
    options: dict[str, str] = field(default_factory=dict)

    @property
    def size(self) -> tuple[int, int] | None:
        """Width and height of `size=WxH`."""
        if "size" not in self.options:
            return None
        width, height = self.options["size"].split("x")
        return int(width), int(height)

    @property
    def fps(self) -> float | None:
        """Frames per second of `fps=N`."""
        return float(self.options["fps"]) if "fps" in self.options else None


def is_live(source: str) -> bool:
    """Whether a source is a device, a stream or a program, not footage."""
    return _kind(source) is not None


def is_camera(source: str) -> bool:
    """Whether a source shows the world: a live one that FFmpeg does not draw."""
    return _kind(source) not in (None, CameraKind.LAVFI)


def _kind(source: str) -> CameraKind | None:
    if source.partition("?")[0].isdigit() or source.startswith("/dev/"):
        return CameraKind.DEVICE
    if _PROGRAM.match(source):
        return CameraKind.PROGRAM
    if source == "picamera2" or source.startswith("picamera2?"):
        return CameraKind.PICAMERA2
    if source.startswith("lavfi:"):
        return CameraKind.LAVFI
    if _URL.match(source):
        return CameraKind.STREAM
    return CameraKind.SDP if source.partition("#")[0].lower().endswith(".sdp") else None


def parse_camera(source: str) -> CameraName:
    """Parse the name of a camera.  Raises CameraError for an invalid name or option."""
    kind = _kind(source)
    if kind is None:
        raise CameraError(f"{source!r} is not a live camera")
    if kind is CameraKind.PROGRAM:
        match = _PROGRAM.match(source)
        assert match is not None
        query, address = (match[1] or "")[1:], match[2].strip()
    elif kind in (CameraKind.STREAM, CameraKind.SDP):
        address, _, query = source.partition("#")
    elif kind is CameraKind.LAVFI:
        address, query = source.partition(":")[2], ""
    else:
        address, _, query = source.partition("?")
        address = f"/dev/video{address}" if address.isdigit() else address
    name = CameraName(source, kind, address, _options(source, kind, query))
    _check(name)
    return name


def _options(source: str, kind: CameraKind, query: str) -> dict[str, str]:
    pairs = parse_qsl(query, keep_blank_values=True)
    for option, _ in pairs:
        if option not in OPTIONS[kind]:
            known = ", ".join(OPTIONS[kind]) or "no options"
            raise CameraError(f"camera {source!r}: {kind.value} has no option {option!r}; it has {known}")
    return dict(pairs)


def _check(name: CameraName) -> None:
    """Raise CameraError for an invalid value."""
    rules = {
        "size": (r"[1-9][0-9]{0,4}x[1-9][0-9]{0,4}", "WIDTHxHEIGHT in pixels"),
        "fps": (r"[1-9][0-9]{0,3}(\.[0-9]+)?", "a number of frames per second"),
        "transport": ("|".join(TRANSPORTS), f"one of {', '.join(TRANSPORTS)}"),
        "camera": (r"[0-9]", "the number of a camera"),
        "buffer_size": (r"[0-9]+", "a number of bytes"),
        "max_delay": (r"[0-9]+", "a number of microseconds"),
        "reorder_queue_size": (r"[0-9]+", "a number of packets"),
    }
    for option, value in name.options.items():
        pattern, meaning = rules.get(option, (r".+", "not empty"))
        if not re.fullmatch(pattern, value):
            raise CameraError(f"camera {name.text!r}: {option} is {meaning}, not {value!r}")
    if name.kind is CameraKind.STREAM:
        _check_scheme(name)
    if name.kind is CameraKind.PROGRAM and not name.address:
        raise CameraError(f"camera {name.text!r}: exec: needs a program, as exec:rpicam-vid -t 0 --codec mjpeg -o -")
    if name.kind is CameraKind.PROGRAM and name.options.get("format") in RAW_FORMATS and name.size is None:
        raise CameraError(f"camera {name.text!r}: format={name.options['format']} has no header: give size=WxH also")
    if name.kind is CameraKind.SDP and not Path(name.address).is_file():
        raise CameraError(f"camera {name.text!r}: there is no file {name.address!r}")


def _check_scheme(name: CameraName) -> None:
    match = _URL.match(name.address)
    scheme = match[1].lower() if match else ""
    if scheme not in SCHEMES:
        raise CameraError(f"camera {name.text!r}: streams begin with {', '.join(sorted(SCHEMES))}, not {scheme}")
    if scheme == "srt" and not has_srt():
        raise CameraError(
            f"camera {name.text!r}: this FFmpeg (of the package av) has no SRT; "
            "use a program: exec?format=mpegts:srt-live-transmit URL file://con"
        )


def has_srt() -> bool:
    """Whether FFmpeg knows the protocol SRT."""
    try:
        av.open("srt://127.0.0.1:1?mode=none", timeout=0.01).close()
    except av.error.ProtocolNotFoundError:
        return False
    except (OSError, ValueError):
        return True
    return True


def why_not_footage(source: str) -> str:
    """What to do about a source that is neither a file, nor a folder, nor a live camera."""
    if re.search(r"\s!\s", source):
        return f"a GStreamer pipeline is given as a program: exec:gst-launch-1.0 -q {source.rsplit('!', 1)[0]}! fdsink"
    return "it is neither a video file nor a folder of images, and no camera has such a name"
