"""A PID controller after Åström & Hägglund, "Advanced PID Control" (2006), ch. 3; the caller gives the time step."""

import math
from dataclasses import dataclass

OBEYED = 0.1
"""Fraction of the limit within which an output counts as flown: an autopilot's lag and gusts deviate by less."""


@dataclass(frozen=True, slots=True)
class Gains:
    """u = kp e + ki ∫e - kd d(measurement)/dt, held within ±limit.

    The derivative acts on the measurement (no kick when the desired value jumps) through a first-order filter of time
    constant `filter_s`.  Raises ValueError when a limit or a time constant is not positive, or a gain
    not finite.
    """

    kp: float  # Proportional gain, 1/s.
    ki: float = 0.0  # Integral gain, 1/s².
    kd: float = 0.0  # Derivative gain, no unit.
    limit: float = math.inf  # Largest output: rad/s of yaw, m/s of climb and approach.
    filter_s: float = 0.1  # Time constant of the derivative's filter: about three frames at 30 frames/s.

    def __post_init__(self) -> None:
        if not (self.limit > 0 and 0 < self.filter_s < math.inf):
            raise ValueError(f"a PID's limit and filter time are positive, not {self.limit:g} and {self.filter_s:g}")
        if not all(map(math.isfinite, (self.kp, self.ki, self.kd))):
            raise ValueError(f"a PID's gains are finite, not {self.kp:g}, {self.ki:g}, {self.kd:g}")


@dataclass(slots=True)
class Pid:
    """The controller: gains, integral term, and the state of the derivative's filter."""

    gains: Gains
    integral: float = 0.0
    output: float = 0.0
    measured: float | None = None
    rate: float = 0.0

    def update(self, error: float, measurement: float, dt_s: float, flown: float | None = None) -> float:
        """Return the output for this error (desired minus measured), `dt_s` after the last one.

        A step with dt <= 0 neither integrates nor differentiates.  Anti-windup by conditional integration: the integral
        is frozen while the output is at its limit and the error pushes further, and while `flown` (the measured value
        of the output) differs from the last output by more than OBEYED, because the vehicle does not carry it out.
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
        """Clear the integral, the output and the derivative."""
        self.integral, self.output, self.measured, self.rate = 0.0, 0.0, None, 0.0
