"""The modes of a V4L2 device, by its ioctls (linux/videodev2.h), for the error message about an unsupported mode."""

import errno
import fcntl
import os
import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass

from follow.camera import CameraError

IN_OUT = 3 << 30  # _IOWR
CAPTURE, CAPTURE_MPLANE = 1, 9  # v4l2_buf_type
DISCRETE = 1  # v4l2_frmsizetypes, v4l2_frmivaltypes
FMT, SIZE, INTERVAL = (2, 64), (74, 44), (75, 52)  # number of the ioctl, bytes of its struct
FOURCC = {  # FFmpeg's name for `input_format` of each code
    "MJPG": "mjpeg",
    "JPEG": "mjpeg",
    "YUYV": "yuyv422",
    "UYVY": "uyvy422",
    "H264": "h264",
    "HEVC": "hevc",
    "NV12": "nv12",
    "YU12": "yuv420p",
    "RGB3": "rgb24",
    "BGR3": "bgr24",
    "GREY": "gray",
}
MOST_NAMED = 12  # modes in one message

Ioctl = Callable[[int, int, bytearray], int]


@dataclass(frozen=True, slots=True)
class CameraMode:
    """A mode of a device: FFmpeg's name of the format, size in pixels, rates in frames per second (may be unknown)."""

    format: str
    width: int
    height: int
    fps: tuple[float, ...] = ()

    def __str__(self) -> str:
        rates = ", ".join(f"{rate:g}" for rate in self.fps)
        return f"{self.format} {self.width}x{self.height}" + (f" at {rates}" if rates else "")


def modes_of(path: str, ioctl: Ioctl = fcntl.ioctl) -> list[CameraMode]:
    """The modes of a device that have a fixed size.  Raises CameraError when it cannot be opened."""
    try:
        device = os.open(path, os.O_RDWR | os.O_NONBLOCK)
    except OSError as error:
        raise CameraError(f"camera {path} cannot be opened: {error.strerror}") from None
    try:
        return [
            CameraMode(
                FOURCC.get(code, code.strip().lower()), width, height, tuple(_rates(device, code, width, height, ioctl))
            )
            for code in _formats(device, ioctl)
            for width, height in _sizes(device, code, ioctl)
        ]
    finally:
        os.close(device)


def check_mode(
    path: str, modes: list[CameraMode], format_: str | None, size: tuple[int, int] | None, fps: float | None
) -> None:
    """Raise CameraError, naming the supported modes, if none fits; a device that lists no modes is not checked."""
    fitting = [
        mode
        for mode in modes
        if format_ in (None, mode.format)
        and size in (None, (mode.width, mode.height))
        and (fps is None or not mode.fps or any(abs(rate - fps) < 0.05 for rate in mode.fps))
    ]
    if modes and not fitting:
        wanted = [format_ or "", "x".join(map(str, size)) if size else "", f"{fps:g} frames/s" if fps else ""]
        named = "; ".join(map(str, modes[:MOST_NAMED])) + ("; ..." if len(modes) > MOST_NAMED else "")
        raise CameraError(f"camera {path} has no mode {' '.join(filter(None, wanted))}; it has {named}")


def _ask(device: int, what: tuple[int, int], request: bytearray, ioctl: Ioctl) -> bool:
    """One ioctl that fills in `request`; False when there is no such entry."""
    number, size = what
    try:
        ioctl(device, IN_OUT | size << 16 | ord("V") << 8 | number, request)
    except OSError as error:
        if error.errno in (errno.EINVAL, errno.ENOTTY, errno.ENODATA):
            return False
        raise CameraError(f"the camera does not list its modes: {error.strerror}") from None
    return True


def _formats(device: int, ioctl: Ioctl) -> Iterator[str]:
    for kind in (CAPTURE, CAPTURE_MPLANE):
        for index in range(64):
            request = bytearray(struct.pack("=2I", index, kind).ljust(FMT[1], b"\0"))
            if not _ask(device, FMT, request, ioctl):
                break
            yield request[44:48].decode("ascii", "replace")


def _sizes(device: int, code: str, ioctl: Ioctl) -> Iterator[tuple[int, int]]:
    for index in range(256):
        request = bytearray(struct.pack("=I4s", index, code.encode()).ljust(SIZE[1], b"\0"))
        if not _ask(device, SIZE, request, ioctl):
            return
        kind, width, height = struct.unpack_from("=3I", request, 8)
        if kind != DISCRETE:
            return
        yield width, height


def _rates(device: int, code: str, width: int, height: int, ioctl: Ioctl) -> Iterator[float]:
    for index in range(64):
        request = bytearray(struct.pack("=I4s2I", index, code.encode(), width, height).ljust(INTERVAL[1], b"\0"))
        if not _ask(device, INTERVAL, request, ioctl):
            return
        kind, numerator, denominator = struct.unpack_from("=3I", request, 16)
        if kind != DISCRETE or not numerator:
            return
        yield round(denominator / numerator, 2)
