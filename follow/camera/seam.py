"""The Camera seam: a source of frames."""

from collections.abc import Iterator
from types import TracebackType
from typing import Protocol

from typing_extensions import Self

from follow.messages import Frame


class Camera(Protocol):
    """A source of frames.  Leaving the `with` block releases the device."""

    def frames(self) -> Iterator[Frame | None]:
        """Yield each new frame in order, or None for a round in which none arrived in time.

        Ends when the source ends.  Raises CameraError when the source breaks.
        """
        ...

    def __enter__(self) -> Self: ...

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None: ...


class CameraError(RuntimeError):
    """A source of frames cannot be opened, or it broke; the message is one sentence for a person."""
