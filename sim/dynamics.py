"""A multirotor with its autopilot: the response to velocity and yaw-rate setpoints.

The chain is common to real autopilots: a dead time, a limited and shaped velocity reference, a PI velocity controller
whose output is an acceleration, a second-order tilt loop that follows it, drag against the moving air.  The controller
uses the estimated velocity, which may differ from the true one.  The parameters are fitted to step responses of a
flown PX4 and a flown ArduCopter (`sim/measured.py`).

The horizontal plane is complex, north + i·east, so that rotating the body frame by the yaw ψ into NED is one product:
v = (forward + i·right)·exp(iψ).
"""

import cmath
import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from follow.messages import HOVER, Autopilot, Setpoint
from sim.measured import GRAVITY_M_S2, GaussMarkov, ResponseModel, VelocityLoop, response_of

GroundHeight = Callable[[float, float], float]
"""(north, east) to the height of the ground there, metres above the local frame's origin."""


def level(_north_m: float, _east_m: float) -> float:
    """Ground at the height of the local frame's origin everywhere."""
    return 0.0


SUBSTEP_S = 0.01  # at most a quarter of the fastest fitted time constant


@dataclass(frozen=True, slots=True)
class Wind:
    """A steady wind blowing toward `toward_rad` (clockwise from north) plus first-order Gauss-Markov gusts."""

    speed_m_s: float = 0.0
    toward_rad: float = 0.0
    gust_m_s: float = 0.0  # standard deviation of each component
    gust_time_s: float = 2.0  # Dryden's length over airspeed at 15 m height and 10 m/s (MIL-F-8785C): L/V ~ 20/10


CALM = Wind()


@dataclass(frozen=True, slots=True)
class VehicleTruth:
    """The vehicle's true motion at `t_s`: local NED, aerospace attitude, yaw rate about the down axis."""

    t_s: float = 0.0
    north_m: float = 0.0
    east_m: float = 0.0
    down_m: float = 0.0
    north_m_s: float = 0.0
    east_m_s: float = 0.0
    down_m_s: float = 0.0
    roll_rad: float = 0.0
    pitch_rad: float = 0.0
    yaw_rad: float = 0.0
    yaw_rate_rad_s: float = 0.0
    landed: bool = False
    ground_m: float = 0.0  # height of the ground below it, above the local frame's origin

    @property
    def height_m(self) -> float:
        """Height above the ground below it."""
        return -self.down_m - self.ground_m


@dataclass(slots=True)
class _Loop:
    """State of one velocity loop; complex for the horizontal plane, real for the vertical axis."""

    v: complex
    v_ref: complex
    a_ref: complex = 0.0
    a: complex = 0.0  # of the rotors: tilt (horizontal) or thrust above hover (vertical)
    a_rate: complex = 0.0
    integral: complex = 0.0

    def step(self, axis: VelocityLoop, command: complex, wind: complex, dt: float) -> None:
        """Advance by `dt` toward the velocity `command`, with the given wind."""
        if math.isinf(axis.ramp_m_s2):
            self.v_ref = command
        else:
            self.v_ref, self.a_ref = ramp(self.v_ref, self.a_ref, command, axis.ramp_m_s2, axis.jerk_m_s3, dt)
        error = self.v_ref - self.v
        ask = axis.gain_per_s * error + self.integral + axis.feed_forward * self.a_ref
        if abs(ask) > axis.limit_m_s2:
            ask *= axis.limit_m_s2 / abs(ask)
        else:
            self.integral += axis.integral_per_s2 * error * dt  # anti-wind-up: not while limited
        omega = axis.omega_rad_s
        self.a_rate += (omega * omega * (ask - self.a) - 2.0 * axis.zeta * omega * self.a_rate) * dt
        self.a += self.a_rate * dt
        self.v += (self.a - axis.drag(self.v - wind)) * dt


def ramp(v: complex, a: complex, command: complex, limit: float, jerk: float, dt: float) -> tuple[complex, complex]:
    """Move a velocity reference toward `command` within an acceleration and a jerk limit; returns (v, a).

    The acceleration is the largest from which the jerk limit can still stop in time: |a|² = 2·jerk·|error| far away,
    linear close by so that it settles (ArduPilot's square-root controller).
    """
    error = command - v
    distance = abs(error)
    slope = jerk / limit
    linear = jerk / slope**2
    speed = slope * distance if distance < linear else math.sqrt(2.0 * jerk * (distance - linear / 2.0))
    wanted = error * (min(speed, limit) / distance) if distance > 0.0 else 0.0 * error
    change = wanted - a
    if abs(change) > jerk * dt:
        change *= jerk * dt / abs(change)
    a = a + change
    return v + a * dt, a


