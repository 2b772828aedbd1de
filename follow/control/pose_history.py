"""Where the vehicle was when a frame was taken: a short history of its states."""

import math
from bisect import bisect_right
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from operator import attrgetter

import numpy as np

from follow.control.drift import Drift
from follow.geometry import Array, wrap
from follow.messages import NEVER, VehicleState

EXTRAPOLATE_S = 0.3
"""Longest extrapolation of a pose beyond its newest message, seconds; the gate handles older telemetry."""

MEMORY = 256
"""States kept: 2.5 s at 100 rounds a second, several times the longest camera latency flown (0.4 s)."""

RATE_S = 0.03
"""A pitch rate is the mean over this time before and after, which averages the noise of single attitude messages."""

JUMP_WITHIN_S = 1.0
"""After a longer gap between two positions the vehicle's own manoeuvres hide a jump."""

COUNTED_M = 0.3
"""A step this large is a jump when the autopilot counts one."""

ACCEL_M_S2 = 6.0
"""Upper limit of the vehicle's own acceleration in a turn or a stop (30 degrees of tilt)."""


@dataclass(frozen=True, slots=True)
class Pose:
    """Attitude (radians), position and velocity (NED) at one time; the velocity is that at which the position moves."""

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

    @property
    def position_ned(self) -> Array:
        """Position (3,), local NED, metres."""
        return np.array([self.north_m, self.east_m, self.down_m])


def blend(before: float, after: float, fraction: float) -> float:
    """Linear interpolation."""
    return before + (after - before) * fraction


@dataclass(slots=True)
class PoseHistory:
    """The vehicle's recent attitudes and positions, each under the time it was measured."""

    attitudes: deque[VehicleState] = field(default_factory=lambda: deque[VehicleState](maxlen=MEMORY))
    positions: deque[VehicleState] = field(default_factory=lambda: deque[VehicleState](maxlen=MEMORY))
    drift: Drift = field(default_factory=Drift)

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
            if state.position_t_s > NEVER:
                self.drift.update(state)

    def jump(self, state: VehicleState, least_m: float) -> Array | None:
        """Return (3,) the new position minus the one extrapolated by velocity; None below `least_m`.

        The vehicle's own acceleration may explain ACCEL_M_S2 dt²/2 of it.  When the autopilot counts a reset of its
        estimator, COUNTED_M is enough.  None also before the first position.
        """
        if not self.positions or NEVER in (last := self.positions[-1].position_t_s, state.position_t_s):
            return None
        dt, q = state.position_t_s - last, self.positions[-1]
        if not 0 < dt < JUMP_WITHIN_S:
            return None
        north = state.north_m - q.north_m - dt * (q.north_m_s + state.north_m_s) / 2
        east = state.east_m - q.east_m - dt * (q.east_m_s + state.east_m_s) / 2
        down = state.down_m - q.down_m - dt * (q.down_m_s + state.down_m_s) / 2
        least = (COUNTED_M if state.resets != q.resets else least_m) + ACCEL_M_S2 * dt**2 / 2
        return np.array([north, east, down]) if math.hypot(north, east, down) > least else None

    def shift(self, offset_ned: Array) -> None:
        """Move all past positions by (3,) metres: the vehicle's estimator was reset."""
        north, east, down = offset_ned
        moved = [
            replace(p, north_m=p.north_m + north, east_m=p.east_m + east, down_m=p.down_m + down)
            for p in self.positions
        ]
        self.positions.clear()
        self.positions.extend(moved)
        self.drift.shift(offset_ned)

    def attitude_gap_s(self, t_s: float) -> float:
        """Seconds between the attitude messages around `t_s`; inf before the first and after the last."""
        return gap_s(self.attitudes, attitude_time, t_s)

    def position_gap_s(self, t_s: float) -> float:
        """The same of the position messages."""
        return gap_s(self.positions, position_time, t_s)

    def pitch_rate(self, t_s: float) -> float:
        """Return the pitch rate about `t_s`, rad/s; 0 unless two attitudes are known around it."""
        ends = [bracket(self.attitudes, attitude_time, t_s + side * RATE_S) for side in (-1, 1)]
        (from_s, before), (to_s, after) = (
            (blend(a.attitude_t_s, b.attitude_t_s, part), blend(a.pitch_rad, b.pitch_rad, part)) for a, b, part in ends
        )
        return (after - before) / (to_s - from_s) if 0.0 < to_s - from_s < JUMP_WITHIN_S else 0.0

    def at(self, t_s: float) -> Pose:
        """Return the pose at `t_s`, interpolated; beyond the newest message extrapolated for at most EXTRAPOLATE_S.

        A time before the oldest message gives the oldest.  Raises IndexError before the first `add`.
        """
        a, b, turned = bracket(self.attitudes, attitude_time, t_s)
        p, q, moved = bracket(self.positions, position_time, t_s)
        yaw = a.yaw_rad + wrap(b.yaw_rad - a.yaw_rad) * turned
        yaw += b.yaw_rate_rad_s * beyond(t_s, b.attitude_t_s, turned)
        ahead = beyond(t_s, q.position_t_s, moved)
        north, east, down = (float(v) for v in self.drift.velocity)
        north_m_s = blend(p.north_m_s, q.north_m_s, moved) + north
        east_m_s = blend(p.east_m_s, q.east_m_s, moved) + east
        down_m_s = blend(p.down_m_s, q.down_m_s, moved) + down
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


def gap_s(states: deque[VehicleState], time: Callable[[VehicleState], float], t_s: float) -> float:
    """Seconds between the states around `t_s`, 0 exactly at one; inf before the first and after the last."""
    a, b, _ = bracket(states, time, t_s)
    if a is b:
        return 0.0 if t_s == time(a) else math.inf
    return time(b) - time(a)


def beyond(t_s: float, newest_t_s: float, fraction: float) -> float:
    """Seconds to extrapolate past the newest message; 0 between two messages."""
    return min(max(t_s - newest_t_s, 0.0), EXTRAPOLATE_S) if fraction == 1.0 else 0.0
