"""No setpoint out of a mode that is not listed or after an expired order: random flights against a reference model."""

import random
from collections import Counter
from dataclasses import dataclass, field, replace
from typing import ClassVar

import pytest

from follow.messages import (
    HOVER,
    NEVER,
    Autopilot,
    BatteryLevel,
    Cause,
    Estimate,
    Instruction,
    Landed,
    Mode,
    Order,
    Reason,
    Release,
    VehicleState,
)
from follow.safety.gate import Limits, Safety
from follow.safety.modes import OPEN_MODES, TABLE, Event, Standing
from tests.support.gate_rig import engaged, flying, seen

LIMITS = Limits()
LISTED = {
    Autopilot.PX4: ("POSCTL", "ALTCTL", "HOLD", "OFFBOARD"),
    Autopilot.ARDUPILOT: ("LOITER", "POSHOLD", "ALT_HOLD", "GUIDED"),
}
OTHERS = ("RTL", "LAND", "TAKEOFF", "MISSION", "BRAKE", "AUTO", "STABILIZE", "")
CONTROL = {Autopilot.PX4: "OFFBOARD", Autopilot.ARDUPILOT: "GUIDED"}
BY_KEY = Reason(Cause.FOLLOW_ORDERED, "key f")


@dataclass(frozen=True)
class Round:
    """What happens in one round of a random flight."""

    dt_s: float
    order: Order | None
    stick: bool
    mode: str | None  # somebody chooses it
    obeys: bool  # the autopilot grants our mode if we request it
    refuses: bool
    landed: Landed
    landed_age_s: float
    battery: BatteryLevel
    rc_healthy: bool | None
    armed: bool
    seen: bool
    fresh: bool
    height_m: float


ROUNDS = 60
SEQUENCES = 300  # for each autopilot: 18,000 rounds; each wrong table below is found within them


def mostly(rng: random.Random, usual, *others):
    """The usual value in fourteen of fifteen rounds: otherwise no flight would reach FOLLOW."""
    return usual if rng.random() < 14 / 15 else rng.choice(others)


def random_round(rng: random.Random) -> Round:
    return Round(
        dt_s=rng.choice((0.03, 0.1, 0.5, 1.5, 4.0)),
        order=rng.choice((Order.FOLLOW, None, None, None, rng.choice((Order.OBSERVE, Order.LEAVE, None)))),
        stick=mostly(rng, False, True),
        mode=mostly(rng, None, *LISTED[Autopilot.PX4], *LISTED[Autopilot.ARDUPILOT], *OTHERS),
        obeys=rng.random() < 0.4,
        refuses=mostly(rng, False, True),
        landed=mostly(rng, Landed.IN_AIR, *Landed),
        landed_age_s=mostly(rng, 0.1, 2.0, 10.0, -10.0),
        battery=mostly(rng, BatteryLevel.OK, *BatteryLevel),
        rc_healthy=mostly(rng, True, False, None),
        armed=mostly(rng, True, False),
        seen=mostly(rng, True, False),
        fresh=mostly(rng, True, False),
        height_m=mostly(rng, 20.0, 1.0, 5.0),
    )


