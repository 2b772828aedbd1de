"""The gate: the last thing before an autopilot.  Nothing but `Safety.allow` makes a setpoint that is sent.

`decide` is a pure function: the gate's state and one round's messages in, the next state and a Decision out.
"""

import math
from dataclasses import dataclass, field, replace

from follow.geometry import wrap
from follow.limiter import Rate, Velocity
from follow.messages import NEVER, Decision, Estimate, Order, Setpoint, VehicleState
from follow.modes import FLYING, STREAMING, Event, Mode, after


@dataclass(frozen=True, slots=True)
class Limits:
    """What no setpoint may pass.  Raises ValueError when a number is not positive or the altitude band is empty."""

    speed_m_s: float = 8.0  # horizontal; a cyclist's speed
    climb_m_s: float = 2.0  # up and down; ArduPilot's own default is 2.5 up, 1.5 down
    accel_m_s2: float = 2.5  # both autopilots fly it at 14 degrees of tilt; PX4 shapes nothing itself
    jerk_m_s3: float = 10.0  # twice ArduPilot's PSC_JERK_XY, which shapes again behind us
    climb_accel_m_s2: float = 2.0
    yaw_rate_rad_s: float = 1.5  # above it motion blur at 30 frames/s eats the picture's detail
    yaw_accel_rad_s2: float = 6.0
    floor_m: float = 2.0  # above the start; a person's reach
    ceiling_m: float = 100.0  # 120 m is the open category's limit in Europe, with margin
    fence_m: float = 300.0  # from where FOLLOW began; visual line of sight of a small drone
    frame_age_s: float = 0.2  # six pictures at 30 frames/s
    latency_s: float = 0.0  # the camera's own known delay, added to the frame's age limit
    attitude_age_s: float = 0.1
    position_age_s: float = 0.5
    heartbeat_age_s: float = 3.0  # three missed heartbeats
    coast_after_s: float = 0.25  # unseen for so long is lost
    search_after_s: float = 2.0  # and so long: hover and search
    give_up_after_s: float = 20.0
    brake_s: float = 1.0  # stale data may come back for so long before the stream stops
    engage_s: float = 5.0  # the autopilot has so long to obey; PX4 may take 1 s of stream and 1 s to say so

    def __post_init__(self) -> None:
        for name in self.__slots__:
            value = getattr(self, name)
            if not (math.isfinite(value) and (value > 0 or (name == "latency_s" and value == 0))):
                raise ValueError(f"limit {name} must be a positive number, not {value:g}")
        if self.floor_m >= self.ceiling_m:
            raise ValueError(f"the floor {self.floor_m:g} m must lie below the ceiling {self.ceiling_m:g} m")


@dataclass(frozen=True, slots=True)
class Gate:
    """What the gate remembers from round to round.  Velocities are NED."""

    mode: Mode = Mode.OBSERVE
    t_s: float = NEVER
    since_s: float = NEVER
    horizontal: Velocity = field(default_factory=Velocity)
    down: Velocity = field(default_factory=lambda: Velocity((0.0,)))
    yaw: Rate = field(default_factory=Rate)
    start_north_m: float = 0.0
    start_east_m: float = 0.0
    wants_follow: bool = False


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
    old = [f"{name} is {state.t_s - t:.2f} s old" for name, t, limit in ages if not abs(state.t_s - t) <= limit]
    numbers = (state.roll_rad, state.pitch_rad, state.yaw_rad, state.north_m, state.east_m, state.down_m)
    speeds = (state.north_m_s, state.east_m_s, state.down_m_s, state.yaw_rate_rad_s)
    if not all(abs(v) <= PLAUSIBLE for v in (*numbers, *speeds)):
        old.append("telemetry is not plausible")
    return tuple(old)


