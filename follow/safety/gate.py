"""The gate: every setpoint that is sent comes from `Safety.allow`.

`decide` is a pure function: the gate's state and one round's messages in, the next state and a Decision out.
"""

import math
from dataclasses import dataclass, field, replace

from follow.geometry import heading_to_ned, ned_to_heading, wrap
from follow.messages import (
    NEVER,
    NO_INSTRUCTION,
    Cause,
    Decision,
    Estimate,
    Instruction,
    Mode,
    Order,
    Reason,
    Setpoint,
    VehicleState,
)
from follow.safety.authority import Authority, Facts, judged
from follow.safety.checks import PLAUSIBLE, hindrances, must_stop, stale, unseen
from follow.safety.envelope import limit_altitude, limit_closing_speed, limit_velocity
from follow.safety.limits import Limits
from follow.safety.modes import STREAMING
from follow.safety.ramps import VelocityRamp, YawRateRamp


@dataclass(frozen=True, slots=True)
class Gate:
    """The gate's memory between rounds.  Velocities are NED; `fence_centre` is north and east (None: not set yet)."""

    authority: Authority = field(default_factory=Authority)
    t_s: float = NEVER
    horizontal: VelocityRamp = field(default_factory=VelocityRamp)
    down: VelocityRamp = field(default_factory=lambda: VelocityRamp((0.0,)))
    yaw: YawRateRamp = field(default_factory=YawRateRamp)
    fence_centre: tuple[float, float] | None = None

    @property
    def mode(self) -> Mode:
        """What the gate is doing."""
        return self.authority.mode


STEP_S = 0.1
"""Maximum time step of the ramps: a longer gap between rounds counts as this."""

STILL_M_S = 0.05
"""A vehicle in BRAKE counts as stopped when the speed last sent is below this."""


def speed(gate: Gate) -> float:
    """The speed last sent, m/s."""
    return math.hypot(*gate.horizontal.v, *gate.down.v)


def scale_for_mode(mode: Mode, desired: Setpoint, unseen_s: float, limits: Limits) -> Setpoint:
    """The desired setpoint that the mode permits: all of it, scaled down with time, the turn only, or zero."""
    if mode not in (Mode.FOLLOW, Mode.COAST, Mode.SEARCH) or not desired.is_finite():
        return Setpoint()
    desired = Setpoint(*(clamped(getattr(desired, name), PLAUSIBLE) for name in Setpoint.__slots__))
    if mode is Mode.FOLLOW:
        return desired
    # For the first half of the timeout all of it: a walker goes on behind a post or a bush, so the view must follow.
    fraction = clamped(max(2 - 2 * unseen_s / limits.search_after_s, 0.0), 1.0) if mode is Mode.COAST else 0.0
    turn = clamped(desired.yaw_rate_rad_s, limits.search_rad_s)
    return Setpoint(desired.forward_m_s * fraction, desired.right_m_s * fraction, desired.down_m_s * fraction, turn)


def clamped(value: float, largest: float) -> float:
    """The value within ±largest."""
    return min(max(value, -largest), largest)


def present_velocity(estimate: Estimate, state: VehicleState, limits: Limits) -> tuple[float, float, float]:
    """The vehicle's own NED velocity as far as stand-off, altitude band and speed limit permit it to be kept."""
    forward, right, _ = state.body_velocity_m_s()
    over = max(math.hypot(forward, right) / limits.speed_m_s, 1.0)
    forward, right = limit_closing_speed(forward / over, right / over, estimate, state, limits)
    down = limit_altitude(clamped(state.down_m_s, limits.climb_m_s), estimate, state, limits)
    return (*heading_to_ned(forward, right, state.yaw_rad), down)


def start_ramps(gate: Gate, estimate: Estimate, state: VehicleState, limits: Limits) -> Gate:
    """The gate as streaming begins: the ramps start at the present velocity."""
    north, east, down = present_velocity(estimate, state, limits)
    return replace(
        gate,
        horizontal=VelocityRamp((north, east)),
        down=VelocityRamp((down,)),
        yaw=YawRateRamp(clamped(state.yaw_rate_rad_s, limits.yaw_rate_rad_s)),
        fence_centre=gate.fence_centre or (state.north_m, state.east_m),
    )


