"""The gate: every setpoint that is sent comes from `Safety.allow`.

`decide` is a pure function: the gate's state and one round's messages in, the next state and a Decision out.
"""

import math
from dataclasses import dataclass, field, replace

from follow.geometry import ned_to_heading, wrap
from follow.messages import (
    NEVER,
    NO_INSTRUCTION,
    Cause,
    Decision,
    Estimate,
    ImageMotion,
    Instruction,
    Mode,
    Order,
    Reason,
    Setpoint,
    VehicleState,
)
from follow.safety.authority import Authority, Facts, judged
from follow.safety.checks import PLAUSIBLE, Hindrance, hindrances, must_stop, stale, unseen
from follow.safety.consistency import Consistency
from follow.safety.distance import (
    UNKNOWN,
    Sighting,
    Worst,
    distance_m,
    gone,
    limit_closing_speed,
    limit_descent,
    moved,
    sighted,
    worst,
    worst_other,
)
from follow.safety.envelope import Surroundings, limit_altitude, limit_velocity
from follow.safety.limits import Limits
from follow.safety.modes import FLYING, STREAMING
from follow.safety.ramps import VelocityRamp, YawRateRamp
from follow.safety.reach import TargetReach, given_up, watched_reach
from follow.safety.response import Response, disobeying, watched


@dataclass(frozen=True, slots=True)
class Gate:
    """The gate's memory between rounds.  Velocities are NED; positions are north and east, None until they are known.

    The fence is centred on home or, if that is unknown, on the position where the first stream began.  `aimed_t_s` is
    when a person last chose the target, `gap_s` the mean time between rounds.
    """

    authority: Authority = field(default_factory=Authority)
    t_s: float = NEVER
    horizontal: VelocityRamp = field(default_factory=VelocityRamp)
    down: VelocityRamp = field(default_factory=lambda: VelocityRamp((0.0,)))
    yaw: YawRateRamp = field(default_factory=YawRateRamp)
    fence_centre: tuple[float, float] | None = None
    last_seen: Sighting | None = None
    resets: int = 0
    aimed_t_s: float = NEVER
    response: Response = field(default_factory=Response)
    reach: TargetReach = field(default_factory=TargetReach)
    gap_s: float = 0.0

    @property
    def mode(self) -> Mode:
        """What the gate is doing."""
        return self.authority.mode


FOLLOWING = (Mode.FOLLOW, Mode.COAST, Mode.SEARCH)
"""The modes in which the vehicle follows its target, or searches for it."""

STEP_S = 0.1
"""Maximum time step of the ramps: a longer gap between rounds is divided into several steps."""

GAP_S = 0.5
"""A longer gap between rounds counts as this: by then the link has paused the stream."""

PACE_S = 2.0
"""Time over which the gap between rounds is averaged: one long round does not make a slow program."""

SLOW_S = 0.25
"""A longer mean gap adds a note: between two rounds the program neither sees nor brakes."""

UNSEEN_S = 0.15
"""A target not seen for this long, two frames of a slow camera, may be behind a wall where it was last seen."""

STILL_M_S, STANDS_M_S = 0.05, 0.15
"""In BRAKE the vehicle counts as stopped when the speed last sent is below STILL_M_S and, unless data are stale, the
expected speed of a vehicle that obeys is below STANDS_M_S.

An autopilot that takes over a moving vehicle flies it on or back to a position of its own choice."""


def speed(gate: Gate) -> float:
    """The speed last sent, m/s."""
    return math.hypot(*gate.horizontal.v, *gate.down.v)


