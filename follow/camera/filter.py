"""A camera in front of another camera."""

from types import TracebackType
from typing import Generic, TypeVar

from typing_extensions import Self

from follow.camera.seam import Camera

C = TypeVar("C", bound=Camera)


class CameraFilter(Generic[C]):
    """A camera that changes another camera's frames; entering and leaving it enters and leaves that camera."""

    def __init__(self, camera: C) -> None:
        self._camera = camera

    def __enter__(self) -> Self:
        self._camera.__enter__()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._camera.__exit__(kind, error, trace)
