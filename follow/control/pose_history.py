"""Where the vehicle was when a frame was taken: a short history of its states."""

from bisect import bisect_right
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from operator import attrgetter

from follow.geometry import wrap
from follow.messages import NEVER, VehicleState

EXTRAPOLATE_S = 0.3
"""Longest extrapolation of a pose beyond its newest message, seconds; the gate handles older telemetry."""

MEMORY = 256
"""States kept: 2.5 s at 100 rounds a second, several times the longest camera latency flown (0.4 s)."""


@dataclass(frozen=True, slots=True)
class Pose:
    """Attitude (radians), position and velocity (NED) at one time."""

    t_s: float
    roll_rad: float
    pitch_rad: float
    yaw_rad: float
    north_m: float
    east_m: float
    down_m: float
    north_m_s: float
    east_m_s: float
    down_m_s: float


def blend(before: float, after: float, fraction: float) -> float:
    """Linear interpolation."""
    return before + (after - before) * fraction


@dataclass(slots=True)
class PoseHistory:
    """The vehicle's recent attitudes and positions, each under the time it was measured."""

    attitudes: deque[VehicleState] = field(default_factory=lambda: deque[VehicleState](maxlen=MEMORY))
    positions: deque[VehicleState] = field(default_factory=lambda: deque[VehicleState](maxlen=MEMORY))

    def add(self, state: VehicleState) -> None:
        """Add a state; a group (attitude, position) that is not newer than the last one is ignored."""
        if self.attitudes and self.attitudes[-1].attitude_t_s == NEVER:
            self.attitudes.clear()
        if not self.attitudes or state.attitude_t_s > self.attitudes[-1].attitude_t_s:
            self.attitudes.append(state)
        if self.positions and self.positions[-1].position_t_s == NEVER:
            self.positions.clear()
        if not self.positions or state.position_t_s > self.positions[-1].position_t_s:
            self.positions.append(state)

    def at(self, t_s: float) -> Pose:
        """Return the pose at `t_s`, interpolated; beyond the newest message extrapolated for at most EXTRAPOLATE_S.

        A time before the oldest message gives the oldest.  Raises IndexError before the first `add`.
        """
        a, b, turned = bracket(self.attitudes, attitude_time, t_s)
        p, q, moved = bracket(self.positions, position_time, t_s)
        yaw = a.yaw_rad + wrap(b.yaw_rad - a.yaw_rad) * turned
        yaw += b.yaw_rate_rad_s * beyond(t_s, b.attitude_t_s, turned)
        ahead = beyond(t_s, q.position_t_s, moved)
        north_m_s = blend(p.north_m_s, q.north_m_s, moved)
        east_m_s = blend(p.east_m_s, q.east_m_s, moved)
        down_m_s = blend(p.down_m_s, q.down_m_s, moved)
        return Pose(
            t_s,
            blend(a.roll_rad, b.roll_rad, turned),
            blend(a.pitch_rad, b.pitch_rad, turned),
            wrap(yaw),
            blend(p.north_m, q.north_m, moved) + north_m_s * ahead,
            blend(p.east_m, q.east_m, moved) + east_m_s * ahead,
            blend(p.down_m, q.down_m, moved) + down_m_s * ahead,
            north_m_s,
            east_m_s,
            down_m_s,
        )


attitude_time = attrgetter("attitude_t_s")
position_time = attrgetter("position_t_s")


def bracket(
    states: deque[VehicleState], time: Callable[[VehicleState], float], t_s: float
) -> tuple[VehicleState, VehicleState, float]:
    """Return the states before and after `t_s` and the fraction of the interval between them, 0..1."""
    i = bisect_right(states, t_s, key=time)
    if i == 0 or i == len(states):
        end = states[0] if i == 0 else states[-1]
        return end, end, 1.0
    before, after = states[i - 1], states[i]
    return before, after, (t_s - time(before)) / (time(after) - time(before))


def beyond(t_s: float, newest_t_s: float, fraction: float) -> float:
    """Seconds to extrapolate past the newest message; 0 between two messages."""
    return min(max(t_s - newest_t_s, 0.0), EXTRAPOLATE_S) if fraction == 1.0 else 0.0