@dataclass
class Referee:
    """An independent model of the right to fly: it implements the rules and shares no code with the gate."""

    limits: ClassVar[Limits] = LIMITS  # the gate's own; the laws are those of LIMITS
    autopilot: Autopilot
    mode: str = "HOLD"
    gate: Safety = field(default_factory=lambda: Safety(Referee.limits))
    t_s: float = 100.0
    in_control: bool = False
    refusal: str = ""
    ordered_t_s: float = NEVER  # of the living order
    had_remote: bool = False
    streams: bool = False
    was_in_control: bool = False
    begun_mode: str = ""
    begun_t_s: float = NEVER

    def play(self, r: Round) -> None:
        self.t_s += r.dt_s
        if r.mode is not None and r.mode != self.mode:
            self.mode, self.in_control, self.ordered_t_s = r.mode, False, NEVER
        elif self.streams and not self.in_control and r.obeys:
            self.mode, self.in_control = CONTROL[self.autopilot], True
        elif self.streams and not self.in_control and r.refuses:
            self.refusal = "DENIED"
        self.had_remote = self.had_remote or r.rc_healthy is True
        instruction = Instruction(r.order, BY_KEY)
        if r.stick:
            instruction = Instruction(Order.OBSERVE, Reason(Cause.STICK))
        if instruction.order is Order.FOLLOW:
            self.ordered_t_s = self.t_s
        elif instruction.order is not None:
            self.ordered_t_s = NEVER
        state = self.state(r)
        estimate = Estimate(self.t_s, 0.0, 0.4, 12.0, 0.5, seen_t_s=self.t_s if r.seen else self.t_s - 1.0)
        frame_t_s = self.t_s if r.fresh else self.t_s - 2.0
        decision = self.gate.allow(HOVER, estimate, state, frame_t_s, instruction)
        self.judge(decision, state, r)
        ends = self.streams and decision.setpoint is None
        if ends and self.in_control:
            self.mode, self.in_control = ("LOITER" if self.autopilot is Autopilot.ARDUPILOT else "HOLD"), False
        if decision.setpoint is not None and not self.streams:
            self.begun_mode, self.begun_t_s, self.refusal = state.mode, self.t_s, ""
        self.streams = decision.setpoint is not None
        self.was_in_control = self.streams and self.in_control

    def state(self, r: Round) -> VehicleState:
        return VehicleState(
            t_s=self.t_s,
            attitude_t_s=self.t_s,
            position_t_s=self.t_s,
            heartbeat_t_s=self.t_s,
            down_m=-r.height_m,
            autopilot=self.autopilot,
            mode=self.mode,
            in_control=self.in_control,
            refusal=self.refusal,
            armed=r.armed,
            landed_t_s=self.t_s - r.landed_age_s,
            landed=r.landed,
            battery=r.battery,
            rc_healthy=r.rc_healthy,
        )

    def judge(self, decision, state: VehicleState, r: Round) -> None:
        """The properties that must hold in every round."""
        if decision.setpoint is None:
            return
        assert r.armed
        assert not r.stick
        if not self.streams:  # a stream begins
            assert state.mode in LISTED[self.autopilot]
            assert 0 <= self.t_s - self.ordered_t_s <= LIMITS.order_timeout_s
            assert r.landed is Landed.IN_AIR
            assert abs(r.landed_age_s) <= 3.0
            assert r.battery not in (BatteryLevel.LOW, BatteryLevel.CRITICAL)
            assert not (self.had_remote and r.rc_healthy is False)
            assert r.height_m >= LIMITS.floor_m
            assert r.seen
            assert r.fresh
            self.ordered_t_s = NEVER  # carried out: the same order does not begin a second stream
        elif not self.in_control:  # it waits for the autopilot
            assert not self.was_in_control
            assert state.mode == self.begun_mode
            assert not self.refusal
            assert self.t_s - self.begun_t_s <= LIMITS.engage_timeout_s


def played(autopilot: Autopilot, seed: int) -> Counter[Mode]:
    """Check a random sequence round by round; returns the modes that it reached."""
    rng = random.Random(seed)
    referee = Referee(autopilot, LISTED[autopilot][0])
    reached = Counter[Mode]()
    for _ in range(ROUNDS):
        referee.play(random_round(rng))
        reached[referee.gate.gate.mode] += 1
    return reached


def all_played(autopilot: Autopilot) -> Counter[Mode]:
    """Check every sequence; returns the modes that they reached."""
    return sum((played(autopilot, seed) for seed in range(SEQUENCES)), Counter[Mode]())


@pytest.mark.parametrize("autopilot", Autopilot)
def test_no_setpoint_without_a_valid_order_out_of_a_listed_mode(autopilot):
    reached = all_played(autopilot)
    assert reached[Mode.ENGAGE] > 100
    assert reached[Mode.FOLLOW] > 100
    assert reached[Mode.BRAKE] > 20


def opened(monkeypatch):
    monkeypatch.setitem(OPEN_MODES, Autopilot.PX4, (*OPEN_MODES[Autopilot.PX4], "RTL"))


def without(event):
    """The table without an event."""

    def change(monkeypatch):
        for triple in [triple for triple in TABLE if triple[2] is event]:
            monkeypatch.delitem(TABLE, triple)

    return change


def straight(monkeypatch):
    """A wrong table: an order starts the stream despite every refusal."""
    for mode in (Mode.OBSERVE, Mode.READY):
        for where in Standing:
            monkeypatch.setitem(TABLE, (mode, where, Event.ASKED), Mode.ENGAGE)


def outliving(monkeypatch):
    """A wrong table: an order never expires."""
    monkeypatch.setattr(Referee, "limits", Limits(order_timeout_s=60.0))


MUTANTS = {
    "an order lives for ever": outliving,
    "RTL is a mode out of which FOLLOW may be ordered": opened,
    "a stick and OBSERVE change nothing": without(Event.ORDER_OBSERVE),
    "a takeover and a disarm change nothing": without(Event.CONTROL_LOST),
    "a refusal changes nothing": without(Event.REFUSED),
    "ENGAGE has no end": without(Event.TIMEOUT),
    "an order needs nothing": straight,
}


