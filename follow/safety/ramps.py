"""Ramps whose speed, acceleration and jerk stay within bounds for any sequence of desired velocities.

The bound on jerk makes braking take time, so a step is taken only if the speed bound can still be kept afterwards:
braking at full jerk from velocity v and acceleration a ends at v + a |a| / (2 J), and that end must lie within the
bound.  Velocities within a bound form a ball, which is convex, so all velocities between v and that end lie within it.
"""

import math
from dataclasses import dataclass

from typing_extensions import Self

BISECTIONS = 12
"""Bisection steps for the largest safe acceleration: the result is exact to 1/4096 of the step."""


def norm(vector: tuple[float, ...]) -> float:
    """Euclidean length."""
    return math.hypot(*vector)


def shortened(vector: tuple[float, ...], longest: float) -> tuple[float, ...]:
    """The vector, no longer than `longest`."""
    length = norm(vector)
    return vector if length <= longest else tuple(v * (longest / length) for v in vector)


def mixed(a: tuple[float, ...], b: tuple[float, ...], fraction: float) -> tuple[float, ...]:
    """a + fraction (b - a)."""
    return tuple(p + fraction * (q - p) for p, q in zip(a, b, strict=True))


@dataclass(frozen=True, slots=True)
class VelocityRamp:
    """A commanded velocity (m/s) and its acceleration (m/s²), of one or two components."""

    v: tuple[float, ...] = (0.0, 0.0)
    a: tuple[float, ...] | None = None

    def towards(self, desired: tuple[float, ...], dt_s: float, speed: float, accel: float, jerk: float) -> Self:
        """One step of `dt_s` towards the desired velocity: |v| <= speed, |dv| <= accel dt, |da| <= jerk dt."""
        a = self.a or (0.0,) * len(self.v)
        if dt_s <= 0:
            return type(self)(self.v, a)
        error = tuple(d - v for d, v in zip(shortened(desired, speed), self.v, strict=True))
        away = norm(error)
        # With this acceleration, full jerk brings it back to zero just as the desired velocity is reached.
        strongest = min(accel, math.sqrt(2 * jerk * away), away / dt_s)
        wanted = tuple(e / away * strongest for e in error) if away > 0 else (0.0,) * len(error)
        change = shortened(tuple(w - p for w, p in zip(wanted, a, strict=True)), jerk * dt_s)
        best = shortened(tuple(p + q for p, q in zip(a, change, strict=True)), accel)
        brake = shortened(a, max(norm(a) - jerk * dt_s, 0.0))
        chosen = safest(self.v, brake, best, dt_s, speed, jerk)
        # The last shortening only removes rounding errors.
        return type(self)(shortened(tuple(v + p * dt_s for v, p in zip(self.v, chosen, strict=True)), speed), chosen)


def safest(
    v: tuple[float, ...], brake: tuple[float, ...], best: tuple[float, ...], dt_s: float, speed: float, jerk: float
) -> tuple[float, ...]:
    """The acceleration nearest to `best`, on the line from `brake`, after which the speed bound can still be kept."""

    def keeps(a: tuple[float, ...]) -> bool:
        reach = dt_s + norm(a) / (2 * jerk)
        return norm(tuple(p + q * reach for p, q in zip(v, a, strict=True))) <= speed

    if keeps(best):
        return best
    low, high = 0.0, 1.0
    for _ in range(BISECTIONS):
        middle = (low + high) / 2
        low, high = (middle, high) if keeps(mixed(brake, best, middle)) else (low, middle)
    return mixed(brake, best, low)


@dataclass(frozen=True, slots=True)
class YawRateRamp:
    """A commanded yaw rate, rad/s."""

    rate: float = 0.0

    def towards(self, desired: float, dt_s: float, fastest: float, accel: float) -> Self:
        """One step of `dt_s` towards the desired rate: |rate| <= fastest, |change| <= accel dt."""
        step = accel * max(dt_s, 0.0)
        wanted = min(max(desired, -fastest), fastest)
        return type(self)(self.rate + min(max(wanted - self.rate, -step), step))
