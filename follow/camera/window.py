"""A virtual camera over footage: a window of each frame that the vehicle's yaw and height move."""

import math
from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from follow.camera import Camera
from follow.camera.filter import CameraFilter
from follow.geometry import Intrinsics
from follow.messages import Frame, VehicleState
from racf.box import Box


class WindowCamera(CameraFilter[Camera]):
    """A window of another camera's frames, turned by the vehicle's yaw and shifted by its height.

    `full` describes the footage's camera; the window has its focal length and shows `window` pixels around
    `start` (x, y) when the vehicle is where it began.  A change of height by h shifts the view by h / `range_m`
    radians.  Outside the footage the window repeats its edge.
    """

    def __init__(
        self,
        camera: Camera,
        state: Callable[[], VehicleState],
        full: Intrinsics,
        window: tuple[int, int],
        start: tuple[float, float],
        range_m: float,
    ) -> None:
        super().__init__(camera)
        self._state, self._full = state, full
        self._size, self._start, self._range_m = window, start, range_m
        begin = state()
        self._yaw_rad, self._down_m = begin.yaw_rad, begin.down_m
        self.window = self._place()

    @property
    def intrinsics(self) -> Intrinsics:
        """The window as a camera of its own, its optical axis through its middle."""
        w, h = self._size
        return Intrinsics(w, h, self._full.fx, self._full.fy, w / 2, h / 2)

    def frames(self) -> Iterator[Frame | None]:
        """Yield the window of each frame; `window` is then its position in the frame."""
        for frame in self._camera.frames():
            self.window = self._place()
            yield frame and replace(frame, image=cut(frame.image, self.window))

    def _place(self) -> Box:
        """The window's present position, in whole pixels."""
        state = self._state()
        yaw = math.remainder(state.yaw_rad - self._yaw_rad, math.tau)
        dip = (state.down_m - self._down_m) / self._range_m
        x = self._start[0] + self._full.fx * yaw
        y = self._start[1] + self._full.fy * dip
        w, h = self._size
        return Box(round(x - w / 2), round(y - h / 2), w, h)


def cut(image: NDArray[np.uint8], window: Box) -> NDArray[np.uint8]:
    """The (h, w) pixels of `window`, wholly or partly outside the image too: there its edge is repeated."""
    rows = np.clip(np.arange(int(window.h)) + int(window.y), 0, image.shape[0] - 1)
    columns = np.clip(np.arange(int(window.w)) + int(window.x), 0, image.shape[1] - 1)
    return np.ascontiguousarray(image[rows[:, None], columns])
