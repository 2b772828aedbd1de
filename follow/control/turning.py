"""How fast the target's course turns, and the prediction if it keeps turning for a moment while unseen."""

import cmath
import math
from collections import deque
from dataclasses import dataclass, field, replace

import numpy as np

from follow.control.joint_filter import ME, MN, VE, VN, D, E, JointFilter, N

TURN_S = 1.0
"""The turn rate is measured over the last second seen and decays with this time constant: targets turn a corner, they
do not circle."""

USUAL_S = 5.0
"""Time constant of the usual speed: longer than a turn, shorter than a change of gait."""

STEPS = 16
"""Number of steps in which a bend is integrated."""


@dataclass(frozen=True, slots=True)
class Bend:
    """How the target is expected to go on after a loss.

    `rate_rad_s` is the rate of its course, positive to the right.  `speed_m_s` is the speed that it returns to, because
    targets slow down only for the turn.  `certainty` is 0 for a target that goes straight, at most 1.
    """

    rate_rad_s: float = 0.0
    speed_m_s: float = 0.0
    certainty: float = 0.0


STRAIGHT = Bend()


@dataclass(slots=True)
class Turning:
    """The target's velocities of the last `TURN_S` in which it was seen, with a variance, and its usual speed."""

    seen: deque[tuple[float, complex, float]] = field(default_factory=deque[tuple[float, complex, float]])
    usual_m_s: float = 0.0
    turned_rad: float = 0.0  # how far the course has turned from that of the last `USUAL_S`

    def add(self, f: JointFilter) -> None:
        """Take in the filter after a box."""
        variance = float(np.linalg.eigvalsh(f.covariance[VN : VE + 1, VN : VE + 1])[-1])
        velocity = complex(f.mean[VN], f.mean[VE])
        if self.seen:
            spent_s = f.t_s - self.seen[-1][0]
            self.usual_m_s += (abs(velocity) - self.usual_m_s) * spent_s / (USUAL_S + spent_s)
            change = cmath.phase(velocity / self.seen[-1][1]) if self.seen[-1][1] else 0.0
            self.turned_rad = (self.turned_rad + change) * USUAL_S / (USUAL_S + spent_s)
        else:
            self.usual_m_s = abs(velocity)
        self.seen.append((f.t_s, velocity, variance))
        while f.t_s - self.seen[0][0] > TURN_S:
            self.seen.popleft()

    def bend(self) -> Bend:
        """The turn over the last second, as far as it exceeds its own uncertainty.

        An estimate r of variance s^2 is shrunk to r (1 - s^2/r^2), as James and Stein do.
        """
        if len(self.seen) < 2:
            return STRAIGHT
        (from_s, before, before_var), (to_s, after, after_var) = self.seen[0], self.seen[-1]
        spent_s = to_s - from_s
        if spent_s < TURN_S / 2 or min(abs(before), abs(after)) < 1e-3:
            return STRAIGHT
        rate = cmath.phase(after / before) / spent_s
        variance = (before_var / abs(before) ** 2 + after_var / abs(after) ** 2) / spent_s**2
        certainty = max(1.0 - variance / rate**2, 0.0) if rate else 0.0
        forward = max(self.turned_rad if rate > 0 else -self.turned_rad, 0.0)
        most = max(math.pi - forward, 0.0) / TURN_S  # a target that has turned back by 180 degrees goes straight
        return Bend(min(max(rate * certainty, -most), most), max(self.usual_m_s, abs(after)), certainty)


def turned_on(f: JointFilter, unseen_s: float, bend: Bend) -> JointFilter:
    """A filter that was predicted `unseen_s` straight ahead, corrected as if the target kept turning.

    The rate decays as exp(-t/T), so the course turns by r T (1 - exp(-t/T)), and the speed returns to the usual one in
    the same way.  The target may also go straight, so the difference counts as one standard deviation.
    """
    v = complex(f.mean[VN], f.mean[VE])
    if bend.certainty == 0.0 or unseen_s <= 0.0 or abs(v) < 1e-3:
        return f
    faster = bend.certainty * (bend.speed_m_s / abs(v) - 1.0)
    times = np.append((np.arange(STEPS) + 0.5) / STEPS, 1.0) * unseen_s
    passed = -np.expm1(-times / TURN_S)
    velocities = v * (1.0 + faster * passed) * np.exp(1j * bend.rate_rad_s * TURN_S * passed)
    gone, change = complex(np.mean(velocities[:-1]) - v) * unseen_s, np.zeros(len(f.mean))
    faster_by = complex(velocities[-1]) - v
    change[[N, E, VN, VE]] = gone.real, gone.imag, faster_by.real, faster_by.imag
    change[D] = f.mean[MN] * gone.real + f.mean[ME] * gone.imag
    return replace(f, mean=f.mean + change, covariance=f.covariance + np.outer(change, change))