def events(gate: Gate, estimate: Estimate, state: VehicleState, old: tuple[str, ...], limits: Limits) -> list[Event]:
    """What this round finds, the gravest first."""
    unseen = state.t_s - estimate.seen_t_s - limits.latency_s
    seen = unseen <= limits.coast_after_s
    found: list[Event] = []
    if gate.mode in FLYING and not (state.in_control and state.armed):
        found.append(Event.CONTROL_LOST)
    found.append(Event.STALE if old else Event.FRESH)
    found.append(Event.CHECKS_GREEN if seen and not old and state.armed and not state.landed else Event.CHECKS_RED)
    if gate.wants_follow and gate.mode is Mode.READY and found[-1] is Event.CHECKS_GREEN:
        found.append(Event.ORDER_FOLLOW)
    if gate.mode in (Mode.READY, Mode.ENGAGE) and state.in_control:
        found.append(Event.CONTROL_GAINED)
    elif gate.mode is Mode.ENGAGE and state.t_s - gate.since_s > limits.engage_s:
        found.append(Event.TIMEOUT)
    found.append(Event.SEEN if seen else Event.UNSEEN)
    if not unseen <= limits.search_after_s:
        found.append(Event.LONG_UNSEEN)
    if not unseen <= limits.give_up_after_s:
        found.append(Event.GIVEN_UP)
    if gate.mode is Mode.BRAKE and speed(gate) < STILL_M_S and state.t_s - gate.since_s >= limits.brake_s:
        found.append(Event.STOPPED)
    return found


def speed(gate: Gate) -> float:
    """The speed last sent, m/s."""
    return math.hypot(*gate.horizontal.v, *gate.down.v)


def goal(mode: Mode, wish: Setpoint, estimate: Estimate, state: VehicleState, limits: Limits) -> Setpoint:
    """What the mode leaves of the wish, before the limits."""
    if mode not in (Mode.FOLLOW, Mode.COAST, Mode.SEARCH) or not wish.is_finite():
        return Setpoint()
    wish = Setpoint(*(min(max(getattr(wish, name), -PLAUSIBLE), PLAUSIBLE) for name in Setpoint.__slots__))
    if mode is Mode.FOLLOW:
        return wish
    unseen = state.t_s - estimate.seen_t_s - limits.latency_s
    share = min(max(1 - unseen / limits.search_after_s, 0.0), 1.0) if mode is Mode.COAST else 0.0
    return Setpoint(wish.forward_m_s * share, wish.right_m_s * share, wish.down_m_s * share, wish.yaw_rate_rad_s)


def braking_speed(room_m: float, accel_m_s2: float) -> float:
    """The speed from which half the allowed deceleration stops within the room, v = sqrt(a d); 0 without room."""
    return math.sqrt(accel_m_s2 * max(room_m, 0.0))


def within(gate: Gate, want: Setpoint, state: VehicleState, limits: Limits) -> tuple[float, float, float]:
    """The goal as NED velocity, held inside speed, fence and altitude band."""
    c, s = math.cos(state.yaw_rad), math.sin(state.yaw_rad)
    north = c * want.forward_m_s - s * want.right_m_s
    east = s * want.forward_m_s + c * want.right_m_s
    over = math.hypot(north, east) / limits.speed_m_s
    if over > 1:
        north, east = north / over, east / over
    out_north, out_east = state.north_m - gate.start_north_m, state.east_m - gate.start_east_m
    distance = math.hypot(out_north, out_east)
    if distance > 0:
        outward = (north * out_north + east * out_east) / distance
        excess = max(outward - braking_speed(limits.fence_m - distance, limits.accel_m_s2), 0.0)
        north, east = north - excess * out_north / distance, east - excess * out_east / distance
    height = -state.down_m
    fastest_down = min(limits.climb_m_s, braking_speed(height - limits.floor_m, limits.climb_accel_m_s2))
    fastest_up = min(limits.climb_m_s, braking_speed(limits.ceiling_m - height, limits.climb_accel_m_s2))
    return north, east, min(max(want.down_m_s, -fastest_up), fastest_down)


