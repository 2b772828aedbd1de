import math
from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from follow.messages import HOVER, NEVER, Estimate, Landed, Mode, Order, Setpoint, VehicleState
from follow.safety.distance import Worst, approach_speed
from follow.safety.envelope import HELD, in_view, limit_altitude, limit_to_fence
from follow.safety.gate import Gate, Limits, Safety, decide, present_velocity
from follow.safety.ramps import VelocityRamp, YawRateRamp
from tests.support.gate_rig import DT, LIMITS, engaged, fly, flying, seen

any_float = st.floats(allow_nan=True, allow_infinity=True)
desired_setpoints = st.builds(Setpoint, any_float, any_float, any_float, any_float)


@given(st.lists(st.tuples(desired_setpoints, st.floats(-0.2, 0.5), any_float, any_float), min_size=1, max_size=40))
@settings(deadline=None)
def test_no_desired_setpoint_passes_a_limit_whatever_comes(rounds):
    safety, t_s = engaged()
    gate = safety.gate
    for desired, dt, yaw, number in rounds:
        t_s += dt
        state = flying(t_s, yaw_rad=yaw if number == number else 0.3, north_m=number, east_m_s=yaw)
        safety.allow(desired, seen(t_s), state, t_s)
        before, gate = gate, safety.gate
        check(before, gate, min(max(dt, 0.0), 0.5))


def check(before, gate, dt):
    """The limits, read off two states of the gate by plain arithmetic."""
    slack = 1e-9
    assert math.hypot(*gate.horizontal.v) <= LIMITS.speed_m_s + slack
    assert abs(gate.down.v[0]) <= LIMITS.climb_m_s + slack
    assert abs(gate.yaw.rate) <= LIMITS.yaw_rate_rad_s + slack
    assert math.dist(before.horizontal.v, gate.horizontal.v) <= LIMITS.accel_m_s2 * dt + slack
    assert abs(before.down.v[0] - gate.down.v[0]) <= LIMITS.climb_accel_m_s2 * dt + slack
    assert abs(before.yaw.rate - gate.yaw.rate) <= LIMITS.yaw_accel_rad_s2 * dt + slack
    jerk = math.dist(before.horizontal.a or (0, 0), gate.horizontal.a or (0, 0))
    assert jerk <= LIMITS.jerk_m_s3 * dt + slack


@given(desired_setpoints, any_float, any_float, any_float, any_float)
@settings(deadline=None)
def test_what_comes_out_is_finite_or_nothing(desired, t_s, frame_t_s, number, seen_t_s):
    safety, _ = engaged()
    state = flying(t_s, yaw_rad=number, down_m=number, north_m_s=number, yaw_rate_rad_s=number)
    decision = safety.allow(desired, seen(seen_t_s), state, frame_t_s)
    assert decision.setpoint is None or decision.setpoint.is_finite()


@given(
    st.lists(st.tuples(st.floats(-30, 30), st.floats(-30, 30), st.floats(0.0, 0.1)), max_size=60),
    st.floats(0.5, 10),
    st.floats(0.5, 5),
    st.floats(0.5, 20),
)
def test_a_ramp_keeps_speed_acceleration_and_jerk(goals, speed, accel, jerk):
    velocity = VelocityRamp()
    for north, east, dt in goals:
        before, velocity = velocity, velocity.towards((north, east), dt, speed, accel, jerk)
        assert math.hypot(*velocity.v) <= speed * (1 + 1e-9)
        assert math.dist(before.v, velocity.v) <= accel * dt + 1e-9
        assert math.dist(before.a or (0, 0), velocity.a) <= jerk * dt + 1e-9


def test_a_ramp_arrives_and_stays():
    velocity = VelocityRamp()
    for _ in range(200):
        velocity = velocity.towards((3.0, -1.0), DT, 8.0, 2.5, 10.0)
    assert velocity.v == pytest.approx((3.0, -1.0), abs=1e-3)


def test_a_yaw_rate_ramps():
    assert YawRateRamp(0.0).towards(9.0, 0.1, 1.5, 6.0) == YawRateRamp(pytest.approx(0.6))


def test_nothing_is_sent_before_the_operators_order():
    assert all(d.setpoint is None for d in fly(Safety(LIMITS), 0.0, 5.0, Setpoint(1.0)))


