"""Camera filters for flying in real time."""

import time
from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from follow.camera import Camera
from follow.camera.filter import CameraFilter
from follow.camera.video import ReplayCamera
from follow.messages import Frame

COARSE = 16  # every 16th row and column tells most frames apart in microseconds


class RealTime(CameraFilter[ReplayCamera]):
    """A replayed camera in real time: each frame is delivered when it is due, stamped with that time."""

    def __init__(self, footage: ReplayCamera, clock: Callable[[], float] = time.monotonic) -> None:
        super().__init__(footage)
        self.footage = footage
        self._clock = clock

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of its frames."""
        return self.footage.size

    @property
    def scale(self) -> int:
        """Pixels of the source in one of its frames."""
        return self.footage.scale

    def frames(self) -> Iterator[Frame | None]:
        """Yield each frame when it is due, or None for a round without one; a slow consumer misses frames."""
        began_s = self._clock()
        for frame in self.footage.frames():
            late_s = self._clock() - began_s - self.footage.t_s
            if late_s > 1 / self.footage.fps:
                continue
            time.sleep(max(-late_s, 0.0))
            yield frame and replace(frame, t_s=self._clock())


class NewPictures(CameraFilter[Camera]):
    """Drops frames that repeat the one before.

    A frozen camera, driver or encoder may go on delivering its last frame with fresh times.  The target then no longer
    moves in the image, and the vehicle would turn towards it for ever.  A working sensor's noise never gives the same
    bytes twice.
    """

    def frames(self) -> Iterator[Frame | None]:
        """Yield what the camera yields, but None for a frame that equals the one before."""
        last: NDArray[np.uint8] | None = None
        for frame in self._camera.frames():
            if frame is None or (last is not None and is_same(frame.image, last)):
                yield None
                continue
            last = frame.image
            yield frame


def is_same(image: NDArray[np.uint8], other: NDArray[np.uint8]) -> bool:
    """Whether two frames are equal in every byte."""
    coarse = slice(None, None, COARSE)
    return np.array_equal(image[coarse, coarse], other[coarse, coarse]) and np.array_equal(image, other)
