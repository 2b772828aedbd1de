"""Cameras that read frames: an image folder or a video file (replayed), a device or a network stream (live).

A replayed source is played round by round: round `n` is the frame of time `n / fps`, and a frame that is missing
or cannot be decoded is a round without one, so that time and annotation rows stay in step with what was filmed.
A live source keeps only its newest frame; a thread at the edge reads it.  A device's frame bears the time at which
it came; a stream's that of its stamp, so that frames which piled up on the way are not taken for new ones.
"""

import os
import re
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from types import TracebackType
from typing import Protocol

import cv2
import numpy as np
from numpy.typing import NDArray
from typing_extensions import Self

from follow.camera import Camera, CameraError
from follow.camera.stream_clock import StreamClock
from follow.messages import Frame, Notify
from racf.imagefolder import IMAGE_SUFFIXES, image_paths, positions

FOLDER_FPS = 30.0  # image folders seldom say; the commonest rate of the published UAV sequences
LONGEST_GAP_S = 10.0  # a longer hole in numbers or time stamps is a cut, not lost frames
DECODE_ATTEMPTS = 64  # failed reads in a row after which a file is taken to have ended: two seconds at 30 frames/s
STAMPED = ("rtsp://", "rtsps://", "udp://", "srt://")  # stamped by the sender; HTTP's stamps may be made up on arrival
ROUND_S = 1 / 20  # live: a round at least this often; PX4 drops OFFBOARD below 2 Hz, 20 Hz is MAVLink's usual rate
REOPEN_AFTER_S = 1.0  # live: pause before a broken stream is tried again
OPEN_S = 10.0  # live: connection timeout (OpenCV's default is 30 s)
SILENT_S = 2.0  # live: read timeout for a sender that died; the gate has stopped by then (0.2 s and 1 s)


class ReplayCamera(Camera, Protocol):
    """A camera whose rounds have a fixed length, and that may know how many there are."""

    fps: float
    rounds: int | None

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of its frames."""
        ...


def open_replay(source: str, fps: float | None, report: Notify) -> ReplayCamera:
    """Open an image folder or a video file; `fps` overrides what the source says.  Raises CameraError."""
    if fps is not None and not 0 < fps <= 1000:
        raise CameraError(f"frames per second must lie in 0..1000, not {fps:g}")
    path = Path(source)
    if path.is_dir():
        return ImageFolder(path, fps or named_fps(path) or FOLDER_FPS, report)
    if path.is_file():
        return VideoFile(path, fps, report)
    raise CameraError(f"{source!r} is neither a video file nor a folder of images")


def named_fps(folder: Path) -> float | None:
    """The rate that a folder's path tells, as in UAV123_10fps/building5; None if it tells no rate."""
    told = re.findall(r"(?<![0-9])([1-9][0-9]{0,2}) ?fps", str(folder.resolve()), re.IGNORECASE)
    return float(told[-1]) if told else None


def is_live(source: str) -> bool:
    """Whether a source is a device (an index or /dev/...) or a stream (a URL), not a file."""
    return source.isdigit() or source.startswith("/dev/") or "://" in source


class _Closing:
    """Entering gives the camera itself; leaving releases nothing more than the class says in `close`."""

    def close(self) -> None:
        """Release what is held."""

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