def test_the_first_setpoint_is_the_present_velocity():
    safety = Safety(LIMITS)
    safety.order(Order.FOLLOW)
    moving = {"yaw_rad": 0.7, "north_m_s": 1.5, "east_m_s": -0.5, "down_m_s": 0.2, "yaw_rate_rad_s": 0.1}
    spoken = [d for d in fly(safety, 0.0, 0.2, HOVER, **moving) if d.setpoint]
    first, state = spoken[0].setpoint, flying(0.0, **moving)
    assert first is not None
    assert (first.forward_m_s, first.right_m_s, first.down_m_s) == pytest.approx(state.body_velocity_m_s())
    assert first.yaw_rate_rad_s == pytest.approx(0.1)


@pytest.mark.parametrize("error_m", [3.0, -3.0, 8.0, -8.0, 20.0, -20.0])
@pytest.mark.parametrize("known_by", ["home", "report", "rangefinder"])
def test_the_floor_is_above_the_ground_wherever_the_estimators_zero_lies(error_m, known_by):
    """The vehicle truly sinks from 6 m; its z is wrong by `error_m`."""
    safety, t_s = engaged()
    height, lowest = 6.0, 6.0
    for i in range(1, round(20.0 / DT)):
        now = t_s + i * DT
        down_m_s = safety.gate.down.v[0]
        height -= down_m_s * DT
        lowest = min(lowest, height)
        known = {
            "home": {"home_t_s": now, "home_down_m": error_m},
            "report": {"above_home_t_s": now, "above_home_m": height},
            "rangefinder": {"above_ground_t_s": now, "above_ground_m": height},
        }[known_by]
        state = flying(now, down_m=error_m - height, down_m_s=down_m_s, **known)
        safety.allow(Setpoint(down_m_s=2.0), seen(now), state, now)
    assert lowest >= LIMITS.floor_m - 0.05
    if error_m < 0.0:  # else the target's head, by z alone as its ground is not known here, forbids the descent
        assert lowest <= LIMITS.floor_m + 0.5


@given(st.floats(-20, 20), st.floats(-20, 20), st.floats(-3, 3), st.floats(0, 8), st.floats(0, 10), st.floats(-9, 9))
def test_the_velocity_at_the_start_keeps_the_speed_limit(north, east, sight, range_m, above, approach):
    """A retreat at the full limit beside a fast motion across was up to 11.3 m/s."""
    state = VehicleState(0.0, north_m_s=north, east_m_s=east, down_m=-8.0)
    velocity = present_velocity(Worst(sight, range_m, above, approach), state, LIMITS)
    assert math.hypot(*velocity[:2]) <= LIMITS.speed_m_s + 1e-9


@pytest.mark.parametrize("error_m", [3.0, 8.0])
def test_follow_is_not_refused_because_the_estimators_zero_lies_low(error_m):
    safety = Safety(LIMITS)
    safety.order(Order.FOLLOW)
    state = flying(0.1, down_m=error_m - 6.0, home_t_s=0.1, home_down_m=error_m, in_control=False, mode="HOLD")
    safety.allow(HOVER, seen(0.1), state, 0.1)
    assert safety.allow(HOVER, seen(0.2), replace(state, t_s=0.2, heartbeat_t_s=0.2), 0.2).mode == "engage"


@pytest.mark.parametrize(("height", "sink"), [(LIMITS.floor_m + 0.2, 2.0), (LIMITS.floor_m + 1.0, 1.0)])
def test_engaging_does_not_continue_a_descent_through_the_floor(height, sink):
    safety = Safety(LIMITS)
    safety.order(Order.FOLLOW)
    sinking = fly(safety, 0.0, 2.0, HOVER, in_control=False, down_m=-height, down_m_s=sink)
    sent = [d.setpoint.down_m_s for d in sinking if d.setpoint]
    assert sent
    assert max(sent) <= max((height - LIMITS.floor_m) / 1.5, 0.0) + 1e-9


def test_engaging_does_not_continue_a_fast_approach_to_the_target():
    safety = Safety(LIMITS)
    safety.order(Order.FOLLOW)
    for n in range(60):
        t_s = n * DT
        state = flying(t_s, in_control=False, down_m=-2.0, north_m_s=4.0)
        near = Estimate(t_s, 0.0, 0.4, LIMITS.min_standoff_m + 0.3, 0.1, seen_t_s=t_s)
        decision = safety.allow(HOVER, near, state, t_s)
        assert decision.setpoint is None or decision.setpoint.forward_m_s <= 0.1 / 1.5
    assert decision.mode == "engage"


