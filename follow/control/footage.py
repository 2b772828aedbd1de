"""Footage answers to the vehicle little or not at all: the target's estimate must not think that it does."""

from dataclasses import replace

from follow.control.target import Target
from follow.messages import Estimate, VehicleState
from racf.box import Box
from racf.track import Track


class FootageTarget:
    """A Target for footage.  The filming camera's own motion is not known: the tracker gets no prior.

    Unless the picture `answers` (a window over it that turns with the vehicle), each one is read as from where the
    vehicle began: what it pretends to fly changes nothing there.
    """

    def __init__(self, target: Target, *, answers: bool) -> None:
        self._target = target
        self._answers = answers
        self._begin: VehicleState | None = None

    def predict(self, state: VehicleState, t_s: float) -> Box | None:
        """None: look where it last was."""
        return None

    def update(self, track: Track | None, state: VehicleState, t_s: float) -> Estimate:
        """The estimate, from where the vehicle is or from where it began."""
        self._begin = self._begin or state
        if not self._answers:
            times = {"t_s": state.t_s, "attitude_t_s": state.attitude_t_s, "position_t_s": state.position_t_s}
            state = replace(self._begin, **times)
        return self._target.update(track, state, t_s)
