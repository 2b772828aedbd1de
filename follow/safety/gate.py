"""The gate: the last thing before an autopilot.  Nothing but `Safety.allow` makes a setpoint that is sent.

`decide` is a pure function: the gate's state and one round's messages in, the next state and a Decision out.
"""

import math
from dataclasses import dataclass, field, replace

from follow.geometry import heading_to_ned, ned_to_heading, wrap
from follow.messages import NEVER, Decision, Estimate, Order, Setpoint, VehicleState
from follow.safety.envelope import bounded, limit_altitude, limit_closing_speed
from follow.safety.limits import Limits
from follow.safety.modes import FLYING, STREAMING, Event, Mode, after
from follow.safety.ramps import VelocityRamp, YawRateRamp


@dataclass(frozen=True, slots=True)
class Gate:
    """What the gate remembers from round to round.  Velocities are NED, `start` is where FOLLOW began.

    `ordered` is an order not yet carried out, `ordered_t_s` the first round that knew of it, `green_t_s` the last round
    with every check green.
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
"""The longest step of the ramps: after a longer gap they go on as if no more time had passed."""

PLAUSIBLE = 1e6
"""No telemetry number (m, m/s, rad) of a small aircraft is larger, nor is a wish taken for more."""

STILL_M_S = 0.05
"""Below this speed setpoint a braking vehicle counts as stopped."""


def stale(state: VehicleState, frame_t_s: float, limits: Limits) -> tuple[str, ...]:
    """Which data are too old, or from the future, to fly on."""
    ages = (
        ("frame", frame_t_s, limits.frame_age_s + limits.latency_s),
        ("attitude", state.attitude_t_s, limits.attitude_age_s),
        ("position", state.position_t_s, limits.position_age_s),
        ("heartbeat", state.heartbeat_t_s, limits.heartbeat_age_s),
    )
    # abs: a time in the future by as much says that the clocks disagree.
    late = [(name, state.t_s - t) for name, t, limit in ages if not abs(state.t_s - t) <= limit]
    old = [f"{name} is {age:.2f} s old" if math.isfinite(age) else f"there is no {name}" for name, age in late]
    numbers = (state.roll_rad, state.pitch_rad, state.yaw_rad, state.north_m, state.east_m, state.down_m)
    speeds = (state.north_m_s, state.east_m_s, state.down_m_s, state.yaw_rate_rad_s)
    if not all(abs(v) <= PLAUSIBLE for v in (*numbers, *speeds)):
        old.append("telemetry is not plausible")
    return tuple(old)


def unseen(estimate: Estimate, t_s: float, limits: Limits) -> float:
    """Seconds since the target was seen, beyond the camera's own delay; inf for an estimate that is not finite."""
    numbers = (estimate.azimuth_rad, estimate.depression_rad, estimate.range_m, estimate.range_std_m)
    if not all(abs(v) <= PLAUSIBLE for v in (*numbers, estimate.north_m_s, estimate.east_m_s)):
        return math.inf
    age_s = t_s - estimate.seen_t_s - limits.latency_s
    return age_s if math.isfinite(age_s) else math.inf


def events(gate: Gate, unseen_s: float, state: VehicleState, old: tuple[str, ...], limits: Limits) -> list[Event]:
    """What this round finds, the gravest first."""
    seen = unseen_s <= limits.coast_after_s
    in_air = state.armed and not state.landed
    green = seen and not old and in_air
    found = [Event.ORDER_OBSERVE] if gate.ordered is Order.OBSERVE else []
    if gate.mode in FLYING and not (state.in_control and state.armed):
        found.append(Event.CONTROL_LOST)
    found.append(Event.STALE if old else Event.FRESH)
    found.append(Event.CHECKS_GREEN if green else Event.CHECKS_RED)
    if gate.ordered is Order.FOLLOW and (green or gate.mode in (Mode.ENDED, Mode.HOLD)):
        found.append(Event.ORDER_FOLLOW)
    # One late picture or packet does not void an order: as in flight, it may come back within `stale_grace_s`.
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