def test_control_of_an_autopilot_that_does_not_obey_is_given_up():
    safety = Safety(LIMITS)
    safety.order(Order.FOLLOW)
    decisions = fly(safety, 0.0, 8.0, HOVER, in_control=False)
    assert decisions[-1].mode is Mode.ENDED
    assert decisions[-1].setpoint is None


STALLS = ({"frame_t_s": 0.5}, {"attitude_t_s": 0.5}, {"position_t_s": 0.1}, {"seen_t_s": 0.5})


def engaging():
    """A gate that has been streaming for half a second to an autopilot that does not obey yet, flying at 2 m/s."""
    safety = Safety(LIMITS)
    safety.order(Order.FOLLOW)
    assert fly(safety, 0.0, 0.5, HOVER, in_control=False, north_m_s=2.0)[-1].mode == "engage"
    return safety


@pytest.mark.parametrize("stall", STALLS)
def test_a_short_stall_while_engaging_costs_neither_the_order_nor_the_stream(stall):
    safety = engaging()
    stalled = fly(safety, 0.5, 0.8, HOVER, in_control=False, north_m_s=2.0, **stall)
    assert {d.mode for d in stalled} == {"engage"}
    assert all(d.setpoint is not None and d.setpoint.forward_m_s <= 2.0 for d in stalled)
    assert fly(safety, 1.3, 0.1, HOVER, in_control=False)[-1].mode == "engage"
    assert fly(safety, 1.4, 0.1, HOVER)[-1].mode == "follow"


@pytest.mark.parametrize("stall", STALLS)
def test_a_longer_stall_while_engaging_ends_it(stall):
    stalled = fly(engaging(), 0.5, LIMITS.stale_grace_s + 0.5, HOVER, in_control=False, **stall)
    assert (stalled[-1].mode, stalled[-1].setpoint) == ("ended", None)


def test_a_stall_while_engaging_ramps_to_zero_and_control_gained_in_it_waits_for_fresh_data():
    safety = engaging()
    fly(safety, 0.5, 0.3, HOVER, in_control=False, north_m_s=2.0, frame_t_s=0.5)
    late = fly(safety, 0.8, 0.6, Setpoint(3.0, yaw_rate_rad_s=1.0), north_m_s=2.0, frame_t_s=0.5)
    assert {d.mode for d in late} == {"engage"}
    assert late[-1].setpoint.forward_m_s < 1.0
    assert late[-1].setpoint.yaw_rate_rad_s == 0.0
    assert fly(safety, 1.4, 0.1, HOVER)[-1].mode == "follow"


@pytest.mark.parametrize(
    "gone", [{"armed": False}, {"landed": Landed.ON_GROUND}, {"landed": Landed.UNKNOWN}, {"landed_t_s": -5.0}]
)
def test_a_vehicle_that_is_not_in_the_air_ends_engaging_at_once(gone):
    (decision,) = fly(engaging(), 0.5, DT, HOVER, in_control=False, **gone)
    assert (decision.mode, decision.setpoint) == ("ended", None)


def test_a_takeover_ends_the_stream_at_once_and_for_good():
    safety, t_s = engaged()
    taken = fly(safety, t_s, DT, Setpoint(2.0), in_control=False)
    assert taken[0].setpoint is None
    assert all(d.setpoint is None for d in fly(safety, t_s + 1, 5.0, Setpoint(2.0)))


def test_the_operator_can_order_again_after_a_takeover():
    safety, t_s = engaged()
    fly(safety, t_s, DT, HOVER, in_control=False)
    safety.order(Order.FOLLOW)
    assert fly(safety, t_s + 1, 0.2, HOVER)[-1].mode == "follow"


def test_observe_stops_the_stream_at_once():
    safety, t_s = engaged()
    safety.order(Order.OBSERVE)
    assert fly(safety, t_s, DT, Setpoint(2.0))[0].setpoint is None


