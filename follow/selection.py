"""What passes between the consoles and the loop: which target a person chose, and what the consoles show of it.

Boxes are in shares of the image, 0 to 1 from its top-left corner, because a console shows it at another size.
"""

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum


@dataclass(frozen=True, slots=True)
class Selection:
    """A person's choice of a target.  A click has no size: `width` and `height` are 0.

    `frame_t_s` is when the frame that the person saw was taken, on the loop's clock; `by` names the console.
    """

    left: float
    top: float
    width: float
    height: float
    frame_t_s: float
    by: str

    @property
    def is_point(self) -> bool:
        """Whether it is a click without a box."""
        return self.width == 0.0 and self.height == 0.0


@dataclass(frozen=True, slots=True)
class Stopped:
    """A person ended the tracking; `by` names the console."""

    by: str


Choice = Selection | Stopped
"""What a person does in the image."""

Choose = Callable[[Choice], str]
"""Takes a choice; returns why it is refused, empty if it is not."""


class TrackingState(str, Enum):
    """What the consoles show of the tracker."""

    IDLE = "idle"
    ACTIVE = "active"
    COASTING = "coasting"


@dataclass(frozen=True, slots=True)
class TrackingStatus:
    """The tracker's state and its box (left, top, width, height), None without one.

    `frame_t_s` is when the newest frame was taken.
    """

    state: TrackingState
    box: tuple[float, float, float, float] | None
    frame_t_s: float
