"""Where the vehicle was when a picture was taken: a short memory of its states."""

from bisect import bisect_right
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from operator import attrgetter

from follow.geometry import wrap
from follow.messages import NEVER, VehicleState

EXTRAPOLATE_S = 0.3
"""How far beyond its newest message a pose may be carried on: above that a stale telemetry is the gate's matter."""

MEMORY = 256
"""States kept: two seconds at a round rate of 100 Hz, twice the longest camera latency flown."""


@dataclass(frozen=True, slots=True)
class Pose:
    """Attitude (radians), place and velocity (NED) at one time."""

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


def blend(before: float, after: float, share: float) -> float:
    """Linear interpolation."""
    return before + (after - before) * share


@dataclass(slots=True)
class PoseHistory:
    """The vehicle's recent attitudes and positions, each under the time it was measured."""

    attitudes: deque[VehicleState] = field(default_factory=lambda: deque[VehicleState](maxlen=MEMORY))
    positions: deque[VehicleState] = field(default_factory=lambda: deque[VehicleState](maxlen=MEMORY))

    def add(self, state: VehicleState) -> None:
        """Remember a state; a group that is not newer than the last one is ignored."""
        if self.attitudes and self.attitudes[-1].attitude_t_s == NEVER:
            self.attitudes.clear()
        if not self.attitudes or state.attitude_t_s > self.attitudes[-1].attitude_t_s:
            self.attitudes.append(state)
        if self.positions and self.positions[-1].position_t_s == NEVER:
            self.positions.clear()
        if not self.positions or state.position_t_s > self.positions[-1].position_t_s:
            self.positions.append(state)

    def at(self, t_s: float) -> Pose:
        """The pose at `t_s`: between two messages by interpolation, beyond the newest by its rates for a moment.

        Before the oldest it is the oldest.  Raises IndexError before the first `add`.
        """
        a, b, share = bracket(self.attitudes, attitude_time, t_s)
        p, q, part = bracket(self.positions, position_time, t_s)
        yaw = a.yaw_rad + wrap(b.yaw_rad - a.yaw_rad) * share
        yaw += b.yaw_rate_rad_s * beyond(t_s, b.attitude_t_s, share)
        ahead = beyond(t_s, q.position_t_s, part)
        north_m_s = blend(p.north_m_s, q.north_m_s, part)
        east_m_s = blend(p.east_m_s, q.east_m_s, part)
        down_m_s = blend(p.down_m_s, q.down_m_s, part)
        return Pose(
            t_s,
            blend(a.roll_rad, b.roll_rad, share),
            blend(a.pitch_rad, b.pitch_rad, share),
            wrap(yaw),
            blend(p.north_m, q.north_m, part) + north_m_s * ahead,
            blend(p.east_m, q.east_m, part) + east_m_s * ahead,
            blend(p.down_m, q.down_m, part) + down_m_s * ahead,
            north_m_s,
            east_m_s,
            down_m_s,
        )


attitude_time = attrgetter("attitude_t_s")
position_time = attrgetter("position_t_s")


def bracket(
    states: deque[VehicleState], time: Callable[[VehicleState], float], t_s: float
) -> tuple[VehicleState, VehicleState, float]:
    """The two states around `t_s` and how far between them it lies, 0..1."""
    i = bisect_right(states, t_s, key=time)
    if i == 0 or i == len(states):
        end = states[0] if i == 0 else states[-1]
        return end, end, 1.0
    before, after = states[i - 1], states[i]
    return before, after, (t_s - time(before)) / (time(after) - time(before))


def beyond(t_s: float, newest_t_s: float, share: float) -> float:
    """Seconds to carry on past the newest message; 0 between two messages."""
    return min(max(t_s - newest_t_s, 0.0), EXTRAPOLATE_S) if share == 1.0 else 0.0
