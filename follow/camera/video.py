"""Cameras that read footage: an image folder or a video file.

Each frame has the time of its own stamp (in a folder: its number over the rate).  A gap in time is filled with rounds
without a frame, at the nominal rate, so that the loop goes on as with a live camera.  Missing frames are counted and
reported in one line at the end.
"""

import re
from collections.abc import Iterator
from pathlib import Path
from types import TracebackType
from typing import Protocol

import cv2
import numpy as np
from numpy.typing import NDArray
from typing_extensions import Self

from follow.camera import Camera, CameraError
from follow.camera.names import why_not_footage
from follow.camera.sizes import Shrink, whole
from follow.messages import Frame, Notify
from racf.errors import VideoError
from racf.imagefolder import IMAGE_SUFFIXES, image_paths, positions
from racf.video import LONGEST_GAP_S, MissingFrames, Video

FOLDER_FPS = 30.0  # default of an image folder: the commonest rate of the published UAV sequences


class ReplayCamera(Camera, Protocol):
    """A camera over footage.

    fps: its nominal rate, 1/s; rounds: about how many there are, or None; t_s: the time of the present round, s;
    scale: pixels of the source in one of its frames.
    """

    fps: float
    rounds: int | None
    t_s: float
    scale: int

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of its frames."""
        ...


def open_replay(source: str, fps: float | None, report: Notify, shrink: Shrink = whole) -> ReplayCamera:
    """Open an image folder or a video file; `fps` overrides what the source says.  Raises CameraError."""
    if fps is not None and not 0 < fps <= 1000:
        raise CameraError(f"frames per second must lie in 0..1000, not {fps:g}")
    require_footage(source)
    path = Path(source)
    if path.is_dir():
        return ImageFolder(path, fps or named_fps(path) or FOLDER_FPS, report, shrink)
    return VideoFile(path, fps, report, shrink)


def require_footage(source: str) -> None:
    """Raise CameraError for a source that is neither a file nor a folder of images."""
    path = Path(source)
    if path.is_dir():
        if not image_paths(path):
            raise CameraError(f"folder {path} holds no images ({', '.join(sorted(IMAGE_SUFFIXES))})")
    elif not path.is_file():
        raise CameraError(f"{source!r} cannot be opened: {why_not_footage(source)}")


def named_fps(folder: Path) -> float | None:
    """The rate in a folder's path, as in UAV123_10fps/building5; None if it holds no rate."""
    rates = re.findall(r"(?<![0-9])([1-9][0-9]{0,2}) ?fps", str(folder.resolve()), re.IGNORECASE)
    return float(rates[-1]) if rates else None


class _Footage:
    """Shared by both kinds: the time of the present round, and one line about missing frames."""

    def __init__(self, name: str, fps: float, report: Notify, missing: MissingFrames) -> None:
        self.name, self.fps, self.t_s = name, fps, 0.0
        self._report, self._missing, self._reported = report, missing, False

    def _until(self, t_s: float, last_s: float) -> Iterator[None]:
        """Rounds without a frame, evenly between two times; leaves the present round at the later one."""
        rounds = max(round((t_s - last_s) * self.fps), 1)
        for n in range(1, rounds):
            self.t_s = last_s + n * (t_s - last_s) / rounds
            yield None
        self.t_s = t_s

    def close(self) -> None:
        """Report what was missing, once."""
        if not self._reported and str(self._missing):
            self._report(f"{self.name}: {self._missing}")
        self._reported = True

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


class ImageFolder(_Footage):
    """The images of a folder, which has some, in natural order; a gap in their numbers gives rounds without a frame."""

    def __init__(self, folder: Path, fps: float, report: Notify, shrink: Shrink = whole) -> None:
        super().__init__(folder.resolve().name, fps, report, MissingFrames())
        paths = image_paths(folder)
        self._slots = dict(zip(positions(paths, int(LONGEST_GAP_S * fps)), paths, strict=True))
        self.rounds: int | None = max(self._slots) + 1
        first = next((image for path in self._slots.values() if (image := _read(path)) is not None), None)
        if first is None:
            raise CameraError(f"none of the {len(paths)} images in {folder} can be decoded")
        size = first.shape[1], first.shape[0]
        self.scale = shrink(size)
        self.size = (size[0] // self.scale, size[1] // self.scale)

    def frames(self) -> Iterator[Frame | None]:
        """Yield each frame, or None where one is missing, unreadable or of another size."""
        shape = None
        for n in range(max(self._slots) + 1):
            self.t_s = n / self.fps
            path = self._slots.get(n)
            image = None if path is None else _read(path)
            shape = shape or (None if image is None else image.shape)
            if path is None:
                self._missing.add("absent", 1, f"before {self._next_name(n)}")
            elif image is None:
                self._missing.add("undecoded", 1, path.name)
            elif shape != image.shape:
                self._missing.add("resized", 1, path.name)
                image = None
            yield None if image is None else Frame(self._shrunk(image), self.t_s, n, self.scale)
        self.close()

    def _shrunk(self, image: NDArray[np.uint8]) -> NDArray[np.uint8]:
        if self.scale == 1:
            return image
        return np.asarray(cv2.resize(image, self.size, interpolation=cv2.INTER_AREA), np.uint8)

    def _next_name(self, n: int) -> str:
        return self._slots[min(slot for slot in self._slots if slot > n)].name


class VideoFile(_Footage):
    """A video file, by its own time stamps, or at `fps` if that is given."""

    def __init__(self, path: Path, fps: float | None, report: Notify, shrink: Shrink = whole) -> None:
        try:
            self._video = Video(path, shrink)
        except VideoError as error:
            raise CameraError(str(error)) from None
        super().__init__(path.name, fps or self._video.fps, report, self._video.missing)
        self._counts, self.scale = fps is not None, self._video.scale
        length_s = self._video.length_s
        self.rounds: int | None = self._video.frames if self._counts or not length_s else round(length_s * self.fps)

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of its images, rotated as the file says."""
        return self._video.size

    def frames(self) -> Iterator[Frame | None]:
        """Yield each frame at the time of its stamp, None for rounds between two of them that are too far apart."""
        for shown in self._video.images():
            t_s = shown.index / self.fps if self._counts else shown.t_s
            yield from self._until(t_s, self.t_s if shown.index else t_s)
            yield Frame(shown.image, t_s, shown.index, self.scale)
        super().close()

    def close(self) -> None:
        """Release the file."""
        super().close()
        self._video.close()


def _read(path: Path) -> NDArray[np.uint8] | None:
    """The BGR image of a file, 8 bit; None if it cannot be decoded."""
    image = cv2.imread(str(path), cv2.IMREAD_COLOR)
    return None if image is None else np.asarray(image, np.uint8)
