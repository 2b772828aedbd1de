"""Where the target will be: the camera's own motion, and the target's smoothed motion over the ground."""

import cv2
import numpy as np
from numpy.typing import NDArray

from racf.box import Box

UInt8 = NDArray[np.uint8]
Float32 = NDArray[np.float32]

LONG_SIDE_PX = 128  # of the reduced picture: enough for the whole picture's motion, small enough to cost a millisecond
MIN_RESPONSE = 0.3  # of the phase correlation's peak; below it the pictures do not match


class EgoMotion:
    """Translation of the background between successive frames, by phase correlation of reduced grey pictures."""

    def __init__(self) -> None:
        self._before: Float32 | None = None
        self._window: Float32 | None = None

    def shift(self, image: UInt8) -> tuple[float, float]:
        """(dx, dy) in frame pixels since the last call; (0, 0) where that is unclear."""
        rows, cols = image.shape[:2]
        factor = max(max(rows, cols) / LONG_SIDE_PX, 1.0)
        size = max(round(cols / factor), 8), max(round(rows / factor), 8)
        # Striding first reads a fraction of a large picture; INTER_AREA then averages what is left.
        stride = max(int(factor // 3), 1)
        small = cv2.resize(image[::stride, ::stride], size, interpolation=cv2.INTER_AREA)
        grey = small if small.ndim == 2 else cv2.cvtColor(small, cv2.COLOR_BGR2GRAY)
        now = np.asarray(grey, dtype=np.float32)
        if self._window is None:
            self._window = np.asarray(cv2.createHanningWindow(size, cv2.CV_32F), dtype=np.float32)
        before, self._before = self._before, now
        if before is None:
            return 0.0, 0.0
        (dx, dy), response = cv2.phaseCorrelate(before, now, self._window)
        if response < MIN_RESPONSE:
            return 0.0, 0.0
        return dx * cols / size[0], dy * rows / size[1]


class Velocity:
    """The target's motion per frame beyond the camera's own: a running mean of what was seen."""

    def __init__(self, rate: float, decay: float) -> None:
        self.rate, self.decay = rate, decay
        self.dx = self.dy = 0.0

    def seen(self, before: Box, after: Box, ego: tuple[float, float]) -> None:
        """The target went from one box to the next while the background moved by `ego`."""
        self.dx += self.rate * (after.centre_x - before.centre_x - ego[0] - self.dx)
        self.dy += self.rate * (after.centre_y - before.centre_y - ego[1] - self.dy)

    def unseen(self) -> None:
        """A frame without the target: what is believed of its motion fades."""
        self.dx, self.dy = self.dx * self.decay, self.dy * self.decay

    def forget(self) -> None:
        """Nothing is known of the motion any more."""
        self.dx = self.dy = 0.0
