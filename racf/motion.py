"""The target's smoothed motion, for predicting its position."""

from racf.box import Box


class Velocity:
    """The target's motion per frame: a running mean."""

    def __init__(self, rate: float, decay: float) -> None:
        self.rate, self.decay = rate, decay
        self.dx = self.dy = 0.0

    def seen(self, before: Box, after: Box) -> None:
        """Take the move from one box to the next into the mean."""
        self.dx += self.rate * (after.centre_x - before.centre_x - self.dx)
        self.dy += self.rate * (after.centre_y - before.centre_y - self.dy)

    def unseen(self) -> None:
        """Decay the motion in a frame without the target."""
        self.dx, self.dy = self.dx * self.decay, self.dy * self.decay

    def forget(self) -> None:
        """Reset the motion to zero."""
        self.dx = self.dy = 0.0