def scale_for_mode(mode: Mode, desired: Setpoint, unseen_s: float, limits: Limits) -> Setpoint:
    """The desired setpoint that the mode permits: all of it, scaled down with time, the turn only, or zero."""
    if mode not in FOLLOWING or not desired.is_finite():
        return Setpoint()
    desired = Setpoint(*(clamped(getattr(desired, name), PLAUSIBLE) for name in Setpoint.__slots__))
    if mode is Mode.FOLLOW:
        return desired
    # Unscaled for the first half of the timeout: a walker goes on behind a post or a bush, so the view must follow.
    fraction = clamped(max(2 - 2 * unseen_s / limits.search_after_s, 0.0), 1.0) if mode is Mode.COAST else 0.0
    turn = clamped(desired.yaw_rate_rad_s, limits.search_rad_s)
    # No descent: an unseen target may have come nearer, and a fast approach leaves no time to climb again.
    down = min(desired.down_m_s, 0.0) * fraction
    return Setpoint(desired.forward_m_s * fraction, desired.right_m_s * fraction, down, turn)


def clamped(value: float, largest: float) -> float:
    """The value within ±largest."""
    return min(max(value, -largest), largest)


def present_velocity(target: Worst, state: VehicleState, limits: Limits) -> tuple[float, float, float]:
    """The vehicle's own NED velocity as far as stand-off, altitude band and speed limit permit it to be kept."""
    over = max(math.hypot(state.north_m_s, state.east_m_s) / limits.speed_m_s, 1.0)
    north, east = limit_closing_speed(state.north_m_s / over, state.east_m_s / over, target, limits)
    fast = max(
        math.hypot(north, east) / limits.speed_m_s, 1.0
    )  # a retreat added to a fast sideways motion may exceed the limit
    north, east = north / fast, east / fast
    down = limit_descent(clamped(state.down_m_s, limits.climb_m_s), target, state, limits)
    return north, east, limit_altitude(down, target, state, limits)


def start_ramps(gate: Gate, target: Worst, state: VehicleState, limits: Limits) -> Gate:
    """The gate as streaming begins: the ramps start at the present velocity."""
    north, east, down = present_velocity(target, state, limits)
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
    t_s = state.t_s if math.isfinite(state.t_s) else gate.t_s
    gate, dt = paced(gate, t_s)
    old = stale(state, frame_t_s, limits)
    old = (*old, *(text for text in (estimate.contradiction, contradiction) if text))
    unseen_s = unseen(estimate, state.t_s, limits)
    is_fresh = not old and math.isfinite(unseen_s)
    target = worst(estimate, state, limits) if is_fresh else UNKNOWN
    gate = remembered(gate, target, estimate, state, dt, is_fresh, limits)
    if is_fresh and unseen_s > limits.search_after_s:
        target = gone(gate.last_seen, state)
    gate = replace(gate, aimed_t_s=t_s) if instruction.aimed else gate
    authority = judged(gate.authority, facts(gate, target, estimate, state, old, unseen_s, instruction, limits), limits)
    if authority.mode in STREAMING and not math.isfinite(state.yaw_rad):
        # Without a heading no NED velocity can be turned into body axes, not even the ramp to zero.
        authority = replace(authority, mode=Mode.ENDED, reason=Reason(Cause.NO_HEADING), order=None)
    notes = (*old, estimate.doubt) if estimate.doubt else old
    notes = notes if desired.is_finite() else (*notes, "the desired setpoint is not finite")
    notes = notes if gate.gap_s <= SLOW_S else (*notes, f"slow: fewer than {1 / SLOW_S:g} rounds a second")
    if authority.mode in STREAMING and gate.mode not in STREAMING:
        gate, dt = start_ramps(gate, target, state, limits), 0.0
    elif authority.mode is not gate.mode and authority.reason.cause is Cause.NOT_OBEYING and is_fresh:
        gate = start_ramps(
            gate, target, state, limits
        )  # ramp from the real velocity: no speed that was not flown stays in the setpoint
    gate = replace(gate, authority=authority, t_s=t_s)
    if authority.mode not in STREAMING:
        return gate, Decision(None, authority.mode, notes, authority.reason, authority.release)
    velocity, turn, held, reach = (0.0, 0.0, 0.0), 0.0, (), TargetReach()
    if is_fresh:
        another = worst_other(estimate.other, state)
        velocity, turn, held = permitted(gate, desired, target, another, state, unseen_s, limits)
        if gate.mode is Mode.FOLLOW:
            reach = watched_reach(gate.reach, desired, velocity[:2], target, state, limits)
    gate = ramped(replace(gate, reach=reach), velocity, turn, dt, limits)
    setpoint = body_setpoint(gate, state.yaw_rad)
    return gate, Decision(setpoint, authority.mode, (*notes, *held), authority.reason, authority.release)


