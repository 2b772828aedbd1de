"""The gate when the program, a sensor or a clock misbehaves."""

import math
from dataclasses import replace

import pytest

from follow.messages import HOVER, BatteryLevel, Cause, Estimate, Order, Setpoint
from follow.safety.distance import UNKNOWN, Worst
from follow.safety.envelope import limit_altitude
from follow.safety.gate import Safety
from follow.safety.reach import TargetReach, given_up, watched_reach
from follow.safety.response import LAG_S
from tests.support.gate_rig import DT, LIMITS, engaged, fly, flying, obeyed, seen

FAR = 200.0


def flown_until_it_stands(round_s, speed_m_s):
    """Seconds and metres from the last frame to a sent speed of zero; each round takes `round_s`."""
    limits = replace(LIMITS, speed_m_s=speed_m_s, clear_distance=0.0)
    safety, t_s, way_m = Safety(limits), 0.0, 0.0
    safety.order(Order.FOLLOW)
    for _ in range(3):
        state = flying(t_s, north_m_s=speed_m_s)
        safety.allow(Setpoint(speed_m_s), replace(seen(t_s), range_m=FAR), state, t_s)
        t_s += round_s
    began_s, frame_t_s = t_s, t_s - LIMITS.frame_age_s - 0.01
    while t_s - began_s < 60.0:
        state = flying(t_s, **obeyed(safety))
        if safety.allow(Setpoint(speed_m_s), replace(seen(t_s), range_m=FAR), state, frame_t_s).setpoint is None:
            break
        way_m += math.hypot(*safety.gate.horizontal.v) * round_s
        t_s += round_s
    return t_s - began_s, way_m


@pytest.mark.parametrize("round_s", [0.1, 0.15, 0.2, 0.3, 0.45])
@pytest.mark.parametrize("speed_m_s", [8.0, 15.0])
def test_however_slow_the_rounds_it_brakes_as_hard(round_s, speed_m_s):
    _, usual_m = flown_until_it_stands(DT, speed_m_s)
    seconds, metres = flown_until_it_stands(round_s, speed_m_s)
    assert seconds < 60.0
    assert metres <= usual_m + speed_m_s * round_s


@pytest.mark.parametrize("round_s", [0.03, 0.1, 0.15, 0.2, 0.3, 0.45])
def test_it_stops_in_front_of_a_target_that_vanished_however_slow_the_rounds(round_s):
    safety, t_s, north_m, gone_s, place_m, farthest_m = Safety(LIMITS), 0.0, 0.0, None, 12.0, 0.0
    safety.order(Order.FOLLOW)
    while t_s < 60.0:
        velocity = obeyed(safety)
        north_m, t_s = north_m + velocity["north_m_s"] * round_s, t_s + round_s
        if gone_s is None:
            place_m = max(place_m, north_m + 12.0)
            gone_s = t_s if velocity["north_m_s"] > 5.4 or t_s > 30.0 else None
        away_m = max(place_m - north_m, 0.1)
        sight = Estimate(
            t_s, 0.0, math.atan2(3.0, away_m), away_m, 0.1, 5.5, seen_t_s=gone_s or t_s, range_near_m=0.99 * away_m,
            ground_below_m=5.0, ground_std_m=0.1, target_height_m=2.0,
        )  # fmt: skip
        safety.allow(Setpoint(8.0), sight, flying(t_s, **velocity, north_m=north_m, down_m=-5.0), t_s)
        farthest_m = max(farthest_m, north_m)
    assert farthest_m < place_m


def test_a_program_that_is_slow_all_the_time_is_noted_and_one_long_round_is_not():
    safety, t_s = engaged()
    for gap_s in (DT, 0.45, *[DT] * 20, *[0.3] * 20):
        t_s += gap_s
        decision = safety.allow(HOVER, seen(t_s), flying(t_s, **obeyed(safety)), t_s)
        assert decision.mode == "follow"
        assert gap_s == 0.3 or not decision.notes
    assert decision.notes == ("slow: fewer than 4 rounds a second",)


@pytest.mark.parametrize("cause", [{"battery": BatteryLevel.LOW}, {"rc_healthy": False}])
@pytest.mark.parametrize(
    "where", [{"north_m": 500.0}, {"down_m": -150.0}, {"above_ground_m": 0.5}], ids=["fence", "ceiling", "floor"]
)
def test_a_reason_to_stop_ends_following_also_outside_the_limits(cause, where):
    """Outside a limit the gate moves the vehicle back; this must not keep the stream alive after a reason to stop."""
    safety, t_s = engaged(home_t_s=0.0, rc_healthy=True)
    moved_m = 0.0
    for _ in range(round(10.0 / DT)):
        t_s += DT
        state = flying(t_s, **{**obeyed(safety), **where}, home_t_s=0.0, above_ground_t_s=t_s, rc_healthy=True)
        decision = safety.allow(HOVER, seen(t_s), replace(state, **cause), t_s)
        moved_m += math.hypot(*safety.gate.horizontal.v, *safety.gate.down.v) * DT
        if decision.setpoint is None:
            break
    assert decision.mode == "ended"
    assert moved_m < 0.1