@pytest.mark.parametrize("mutant", MUTANTS)
def test_the_property_test_detects_a_wrong_table(mutant, monkeypatch):
    MUTANTS[mutant](monkeypatch)

    with pytest.raises(AssertionError):
        all_played(Autopilot.PX4)


def calm(**changes) -> Round:
    usual = Round(
        0.1, None, False, None, False, False, Landed.IN_AIR, 0.1, BatteryLevel.OK, True, True, True, True, 20.0
    )
    return replace(usual, **changes)


def reason_after(*played: Round) -> tuple[Mode, Reason]:
    referee = Referee(Autopilot.PX4)
    for r in played:
        referee.play(r)
    authority = referee.gate.gate.authority
    return authority.mode, authority.reason


FOLLOWING = (calm(order=Order.FOLLOW), calm(obeys=True))


def test_the_flights_of_the_property_test_reach_follow():
    assert reason_after(*FOLLOWING) == (Mode.FOLLOW, Reason(Cause.BEGAN))


@pytest.mark.parametrize(
    ("played", "mode", "cause"),
    [
        ((calm(), calm(dt_s=0.6)), Mode.READY, Cause.READY),
        ((calm(seen=False),), Mode.OBSERVE, Cause.NOT_READY),
        ((calm(order=Order.FOLLOW, seen=False),), Mode.OBSERVE, Cause.ORDER_WAITS),
        ((calm(order=Order.FOLLOW, seen=False), calm(dt_s=4.0, seen=False)), Mode.OBSERVE, Cause.ORDER_VOID),
        ((calm(order=Order.FOLLOW, seen=False), calm(seen=False, stick=True)), Mode.OBSERVE, Cause.STICK),
        ((calm(order=Order.FOLLOW, seen=False), calm(mode="POSCTL")), Mode.OBSERVE, Cause.ORDER_VOID),
        ((calm(mode="RTL"), calm(order=Order.FOLLOW)), Mode.OBSERVE, Cause.ORDER_REFUSED),
        ((calm(order=Order.FOLLOW, landed=Landed.UNKNOWN),), Mode.OBSERVE, Cause.ORDER_REFUSED),
        ((calm(order=Order.FOLLOW, height_m=1.0),), Mode.OBSERVE, Cause.ORDER_REFUSED),
        ((calm(order=Order.FOLLOW, battery=BatteryLevel.LOW),), Mode.OBSERVE, Cause.ORDER_REFUSED),
        ((calm(order=Order.FOLLOW), calm(refuses=True)), Mode.ENDED, Cause.REFUSED),
        ((calm(order=Order.FOLLOW), *[calm(dt_s=1.5)] * 4), Mode.ENDED, Cause.IGNORED),
        ((calm(order=Order.FOLLOW), calm(mode="POSCTL")), Mode.ENDED, Cause.MODE_LEFT),
        ((*FOLLOWING, calm(mode="RTL")), Mode.ENDED, Cause.MODE_LEFT),
        ((*FOLLOWING, calm(stick=True)), Mode.ENDED, Cause.STICK),
        ((*FOLLOWING, calm(seen=False)), Mode.COAST, Cause.NOT_SEEN),
        ((*FOLLOWING, calm(fresh=False)), Mode.BRAKE, Cause.STALE),
        ((*FOLLOWING, calm(battery=BatteryLevel.LOW)), Mode.BRAKE, Cause.BATTERY),
        ((*FOLLOWING, calm(battery=BatteryLevel.LOW), calm(dt_s=0.5), calm(dt_s=1.5)), Mode.ENDED, Cause.STOPPED),
        ((*FOLLOWING, calm(rc_healthy=False)), Mode.BRAKE, Cause.REMOTE_LOST),
        ((*FOLLOWING, calm(landed=Landed.ON_GROUND)), Mode.BRAKE, Cause.LANDED),
        ((*FOLLOWING, calm(order=Order.LEAVE), calm()), Mode.ENDED, Cause.LEAVING),
        ((*FOLLOWING, calm(armed=False)), Mode.ENDED, Cause.DISARMED),
    ],
)
def test_every_change_has_its_reason(played, mode, cause):
    ended_in, reason = reason_after(*played)
    assert (ended_in, reason.cause) == (mode, cause)
    assert "{" not in str(reason)


def test_a_stick_requests_the_stick_mode_and_every_other_end_requests_hold():
    referee = Referee(Autopilot.ARDUPILOT, "LOITER")
    for r in FOLLOWING:
        referee.play(r)
    stick = Instruction(Order.OBSERVE, Reason(Cause.STICK))
    estimate = Estimate(referee.t_s, 0.0, 0.4, 12.0, 0.5, seen_t_s=referee.t_s)
    state = referee.state(calm())
    gate = replace(referee.gate.gate)
    assert referee.gate.allow(HOVER, estimate, state, referee.t_s, stick).release is Release.STICKS
    key = Instruction(Order.OBSERVE, Reason(Cause.OBSERVE_ORDERED, "key o"))
    assert Safety(LIMITS, gate).allow(HOVER, estimate, state, referee.t_s, key).release is Release.HOLD


