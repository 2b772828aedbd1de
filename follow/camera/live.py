"""Live cameras: a thread reads the source and keeps only the newest frame; a source that breaks is opened again."""

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from types import TracebackType

import numpy as np
from numpy.typing import NDArray
from typing_extensions import Self

from follow.camera import CameraError
from follow.camera.capture import Capture, open_stream
from follow.camera.names import CameraKind, CameraName, parse_camera
from follow.camera.picamera import PicameraCapture
from follow.camera.program import open_program
from follow.camera.sizes import Shrink, whole
from follow.messages import NEVER, Frame, Notify

ROUND_S = 1 / 20  # a round at least this often; PX4 drops OFFBOARD below 2 Hz, 20 Hz is MAVLink's usual rate
REOPEN_AFTER_S = 1.0  # pause before a broken source is tried again
CLOSE_S = 3.0  # timeout for the reading thread to end; a program gets 1 s before it is killed


class LiveVideo:
    """A live camera, named as in `follow.camera.names`.  Raises CameraError if it cannot be opened.

    A frame has the time at which it was taken, as far as that is known: from the kernel or the sensor, from a stream's
    stamps (the extra delay of single frames), else from its arrival.  `delay_s`, the delay of exposure, encoding and
    transport common to all frames, is subtracted.  `size` is the width and height of its frames; one of their pixels is
    `scale` pixels of the source.
    """

    def __init__(
        self,
        source: str,
        report: Notify,
        delay_s: float = 0.0,
        clock: Callable[[], float] = time.monotonic,
        shrink: Shrink = whole,
    ) -> None:
        self._name = parse_camera(source)
        self._report = report
        self._delay_s = delay_s
        self._clock = clock
        self._capture: Capture | None = open_capture(self._name, clock)
        self.scale = shrink(self._capture.size)
        self.size = self._capture.size[0] // self.scale, self._capture.size[1] // self.scale
        self._fresh = threading.Condition()
        self._newest: Frame | None = None
        self._index, self._taken_t_s, self._troubled = -1, NEVER, False
        self._closing = threading.Event()
        self._reader = threading.Thread(target=self._read, name="camera", daemon=True)
        self._reader.start()

    def frames(self) -> Iterator[Frame | None]:
        """Yield the newest frame as soon as it is there, or None when a round passes without one; never ends."""
        while not self._closing.is_set():
            with self._fresh:
                self._fresh.wait_for(lambda: self._newest is not None, timeout=ROUND_S)
                frame, self._newest = self._newest, None
            yield frame

    def _read(self) -> None:
        """The reading thread: read until the source breaks, report that once, open it again."""
        while not self._closing.is_set():
            try:
                self._capture = self._capture or open_capture(self._name, self._clock)
                self._capture.shrink = self.scale
                for image, taken_t_s in self._capture.images():
                    self._take(image, taken_t_s)
                    if self._closing.is_set():
                        break
            except Exception as error:  # noqa: BLE001  # whatever a driver or a decoder raises, this thread goes on
                why = str(error) if isinstance(error, CameraError) else f"{type(error).__name__}: {error}"
                self._tell(
                    f"camera {self._name.text!r} gives no frame ({why}): trying again every {REOPEN_AFTER_S:g} s"
                )
                self._give_back()
                self._closing.wait(REOPEN_AFTER_S)
        self._give_back()

    def _take(self, image: NDArray[np.uint8], taken_t_s: float | None) -> None:
        """Keep an image as the newest frame, if it has the right size and its time is known and later than the last."""
        size = image.shape[1], image.shape[0]
        if size != self.size:  # the lens is known for frames of that size
            named, wanted = (f"{w * self.scale}x{h * self.scale}" for w, h in (size, self.size))
            self._tell(f"camera {self._name.text!r} gives {named}, not {wanted}: not used")
            return
        if self._troubled:
            self._report(f"camera {self._name.text!r} gives frames again")
        self._troubled = False
        self._index += 1
        if taken_t_s is not None and taken_t_s > self._taken_t_s:
            self._taken_t_s = taken_t_s
            with self._fresh:
                self._newest = Frame(image, taken_t_s - self._delay_s, self._index, self.scale)
                self._fresh.notify()

    def _tell(self, line: str) -> None:
        """Report trouble once until frames arrive again."""
        if not self._troubled and not self._closing.is_set():
            self._report(line)
        self._troubled = True

    def _give_back(self) -> None:
        capture, self._capture = self._capture, None
        if capture is not None:
            with suppress(Exception):  # closing a broken source may also fail
                capture.close()

    def close(self) -> None:
        """Stop reading; a thread stuck in its driver is left running."""
        self._closing.set()
        capture = self._capture
        if capture is not None:
            capture.interrupt()
        self._reader.join(timeout=CLOSE_S)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def open_capture(name: CameraName, clock: Callable[[], float]) -> Capture:
    """Connect to the source of a name.  Raises CameraError."""
    if name.kind is CameraKind.PROGRAM:
        return open_program(name, clock)
    if name.kind is CameraKind.PICAMERA2:
        return PicameraCapture(name, clock)
    return open_stream(name, clock)
