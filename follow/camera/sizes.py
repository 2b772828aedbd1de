"""The image size for tracking: large sources are shrunk when they are decoded; outside the loop boxes are in source
pixels.

An image is shrunk by the largest whole number that leaves `LEAST_LENGTH_PX` along its longer side and
`LEAST_TARGET_PX` across the target: 1920x1080 by 2, 3840x2160 by 4 for a target of 128 px or more, by 3 for 96 px.
"""

from collections.abc import Callable

from racf.box import Box

LEAST_LENGTH_PX = 960  # half of 1080p; a 1280x720 camera is not shrunk
LEAST_TARGET_PX = 32  # a search area of 5 times that is sampled in 150 to 200 px, so no detail is lost

Shrink = Callable[[tuple[int, int]], int]
"""Gives the whole number by which an image of (width, height) is shrunk."""


def whole(_size: tuple[int, int]) -> int:
    """Shrink nothing."""
    return 1


def shrink_for(target: Box) -> Shrink:
    """The rule for a target of that size, in source pixels."""

    def rule(size: tuple[int, int]) -> int:
        return max(min(max(size) // LEAST_LENGTH_PX, int(min(target.w, target.h) // LEAST_TARGET_PX)), 1)

    return rule
