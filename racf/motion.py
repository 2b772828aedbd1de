"""Where the target will be: its smoothed motion."""

from racf.box import Box


class Velocity:
    """The target's motion per frame: a running mean of what was seen."""

    def __init__(self, rate: float, decay: float) -> None:
        self.rate, self.decay = rate, decay
        self.dx = self.dy = 0.0

    def seen(self, before: Box, after: Box) -> None:
        """Take the move from one box to the next into the mean."""
        self.dx += self.rate * (after.centre_x - before.centre_x - self.dx)
        self.dy += self.rate * (after.centre_y - before.centre_y - self.dy)

    def unseen(self) -> None:
        """A frame without the target: the assumed motion fades."""
        self.dx, self.dy = self.dx * self.decay, self.dy * self.decay

    def forget(self) -> None:
        """The motion is unknown again."""
        self.dx = self.dy = 0.0
