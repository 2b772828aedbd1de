"""A Raspberry Pi's camera by picamera2, which is imported only if this camera is used."""

import importlib
import time
from collections.abc import Callable, Iterator
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from follow.camera import CameraError
from follow.camera.names import CameraName

SIZE = (1280, 720)
FPS = 30.0
BUFFERS = 3  # one being filled, one waiting, one in use: fewer drop frames, more only take memory
MOST_AGE_S = 5.0  # a sensor's stamp further back is of another clock


class PicameraCapture:
    """Frames of picamera2 with the sensor's own time stamps."""

    def __init__(self, name: CameraName, clock: Callable[[], float]) -> None:
        try:
            picamera2: Any = importlib.import_module("picamera2")
        except ImportError as error:
            raise CameraError(
                f"camera {name.text!r} needs the package picamera2 ({error}): sudo apt install python3-picamera2, and "
                "a virtual environment with --system-site-packages; or exec:rpicam-vid, see docs/cameras.md"
            ) from None
        self._clock, self.shrink = clock, 1
        self.size = name.size or SIZE
        try:
            self._camera: Any = picamera2.Picamera2(int(name.options.get("camera", "0")))
            configuration = self._camera.create_video_configuration(
                main={"size": self.size, "format": "RGB888"},  # libcamera's RGB888 is B, G, R in memory
                controls={"FrameRate": name.fps or FPS},
                buffer_count=BUFFERS,
            )
            self._camera.configure(configuration)
            self._camera.start()
        except (RuntimeError, IndexError, ValueError) as error:
            raise CameraError(f"camera {name.text!r} cannot be opened: {error}") from None
        self.size = tuple(self._camera.camera_configuration()["main"]["size"])

    def images(self) -> Iterator[tuple[NDArray[np.uint8], float | None]]:
        """Yield each frame with the middle of its exposure on our clock."""
        while True:
            try:
                request = self._camera.capture_request()
            except (RuntimeError, TimeoutError) as error:
                raise CameraError(str(error)) from None
            try:
                image = np.asarray(request.make_array("main"), np.uint8)
                size = (image.shape[1] // self.shrink, image.shape[0] // self.shrink)
                image = cv2.resize(image, size, interpolation=cv2.INTER_AREA) if self.shrink > 1 else image.copy()
                yield np.asarray(image, np.uint8), self._taken_at(request.get_metadata())
            finally:
                request.release()

    def _taken_at(self, metadata: dict[str, Any]) -> float:
        """SensorTimestamp is when the first row was read out, in ns of CLOCK_BOOTTIME."""
        now_t_s = self._clock()
        if "SensorTimestamp" not in metadata:
            return now_t_s
        age_s = time.clock_gettime(time.CLOCK_BOOTTIME) - metadata["SensorTimestamp"] / 1e9
        age_s += metadata.get("ExposureTime", 0) / 2e6  # microseconds; exposure ends as the row is read out
        return now_t_s - age_s if 0 <= age_s < MOST_AGE_S else now_t_s

    def interrupt(self) -> None:
        """Do nothing: `images` ends with the next frame."""

    def close(self) -> None:
        """Release the camera."""
        self._camera.stop()
        self._camera.close()