def test_a_release_in_our_own_mode_is_reported_as_a_pause_of_the_stream():
    """The link releases control after a pause of the stream; ArduPilot then stays in GUIDED."""
    safety, t_s = engaged()
    decision = safety.allow(HOVER, seen(t_s), flying(t_s, in_control=False, mode="OFFBOARD"), t_s)
    assert (decision.mode, decision.reason.cause) == (Mode.ENDED, Cause.STREAM_PAUSED)
    safety, t_s = engaged()
    decision = safety.allow(HOVER, seen(t_s), flying(t_s, in_control=False, mode="HOLD"), t_s)
    assert (decision.mode, decision.reason) == (Mode.ENDED, Reason(Cause.MODE_LEFT, "HOLD"))


def test_a_stick_after_the_end_requests_the_stick_mode():
    referee = Referee(Autopilot.ARDUPILOT, "LOITER")
    for r in (*FOLLOWING, calm(order=Order.OBSERVE), calm()):
        referee.play(r)
    stick = Instruction(Order.OBSERVE, Reason(Cause.STICK))
    estimate = Estimate(referee.t_s, 0.0, 0.4, 12.0, 0.5, seen_t_s=referee.t_s)
    decision = referee.gate.allow(HOVER, estimate, referee.state(calm()), referee.t_s, stick)
    assert (decision.mode, decision.setpoint, decision.release) == (Mode.ENDED, None, Release.STICKS)
    assert decision.reason == Reason(Cause.STICK)


def test_a_stick_value_that_jumps_requests_hold():
    referee = Referee(Autopilot.ARDUPILOT, "LOITER")
    for r in FOLLOWING:
        referee.play(r)
    jumped = Instruction(Order.OBSERVE, Reason(Cause.STICK_JUMPED))
    estimate = Estimate(referee.t_s, 0.0, 0.4, 12.0, 0.5, seen_t_s=referee.t_s)
    decision = referee.gate.allow(HOVER, estimate, referee.state(calm()), referee.t_s, jumped)
    assert (decision.setpoint, decision.release) == (None, Release.HOLD)


def test_a_battery_that_recovers_under_less_load_does_not_resume_the_flight():
    assert reason_after(*FOLLOWING, calm(battery=BatteryLevel.LOW), *[calm()] * 15)[0] is not Mode.FOLLOW


def test_hovering_after_a_search_ends():
    lost = [calm(dt_s=1.5, seen=False)] * 40
    referee = Referee(Autopilot.PX4)
    for r in FOLLOWING:
        referee.play(r)
    seen_t_s = referee.t_s
    modes = []
    for _ in lost:
        referee.t_s += 1.0
        state = referee.state(calm())
        estimate = Estimate(referee.t_s, 0.0, 0.4, 12.0, 0.5, seen_t_s=seen_t_s)
        modes.append(referee.gate.allow(HOVER, estimate, state, referee.t_s).mode)
        if modes[-1] is Mode.ENDED:
            break
    else:
        for _ in range(60):
            referee.t_s += 1.0
            estimate = Estimate(referee.t_s, 0.0, 0.4, 12.0, 0.5, seen_t_s=seen_t_s)
            modes.append(referee.gate.allow(HOVER, estimate, referee.state(calm()), referee.t_s).mode)
    assert list(dict.fromkeys(modes)) == [Mode.COAST, Mode.SEARCH, Mode.HOLD, Mode.ENDED]


def test_a_silent_vehicle_is_reported_instead_of_its_last_mode_and_refuses_an_order_at_once():
    """Its mode of three seconds ago would send the pilot to the wrong switch."""
    safety, heard_s = Safety(Limits()), 1.0
    for i in range(180):
        t_s = i / 30
        silent = {"heartbeat_t_s": min(t_s, heard_s), "mode": "RTL", "in_control": False}
        if i == 150:
            safety.order(Order.FOLLOW)
        decision = safety.allow(HOVER, seen(t_s), flying(t_s, **silent), t_s)
        if 1.1 < t_s < heard_s + 3.0:
            assert "RTL" in str(decision.reason)
        if t_s > heard_s + 3.1:
            assert "nothing heard from the vehicle for 3 s" in str(decision.reason)
            assert "RTL" not in str(decision.reason)
        if i == 150:
            assert decision.reason.cause is Cause.ORDER_REFUSED
