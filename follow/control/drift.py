"""How the vehicle's reported position moves away from its reported velocity.

An estimator with noisy sensors reports a velocity near the commanded one, while its position moves faster: with PX4 by
0.15 to 0.4 m/s, for some seconds in one direction (docs/vehicle.md).  The target's position and velocity
are in the frame of the reported positions, so the vehicle's velocity must be in it as well, whichever of the two is
right over the ground.  On each axis the state is (position p, drift b):

    p' = v_reported + b,    b' = -b / DRIFT_S + white noise,    z = p + white noise

a Kalman filter with b a first-order Gauss-Markov process (Bar-Shalom et al., 2001, §8.2).  The axes share one
covariance.
"""

import math
from dataclasses import dataclass, field

import numpy as np

from follow.geometry import Array
from follow.messages import VehicleState

DRIFT_STD_M_S = 0.3
DRIFT_S = 5.0
"""Standard deviation and correlation time of the drift: PX4's in three flights was 0.11 to 0.39 m/s, 3 to 10 s."""

POSITION_STD_M = 0.05
"""White error of a reported position against the integral of the velocity."""

GAP_S = 1.0
"""After a longer gap between two positions the vehicle's own manoeuvres hide the drift."""


@dataclass(slots=True)
class Drift:
    """`velocity` (3,), NED, m/s, is the rate of the reported position minus the reported velocity."""

    velocity: Array = field(default_factory=lambda: np.zeros(3))
    _t_s: float = -math.inf
    _place: Array = field(default_factory=lambda: np.zeros(3))
    _reported: Array = field(default_factory=lambda: np.zeros(3))
    _p: tuple[float, float, float] = (0.0, 0.0, 0.0)  # variance of p, covariance, variance of b

    def update(self, state: VehicleState) -> None:
        """Take in a state with a newer position; one that is not finite is ignored."""
        t_s = state.position_t_s
        place = np.array([state.north_m, state.east_m, state.down_m])
        reported = np.array([state.north_m_s, state.east_m_s, state.down_m_s])
        if not np.isfinite([*place, *reported]).all():
            return
        dt = t_s - self._t_s
        mean_velocity, self._t_s, self._reported = (self._reported + reported) / 2, t_s, reported
        if not 0 < dt <= GAP_S:
            self._place, self._p = place, (POSITION_STD_M**2, 0.0, DRIFT_STD_M_S**2)
            return
        keep = math.exp(-dt / DRIFT_S)
        reach = DRIFT_S * (1 - keep)  # integral over dt of a drift of 1 m/s
        pp, pb, bb = self._p
        pp, pb, bb = pp + 2 * reach * pb + reach**2 * bb, keep * (pb + reach * bb), keep**2 * bb
        bb += (1 - keep**2) * DRIFT_STD_M_S**2
        off = place - (self._place + dt * mean_velocity + reach * self.velocity)
        gain_p, gain_b = pp / (pp + POSITION_STD_M**2), pb / (pp + POSITION_STD_M**2)
        self._place = place - (1 - gain_p) * off
        self.velocity = keep * self.velocity + gain_b * off
        self._p = (1 - gain_p) * pp, (1 - gain_p) * pb, bb - gain_b * pb

    def shift(self, offset_ned: Array) -> None:
        """The vehicle's estimator was reset by (3,) metres."""
        self._place = self._place + offset_ned
