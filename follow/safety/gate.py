"""The gate: every setpoint that is sent comes from `Safety.allow`.

`decide` is a pure function: the gate's state and one round's messages in, the next state and a Decision out.
"""

import math
from dataclasses import dataclass, field, replace

from follow.geometry import heading_to_ned, ned_to_heading, wrap
from follow.messages import NEVER, Decision, Estimate, Mode, Order, Setpoint, VehicleState
from follow.safety.envelope import limit_altitude, limit_closing_speed, limit_velocity
from follow.safety.limits import Limits
from follow.safety.modes import FLYING, STREAMING, Event, after
from follow.safety.ramps import VelocityRamp, YawRateRamp


@dataclass(frozen=True, slots=True)
class Gate:
    """The gate's memory between rounds.  Velocities are NED; `start_north_m`, `start_east_m` are where FOLLOW began.

    `since_s` is when the mode began.  `ordered` is a pending order and `ordered_t_s` the round that first saw it (None:
    no round yet).  `green_t_s` is the last round with every check green.
    """

    mode: Mode = Mode.OBSERVE
    t_s: float = NEVER
    since_s: float = NEVER
    horizontal: VelocityRamp = field(default_factory=VelocityRamp)
    down: VelocityRamp = field(default_factory=lambda: VelocityRamp((0.0,)))
    yaw: YawRateRamp = field(default_factory=YawRateRamp)
    start_north_m: float = 0.0
    start_east_m: float = 0.0
    ordered: Order | None = None
    ordered_t_s: float | None = None
    green_t_s: float = NEVER


STEP_S = 0.1
"""Maximum time step of the ramps: a longer gap between rounds counts as this."""

PLAUSIBLE = 1e6
"""Bound on telemetry numbers (m, m/s, rad): a larger one is invalid.  Desired velocities are clamped to it."""

STILL_M_S = 0.05
"""A vehicle in BRAKE counts as stopped when the speed last sent is below this."""


def stale(state: VehicleState, frame_t_s: float, limits: Limits) -> tuple[str, ...]:
    """The data that are too old, too far in the future or invalid, one line for each."""
    ages = (
        ("frame", frame_t_s, limits.frame_age_s + (limits.latency_s or 0.0)),
        ("attitude", state.attitude_t_s, limits.attitude_age_s),
        ("position", state.position_t_s, limits.position_age_s),
        ("heartbeat", state.heartbeat_t_s, limits.heartbeat_age_s),
    )
    # abs: a time that far in the future means that the clocks disagree.
    late = [(name, state.t_s - t) for name, t, limit in ages if not abs(state.t_s - t) <= limit]
    old = [f"{name} is {age:.2f} s old" if math.isfinite(age) else f"there is no {name}" for name, age in late]
    numbers = (state.roll_rad, state.pitch_rad, state.yaw_rad, state.north_m, state.east_m, state.down_m)
    speeds = (state.north_m_s, state.east_m_s, state.down_m_s, state.yaw_rate_rad_s)
    if not all(abs(v) <= PLAUSIBLE for v in (*numbers, *speeds)):
        old.append("telemetry is not plausible")
    return tuple(old)


def unseen(estimate: Estimate, t_s: float, limits: Limits) -> float:
    """Seconds since the target was last seen, less the camera's own delay; inf for an estimate that is not finite."""
    numbers = (estimate.azimuth_rad, estimate.depression_rad, estimate.range_m, estimate.range_std_m)
    if not all(abs(v) <= PLAUSIBLE for v in (*numbers, estimate.north_m_s, estimate.east_m_s)):
        return math.inf
    age_s = t_s - estimate.seen_t_s - (limits.latency_s or 0.0)
    return age_s if math.isfinite(age_s) else math.inf


def events(gate: Gate, unseen_s: float, state: VehicleState, old: tuple[str, ...], limits: Limits) -> list[Event]:
    """The events of this round, in the order in which the table takes them."""
    seen = unseen_s <= limits.coast_after_s
    in_air = state.armed and state.in_air
    green = seen and not old and in_air
    found = [Event.ORDER_OBSERVE] if gate.ordered is Order.OBSERVE else []
    if gate.mode in FLYING and not (state.in_control and state.armed):
        found.append(Event.CONTROL_LOST)
    found.append(Event.STALE if old else Event.FRESH)
    found.append(Event.CHECKS_GREEN if green else Event.CHECKS_RED)
    if gate.ordered is Order.FOLLOW and (green or gate.mode in (Mode.ENDED, Mode.HOLD)):
        found.append(Event.ORDER_FOLLOW)
    # One late frame or packet does not void an order: it has the same grace period as in flight.
    if not (green or (in_air and 0.0 <= state.t_s - gate.green_t_s <= limits.stale_grace_s)):
        found.append(Event.STAYED_RED)
    if state.in_control and green:
        found.append(Event.CONTROL_GAINED)
    if gate.mode is Mode.ENGAGE and state.t_s - gate.since_s > limits.engage_timeout_s:
        found.append(Event.TIMEOUT)
    found.append(Event.SEEN if seen else Event.UNSEEN)
    if unseen_s > limits.search_after_s:
        found.append(Event.LONG_UNSEEN)
    if unseen_s > limits.give_up_after_s:
        found.append(Event.GIVEN_UP)
    if gate.mode is Mode.BRAKE and speed(gate) < STILL_M_S and state.t_s - gate.since_s >= limits.stale_grace_s:
        found.append(Event.STOPPED)
    return found


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