class ImageFolder(_Closing):
    """The images of a folder in natural order; a hole in their numbers is rounds without a frame."""

    def __init__(self, folder: Path, fps: float, report: Notify) -> None:
        paths = image_paths(folder)
        if not paths:
            raise CameraError(f"folder {folder} holds no images ({', '.join(sorted(IMAGE_SUFFIXES))})")
        self.fps = fps
        self._report = report
        self._slots = dict(zip(positions(paths, int(LONGEST_GAP_S * fps)), paths, strict=True))
        self.rounds: int | None = max(self._slots) + 1

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the first frame that can be decoded.  Raises CameraError when none can."""
        for path in self._slots.values():
            image = cv2.imread(str(path), cv2.IMREAD_COLOR)
            if image is not None:
                return image.shape[1], image.shape[0]
        raise CameraError(f"none of the {len(self._slots)} images can be decoded")

    def frames(self) -> Iterator[Frame | None]:
        """Yield each frame, or None where one is missing, unreadable or of another size."""
        shape = None
        gap = 0
        for n in range(max(self._slots) + 1):
            path = self._slots.get(n)
            if path is None:
                gap += 1
                yield None
                continue
            if gap:
                self._report(
                    f"{gap} frame{'s are' if gap > 1 else ' is'} missing before {path.name}: played as a pause"
                )
                gap = 0
            image = cv2.imread(str(path), cv2.IMREAD_COLOR)
            if image is None:
                self._report(f"{path.name} cannot be decoded: skipped")
                yield None
            elif shape not in (None, image.shape):
                self._report(f"{path.name} is {_size(image.shape)}, not {_size(shape)} like the first frame: skipped")
                yield None
            else:
                shape = image.shape
                yield Frame(_bytes(image), n / self.fps, n)


class VideoFile(_Closing):
    """A video file; a frame that does not decode is a round without one."""

    def __init__(self, path: Path, fps: float | None, report: Notify) -> None:
        _hush_decoders()
        self._path = path
        self._report = report
        self._video = cv2.VideoCapture(str(path))
        if not self._video.isOpened():
            raise CameraError(f"{path} cannot be opened as a video")
        said = self._video.get(cv2.CAP_PROP_FPS)
        self._file_fps = said if 0 < said <= 1000 else FOLDER_FPS
        self.fps = fps or self._file_fps
        promised = self._video.get(cv2.CAP_PROP_FRAME_COUNT)
        self.rounds = int(promised) if 0 < promised < 1e7 else None

    @property
    def size(self) -> tuple[int, int]:
        """Width and height as the container says."""
        return int(self._video.get(cv2.CAP_PROP_FRAME_WIDTH)), int(self._video.get(cv2.CAP_PROP_FRAME_HEIGHT))

    def close(self) -> None:
        """Release the file."""
        self._video.release()

    def frames(self) -> Iterator[Frame | None]:
        """Yield each frame in the round that its time stamp says, None for those lost before it."""
        expected, shift, shape = 0, 0, None
        while (image := self._next()) is not None:
            stamp = round(self._video.get(cv2.CAP_PROP_POS_MSEC) / 1000 * self._file_fps) - shift
            lost = max(stamp - expected, 0)
            if lost > LONGEST_GAP_S * self._file_fps:
                self._report(f"{self._path.name}: time jumps by {lost / self._file_fps:.0f} s at frame {expected}: cut")
                shift, lost = shift + lost, 0
            if lost:
                self._report(f"{self._path.name}: {lost} frames lost or corrupt before frame {expected + lost}")
                yield from (None for _ in range(lost))
            n = expected + lost
            expected = n + 1
            shape = shape or image.shape
            if image.shape != shape:
                self._report(f"{self._path.name}: frame {n} is {_size(image.shape)}, not {_size(shape)}: skipped")
                yield None
            else:
                yield Frame(_bytes(image), n / self.fps, n)
        if self.rounds is not None and expected < self.rounds:
            self._report(f"{self._path.name} ended after {expected} of {self.rounds} frames")

    def _next(self) -> NDArray[np.generic] | None:
        for _ in range(DECODE_ATTEMPTS):
            good, image = self._video.read()
            if good:
                return image
        return None


class LiveVideo(_Closing):
    """A device or stream.  A thread reads it; only the newest frame is kept, with the time at which it came.

    Where a stream bears stamps it is the time at which the frame would have come had nothing held it up.  `delay_s`,
    which exposure, encoding and the way take of every frame, is taken off.
    `size` is the width and height of its frames, as it says itself.
    """

    def __init__(
        self, source: str, report: Notify, delay_s: float = 0.0, clock: Callable[[], float] = time.monotonic
    ) -> None:
        _hush_decoders()
        self._source = source
        self._report = report
        self._delay_s = delay_s
        self._clock = clock
        self._video = self._open()
        if not self._video.isOpened():
            raise CameraError(f"camera {source!r} cannot be opened")
        self.size = int(self._video.get(cv2.CAP_PROP_FRAME_WIDTH)), int(self._video.get(cv2.CAP_PROP_FRAME_HEIGHT))
        self._sized = f"{self.size[0]}x{self.size[1]}"  # the lens is known for frames of this size
        self._fresh = threading.Condition()
        self._newest: Frame | None = None
        self._closing = threading.Event()
        self._reader = threading.Thread(target=self._read, name="camera", daemon=True)
        self._reader.start()

    def close(self) -> None:
        """Stop reading; a reader stuck in its driver is left behind."""
        self._closing.set()
        self._reader.join(timeout=1.0)

    def frames(self) -> Iterator[Frame | None]:
        """Yield the newest frame as soon as it is there, or None when a round passes without one; never ends."""
        while not self._closing.is_set():
            with self._fresh:
                self._fresh.wait_for(lambda: self._newest is not None, timeout=ROUND_S)
                frame, self._newest = self._newest, None
            yield frame

    def _open(self) -> cv2.VideoCapture:
        if "://" in self._source:
            how = [cv2.CAP_PROP_OPEN_TIMEOUT_MSEC, int(1e3 * OPEN_S)]
            how += [cv2.CAP_PROP_READ_TIMEOUT_MSEC, int(1e3 * SILENT_S)]
            # Each thread more holds a frame back: H.264 at 30 frames/s came 72 ms late instead of 106 with two.
            how += [cv2.CAP_PROP_N_THREADS, 1]
            return cv2.VideoCapture(self._source, cv2.CAP_FFMPEG, how)
        video = cv2.VideoCapture(int(self._source) if self._source.isdigit() else self._source)
        video.set(cv2.CAP_PROP_BUFFERSIZE, 1)  # where the driver obeys: no queue of old frames
        return video

    def _read(self) -> None:
        index, broken = 0, False
        stream = StreamClock()
        while not self._closing.is_set():
            good, image = self._video.read()
            if good and _size(image.shape) != self._sized:
                if not broken:
                    self._report(f"camera {self._source!r} gives {_size(image.shape)}, not {self._sized}: not used")
                broken = True
                continue
            if good:
                if broken:
                    self._report(f"camera {self._source!r} gives frames again")
                broken = False
                t_s = self._clock()
                if self._source.startswith(STAMPED):
                    t_s = stream.taken_at(self._video.get(cv2.CAP_PROP_POS_MSEC) / 1e3, t_s)
                if t_s is not None:
                    with self._fresh:
                        self._newest = Frame(_bytes(image), t_s - self._delay_s, index)
                        self._fresh.notify()
                index += 1
                continue
            if not broken:
                self._report(f"camera {self._source!r} gives no frame: trying again every {REOPEN_AFTER_S:g} s")
            broken = True
            self._video.release()
            if not self._closing.wait(REOPEN_AFTER_S):
                self._video, stream = self._open(), StreamClock()
        self._video.release()


def _hush_decoders() -> None:
    """Keep FFmpeg's own lines off standard error; what they mean for a person is reported by this module."""
    os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")  # AV_LOG_QUIET; OpenCV has no call for it
    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)


def _bytes(image: NDArray[np.generic]) -> NDArray[np.uint8]:
    if image.dtype != np.uint8:
        raise CameraError(f"frames must be 8 bit, not {image.dtype}")
    return image.view(np.uint8)


def _size(shape: tuple[int, ...] | None) -> str:
    return "" if shape is None else f"{shape[1]}x{shape[0]}"