def test_a_lost_target_slows_the_vehicle_then_searches_then_holds():
    safety, t_s = engaged()
    fly(safety, t_s, 3.0, Setpoint(2.0, yaw_rate_rad_s=0.3))
    lost = fly(safety, t_s + 3, 30.0, Setpoint(2.0, yaw_rate_rad_s=0.3), seen_t_s=t_s + 3)
    modes = list(dict.fromkeys(d.mode for d in lost))
    assert modes == ["follow", "coast", "search", "hold"]
    searching = next(d for d in lost[::-1] if d.mode == "search")
    assert searching.setpoint == Setpoint(yaw_rate_rad_s=pytest.approx(0.3))
    assert lost[-1].setpoint == HOVER


@pytest.mark.parametrize(
    "stopped", ["frame", "attitude_t_s", "position_t_s", "heartbeat_t_s"], ids=lambda name: name.split("_")[0]
)
def test_stale_data_ramp_to_zero_and_stop_the_stream(stopped):
    safety, t_s = engaged()
    fly(safety, t_s, 3.0, Setpoint(2.0))
    t_s += 3
    old = {"frame_t_s": t_s} if stopped == "frame" else {stopped: t_s}
    decisions = fly(safety, t_s, 6.0, Setpoint(2.0), **old)
    assert decisions[-1].setpoint is None
    assert decisions[-1].mode == "ended"
    last = [d.setpoint for d in decisions if d.setpoint][-1]
    assert math.hypot(last.forward_m_s, last.right_m_s) < 0.1


def test_a_short_stall_does_not_end_following():
    safety, t_s = engaged()
    fly(safety, t_s, 0.4, Setpoint(2.0), frame_t_s=t_s)
    assert fly(safety, t_s + 0.4, 0.2, Setpoint(2.0))[-1].mode == "follow"


@pytest.mark.parametrize(("height", "desired"), [(1.5, 1.0), (101.0, -1.0)])
def test_outside_the_altitude_band_the_vehicle_returns_slowly(height, desired):
    safety, t_s = engaged()
    sent = fly(safety, t_s, 1.0, Setpoint(down_m_s=desired), down_m=-height)[-1].setpoint
    assert sent is not None
    assert 0 < -sent.down_m_s * math.copysign(1, desired) <= 0.5


def test_the_fence_stops_outward_but_not_inward_motion():
    safety, t_s = engaged()
    out = fly(safety, t_s, 4.0, Setpoint(3.0), north_m=300.5)[-1].setpoint
    back = fly(safety, t_s + 4, 4.0, Setpoint(-3.0), north_m=300.5)[-1].setpoint
    assert out is not None
    assert back is not None
    assert -0.5 <= out.forward_m_s < 0
    assert back.forward_m_s == pytest.approx(-LIMITS.out_of_view_m_s, abs=1e-2)


def test_the_gate_is_a_function_of_its_state():
    safety, t_s = engaged()
    args = (Setpoint(2.0), seen(t_s + DT), flying(t_s + DT), t_s + DT, LIMITS)
    assert decide(safety.gate, *args) == decide(safety.gate, *args)


def test_a_clock_that_jumps_back_changes_no_setpoint():
    safety, t_s = engaged()
    before = safety.gate
    safety.allow(Setpoint(5.0), seen(t_s - 50), flying(t_s - 50), t_s - 50)
    assert safety.gate.horizontal.v == before.horizontal.v


def test_above_a_near_target_it_retreats_and_does_not_descend():
    safety, t_s = engaged(down_m=-6.0)
    for i in range(1, 60):
        now = t_s + i * DT
        near = replace(seen(now), range_m=0.5, range_std_m=0.1)
        decision = safety.allow(Setpoint(down_m_s=1.0), near, flying(now, down_m=-5.9), now)
    assert decision.setpoint.forward_m_s < 0.0
    assert decision.setpoint.down_m_s < 0.0
    assert HELD["head"] in decision.notes


@pytest.mark.parametrize(
    "bad", [{"speed_m_s": 0.0}, {"accel_m_s2": math.nan}, {"floor_m": 200.0}, {"half_view_rad": 2.0}]
)
def test_impossible_limits_are_refused(bad):
    with pytest.raises(ValueError, match=r"limit|floor"):
        Limits(**bad)


def test_an_untouched_gate_observes():
    assert Gate().mode is Mode.OBSERVE
    assert Gate().t_s == NEVER


def test_an_order_that_cannot_be_granted_for_long_expires():
    safety = Safety(LIMITS)
    safety.order(Order.FOLLOW)
    fly(safety, 0.0, 31.0, HOVER, armed=False)
    assert fly(safety, 31.0, 1.0, HOVER)[-1].mode == "ready"


