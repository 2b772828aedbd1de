"""A velocity filtered without lag behind steady acceleration: a critically damped g-h filter with a bound.

The g-h filter predicts by the trend and corrects velocity and trend by the prediction's error; critically damped as in
Brookner, *Tracking and Kalman Filtering Made Easy* (1998), chapter 1.
"""

import math
from dataclasses import dataclass

FARTHEST_M_S = 0.2
"""The filtered velocity never differs from the measured one by more than this: a larger change is the target's own,
which sets off, stops or turns, and is followed at once."""


NO_TIME_S = 1e-6
"""Within so short a time nothing moves, and a trend would be a quotient of roundings."""


@dataclass(slots=True)
class Trend:
    """The filtered velocity north and east, m/s, and its rate of change, m/s²."""

    north_m_s: float
    east_m_s: float
    north_m_s2: float = 0.0
    east_m_s2: float = 0.0

    def follow(self, north_m_s: float, east_m_s: float, dt: float, time_s: float) -> None:
        """Take in a velocity that is finite, `dt` seconds after the last; `time_s` is the filter's time constant.

        After an interval as long as that it is taken over as it is; an interval of zero or NaN changes nothing.  The
        trend's gain doubles up to FARTHEST_M_S; a larger error counts as that, so that a jump is hardly taken for an
        acceleration.
        """
        if not dt > NO_TIME_S:  # also NaN
            return
        if dt >= time_s:
            self.north_m_s, self.east_m_s, self.north_m_s2, self.east_m_s2 = north_m_s, east_m_s, 0.0, 0.0
            return
        n, e = self.north_m_s + dt * self.north_m_s2, self.east_m_s + dt * self.east_m_s2
        north, east = north_m_s - n, east_m_s - e
        off = math.hypot(north, east) / FARTHEST_M_S
        part = max(-math.expm1(-2.0 * dt / time_s), 1.0 - 1.0 / max(off, 1.0))
        self.north_m_s, self.east_m_s = n + part * north, e + part * east
        counted = min(off, 1.0)
        gain = math.expm1(-dt / time_s) ** 2 / dt * (1.0 + counted * counted) / max(off, 1.0)
        self.north_m_s2 += gain * north
        self.east_m_s2 += gain * east
