"""The last seconds of a camera: the frames on which a person may have drawn a selection."""

from collections import deque
from collections.abc import Iterator

from follow.camera.filter import CameraFilter
from follow.camera.seam import Camera
from follow.messages import Frame

RECENT_S = 2.0  # longest delay of a person's box: reaction, drawing, video and radio
RECENT_BYTES = 256_000_000  # two seconds of 1280x720 at 30 Hz are 166 MB


class RecentFrames(CameraFilter[Camera]):
    """A camera that keeps its last frames: at most RECENT_S and RECENT_BYTES of them, the newest always."""

    def __init__(self, camera: Camera, seconds: float = RECENT_S, most_bytes: int = RECENT_BYTES) -> None:
        super().__init__(camera)
        self._seconds, self._most_bytes = seconds, most_bytes
        self._kept: deque[Frame] = deque()
        self._bytes = 0

    @property
    def kept(self) -> tuple[Frame, ...]:
        """The frames that are kept, oldest first."""
        return tuple(self._kept)

    def frames(self) -> Iterator[Frame | None]:
        """Yield what the camera yields; a frame is kept before it is yielded."""
        for frame in self._camera.frames():
            if frame is not None:
                self._keep(frame)
            yield frame

    def _keep(self, frame: Frame) -> None:
        self._kept.append(frame)
        self._bytes += frame.image.nbytes
        while len(self._kept) > 1 and (frame.t_s - self._kept[0].t_s > self._seconds or self._bytes > self._most_bytes):
            self._bytes -= self._kept.popleft().image.nbytes