def decide(
    gate: Gate,
    desired: Setpoint,
    estimate: Estimate,
    state: VehicleState,
    frame_t_s: float,
    limits: Limits,
    instruction: Instruction = NO_INSTRUCTION,
    contradiction: str = "",
) -> tuple[Gate, Decision]:
    """One round of the gate.

    `contradiction` is what an external check found to contradict the estimate; it brakes like stale data.
    """
    old = stale(state, frame_t_s, limits)
    old = (*old, contradiction) if contradiction else old
    unseen_s = unseen(estimate, state.t_s, limits)
    stopping = must_stop(state, gate.authority.had_remote)
    findings = hindrances(state, old, unseen_s, stopping, instruction.forbids, limits)
    still = speed(gate) < STILL_M_S
    authority = judged(gate.authority, Facts(state, old, unseen_s, findings, stopping, still, instruction), limits)
    if authority.mode in STREAMING and not math.isfinite(state.yaw_rad):
        # Without a heading no NED velocity can be turned into body axes, not even the ramp to zero.
        authority = replace(authority, mode=Mode.ENDED, reason=Reason(Cause.NO_HEADING), order=None)
    t_s = state.t_s if math.isfinite(state.t_s) else gate.t_s
    dt = clamped(max(t_s - gate.t_s, 0.0), STEP_S) if gate.t_s > NEVER else 0.0
    notes = old if desired.is_finite() else (*old, "the desired setpoint is not finite")
    begins = authority.mode in STREAMING and gate.mode not in STREAMING
    if begins:
        gate, dt = start_ramps(gate, estimate, state, limits), 0.0
    gate = replace(gate, authority=authority, t_s=t_s)
    if authority.mode not in STREAMING:
        return gate, Decision(None, authority.mode, notes, authority.reason, authority.release)
    fresh = not old and math.isfinite(unseen_s)
    velocity, turn, held = permitted(gate, desired, estimate, state, unseen_s if fresh else None, limits)
    gate = ramped(gate, velocity, turn, dt, limits)
    setpoint = body_setpoint(gate, state.yaw_rad)
    return gate, Decision(setpoint, authority.mode, (*notes, *held), authority.reason, authority.release)


def permitted(
    gate: Gate, desired: Setpoint, estimate: Estimate, state: VehicleState, unseen_s: float | None, limits: Limits
) -> tuple[tuple[float, float, float], float, tuple[str, ...]]:
    """The NED velocity and yaw rate that mode and limits permit, and notes.  `unseen_s` is None on stale data."""
    if unseen_s is None:
        return (0.0, 0.0, 0.0), 0.0, ()
    if gate.mode is Mode.ENGAGE:
        # The measured velocity jitters: it is approached within the ramps' acceleration, never copied.
        return present_velocity(estimate, state, limits), clamped(state.yaw_rate_rad_s, limits.yaw_rate_rad_s), ()
    allowed = scale_for_mode(gate.mode, desired, unseen_s, limits)
    speed_m_s = limits.speed_m_s if gate.mode is Mode.FOLLOW else min(limits.coast_m_s, limits.speed_m_s)
    centre = gate.fence_centre or (state.north_m, state.east_m)
    velocity, held = limit_velocity(allowed, speed_m_s, estimate, state, centre, limits)
    return velocity, allowed.yaw_rate_rad_s, held


def ramped(gate: Gate, velocity: tuple[float, float, float], yaw_rate: float, dt_s: float, limits: Limits) -> Gate:
    """The gate one time step closer to a NED velocity and a yaw rate, within acceleration and jerk."""
    n, e, down = velocity
    return replace(
        gate,
        horizontal=gate.horizontal.towards((n, e), dt_s, limits.speed_m_s, limits.accel_m_s2, limits.jerk_m_s3),
        down=gate.down.towards((down,), dt_s, limits.climb_m_s, limits.climb_accel_m_s2, limits.jerk_m_s3),
        yaw=gate.yaw.towards(yaw_rate, dt_s, limits.yaw_rate_rad_s, limits.yaw_accel_rad_s2),
    )


def body_setpoint(gate: Gate, yaw_rad: float) -> Setpoint:
    """The gate's NED velocity as a setpoint in the heading frame."""
    north, east = gate.horizontal.v
    return Setpoint(*ned_to_heading(north, east, wrap(yaw_rad)), gate.down.v[0], gate.yaw.rate)


@dataclass(slots=True)
class Safety:
    """Keeps the gate's state between rounds; `decide` does everything else."""

    limits: Limits = field(default_factory=Limits)
    gate: Gate = field(default_factory=Gate)
    ordered: Instruction | None = None

    def allow(
        self,
        desired: Setpoint,
        estimate: Estimate,
        state: VehicleState,
        frame_t_s: float,
        instruction: Instruction = NO_INSTRUCTION,
        contradiction: str = "",
    ) -> Decision:
        """Limit the desired setpoint at `state.t_s`; `frame_t_s` is when the newest frame was taken."""
        if self.ordered is not None and instruction.order is None:
            instruction, self.ordered = replace(self.ordered, forbids=instruction.forbids), None
        args = desired, estimate, state, frame_t_s, self.limits, instruction, contradiction
        self.gate, decision = decide(self.gate, *args)
        return decision

    def order(self, order: Order, reason: Reason | None = None) -> None:
        """Give an order; the next round acts on it."""
        causes = {Order.FOLLOW: Cause.FOLLOW_ORDERED, Order.OBSERVE: Cause.OBSERVE_ORDERED, Order.LEAVE: Cause.LEAVING}
        self.ordered = Instruction(order, reason or Reason(causes[order], "the program"))
