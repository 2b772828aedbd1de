"""Who controls the vehicle: the pending order and the gate's mode, round by round.  Pure functions.

An order is pending for at most `order_timeout_s`.  A change of the vehicle's mode, a stick, a lost remote control or a
refusal voids it earlier.  It is refused at once if a finding forbids it that cannot pass by itself.
"""

from dataclasses import dataclass, replace

from follow.messages import (
    NEVER,
    NO_INSTRUCTION,
    PILOTS_STICK,
    Cause,
    Instruction,
    Mode,
    Order,
    Reason,
    Release,
    VehicleState,
)
from follow.safety.checks import Hindrance
from follow.safety.limits import Limits
from follow.safety.modes import FLYING, STREAMING, Event, after, standing

WORDS_S = 3.0
"""The autopilot's last text explains a change of its mode if it is not older than this."""

AFTERWARDS = (Mode.ENDED, Mode.OBSERVE)
"""Modes without a stream, in which the vehicle may still be in a flight mode that we requested."""


@dataclass(frozen=True, slots=True)
class PendingOrder:
    """FOLLOW, ordered by `by` at `t_s`, while the vehicle was in `vehicle_mode`."""

    by: str
    t_s: float
    vehicle_mode: str


@dataclass(frozen=True, slots=True)
class Authority:
    """The gate's mode with its reason, and what it must remember of the operator and the vehicle.

    `since_s` is when the mode began, `clear_since_s` since when nothing forbids FOLLOW (None: something does) and
    `clear_t_s` the last round in which nothing did.  `shown` is the finding last shown as what READY waits for,
    `engaged_from` the vehicle's mode when ENGAGE began, `obeyed_in` that in which it last obeyed, `last` is the reason
    why BRAKE may not return to flying.
    """

    mode: Mode = Mode.OBSERVE
    since_s: float = NEVER
    reason: Reason = NO_INSTRUCTION.reason
    release: Release = Release.HOLD
    order: PendingOrder | None = None
    clear_since_s: float | None = None
    clear_t_s: float = NEVER
    shown: str = ""
    engaged_from: str = ""
    obeyed_in: str = ""
    last: Reason | None = None
    had_remote: bool = False


@dataclass(frozen=True, slots=True)
class Facts:
    """Everything about one round that `judged` needs.

    `old` lists the stale data, `stopping` is the reason that must end FOLLOW, `findings` forbid it; `is_still` says
    that the vehicle has stopped.
    """

    state: VehicleState
    old: tuple[str, ...]
    unseen_s: float
    findings: tuple[Hindrance, ...]
    stopping: Reason | None = None
    beyond: str = ""  # why the target is out of reach
    is_given_up: bool = False  # ... for longer than its timeout
    is_still: bool = True
    instruction: Instruction = NO_INSTRUCTION


Found = tuple[Event, Reason]


def judged(now: Authority, facts: Facts, limits: Limits) -> Authority:
    """The authority after one round."""
    t_s, findings = facts.state.t_s, facts.findings
    now = replace(now, had_remote=now.had_remote or facts.state.rc_healthy is True)
    if facts.state.in_control:
        now = replace(now, obeyed_in=facts.state.mode)
    if findings:
        now = replace(now, clear_since_s=None)
    else:
        since_s = t_s if now.clear_since_s is None else now.clear_since_s
        now = replace(now, clear_since_s=since_s, clear_t_s=t_s)
    now = heard(now, facts)
    granted, verdict = order_verdict(now, facts, limits)
    mode, reason, where = now.mode, None, standing(facts.state)
    for event, why in events(now, facts, granted, limits):
        then = after(mode, where, event)
        if then is not mode:
            mode, reason = then, why
    shown = findings[0].what if findings else ""
    if mode is Mode.OBSERVE and verdict is not None:
        reason = verdict
    elif mode is Mode.OBSERVE is now.mode and findings and shown != now.shown:
        reason = Reason(Cause.NOT_READY, shown)
    elif mode is Mode.FOLLOW is now.mode:
        reason = reach_reason(now, facts)
    if (granted and mode in STREAMING) or (verdict is not None and verdict.cause is not Cause.ORDER_WAITS):
        now = replace(now, order=None)
    if mode is not now.mode:
        return entered(now, mode, reason or now.reason, facts)
    return now if reason is None else replace(now, reason=reason, shown=shown)