def lean(accel: complex) -> tuple[float, float]:
    """(roll, pitch) at which the rotors carry the weight and accelerate by forward + i·right."""
    pitch = -math.atan2(accel.real, GRAVITY_M_S2)
    return math.atan2(accel.imag * math.cos(pitch), GRAVITY_M_S2), pitch


_Triple = tuple[float, float, float]
_NONE: _Triple = (0.0, 0.0, 0.0)


class Vehicle:
    """The vehicle in flight.  The same seed and calls give the same motion, bit for bit.

    `response` may be replaced in flight, as when a parameter of the autopilot changes.
    """

    def __init__(
        self,
        autopilot: Autopilot,
        start: VehicleTruth = VehicleTruth(),
        wind: Wind = CALM,
        seed: int = 0,
        response: ResponseModel | None = None,
        ground: GroundHeight = level,
    ) -> None:
        self.autopilot = autopilot
        self.response = response or response_of(autopilot, seed)
        self.wind = wind
        self._ground = ground
        ground_m = ground(start.north_m, start.east_m)
        self.motion = replace(start, landed=-start.down_m <= ground_m, ground_m=ground_m)
        self._random = np.random.default_rng(seed)
        self._gust = 0j
        self._velocity_error = (
            _NONE if self.motion.landed else self._drawn(_NONE, self.response.velocity_error, math.inf)
        )
        v = complex(start.north_m_s, start.east_m_s)
        self._plane = _Loop(v, v)
        self._lift = _Loop(start.down_m_s, start.down_m_s)
        self._plane.a = self._plane.integral = self.response.horizontal.drag(v - self._air())
        if not self.motion.landed:
            roll, pitch = lean(self._plane.a * cmath.exp(-1j * start.yaw_rad))
            self.motion = replace(self.motion, roll_rad=roll, pitch_rad=pitch)
        self._lift.a = self._lift.integral = self.response.vertical.drag(start.down_m_s)
        self._rate_ref = self._rate = start.yaw_rate_rad_s
        self._rate_integral = self.response.turn.damping_per_s * self._rate
        self._waiting: deque[tuple[float, Setpoint]] = deque()
        still = Setpoint(yaw_rate_rad_s=start.yaw_rate_rad_s)
        if v or start.down_m_s:
            level = v * cmath.exp(-1j * start.yaw_rad)
            still = Setpoint(level.real, level.imag, start.down_m_s, start.yaw_rate_rad_s)
        self._obeying = [still, still, still]  # by the horizontal, the vertical and the yaw loop

    @property
    def reported(self) -> VehicleTruth:
        """The motion as the vehicle estimates it: the true one, but with an error in the velocity."""
        m, (north, east, down) = self.motion, self._velocity_error
        return replace(m, north_m_s=m.north_m_s + north, east_m_s=m.east_m_s + east, down_m_s=m.down_m_s + down)

    def step(self, setpoint: Setpoint | None, dt_s: float) -> VehicleTruth:
        """Fly for `dt_s` with this setpoint arriving at its start; None: motors off.

        Raises ValueError for a setpoint that is not finite or a `dt_s` that is not positive.
        """
        if dt_s <= 0.0:
            raise ValueError(f"a step needs a positive duration, not {dt_s} s")
        if setpoint is None:
            self._fall(dt_s)
            return self.motion
        if not setpoint.is_finite():
            raise ValueError(f"a setpoint needs four finite numbers, not {setpoint}")
        self._waiting.append((self.motion.t_s, setpoint))
        count = math.ceil(dt_s / SUBSTEP_S - 1e-9)
        for _ in range(count):
            self._substep(dt_s / count)
        return self.motion

    def _air(self) -> complex:
        return cmath.rect(self.wind.speed_m_s, self.wind.toward_rad) + self._gust

    def _obeyed(self, t_s: float) -> tuple[Setpoint, Setpoint, Setpoint]:
        """The setpoints whose dead time has passed: of the horizontal, the vertical and the yaw loop."""
        response = self.response
        dead_s = response.horizontal.dead_time_s, response.vertical.dead_time_s, response.turn.dead_time_s
        for sent_s, setpoint in self._waiting:
            for loop, dead in enumerate(dead_s):
                if t_s - sent_s >= dead - 1e-9:
                    self._obeying[loop] = setpoint
        oldest = t_s - max(dead_s) - 1e-9
        while self._waiting and self._waiting[0][0] <= oldest:
            self._waiting.popleft()
        level, climb, turn = self._obeying
        return level, climb, turn

    def _substep(self, dt: float) -> None:
        now = self.motion
        response = self.response
        level, climb, turning = self._obeyed(now.t_s)
        self._weather(dt)
        yaw = now.yaw_rad
        if now.landed and climb.down_m_s >= 0.0:
            self._rest(dt)
            return
        desired = complex(level.forward_m_s, level.right_m_s)
        limits = response.limits
        desired *= limits.level_m_s / abs(desired) if abs(desired) > limits.level_m_s else 1.0
        down = max(-limits.climb_m_s, min(limits.descend_m_s, climb.down_m_s))
        # It controls the estimated velocity: an error of the estimate acts as the opposite error of the command.
        north_wrong, east_wrong, down_wrong = self._velocity_error
        command = desired * cmath.exp(1j * yaw) - complex(north_wrong, east_wrong)
        self._plane.step(response.horizontal, command, self._air(), dt)
        self._lift.step(response.vertical, down - down_wrong, 0.0, dt)
        self._turn(turning.yaw_rate_rad_s, dt)
        roll, pitch = lean(self._plane.a * cmath.exp(-1j * yaw))
        v, v_down = self._plane.v, self._lift.v.real
        north, east, next_down = now.north_m + v.real * dt, now.east_m + v.imag * dt, now.down_m + v_down * dt
        ground_m = self._ground(north, east)
        landed = -next_down - ground_m <= 0.0 and -next_down - ground_m <= now.height_m
        self.motion = VehicleTruth(
            t_s=now.t_s + dt,
            north_m=north,
            east_m=east,
            down_m=0.0 - ground_m if landed else next_down,
            north_m_s=v.real,
            east_m_s=v.imag,
            down_m_s=v_down,
            roll_rad=roll,
            pitch_rad=pitch,
            yaw_rad=math.remainder(yaw + self._rate * dt, math.tau),
            yaw_rate_rad_s=self._rate,
            landed=landed,
            ground_m=ground_m,
        )

    def _turn(self, command: float, dt: float) -> None:
        turn = self.response.turn
        limited = max(-turn.rate_limit_rad_s, min(turn.rate_limit_rad_s, command))
        change = turn.ramp_rad_s2 * dt
        self._rate_ref += max(-change, min(change, limited - self._rate_ref))
        error = self._rate_ref - self._rate
        self._rate_integral += turn.integral_per_s2 * error * dt
        self._rate += (turn.gain_per_s * error + self._rate_integral - turn.damping_per_s * self._rate) * dt

    def _weather(self, dt: float) -> None:
        """Advance gusts and velocity error: x' = x·e + σ·sqrt(1 - e²)·n with e = exp(-dt/τ), exact for any dt."""
        if self.wind.gust_m_s > 0.0:
            keep = math.exp(-dt / self.wind.gust_time_s)
            spread = self.wind.gust_m_s * math.sqrt(1.0 - keep * keep)
            n = self._random.standard_normal(2)
            self._gust = keep * self._gust + spread * complex(n[0], n[1])
        self._velocity_error = self._drawn(self._velocity_error, self.response.velocity_error, dt)

    def _drawn(self, now: _Triple, noise: GaussMarkov, dt: float) -> _Triple:
        """The next value of a velocity's noise, `dt` later."""
        spreads = noise.north_m_s, noise.east_m_s, noise.down_m_s
        if not any(spreads):
            return _NONE
        keep = math.exp(-dt / noise.time_s)
        new = math.sqrt(1.0 - keep * keep)
        n = self._random.standard_normal(3)
        north, east, down = (keep * x + new * s * float(k) for x, s, k in zip(now, spreads, n, strict=True))
        return north, east, down

    def _rest(self, dt: float) -> None:
        """Stand still on the ground."""
        self._plane = _Loop(0.0, 0.0)
        self._lift = _Loop(0.0, 0.0)
        self._rate = self._rate_ref = self._rate_integral = 0.0
        self._velocity_error = _NONE  # the estimator knows that a vehicle on the ground does not move
        now = self.motion
        ground_m = self._ground(now.north_m, now.east_m)
        self.motion = VehicleTruth(
            now.t_s + dt, now.north_m, now.east_m, 0.0 - ground_m, yaw_rad=now.yaw_rad, landed=True, ground_m=ground_m
        )

    def _fall(self, dt_s: float) -> None:
        """Motors off: free fall without rotation, down to the ground."""
        self._obeying = [HOVER, HOVER, HOVER]
        self._waiting.clear()
        now = self.motion
        v_down = now.down_m_s + GRAVITY_M_S2 * dt_s
        down = now.down_m + v_down * dt_s
        north, east = now.north_m + now.north_m_s * dt_s, now.east_m + now.east_m_s * dt_s
        ground_m = self._ground(north, east)
        if now.landed or -down <= ground_m:
            self._rest(dt_s)
            return
        self._lift.v = self._lift.v_ref = v_down
        self.motion = replace(
            now, t_s=now.t_s + dt_s, north_m=north, east_m=east, down_m=down, down_m_s=v_down, ground_m=ground_m
        )