def start_ramps(gate: Gate, estimate: Estimate, state: VehicleState, limits: Limits) -> Gate:
    """The gate as streaming begins: the ramps start at the present velocity, the fence is centred here.

    Stand-off and altitude limit the present velocity also: it must not be kept up into the ground or the target.
    """
    forward, right, _ = state.body_velocity_m_s()
    over = max(math.hypot(forward, right) / limits.speed_m_s, 1.0)
    forward, right = limit_closing_speed(forward / over, right / over, estimate, state, limits)
    down = limit_altitude(clamped(state.down_m_s, limits.climb_m_s), estimate, state, limits)
    return replace(
        gate,
        horizontal=VelocityRamp(heading_to_ned(forward, right, state.yaw_rad)),
        down=VelocityRamp((down,)),
        yaw=YawRateRamp(min(max(state.yaw_rate_rad_s, -limits.yaw_rate_rad_s), limits.yaw_rate_rad_s)),
        start_north_m=state.north_m,
        start_east_m=state.east_m,
    )


def decide(
    gate: Gate, desired: Setpoint, estimate: Estimate, state: VehicleState, frame_t_s: float, limits: Limits
) -> tuple[Gate, Decision]:
    """One round of the gate."""
    old = stale(state, frame_t_s, limits)
    unseen_s = unseen(estimate, state.t_s, limits)
    mode = gate.mode
    found = events(gate, unseen_s, state, old, limits)
    for event in found:
        mode = after(mode, event)
    t_s = state.t_s if math.isfinite(state.t_s) else gate.t_s
    since_s = gate.since_s if mode is gate.mode else t_s
    dt = clamped(max(t_s - gate.t_s, 0.0), STEP_S) if gate.t_s > NEVER else 0.0
    notes = old if desired.is_finite() else (*old, "the desired setpoint is not finite")
    if mode in STREAMING and not math.isfinite(state.yaw_rad):
        mode = Mode.ENDED  # without a heading no NED velocity can be turned into body axes, not even the ramp to zero
    fresh = not old and math.isfinite(unseen_s)
    if mode in STREAMING and (gate.mode not in STREAMING or (mode is Mode.ENGAGE and fresh)):
        gate, dt = start_ramps(gate, estimate, state, limits), 0.0
    green_t_s = t_s if Event.CHECKS_GREEN in found else gate.green_t_s
    gate = remembered(replace(gate, mode=mode, t_s=t_s, since_s=since_s, green_t_s=green_t_s), limits)
    if mode not in STREAMING:
        return gate, Decision(None, mode, notes)
    permitted = scale_for_mode(mode, desired, unseen_s, limits)
    velocity, held = (0.0, 0.0, 0.0), ()
    if fresh:
        speed_m_s = limits.speed_m_s if mode is Mode.FOLLOW else min(limits.coast_m_s, limits.speed_m_s)
        start = gate.start_north_m, gate.start_east_m
        velocity, held = limit_velocity(permitted, speed_m_s, estimate, state, start, limits)
    gate = ramped(gate, velocity, permitted.yaw_rate_rad_s, dt, limits)
    return gate, Decision(body_setpoint(gate, state.yaw_rad), mode, (*notes, *held))


def remembered(gate: Gate, limits: Limits) -> Gate:
    """The gate without its order once that is carried out, or void after its timeout."""
    if gate.ordered is None:
        return gate
    since_s = gate.t_s if gate.ordered_t_s is None else gate.ordered_t_s
    if gate.mode in STREAMING or gate.ordered is Order.OBSERVE or gate.t_s - since_s > limits.order_timeout_s:
        return replace(gate, ordered=None, ordered_t_s=None)
    return replace(gate, ordered_t_s=since_s)


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

    def allow(self, desired: Setpoint, estimate: Estimate, state: VehicleState, frame_t_s: float) -> Decision:
        """Limit the desired setpoint at `state.t_s`; `frame_t_s` is when the newest frame was taken."""
        self.gate, decision = decide(self.gate, desired, estimate, state, frame_t_s, self.limits)
        return decision

    def order(self, order: Order) -> None:
        """Take the operator's order: the next round acts on it, on FOLLOW once the checks are green."""
        self.gate = replace(self.gate, ordered=order, ordered_t_s=None)