def reach_reason(now: Authority, facts: Facts) -> Reason | None:
    """The reason of FOLLOW as its target gets out of reach, and in reach again; None while nothing changes."""
    was_beyond = now.reason.cause is Cause.OUT_OF_REACH
    if facts.beyond and not was_beyond:
        return Reason(Cause.OUT_OF_REACH, facts.beyond)
    return Reason(Cause.IN_REACH) if was_beyond and not facts.beyond else None


def entered(now: Authority, mode: Mode, reason: Reason, facts: Facts) -> Authority:
    """The authority as a mode begins."""
    final = (Cause.BATTERY, Cause.REMOTE_LOST, Cause.LANDED, Cause.NOT_OBEYING, Cause.LEAVING)
    return replace(
        now,
        mode=mode,
        since_s=facts.state.t_s,
        reason=reason,
        release=Release.STICKS if reason.cause in PILOTS_STICK else Release.HOLD,
        order=None if mode in STREAMING or now.mode in STREAMING else now.order,
        engaged_from=facts.state.mode if mode is Mode.ENGAGE else now.engaged_from,
        last=reason if mode is Mode.BRAKE and reason.cause in final else None,
        shown=facts.findings[0].what if facts.findings else "",
    )


def heard(now: Authority, facts: Facts) -> Authority:
    """The authority with a new order, or without one that the operator withdrew."""
    order = facts.instruction.order
    leaving = Reason(Cause.LEAVING, facts.instruction.reason.what) if order is Order.LEAVE else None
    if now.mode is Mode.BRAKE and (last := leaving or facts.stopping):
        return replace(now, last=last, reason=leaving or now.reason)
    if order is Order.FOLLOW and (now.mode not in STREAMING or now.mode is Mode.HOLD):
        pending = PendingOrder(facts.instruction.reason.what, facts.state.t_s, facts.state.mode)
        return replace(now, order=pending)
    if now.mode in AFTERWARDS and facts.instruction.reason.cause in PILOTS_STICK:
        # The vehicle may hover in the Hold or BRAKE that we requested, where the pilot's sticks do nothing, also when
        # FOLLOW was ordered and refused there.
        now = replace(now, release=Release.STICKS)
        if now.mode is Mode.ENDED:
            return replace(now, order=None, reason=facts.instruction.reason)
    if order is None or order is Order.FOLLOW:
        return now
    if now.reason.cause is Cause.ORDER_WAITS:  # replace the reason: the order no longer waits
        return replace(now, order=None, reason=facts.instruction.reason)
    return replace(now, order=None)


def order_verdict(now: Authority, facts: Facts, limits: Limits) -> tuple[bool, Reason | None]:
    """Whether a pending order is granted now; the reason if it waits, or is refused or void."""
    order, findings, t_s = now.order, facts.findings, facts.state.t_s
    if order is None:
        return False, None
    if facts.state.mode != order.vehicle_mode:
        return False, Reason(Cause.ORDER_VOID, f"the vehicle went to {facts.state.mode or 'no known mode'}")
    if not 0.0 <= t_s - order.t_s <= limits.order_timeout_s:
        missing = findings[0].what if findings else "it could not be carried out"
        return False, Reason(Cause.ORDER_VOID, f"{missing}, for {limits.order_timeout_s:g} s")
    if hard := [finding for finding in findings if not finding.passing]:
        return False, Reason(Cause.ORDER_REFUSED, hard[0].what)
    if findings:
        until = f"{order.by}; waits {limits.order_timeout_s:g} s for: {findings[0].what}"
        return False, Reason(Cause.ORDER_WAITS, until)
    # The last known mode may be a second old: somebody may have commanded a return meanwhile.
    is_newer = facts.state.heartbeat_t_s >= order.t_s
    return is_newer, None if is_newer else Reason(Cause.ORDER_WAITS, f"{order.by}; waits for a newer heartbeat")