def test_after_holding_the_operator_can_order_again():
    safety, t_s = engaged()
    fly(safety, t_s, 30.0, HOVER, seen_t_s=t_s)
    assert fly(safety, t_s + 30, 1.0, HOVER)[-1].mode == "hold"
    safety.order(Order.FOLLOW)
    assert fly(safety, t_s + 31, 1.0, HOVER)[-1].mode == "follow"


def test_a_desired_setpoint_that_is_not_finite_hovers_and_says_so():
    safety, t_s = engaged()
    decision = fly(safety, t_s, 2.0, Setpoint(math.nan, 0.0, 0.0, 1.0))[-1]
    assert decision.setpoint == HOVER
    assert "the desired setpoint is not finite" in decision.notes


def test_an_estimate_that_is_not_finite_counts_as_unseen():
    safety, t_s = engaged()
    for i in range(1, 10):
        now = t_s + i * DT
        decision = safety.allow(Setpoint(2.0), replace(seen(now), range_m=math.nan), flying(now), now)
    assert decision.mode != "follow"


@given(st.floats(-20, 20), st.floats(-20, 20))
def test_outside_the_cameras_view_the_speed_is_limited_to_blind_speed(forward, right):
    f, r = in_view(forward, right, LIMITS)
    seen_angles = [LIMITS.half_view_rad * i / 50 for i in range(-50, 51)]
    lengths = [max(f * math.cos(a) + r * math.sin(a), 0.0) for a in seen_angles]
    off = min(math.hypot(f - k * math.cos(a), r - k * math.sin(a)) for k, a in zip(lengths, seen_angles, strict=True))
    assert off <= LIMITS.out_of_view_m_s + 0.02
    assert math.hypot(f, r) <= math.hypot(forward, right) + 1e-9


@given(st.floats(-9, 9), st.floats(-9, 9), st.floats(-500, 500), st.floats(-500, 500))
def test_beyond_the_fence_no_velocity_leads_outward(north, east, out_north, out_east):
    n, e = limit_to_fence(north, east, (out_north, out_east), LIMITS)
    if math.hypot(out_north, out_east) >= LIMITS.fence_m:
        assert n * out_north + e * out_east <= 1e-6


@pytest.mark.parametrize("speed", [2.0, 8.0])
def test_a_vehicle_with_a_late_response_stops_before_the_border(speed):
    """A vehicle with half a second of lag behind the ramps, flown at the border at full speed."""
    room, v, ramp = 60.0, 0.0, VelocityRamp()
    for _ in range(3000):
        ramp = ramp.towards((min(speed, approach_speed(max(room, 0.0), LIMITS.accel_m_s2)), 0.0), DT, 8.0, 2.5, 10.0)
        v += (ramp.v[0] - v) * DT / 0.5
        room -= v * DT
        assert room > -0.2
    assert room < 0.5


def test_a_note_says_which_speed_limit_acts():
    safety, t_s = engaged()
    wanted = Setpoint(LIMITS.speed_m_s + 1)
    assert HELD["speed"] in safety.allow(wanted, seen(t_s + DT), flying(t_s + DT), t_s + DT).notes
    for i in range(2, 12):
        now = t_s + i * DT
        decision = safety.allow(wanted, seen(t_s), flying(now), now)
    assert decision.mode is Mode.COAST
    assert HELD["unseen"] in decision.notes
    assert HELD["speed"] not in decision.notes


@given(st.floats(-0.5, 0.5), st.floats(0, 200))
def test_drift_is_compensated_at_floor_and_ceiling(drift, height_m):
    """At floor and ceiling what is allowed and the drift together stay within what is allowed without a drift."""
    state = flying(1.0, down_m=-height_m)
    still, drifting = (Worst(0.0, 12.0, 0.0, 0.0, drift_down_m_s=d) for d in (0.0, drift))
    fastest_up = -limit_altitude(-9.0, still, state, LIMITS)
    fastest_down = limit_altitude(9.0, still, state, LIMITS)
    if height_m >= LIMITS.ceiling_m:
        assert limit_altitude(-9.0, drifting, state, LIMITS) + min(drift, 0.0) >= -fastest_up - 1e-9
    if height_m <= LIMITS.floor_m:
        assert limit_altitude(9.0, drifting, state, LIMITS) + max(drift, 0.0) <= fastest_down + 1e-9
