"""The one box convention: `x, y` is the top-left corner, pixel (0, 0) covers [0, 1) x [0, 1)."""

import math
from dataclasses import dataclass

from typing_extensions import Self

LEAST_INSIDE = 0.5
"""Least fraction of a first box inside the image: with less, the tracker mostly learns the image's repeated edge."""

MOST_OF_IMAGE = 0.9
"""Largest fraction of the image that a first box may fill."""

CLEAR_PX = 10.0
"""Least side of a target for reliable tracking: one pixel of error is 10 % of it, and 10 % of the distance."""


@dataclass(frozen=True, slots=True)
class Box:
    """An axis-aligned rectangle in 0-based pixels; the centre is at `x + w/2, y + h/2`.

    Any kind of number becomes a float.  Raises ValueError if one is not a finite number, or a side is not positive.
    """

    x: float
    y: float
    w: float
    h: float

    def __post_init__(self) -> None:
        given = (self.x, self.y, self.w, self.h)
        try:
            x, y, w, h = map(float, given)  # a narrow numpy scalar would overflow in sums and products
        except (TypeError, ValueError, OverflowError):
            raise ValueError(f"a box needs four finite numbers, not {','.join(map(str, given))}") from None
        for name, value in zip("xywh", (x, y, w, h), strict=True):
            object.__setattr__(self, name, value)
        if not all(math.isfinite(v) for v in (x, y, w, h)):
            raise ValueError(f"a box needs four finite numbers, not {self}")
        if self.w <= 0 or self.h <= 0:
            raise ValueError(f"a box needs a positive width and height, not {self}")

    def __str__(self) -> str:
        return f"{self.x:g},{self.y:g},{self.w:g},{self.h:g}"

    @classmethod
    def parse(cls, text: str) -> Self:
        """Read `x,y,w,h`; raises ValueError naming the text."""
        try:
            x, y, w, h = (float(part) for part in text.split(","))
        except ValueError:
            raise ValueError(f"a box is written x,y,w,h, not {text!r}") from None
        return cls(x, y, w, h)

    @classmethod
    def around(cls, centre_x: float, centre_y: float, w: float, h: float) -> Self:
        """The box of size `w` x `h` whose centre is at the given point."""
        return cls(centre_x - w / 2, centre_y - h / 2, w, h)

    @property
    def centre_x(self) -> float:
        """Horizontal centre in pixels."""
        return self.x + self.w / 2

    @property
    def centre_y(self) -> float:
        """Vertical centre in pixels."""
        return self.y + self.h / 2

    @property
    def area(self) -> float:
        """Square pixels."""
        return self.w * self.h

    def intersection(self, other: "Box") -> float:
        """Shared area in square pixels."""
        w = min(self.x + self.w, other.x + other.w) - max(self.x, other.x)
        h = min(self.y + self.h, other.y + other.h) - max(self.y, other.y)
        return max(w, 0.0) * max(h, 0.0)

    def iou(self, other: "Box") -> float:
        """Intersection over union, in 0..1."""
        shared = self.intersection(other)
        return shared / (self.area + other.area - shared)

    def zoomed(self, factor: float) -> "Box":
        """The box in an image that is `factor` times as large."""
        return Box(self.x * factor, self.y * factor, self.w * factor, self.h * factor)

    def moved(self, dx: float, dy: float) -> "Box":
        """The same box, `dx, dy` pixels further."""
        return Box(self.x + dx, self.y + dy, self.w, self.h)

    def scaled(self, factor: float) -> "Box":
        """The box about the same centre with both sides times `factor`."""
        return Box.around(self.centre_x, self.centre_y, self.w * factor, self.h * factor)

    def as_start(self, width: int, height: int) -> str:
        """A warning about this box as a tracker's start in an image of that size, "" for a good one.

        Raises ValueError if less than half of it lies in the image, or if it leaves no background around it.
        """
        inside = self.intersection(Box(0, 0, width, height))
        if inside <= 0:
            raise ValueError(f"target {self} lies outside the {width}x{height} image")
        if inside < LEAST_INSIDE * self.area:
            raise ValueError(
                f"only {100 * inside / self.area:.0f} % of target {self} lies in the {width}x{height} image: "
                f"at least {100 * LEAST_INSIDE:.0f} % must"
            )
        if inside > MOST_OF_IMAGE * width * height:
            raise ValueError(
                f"target {self} fills the {width}x{height} image: a tracker needs some background around it"
            )
        # Half a pixel may be rounding.
        beyond = max(-self.x, -self.y, self.x + self.w - width, self.y + self.h - height)
        part = f"{100 - 100 * inside / self.area:.0f} % of target {self} lies outside the {width}x{height} image"
        return f"{part}: the tracker starts with what it sees of it" if beyond > 0.5 else ""


def tiny_line(box: Box) -> str:
    """One sentence for a person about a target with a side below CLEAR_PX; "" for one that is large enough."""
    if not min(box.w, box.h) < CLEAR_PX:  # also for a forged box of NaN
        return ""
    return (
        f"the target is only {_whole_px(box.w)}x{_whole_px(box.h)} pixels; it needs at least {CLEAR_PX:g} on each "
        "side to be held and for its distance: go closer, or use a longer lens or a higher resolution"
    )


def _whole_px(side: float) -> str:
    """A side in whole pixels; one below CLEAR_PX is not rounded up to it."""
    return f"{side if side >= CLEAR_PX else min(side, CLEAR_PX - 1.0):.0f}"
