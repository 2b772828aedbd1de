"""A recorded flight as camera, link, tracker, meter and operator, so that the loop can run on it again.

Each round of the loop gets the recorded round's frame, state, track, motion and instruction.  The vehicle is not
simulated: it follows its recorded path, whatever setpoint the loop sends.
"""

from collections.abc import Callable, Iterator, Sequence
from types import TracebackType

import numpy as np
from numpy.typing import NDArray
from typing_extensions import Self

from follow.messages import Frame, ImageMotion, Instruction, Order, Setpoint, VehicleState
from follow.recording.exact import Round
from racf.box import Box
from racf.track import Track

NO_IMAGE = np.zeros((0, 0, 3), np.uint8)


class RecordedFlight:
    """The rounds of a recording, as both a Camera and a Link.

    `frames` ends before the round with the order to leave: later rounds have no camera
    (`follow.flight.live_flight.ramping_down`).  `forget` is called when the operator chose a new target.
    """

    def __init__(
        self,
        rounds: Sequence[Round],
        image: Callable[[Round], NDArray[np.uint8]] = lambda _round: NO_IMAGE,
        forget: Callable[[], object] = lambda: None,
    ) -> None:
        leaving = (n for n, r in enumerate(rounds) if r.instruction.order is Order.LEAVE)
        self.flown = next(leaving, len(rounds))
        self.rounds = rounds
        self.forget = forget
        self._image = image
        self._next = 0

    @property
    def now(self) -> Round:
        """The present round: the one whose state was given last."""
        return self.rounds[self._next - 1]

    @property
    def left(self) -> int:
        """Number of rounds that are still to be flown."""
        return len(self.rounds) - self._next

    def frames(self) -> Iterator[Frame | None]:
        """Yield each recorded frame's time and number, or None for a round without one."""
        while self._next < self.flown:
            coming = self.rounds[self._next]
            yield None if coming.frame is None else Frame(self._image(coming), *coming.frame, coming.scale)

    def state(self) -> VehicleState:
        """Begin the next round; returns the recorded state."""
        self._next += 1
        return self.now.state

    def send(self, setpoint: Setpoint | None) -> None:
        """Check the setpoint and drop it.  Raises ValueError for one that is not finite."""
        if setpoint is not None:
            setpoint.require_finite()

    def instruct(self) -> Instruction:
        """The recorded instruction of this round."""
        if self.now.instruction.aimed:
            self.forget()
        return self.now.instruction

    def truth(self) -> Box | None:
        """The target's annotated box in this round's image, if it was known."""
        return self.now.truth

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        return


class RecordedTracker:
    """Gives each round's recorded track; ignores the image and the prior."""

    def __init__(self, flight: RecordedFlight) -> None:
        self._flight = flight

    def update(self, image: NDArray[np.uint8], prior: Box | None = None) -> Track:
        """The track of the present round."""
        track = self._flight.now.track
        assert track is not None, "a round with a frame has a track"
        return track


class RecordedMeter:
    """Gives each round's recorded motion of the image."""

    def __init__(self, flight: RecordedFlight) -> None:
        self._flight = flight

    def update(self, frame: Frame | None, track: Track | None, state: VehicleState) -> ImageMotion | None:
        """The motion of the present round."""
        return self._flight.now.motion