def paced(gate: Gate, t_s: float) -> tuple[Gate, float]:
    """The gate with the mean time between rounds, and the time since the last one, s."""
    dt = clamped(max(t_s - gate.t_s, 0.0), GAP_S) if gate.t_s > NEVER else 0.0
    return replace(gate, gap_s=gate.gap_s + (dt - gate.gap_s) * (1.0 - math.exp(-dt / PACE_S))), dt


def facts(
    gate: Gate,
    target: Worst,
    estimate: Estimate,
    state: VehicleState,
    old: tuple[str, ...],
    unseen_s: float,
    instruction: Instruction,
    limits: Limits,
) -> Facts:
    """The facts of this round for the authority."""
    stopping = must_stop(state, gate.authority.had_remote) or disobeying(gate.response, state, limits)
    found = hindrances(state, old, unseen_s, stopping, instruction.forbids, limits)
    if target is not UNKNOWN and distance_m(target) < limits.min_standoff_m:
        found = (*found, Hindrance(too_near(estimate, limits), passing=True))
    beyond, over = gate.reach.told, given_up(gate.reach, state, limits)
    # A target that was just chosen has the same timeouts as one that was lost.
    waited_s = unseen_s if math.isfinite(unseen_s) else state.t_s - gate.aimed_t_s
    lags = gate.authority.last is not None and math.hypot(*gate.response.expected) >= STANDS_M_S
    return Facts(state, old, waited_s, found, stopping, beyond, over, speed(gate) < STILL_M_S and not lags, instruction)


def too_near(estimate: Estimate, limits: Limits) -> str:
    """What forbids FOLLOW of a target that may be within the minimum stand-off: its distance, or its uncertainty."""
    least_m = limits.min_standoff_m
    if math.hypot(estimate.range_m, estimate.range_m * math.tan(estimate.depression_rad)) < least_m:
        return f"the target is nearer than {least_m:g} m: fly back"
    return f"range uncertain, maybe under {least_m:g} m: wait"


def remembered(
    gate: Gate, target: Worst, estimate: Estimate, state: VehicleState, dt_s: float, is_fresh: bool, limits: Limits
) -> Gate:
    """The gate with the last sighting, the fence's centre and the vehicle's response."""
    if state.resets != gate.resets:  # the autopilot moved its own origin: move all stored positions with it
        seen = moved(gate.last_seen, state) if gate.last_seen is not None else None
        centre = gate.fence_centre
        if centre is not None:
            centre = centre[0] + state.reset_north_m, centre[1] + state.reset_east_m
        gate = replace(gate, resets=state.resets, last_seen=seen, fence_centre=centre)
    if is_fresh and (gate.last_seen is None or estimate.seen_t_s > gate.last_seen.t_s):
        before = gate.last_seen if gate.mode in FOLLOWING else None  # else a person flies, and the climb starts again
        gate = replace(gate, last_seen=sighted(before, target, estimate.seen_t_s, state, limits))
    if is_fresh and state.home_t_s > NEVER:
        gate = replace(gate, fence_centre=(state.home_north_m, state.home_east_m))
    if gate.mode not in FLYING:
        present = state.north_m_s, state.east_m_s, state.down_m_s
        return replace(gate, response=Response(present if is_fresh else gate.response.expected))
    north, east = gate.horizontal.v
    response = watched(gate.response, (north, east, gate.down.v[0]), state, dt_s)
    return replace(gate, response=response if is_fresh else Response(response.expected))