def goal(mode: Mode, desired: Setpoint, unseen_s: float, limits: Limits) -> Setpoint:
    """What the mode leaves of the desired setpoint: all, less and less, a turn, nothing."""
    if mode not in (Mode.FOLLOW, Mode.COAST, Mode.SEARCH) or not desired.is_finite():
        return Setpoint()
    desired = Setpoint(*(clipped(getattr(desired, name), PLAUSIBLE) for name in Setpoint.__slots__))
    if mode is Mode.FOLLOW:
        return desired
    # The first half of the time all of it: behind a post or a bush a walker goes on, and so must the view.
    share = clipped(max(2 - 2 * unseen_s / limits.search_after_s, 0.0), 1.0) if mode is Mode.COAST else 0.0
    turn = clipped(desired.yaw_rate_rad_s, limits.search_rad_s)
    return Setpoint(desired.forward_m_s * share, desired.right_m_s * share, desired.down_m_s * share, turn)


def clipped(value: float, largest: float) -> float:
    """The value within ±largest."""
    return min(max(value, -largest), largest)


def start_ramps(gate: Gate, estimate: Estimate, state: VehicleState, limits: Limits) -> Gate:
    """The gate as streaming begins: ramps start at the present velocity, the fence is centred here.

    The present velocity is not to be kept up into the ground or the target: stand-off and altitude limit it, too.
    """
    forward, right, _ = state.body_velocity_m_s()
    over = max(math.hypot(forward, right) / limits.speed_m_s, 1.0)
    forward, right = limit_closing_speed(forward / over, right / over, estimate, state, limits)
    down = limit_altitude(clipped(state.down_m_s, limits.climb_m_s), estimate, state, limits)
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
    dt = clipped(max(t_s - gate.t_s, 0.0), STEP_S) if gate.t_s > NEVER else 0.0
    notes = old if desired.is_finite() else (*old, "the desired setpoint is not finite")
    if mode in STREAMING and not math.isfinite(state.yaw_rad):
        mode = Mode.ENDED  # without a heading no direction can be sent, not even zero turned into the body's axes
    fresh = not old and math.isfinite(unseen_s)
    if mode in STREAMING and (gate.mode not in STREAMING or (mode is Mode.ENGAGE and fresh)):
        gate, dt = start_ramps(gate, estimate, state, limits), 0.0
    green_t_s = t_s if Event.CHECKS_GREEN in found else gate.green_t_s
    gate = remembered(replace(gate, mode=mode, t_s=t_s, since_s=since_s, green_t_s=green_t_s), limits)
    if mode not in STREAMING:
        return gate, Decision(None, mode.value, notes)
    want = goal(mode, desired, unseen_s, limits)
    velocity, held = (0.0, 0.0, 0.0), ()
    if fresh:
        speed_m_s = limits.speed_m_s if mode is Mode.FOLLOW else min(limits.coast_m_s, limits.speed_m_s)
        start = gate.start_north_m, gate.start_east_m
        velocity, held = bounded(want, speed_m_s, estimate, state, start, limits)
    gate = ramped(gate, velocity, want.yaw_rate_rad_s, dt, limits)
    return gate, Decision(body_setpoint(gate, state.yaw_rad), mode.value, (*notes, *held))


def remembered(gate: Gate, limits: Limits) -> Gate:
    """The gate with its order forgotten once it is carried out, or void once it waited too long."""
    if gate.ordered is None:
        return gate
    since_s = gate.t_s if gate.ordered_t_s is None else gate.ordered_t_s
    if gate.mode in STREAMING or gate.ordered is Order.OBSERVE or gate.t_s - since_s > limits.order_timeout_s:
        return replace(gate, ordered=None, ordered_t_s=None)
    return replace(gate, ordered_t_s=since_s)


def ramped(gate: Gate, velocity: tuple[float, float, float], yaw_rate: float, dt_s: float, limits: Limits) -> Gate:
    """The gate one step nearer to a NED velocity and a yaw rate, within acceleration and jerk."""
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
    """Holds the gate's state between rounds; everything else is `decide`."""

    limits: Limits = field(default_factory=Limits)
    gate: Gate = field(default_factory=Gate)

    def allow(self, desired: Setpoint, estimate: Estimate, state: VehicleState, frame_t_s: float) -> Decision:
        """What of the desired setpoint may be sent at `state.t_s`, given when the newest picture was taken."""
        self.gate, decision = decide(self.gate, desired, estimate, state, frame_t_s, self.limits)
        return decision

    def order(self, order: Order) -> None:
        """Take in what the operator asks for: the next round acts on it, FOLLOW as soon as the checks are green."""
        self.gate = replace(self.gate, ordered=order, ordered_t_s=None)