def events(now: Authority, facts: Facts, granted: bool, limits: Limits) -> list[Found]:
    """The events of this round with their reasons, in the order in which the table applies them."""
    found = [*operator_events(now, facts), *vehicle_events(now, facts, limits)]
    findings, t_s = facts.findings, facts.state.t_s
    if findings:
        found.append((Event.HINDERED, Reason(Cause.NOT_READY, findings[0].what)))
        # One late frame or packet does not void an order: it has the same grace period as in flight.
        recent = 0.0 <= t_s - now.clear_t_s <= limits.stale_grace_s
        if not (recent and all(finding.passing for finding in findings)):
            found.append((Event.STAYED_HINDERED, Reason(Cause.ORDER_VOID, findings[0].what)))
    elif granted or (now.clear_since_s is not None and t_s - now.clear_since_s >= limits.ready_after_s):
        found.append((Event.CLEARED, Reason(Cause.READY)))
    if granted and now.order is not None:
        found.append((Event.ORDER_FOLLOW, Reason(Cause.FOLLOW_ORDERED, now.order.by)))
    if not findings:
        found.append((Event.CONTROL_GAINED, Reason(Cause.BEGAN)))
    if now.mode is Mode.ENGAGE and not 0.0 <= t_s - now.since_s <= limits.engage_timeout_s:
        found.append((Event.TIMEOUT, Reason(Cause.IGNORED, seconds=limits.engage_timeout_s)))
    return [*found, *target_events(facts, limits), *ending_events(now, facts, limits)]


def operator_events(now: Authority, facts: Facts) -> list[Found]:
    """What the operator orders."""
    order, reason = facts.instruction.order, facts.instruction.reason
    if order is Order.FOLLOW:
        return [(Event.ASKED, Reason(Cause.ORDER_WAITS, reason.what))]
    if order is None:
        return []
    if order is Order.LEAVE:
        return [(Event.ORDER_LEAVE, Reason(Cause.LEAVING, reason.what))]
    return [(Event.ORDER_OBSERVE, reason)]


def vehicle_events(now: Authority, facts: Facts, limits: Limits) -> list[Found]:
    """What the vehicle and its data do."""
    state, found = facts.state, list[Found]()
    left_before_obeying = state.mode != now.engaged_from and not state.in_control
    if not state.armed:
        found.append((Event.CONTROL_LOST, Reason(Cause.DISARMED)))
    elif (now.mode in FLYING and not state.in_control) or (now.mode is Mode.ENGAGE and left_before_obeying):
        words = f": {state.said}" if 0.0 <= state.t_s - state.said_t_s <= WORDS_S else ""
        left = Reason(Cause.MODE_LEFT, f"{state.mode or 'no known mode'}{words}")
        # After a pause of our own stream the link reports control as lost, though the autopilot stays in its mode.
        paused = now.mode in FLYING and state.mode == now.obeyed_in
        found.append((Event.CONTROL_LOST, Reason(Cause.STREAM_PAUSED) if paused else left))
    if state.refusal:
        found.append((Event.REFUSED, Reason(Cause.REFUSED, state.refusal)))
    if facts.stopping is not None:
        found.append((Event.MUST_STOP, facts.stopping))
    if facts.old:
        found.append((Event.STALE, Reason(Cause.STALE, facts.old[0])))
    elif now.mode is Mode.BRAKE and now.last is None and facts.stopping is None:
        found.append((Event.FRESH, Reason(Cause.FRESH)))
    return found


def target_events(facts: Facts, limits: Limits) -> list[Found]:
    """Whether the target is seen, and for how long it was not."""
    unseen_s = facts.unseen_s
    if unseen_s <= limits.coast_after_s:
        beyond = [(Event.OUT_OF_REACH, Reason(Cause.OUT_OF_REACH, facts.beyond))] if facts.is_given_up else []
        return [(Event.SEEN, Reason(Cause.SEEN)), *beyond]
    reason = Reason(Cause.NOT_SEEN, seconds=unseen_s)
    found = [(Event.UNSEEN, reason)]
    if unseen_s > limits.search_after_s:
        found.append((Event.LONG_UNSEEN, reason))
    if unseen_s > limits.give_up_after_s:
        found.append((Event.GIVEN_UP, reason))
    return found


def ending_events(now: Authority, facts: Facts, limits: Limits) -> list[Found]:
    """The ends of HOLD and BRAKE."""
    spent_s = facts.state.t_s - now.since_s
    if now.mode is Mode.HOLD and not 0.0 <= spent_s <= limits.hold_timeout_s:
        return [(Event.HOLD_OVER, Reason(Cause.HOLD_OVER, seconds=limits.hold_timeout_s))]
    leaving = now.last is not None and now.last.cause is Cause.LEAVING
    if now.mode is Mode.BRAKE and facts.is_still and (leaving or spent_s >= limits.stale_grace_s):
        why = now.reason if leaving else Reason(Cause.STOPPED, str(now.reason))
        return [(Event.STOPPED, why)]
    return []
