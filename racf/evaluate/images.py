"""Images from files: one, a folder of numbered ones, or a video."""

from collections.abc import Callable, Iterator
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from racf.evaluate.benchmarks import all_frames
from racf.video import Video

Image = NDArray[np.uint8]  # (rows, columns, 3), BGR


def read_frame(path: Path) -> Image:
    """One image; raises ValueError naming the file."""
    try:
        image = cv2.imread(str(path), cv2.IMREAD_COLOR)
    except cv2.error:  # its header declares more pixels than OpenCV accepts
        image = None
    if image is None:
        raise ValueError(f"{path} is not an image that OpenCV can read")
    return np.asarray(image, dtype=np.uint8)


class FrameCache:
    """The decoded images of one folder, the first `max_bytes` of them: runs on one sequence follow one another."""

    def __init__(self, max_bytes: int) -> None:
        self.max_bytes = max_bytes
        self._folder: Path | None = None
        self._images: dict[Path, Image] = {}
        self._bytes = 0

    def read(self, path: Path) -> Image:
        """One image, a copy that the caller may change; raises ValueError naming the file."""
        if path.parent != self._folder:
            self._folder, self._images, self._bytes = path.parent, {}, 0
        image = self._images.get(path)
        if image is not None:
            return image.copy()
        image = read_frame(path)
        if self._bytes + image.nbytes <= self.max_bytes:
            self._images[path] = image.copy()
            self._bytes += image.nbytes
        return image


def frames_of(source: Path) -> Iterator[Image]:
    """The images of a folder or of a video file, in order; raises when there are none."""
    return (image for image in rows_of(source) if image is not None)


def rows_of(source: Path, notify: Callable[[str], None] = lambda _line: None) -> Iterator[Image | None]:
    """The same with None for each frame of a video that does not decode, so that annotated rows stay in step.

    `notify` gets one line about what a video lacks.
    """
    if source.is_dir():
        paths = all_frames(source / "img" if (source / "img").is_dir() else source)
        if not paths:
            raise ValueError(f"{source} is a folder without images")
        for path in paths:
            yield read_frame(path)
        return
    if not source.is_file():
        raise FileNotFoundError(f"{source} is neither a folder of images nor a video file")
    with Video(source) as video:
        row = 0
        for shown in video.images():
            yield from (None for _ in range(row, shown.index))
            yield shown.image
            row = shown.index + 1
        if lacks := str(video.missing):
            notify(f"{source.name}: {lacks}")
