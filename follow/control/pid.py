"""One PID controller, as in Åström & Hägglund, "Advanced PID Control" (2006), ch. 3: no clock of its own."""

import math
from dataclasses import dataclass

OBEYED = 0.1
"""An output counts as carried out within this share of its limit: an autopilot's lag and gusts are smaller."""


@dataclass(frozen=True, slots=True)
class Gains:
    """u = kp e + ki ∫e - kd d(measurement)/dt, held within ±limit.

    The derivative acts on the measurement (no kick when the wanted value jumps) through a first-order filter of time
    constant `filter_s`.  Raises ValueError when a limit or a time constant is not positive, or a gain
    not finite.
    """

    kp: float
    ki: float = 0.0
    kd: float = 0.0
    limit: float = math.inf
    filter_s: float = 0.1  # about three pictures at 30 frames/s

    def __post_init__(self) -> None:
        if not (self.limit > 0 and 0 < self.filter_s < math.inf):
            raise ValueError(f"a PID's limit and filter time are positive, not {self.limit:g} and {self.filter_s:g}")
        if not all(map(math.isfinite, (self.kp, self.ki, self.kd))):
            raise ValueError(f"a PID's gains are finite, not {self.kp:g}, {self.ki:g}, {self.kd:g}")


@dataclass(slots=True)
class Pid:
    """The controller: gains, the integral's share of the output, and what the derivative needs."""

    gains: Gains
    integral: float = 0.0
    output: float = 0.0
    measured: float | None = None
    rate: float = 0.0

    def update(self, error: float, measurement: float, dt_s: float, flown: float | None = None) -> float:
        """The output for this error (wanted minus measured), `dt_s` after the last one.

        A step without time (dt <= 0) neither integrates nor differentiates.  Anti-windup (conditional integration):
        the integral stays when the output is at its limit and the error would push it further out, and while `flown`,
        what really comes of the output, is not about the last output: what is not carried out is not to be made up for.
        """
        g = self.gains
        if dt_s > 0:
            if self.measured is not None:
                self.rate += (measurement - self.measured - self.rate * dt_s) / (g.filter_s + dt_s)
            self.measured = measurement
        free = g.kp * error + self.integral - g.kd * self.rate
        obeyed = flown is None or abs(flown - self.output) <= OBEYED * g.limit
        if dt_s > 0 and obeyed and (abs(free) < g.limit or free * error * g.ki < 0):
            step = g.ki * error * dt_s
            self.integral += step
            free += step
        self.output = min(max(free, -g.limit), g.limit)
        return self.output

    def reset(self) -> None:
        """Forget the past."""
        self.integral, self.output, self.measured, self.rate = 0.0, 0.0, None, 0.0
