"""An estimate for recorded footage, whose camera does not move with the simulated vehicle."""

import math
from dataclasses import replace

from follow.control.target import Target
from follow.messages import Estimate, ImageMotion, VehicleState
from follow.selection import Detections
from racf.box import Box
from racf.track import Track

ANY_SIZE = 2.0
"""Relative deviation of an unknown size: one standard deviation is a factor of seven."""


class FootageTarget:
    """A Target for footage.  The motion of the camera that filmed it is unknown, so the tracker gets no prior.

    With `moves_view` the view is a window over the footage that turns with the vehicle.  Without it each image is read
    from the vehicle's first pose, because the simulated flight does not change what the footage shows.  The vehicle's
    height is invented, so the size's prior must admit a target of any size.
    """

    def __init__(self, target: Target, *, moves_view: bool) -> None:
        target.config = replace(target.config, size_relative_std=ANY_SIZE)
        self._target = target
        self._moves_view = moves_view
        self._begin: VehicleState | None = None

    def predict(self, state: VehicleState, t_s: float, found: Detections | None = None) -> Box | None:
        """Return None: the tracker searches around its last position."""
        return None

    def update(
        self, track: Track | None, state: VehicleState, t_s: float, motion: ImageMotion | None = None
    ) -> Estimate:
        """Return the estimate, seen from the vehicle's pose (`moves_view`) or from its first pose.

        `motion` is ignored: the vehicle's height is not that of the camera that filmed the footage.
        """
        self._begin = self._begin or state
        if not self._moves_view:
            times = {"t_s": state.t_s, "attitude_t_s": state.attitude_t_s, "position_t_s": state.position_t_s}
            state = replace(self._begin, **times)
        estimate = self._target.update(track, state, t_s)
        return replace(estimate, contradiction="", range_near_m=math.inf)
