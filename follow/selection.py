"""Messages between consoles and loop: the target that a person chose, how to follow it, and the status to show.

Boxes are fractions of the image, 0 to 1 from its top-left corner, because a console shows it at another size.  Those of
a detector are in pixels, like the tracker's.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum

from racf.box import Box


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
        """Whether this is a click without a box."""
        return self.width == 0.0 and self.height == 0.0


@dataclass(frozen=True, slots=True)
class Cleared:
    """A person ended the tracking; `by` names the console."""

    by: str


Choice = Selection | Cleared
"""What a person does in the image."""

Choose = Callable[[Choice], str]
"""Takes a choice; returns why it is refused, or ""."""


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


@dataclass(frozen=True, slots=True)
class Detection:
    """An object in the pixels of an image, with a score of 0 to 1."""

    box: Box
    score: float


DETECTIONS_S = 1.0
"""Detections older than this are no longer shown or used: a walker has left the box by then."""


@dataclass(frozen=True, slots=True)
class Detections:
    """The detector's objects in the frame of that time and index: each once, the likeliest first."""

    t_s: float
    index: int
    objects: tuple[Detection, ...] = ()


HOVER_HERE = "hover"
"""The wanted mode in which the vehicle stays where it is and does not turn."""


@dataclass(frozen=True, slots=True)
class Wanted:
    """A person's changes to the settings of the servo, for now.

    `mode` is a servo mode's name or HOVER_HERE, empty for the configured one.  `standoff_factor` multiplies the
    stand-off, `raise_rad` raises the vehicle so that the target appears that much lower than the image's middle row,
    `around_m_s` moves it across the line of sight, to the right.
    """

    mode: str = ""
    standoff_factor: float = 1.0
    raise_rad: float = 0.0
    around_m_s: float = 0.0


AS_SET = Wanted()


@dataclass(frozen=True, slots=True)
class KeptStandoff:
    """The stand-off that the servo keeps, metres (NaN: none), and why it is larger than a person wants it."""

    standoff_m: float
    why: str = ""


NOT_KEPT = KeptStandoff(math.nan)
ANY_STANDOFF = KeptStandoff(0.0)