@pytest.mark.parametrize("seen_for_s", [0.0, 600.0])
def test_a_rangefinder_that_sticks_low_does_not_lead_over_the_ceiling_or_far_above_the_target(seen_for_s):
    safety, t_s = engaged()
    height_m, start_s = 20.0, t_s
    while t_s < start_s + 300.0:
        t_s += 0.1
        velocity = obeyed(safety)
        height_m -= velocity["down_m_s"] * 0.1
        sight = replace(
            seen(min(t_s, start_s + seen_for_s)), t_s=t_s, depression_rad=math.atan2(height_m - 1.0, 12.0),
            ground_below_m=height_m, ground_std_m=0.3, target_height_m=1.8,
        )  # fmt: skip
        state = flying(t_s, **velocity, down_m=-height_m, above_ground_t_s=t_s, above_ground_m=0.5)
        safety.allow(HOVER, sight, state, t_s)
    assert height_m < LIMITS.above_target_m + 5.0


def test_below_the_floor_and_above_the_ceiling_at_once_it_keeps_its_height():
    state = flying(1.0, down_m=-150.0, above_ground_t_s=1.0, above_ground_m=0.5)
    for down in (-3.0, 0.0, 3.0):
        assert limit_altitude(down, UNKNOWN, state, LIMITS) == 0.0


def test_a_sighting_in_the_future_is_ignored():
    safety, t_s = engaged()
    for _ in range(round(5.0 / DT)):
        t_s += DT
        decision = safety.allow(Setpoint(2.0), replace(seen(t_s), seen_t_s=100.0), flying(t_s, **obeyed(safety)), t_s)
    assert decision.mode != "follow"
    assert decision.setpoint is None or decision.setpoint.forward_m_s == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize("start_s", [0.0, 1e-9, 5.0])
def test_the_gate_gets_ready_for_any_start_of_the_clock(start_s):
    safety = Safety(LIMITS)
    for i in range(round((LIMITS.ready_after_s + 1.0) / DT)):
        t_s = start_s + i * DT
        state = flying(t_s, in_control=False, mode="POSCTL")
        decision = safety.allow(HOVER, seen(t_s), state, t_s)
    assert decision.mode == "ready"


@pytest.mark.parametrize("speed_m_s", [1.4, 2.5, 6.0])
def test_control_of_a_vehicle_that_stands_despite_its_setpoints_is_given_up(speed_m_s):
    """The uplink is lost: when it returns, the setpoint must not have wound up meanwhile."""
    safety, t_s = engaged()
    rounds = fly(safety, t_s, 8.0, Setpoint(speed_m_s), north_m_s=0.1, east_m_s=0.0)
    began = next(i for i, d in enumerate(rounds) if d.reason.cause is Cause.NOT_OBEYING)
    assert began * DT < LIMITS.disobey_after_s + 2.0
    assert rounds[-1].setpoint is None


def out_of_reach(cut_m_s, seconds):
    """The rounds of a target that runs away at 7.5 m/s; a limit takes `cut_m_s` off the desired speed, by round."""
    reach, told = TargetReach(), []
    for i in range(round(seconds / DT)):
        t_s = i * DT
        target = Worst(0.0, 20.0 + 2.5 * t_s, 5.0, 7.5)
        state = flying(t_s, north_m_s=5.0)
        reach = watched_reach(reach, Setpoint(5.0 + cut_m_s(i)), (5.0, 0.0), target, state, LIMITS)
        told.append(bool(reach.told))
    return told, reach, state


def test_a_target_that_runs_away_is_not_in_reach_again_because_a_limit_took_less_for_a_moment():
    told, reach, state = out_of_reach(lambda i: 0.4 if i % 100 == 99 and i > 300 else 2.0, 60.0)
    first = told.index(True)
    assert first * DT < LIMITS.reach_after_s + 1.0
    assert all(told[first:])
    assert given_up(reach, state, LIMITS)


def test_a_target_is_in_reach_again_when_no_limit_keeps_the_vehicle_from_it_for_long():
    told, _, _ = out_of_reach(lambda i: 2.0 if i * DT < 20.0 else 0.0, 40.0)
    assert told[round(20.0 / DT) - 1]
    assert not told[-1]


@pytest.mark.parametrize("speed_m_s", [1.4, 8.0])
def test_the_stream_ends_when_the_vehicle_stands_and_not_while_it_lags_behind(speed_m_s):
    """Given back earlier, the autopilot would fly it on, or back, to a place of its own."""
    safety, t_s = engaged()
    flown = sent = 0.0
    safety.order(Order.FOLLOW)
    for i in range(round(40.0 / DT)):
        t_s += DT
        flown += (safety.gate.horizontal.v[0] - flown) * (1.0 - math.exp(-DT / LAG_S))
        if i == round(15.0 / DT):
            safety.order(Order.LEAVE)
        target = replace(seen(t_s), range_m=FAR)
        decision = safety.allow(Setpoint(speed_m_s), target, flying(t_s, north_m_s=flown), t_s)
        if decision.setpoint is None:
            break
        sent = decision.setpoint.forward_m_s
    assert decision.mode == "ended"
    assert sent == pytest.approx(0.0, abs=0.05)
    assert abs(flown) < 0.2
    assert t_s < 15.0 + speed_m_s / LIMITS.accel_m_s2 + 4.0