def begun(gate: Gate, state: VehicleState, limits: Limits) -> Gate:
    """The gate as streaming begins: ramps start at the present velocity, the fence is centred here."""
    over = max(math.hypot(state.north_m_s, state.east_m_s) / limits.speed_m_s, 1.0)
    return replace(
        gate,
        horizontal=Velocity((state.north_m_s / over, state.east_m_s / over)),
        down=Velocity((min(max(state.down_m_s, -limits.climb_m_s), limits.climb_m_s),)),
        yaw=Rate(min(max(state.yaw_rate_rad_s, -limits.yaw_rate_rad_s), limits.yaw_rate_rad_s)),
        start_north_m=state.north_m,
        start_east_m=state.east_m,
    )


def decide(
    gate: Gate, wish: Setpoint, estimate: Estimate, state: VehicleState, frame_t_s: float, limits: Limits
) -> tuple[Gate, Decision]:
    """One round of the gate."""
    old = stale(state, frame_t_s, limits)
    mode = gate.mode
    for event in events(gate, estimate, state, old, limits):
        mode = after(mode, event)
    t_s = state.t_s if math.isfinite(state.t_s) else gate.t_s
    if mode is not gate.mode:
        gate = replace(gate, since_s=t_s, wants_follow=gate.wants_follow and mode in (Mode.OBSERVE, Mode.READY))
    dt = min(max(t_s - gate.t_s, 0.0), STEP_S) if gate.t_s > NEVER else 0.0
    notes = old if wish.is_finite() else (*old, "the wish is not finite")
    if mode not in STREAMING:
        return replace(gate, mode=mode, t_s=t_s), Decision(None, mode.value, notes)
    if gate.mode not in STREAMING or mode is Mode.ENGAGE:
        gate, dt = begun(gate, state, limits), 0.0
    if old and not math.isfinite(state.yaw_rad):
        return replace(gate, mode=Mode.ENDED, t_s=t_s), Decision(None, Mode.ENDED.value, notes)
    want = goal(mode, wish, estimate, state, limits)
    north, east, down = (0.0, 0.0, 0.0) if old else within(gate, want, state, limits)
    gate = replace(
        gate,
        mode=mode,
        t_s=t_s,
        horizontal=gate.horizontal.towards((north, east), dt, limits.speed_m_s, limits.accel_m_s2, limits.jerk_m_s3),
        down=gate.down.towards((down,), dt, limits.climb_m_s, limits.climb_accel_m_s2, limits.jerk_m_s3),
        yaw=gate.yaw.towards(want.yaw_rate_rad_s, dt, limits.yaw_rate_rad_s, limits.yaw_accel_rad_s2),
    )
    return gate, Decision(body_setpoint(gate, state.yaw_rad), mode.value, notes)


def body_setpoint(gate: Gate, yaw_rad: float) -> Setpoint:
    """The gate's NED velocity as a setpoint in the heading frame."""
    c, s = math.cos(wrap(yaw_rad)), math.sin(wrap(yaw_rad))
    north, east = gate.horizontal.v
    return Setpoint(c * north + s * east, c * east - s * north, gate.down.v[0], gate.yaw.rate)


@dataclass(slots=True)
class Safety:
    """Holds the gate's state between rounds; everything else is `decide`."""

    limits: Limits = field(default_factory=Limits)
    gate: Gate = field(default_factory=Gate)

    def allow(self, wish: Setpoint, estimate: Estimate, state: VehicleState, frame_t_s: float) -> Decision:
        """What of the wish may be sent at `state.t_s`, given when the newest picture was taken."""
        self.gate, decision = decide(self.gate, wish, estimate, state, frame_t_s, self.limits)
        return decision

    def order(self, order: Order) -> None:
        """Take in what the operator asks for: FOLLOW waits for green checks, OBSERVE acts at once."""
        if order is Order.FOLLOW:
            mode = after(self.gate.mode, Event.ORDER_FOLLOW) if self.gate.mode is not Mode.READY else Mode.READY
            self.gate = replace(self.gate, mode=mode, wants_follow=True)
        else:
            self.gate = replace(self.gate, mode=after(self.gate.mode, Event.ORDER_OBSERVE), wants_follow=False)
