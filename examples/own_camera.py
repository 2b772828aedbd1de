"""Your own camera in the loop: a class that yields frames, here a red square that wanders over grass.

    python examples/own_camera.py

The same three methods are all that a driver of a real camera needs.  The times must be on the link's clock, and in
flight they are the times at which the frames were taken, not those at which they arrived.
"""

import math
from collections.abc import Iterator

import numpy as np
from typing_extensions import Self

from follow.control.acquire import Acquire
from follow.control.footage import FootageTarget
from follow.control.servo import Servo
from follow.control.target import Target
from follow.flight.session import once
from follow.geometry import Intrinsics
from follow.link.replay import ReplayLink
from follow.loop import follow
from follow.messages import Frame, Order
from follow.safety.gate import Safety
from racf import Racf
from racf.box import Box

FPS, WIDTH, HEIGHT, SIDE = 30.0, 640, 360, 40


class WanderingSquare:
    """A Camera: `frames` yields a Frame, or None for a round without a new one; `with` opens and closes it."""

    def __init__(self, seconds: float) -> None:
        self.rounds = int(seconds * FPS)
        self.grass = np.random.default_rng(0).integers(60, 120, (HEIGHT, WIDTH, 3), np.uint8)

    def corner(self, n: int) -> tuple[int, int]:
        """Column and row of the square's top-left corner in frame `n`."""
        return round(300 + 120 * math.sin(n / 40)), 160

    def frames(self) -> Iterator[Frame | None]:
        """Draw each frame: uint8, (rows, columns, 3), BGR."""
        for n in range(self.rounds):
            image, (x, y) = self.grass.copy(), self.corner(n)
            image[y : y + SIDE, x : x + SIDE] = (40, 40, 220)
            yield Frame(image, t_s=n / FPS, index=n)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_error: object) -> None:
        """Nothing to close here; a real camera closes its device."""


def main(seconds: float = 4.0) -> list[float]:
    """Follow the square; returns how far the tracker's box was from it in each frame, pixels."""
    camera, link, tracker, safety = WanderingSquare(seconds), ReplayLink(FPS, height_m=10.0), Racf(), Safety()
    lens, down_rad = Intrinsics.from_fov(WIDTH, HEIGHT, math.radians(70)), math.radians(30)
    start = Acquire(tracker.init, tracker.update, Box(*camera.corner(0), SIDE, SIDE))
    target = FootageTarget(Target(lens, down_rad), moves_view=False)  # flying does not move the square
    parts = start, target, Servo(down_rad), safety
    errors: list[float] = []
    with camera, link:
        for tick in follow(camera, link, *parts, once(Order.FOLLOW)):
            if tick.track is not None and tick.frame is not None:
                errors.append(abs(tick.track.box.x - camera.corner(tick.frame.index)[0]))
    print(f"{len(errors)} frames, {max(errors):.1f} px off at most")
    return errors


if __name__ == "__main__":
    main()