def permitted(
    gate: Gate,
    desired: Setpoint,
    target: Worst,
    another: Worst | None,
    state: VehicleState,
    unseen_s: float,
    limits: Limits,
) -> tuple[tuple[float, float, float], float, tuple[str, ...]]:
    """The NED velocity and yaw rate that mode and limits permit on fresh data, and notes."""
    if gate.mode is Mode.BRAKE:  # BRAKE ends when the vehicle stands still, so no border may move it
        return (0.0, 0.0, 0.0), 0.0, ()
    if gate.mode is Mode.ENGAGE:
        # The measured velocity jitters: it is approached within the ramps' acceleration, never copied.
        return present_velocity(target, state, limits), clamped(state.yaw_rate_rad_s, limits.yaw_rate_rad_s), ()
    allowed = scale_for_mode(gate.mode, desired, unseen_s, limits)
    speed_m_s = limits.speed_m_s if gate.mode is Mode.FOLLOW else min(limits.coast_m_s, limits.speed_m_s)
    last_seen = gate.last_seen if unseen_s > UNSEEN_S and gate.mode in FOLLOWING else None
    around = Surroundings(target, gate.fence_centre or (state.north_m, state.east_m), last_seen, another)
    velocity, held = limit_velocity(allowed, speed_m_s, around, state, limits)
    return velocity, allowed.yaw_rate_rad_s, held


def ramped(gate: Gate, velocity: tuple[float, float, float], yaw_rate: float, dt_s: float, limits: Limits) -> Gate:
    """The gate `dt_s` closer to a NED velocity and a yaw rate, within acceleration and jerk."""
    n, e, down = velocity
    steps = max(math.ceil(dt_s / STEP_S), 1)
    for _ in range(steps):
        step_s = dt_s / steps
        gate = replace(
            gate,
            horizontal=gate.horizontal.towards((n, e), step_s, limits.speed_m_s, limits.accel_m_s2, limits.jerk_m_s3),
            down=gate.down.towards((down,), step_s, limits.climb_m_s, limits.climb_accel_m_s2, limits.jerk_m_s3),
            yaw=gate.yaw.towards(yaw_rate, step_s, limits.yaw_rate_rad_s, limits.yaw_accel_rad_s2),
        )
    return gate


def body_setpoint(gate: Gate, yaw_rad: float) -> Setpoint:
    """The gate's NED velocity as a setpoint in the heading frame."""
    north, east = gate.horizontal.v
    return Setpoint(*ned_to_heading(north, east, wrap(yaw_rad)), gate.down.v[0], gate.yaw.rate)


@dataclass(slots=True)
class Safety:
    """Keeps the gate's state between rounds; `decide` does everything else."""

    limits: Limits = field(default_factory=Limits)
    gate: Gate = field(default_factory=Gate)
    consistency: Consistency = field(default_factory=Consistency)
    ordered: Instruction | None = None

    def allow(
        self,
        desired: Setpoint,
        estimate: Estimate,
        state: VehicleState,
        frame_t_s: float,
        instruction: Instruction = NO_INSTRUCTION,
        motion: ImageMotion | None = None,
    ) -> Decision:
        """Limit the desired setpoint at `state.t_s`; `frame_t_s` is when the newest frame was taken."""
        if self.ordered is not None and instruction.order is None:
            instruction, self.ordered = replace(self.ordered, forbids=instruction.forbids), None
        contradiction = self.consistency.update(motion, state.t_s)
        args = desired, estimate, state, frame_t_s, self.limits, instruction, contradiction
        self.gate, decision = decide(self.gate, *args)
        return decision

    def order(self, order: Order, reason: Reason | None = None) -> None:
        """Give an order; the next round acts on it."""
        causes = {Order.FOLLOW: Cause.FOLLOW_ORDERED, Order.OBSERVE: Cause.OBSERVE_ORDERED, Order.LEAVE: Cause.LEAVING}
        self.ordered = Instruction(order, reason or Reason(causes[order], "the program"))
