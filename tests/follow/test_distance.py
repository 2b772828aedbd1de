"""The minimum distance: what the gate does when the target is near, comes nearer or vanished; and the response."""

import math
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from follow.messages import HOVER, Cause, Estimate, Mode, Order, Setpoint
from follow.safety.distance import (
    DRIFT_M_S,
    JOG_M_S,
    NOTICE_S,
    SPRINT_M_S,
    SPRINT_STANDOFF_M,
    STEADY_S,
    WALK_M_S,
    Sighting,
    Worst,
    closing_speed,
    gone,
    limit_closing_speed,
    limit_to_last_seen,
    needed_above_m,
    sprint_above_m,
    stopping_speed,
    unseen_bounds,
    walking,
    worst,
)
from follow.safety.envelope import HELD
from follow.safety.gate import Safety
from follow.safety.ramps import VelocityRamp
from tests.support.gate_rig import DT, LIMITS, engaged, fly, flying, obeyed, seen


@given(st.floats(-20, 20), st.floats(-3, 3), st.floats(0.1, 100), st.floats(0, 30), st.floats(2, 30), st.floats(-7, 7))
def test_approach_stops_at_the_stand_off_of_the_nearest_possible_range(speed, azimuth, away, std, height, toward):
    """Reference: the relative motion along the line of sight, braked at half the limit, ends outside the stand-off."""
    north, east = -toward * math.cos(azimuth), -toward * math.sin(azimuth)
    estimate = replace(seen(0.0), azimuth_rad=azimuth, range_m=away, range_std_m=std, north_m_s=north, east_m_s=east)
    target = worst(estimate, flying(0.0, down_m=-height), LIMITS)
    n, e = limit_closing_speed(speed * math.cos(azimuth), speed * math.sin(azimuth), target, LIMITS)
    closing = n * math.cos(azimuth) + e * math.sin(azimuth)
    near, above = max(away - 2 * std, 0.0), height - 2.0
    assert closing <= speed + 1e-9
    assert closing >= min(speed, -LIMITS.speed_m_s) - 1e-9
    needed = math.sqrt(max(LIMITS.min_standoff_m**2 - above**2, 0.0))
    relative = closing + toward
    if needed > 0 and relative > 0 and closing > -LIMITS.speed_m_s + 1e-6:
        assert near - relative**2 / LIMITS.accel_m_s2 >= needed - 1e-6
    assert max(closing, 0.0) ** 2 / (2 * LIMITS.accel_m_s2) + max(closing, 0.0) <= near + 1e-6


@given(st.floats(0.0, 30.0), st.floats(0.0, 10.0), st.floats(-7.0, 7.0))
def test_the_required_height_keeps_the_stand_off_at_the_nearest_point(away, above, toward):
    estimate = replace(seen(0.0), range_m=away, range_std_m=0.0, north_m_s=-toward)
    state = flying(0.0, down_m=-2.0 - above)
    target = worst(estimate, state, LIMITS)
    needed = needed_above_m(target, state, LIMITS)
    nearest = max(away - max(toward, 0.0) ** 2 / 5.0 - 3.5 * max(toward, 0.0), 0.0)  # 1 s, ramp 0.5 s, 4 m at 2 m/s
    assert math.hypot(nearest, needed) >= LIMITS.min_standoff_m - 1e-6


@pytest.mark.parametrize("speed", [3.0, 5.0, 7.0])
def test_a_vehicle_stops_before_the_place_where_its_target_vanished(speed):
    """A doorway: the target vanishes; the loss is detected after 0.25 s, and the vehicle has a lag of 0.6 s."""
    room = (speed + 2.5) ** 2 / 5.0 - 2.5 / 2  # from which stopping_speed allows this speed
    assert stopping_speed(room, LIMITS.accel_m_s2) == pytest.approx(speed)
    v, north, ramp = speed, -room + 0.25 * speed, VelocityRamp((speed, 0.0))
    for _ in range(600):
        state = flying(0.0, north_m=north)
        desired = limit_to_last_seen(speed, 0.0, Sighting(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0), state, LIMITS)
        ramp = ramp.towards(desired, DT, 8.0, 2.5, 10.0)
        v += (ramp.v[0] - v) * DT / 0.6
        north += v * DT
    assert north < 0.0
    assert abs(v) < 0.3


def test_follow_is_not_granted_from_inside_the_stand_off():
    safety = Safety(LIMITS)
    safety.order(Order.FOLLOW)
    for i in range(120):
        t_s = i * DT
        near = replace(seen(t_s), range_m=2.2, range_std_m=0.1)
        decision = safety.allow(HOVER, near, flying(t_s, down_m=-3.0), t_s)
        assert decision.setpoint is None
    assert decision.reason.cause is Cause.ORDER_VOID
    assert "nearer than 4 m" in str(decision.reason)


@pytest.mark.parametrize("toward", [1.4, 3.0, 6.0])
def test_a_target_that_comes_nearer_makes_the_gate_retreat_and_climb_against_the_servo(toward):
    safety, t_s = engaged(down_m=-4.0)
    coming = replace(seen(t_s + DT), range_m=5.0, range_std_m=0.2, north_m_s=-toward)
    for i in range(1, 45):
        now = t_s + i * DT
        state = flying(now, down_m=-4.0, **{**obeyed(safety), "down_m_s": 0.0})
        decision = safety.allow(Setpoint(3.0, 0.0, 1.0), replace(coming, t_s=now, seen_t_s=now), state, now)
    assert decision.setpoint.forward_m_s < -0.5
    if toward >= 3.0:  # a walker is outrun along the ground
        assert decision.setpoint.down_m_s < 0.0
    assert HELD["stand-off"] in decision.notes


@given(st.floats(0.0, 40.0), st.sampled_from([(SPRINT_M_S, SPRINT_STANDOFF_M), (JOG_M_S, LIMITS.min_standoff_m)]))
def test_from_the_height_that_a_run_requires_the_stand_off_is_kept(away, run):
    """Reference: the climb step by step, with the delay, until the runner is below."""
    speed, least = run
    above = sprint_above_m(away, LIMITS)
    rate, t_s = 0.0, 0.0
    while t_s < away / speed:
        t_s += 1e-3
        if t_s > NOTICE_S:
            rate = min(rate + LIMITS.climb_accel_m_s2 * 1e-3, LIMITS.climb_m_s)
        above += rate * 1e-3
    assert above >= least - 0.01
    assert sprint_above_m(away, LIMITS) <= LIMITS.min_standoff_m


@given(
    st.floats(0.0, 40.0),
    st.floats(0.0, 4.0),
    st.sampled_from([(SPRINT_M_S, SPRINT_STANDOFF_M), (JOG_M_S, LIMITS.min_standoff_m)]),
)
def test_an_unseen_runner_is_evaded_upward_from_the_height_that_a_run_requires(away, higher, run):
    """Reference: the climb step by step, begun after 0.15 s, by a vehicle with a lag of 0.6 s."""
    speed, least = run
    above = sprint_above_m(away, LIMITS) + higher
    seen_last = Sighting(away, 0.0, 0.0, 0.0, -1.8, -1.8 - above, -STEADY_S)
    down, v, ramp, t_s = -1.8 - above, 0.0, VelocityRamp((0.0,)), 0.0
    nearest, highest = math.inf, above
    while t_s < away / speed + 3.0:
        t_s += DT
        state = flying(t_s, down_m=down, north_m=0.0)
        wanted = 0.0
        if t_s > 0.15:
            fastest_down, fastest_up = unseen_bounds(seen_last, state, LIMITS)
            wanted = max(min(0.0, fastest_down), -fastest_up)
        ramp = ramp.towards((wanted,), DT, LIMITS.climb_m_s, LIMITS.climb_accel_m_s2, LIMITS.jerk_m_s3)
        v += (ramp.v[0] - v) * DT / 0.6
        down += v * DT
        nearest = min(nearest, math.hypot(max(away - speed * t_s, 0.0), -1.8 - down))
        highest = max(highest, -1.8 - down)
    assert nearest >= least - 0.05
    way_m = LIMITS.climb_m_s**2 / (2 * LIMITS.climb_accel_m_s2) + 0.6 * LIMITS.climb_m_s  # of braking, and the lag
    begun = sprint_above_m(away, LIMITS) + higher
    assert highest <= max(begun, LIMITS.min_standoff_m + way_m) + 1e-6  # it flees from no guess


@given(st.floats(0.0, 40.0), st.floats(-math.pi, math.pi), st.floats(0.0, 4.0), st.floats(0.0, 6.0), st.floats(-7, 7))
def test_the_closing_speed_to_an_unseen_walker_is_that_to_a_visible_one(away, sight, unseen_s, above, toward):
    """Reference: the stand-off to a visible person who has walked towards the vehicle since the last sighting."""
    state = flying(unseen_s, down_m=-above)
    place = away * math.cos(sight), away * math.sin(sight)
    behind = Worst(sight, 100.0, above, toward)  # the estimate lets him go on
    unseen = walking(behind, Sighting(*place, sight, 0.0, 0.0, 0.0, 0.0), state)
    seen_walk = Worst(sight, max(away - WALK_M_S * unseen_s, 0.0), above, max(WALK_M_S, toward))
    assert closing_speed(unseen, LIMITS) == pytest.approx(closing_speed(seen_walk, LIMITS))
    assert closing_speed(unseen, LIMITS) <= closing_speed(behind, LIMITS)
    assert walking(gone(None, state), Sighting(*place, sight, 0.0, 0.0, 0.0, 0.0), state) == gone(None, state)


@pytest.mark.parametrize(("jump_m", "mode_s"), [(0.0, 2.0), (0.0, 8.0), (-5.0, 2.0)])
def test_a_low_vehicle_whose_target_is_lost_climbs_above_an_approaching_person_and_no_further(jump_m, mode_s):
    """Also in SEARCH, and when the autopilot's height jumps; no horizontal retreat from a predicted position."""
    safety, t_s = engaged(down_m=-3.0)
    high_m, down, reset, notes = 3.0, -3.0, {}, set()
    for i in range(1, round(mode_s / DT)):
        now = t_s + i * DT
        if i == 20 and jump_m:
            down, reset = down + jump_m, {"resets": 1, "reset_t_s": now, "reset_down_m": jump_m}
        low = replace(seen(now), seen_t_s=t_s, range_m=9.0, ground_below_m=high_m, ground_std_m=0.1)
        state = flying(now, down_m=down, **{**obeyed(safety), **reset})
        decision = safety.allow(Setpoint(1.0, 0.0, 0.5), low, state, now)
        down += safety.gate.down.v[0] * DT
        high_m -= safety.gate.down.v[0] * DT
        notes |= set(decision.notes)
    assert decision.mode == ("coast" if mode_s < 4.0 else "search")
    assert HELD["below"] in notes
    if mode_s > 4.0:  # a head at 2 m, 0.2 m for the ground's uncertainty; 1 m of braking
        assert 6.2 <= high_m <= 7.3
    else:
        assert 5.0 <= high_m <= 7.3


@pytest.mark.parametrize(("shows_s", "hides_s"), [(0.1, 1.0), (0.4, 2.6), (0.6, 6.0), (2.0, 6.0)])
def test_repeated_short_sightings_at_the_vehicles_own_height_cause_only_a_bounded_climb(shows_s, hides_s):
    """A box that is fixed in the image, or a far object: after each loss its predicted head is at our height."""
    safety, t_s = engaged(down_m=-6.0)
    down, seen_s, head_m, highest = -6.0, t_s, 6.0, 6.0
    for i in range(1, round(60.0 / DT)):
        now = t_s + i * DT
        if (i * DT) % (shows_s + hides_s) < shows_s:
            seen_s, head_m = now, -down
        below_m = 2.0 - down - head_m
        level = replace(seen(now), seen_t_s=seen_s, range_m=9.0, ground_below_m=below_m, ground_std_m=0.1)
        state = flying(now, down_m=down, **obeyed(safety))
        safety.allow(Setpoint(), level, state, now)
        down += safety.gate.down.v[0] * DT
        highest = max(highest, -down)
    way_m = LIMITS.climb_m_s**2 / (2 * LIMITS.climb_accel_m_s2)
    seen_m = LIMITS.climb_m_s * 60.0 / (shows_s + hides_s) * shows_s  # while it is seen the vehicle evades it
    assert 8.0 < highest <= 6.0 + LIMITS.min_standoff_m + way_m + seen_m


@pytest.mark.parametrize(
    ("limit", "name"), [({"ceiling_m": 5.0}, "ceiling"), ({"above_target_m": 2.0}, "above target")]
)
def test_the_climb_above_an_unseen_target_ends_at_the_limits_and_is_reported(limit, name):
    """Also in SEARCH, where the target may be anywhere along the ground, but no deeper than it was."""
    safety, t_s = engaged(down_m=-3.0)
    safety.limits = replace(LIMITS, **limit)
    down = -3.0
    for i in range(1, round(9.0 / DT)):
        now = t_s + i * DT
        low = replace(seen(now), seen_t_s=t_s, range_m=9.0, ground_below_m=-down, ground_std_m=0.1)
        decision = safety.allow(Setpoint(), low, flying(now, down_m=down, **obeyed(safety)), now)
        down += safety.gate.down.v[0] * DT
    assert decision.mode == "search"
    assert -down <= 5.0 + 0.3  # a head at 2 m, less 0.2 m, and 2 m; the ramp's own lag
    assert HELD["below"] not in decision.notes
    assert HELD[name] in decision.notes


def test_a_vehicle_that_stops_does_not_climb_over_a_target_that_it_lost():
    safety, t_s = engaged(down_m=-3.0)
    safety.order(Order.OBSERVE)
    for i in range(1, 30):
        now = t_s + i * DT
        low = replace(seen(now), seen_t_s=t_s, ground_below_m=3.0, ground_std_m=0.1, target_height_m=1.8)
        decision = safety.allow(HOVER, low, flying(now, down_m=-3.0), now)
        assert decision.setpoint is None or abs(decision.setpoint.down_m_s) < 1e-6


def test_lower_than_a_run_allows_the_gate_climbs_although_nobody_runs():
    safety, t_s = engaged(down_m=-3.0)
    now = t_s + DT
    for i in range(1, 60):
        now = t_s + i * DT
        low = replace(seen(now), range_std_m=0.1, ground_below_m=3.0, ground_std_m=0.1, target_height_m=1.8)
        state = flying(now, down_m=-3.0, **{**obeyed(safety), "down_m_s": 0.0})
        decision = safety.allow(Setpoint(0.0, 0.0, 0.5), low, state, now)
    assert decision.setpoint.down_m_s < -0.5
    assert HELD["head"] in decision.notes


def test_the_floor_is_that_of_the_rangefinder_where_it_is_lower():
    safety, t_s = engaged()
    low = fly(safety, t_s, 3.0, Setpoint(down_m_s=1.0), down_m=-10.0, above_ground_m=1.5, above_ground_t_s=t_s + 2.2)
    assert low[-1].setpoint.down_m_s < 0.0
    old = fly(safety, t_s + 3.0, 3.0, Setpoint(down_m_s=1.0), down_m=-10.0, above_ground_m=1.5, above_ground_t_s=0.0)
    assert old[-1].setpoint.down_m_s > 0.5


def test_a_climb_ends_at_its_height_above_the_target():
    safety, t_s = engaged()
    high = fly(safety, t_s, 3.0, Setpoint(down_m_s=-2.0), down_m=-27.5)[-1]
    assert high.setpoint.down_m_s == pytest.approx(0.0, abs=1e-3)
    assert HELD["above target"] in high.notes


def test_control_of_a_vehicle_that_does_not_follow_setpoints_is_given_up():
    safety, t_s = engaged()
    standing = fly(safety, t_s, 10.0, Setpoint(4.0), north_m_s=0.0, east_m_s=0.0)
    causes = list(dict.fromkeys(d.reason.cause for d in standing))
    assert causes == [Cause.BEGAN, Cause.NOT_OBEYING, Cause.STOPPED]
    began = next(i for i, d in enumerate(standing) if d.reason.cause is Cause.NOT_OBEYING)
    assert began * DT < 4.0
    assert standing[-1].setpoint is None


def test_a_vehicle_that_lags_or_drifts_as_real_ones_do_obeys():
    safety, t_s = engaged()
    v = 0.0
    for i in range(1, 900):
        now = t_s + i * DT
        v += (safety.gate.horizontal.v[0] - v) * DT / 0.9
        state = flying(now, north_m_s=v + 0.5, down_m_s=0.3 * math.sin(now))
        decision = safety.allow(Setpoint(6.0 if i // 150 % 2 else -1.0), seen(now), state, now)
    assert decision.mode is Mode.FOLLOW


def test_stored_positions_move_with_the_autopilots_origin():
    safety, t_s = engaged()
    place, centre = safety.gate.last_seen, safety.gate.fence_centre
    moved = {"resets": 1, "reset_north_m": 5.0, "reset_east_m": -2.0, "north_m": 5.0, "east_m": -2.0}
    safety.allow(HOVER, seen(t_s), flying(t_s + DT, **moved), t_s + DT)
    now = safety.gate.last_seen
    assert (now.north_m, now.east_m) == pytest.approx((place.north_m + 5.0, place.east_m - 2.0))
    assert safety.gate.fence_centre == pytest.approx((centre[0] + 5.0, centre[1] - 2.0))


def test_an_origin_that_moves_before_any_position_is_stored_changes_nothing():
    safety = Safety()
    safety.allow(HOVER, seen(0.0), flying(0.0, resets=1, reset_north_m=5.0), 0.0)
    assert safety.gate.resets == 1
    assert safety.gate.fence_centre is None or safety.gate.fence_centre[0] != 5.0


@given(st.floats(-3, 3), st.floats(0, 100), st.floats(0, 30), st.floats(-7, 7), st.floats(-0.5, 0.5), st.floats(0, 6.3))
def test_a_drift_towards_the_target_is_compensated(azimuth, away, height, toward, drift, course):
    """With a drift, the position (velocity plus drift) closes in no faster than without one."""
    north, east = -toward * math.cos(azimuth), -toward * math.sin(azimuth)
    still = replace(seen(0.0), azimuth_rad=azimuth, range_m=away, north_m_s=north, east_m_s=east)
    drifting = replace(still, drift_north_m_s=drift * math.cos(course), drift_east_m_s=drift * math.sin(course))
    state = flying(0.0, down_m=-height)
    without, target = worst(still, state, LIMITS), worst(drifting, state, LIMITS)
    closes = closing_speed(target, LIMITS) + drift * math.cos(course - azimuth)
    assert closes <= max(closing_speed(without, LIMITS), -LIMITS.speed_m_s + DRIFT_M_S) + 1e-9
    assert closing_speed(target, LIMITS) <= closing_speed(without, LIMITS)
    assert needed_above_m(target, state, LIMITS) >= needed_above_m(without, state, LIMITS)


def test_far_above_the_target_only_the_clear_distance_limits_the_closing_speed():
    above = Worst(0.0, 3.0, LIMITS.min_standoff_m + 1.0, 0.0)
    open_field = replace(LIMITS, clear_distance=0.0)
    assert math.isinf(closing_speed(above, open_field))
    assert closing_speed(above, replace(LIMITS, clear_distance=1.0)) == stopping_speed(3.0, LIMITS.accel_m_s2)


@pytest.mark.parametrize(("speed", "accel", "standoff"), [(8.0, 2.5, 21.0), (15.0, 4.0, 44.0)])
def test_the_stand_off_that_the_clear_distance_of_a_cyclist_or_car_needs(speed, accel, standoff):
    """docs/hazards.md lists these stand-offs as the cost of the rule, which is off for cyclists and cars."""
    limits = replace(LIMITS, accel_m_s2=accel)
    assert (
        closing_speed(Worst(0.0, standoff, 20.0, 0.0), limits)
        >= speed
        > closing_speed(Worst(0.0, standoff - 1.0, 20.0, 0.0), limits)
    )


def test_the_fence_is_centred_on_home_and_does_not_move_with_orders():
    home = {"home_t_s": 0.0, "home_north_m": -290.0}
    safety, t_s = engaged(**home)
    out = fly(safety, t_s, 4.0, Setpoint(3.0), north_m=10.5, **home)[-1].setpoint
    assert out.forward_m_s < 0.0


def test_an_external_contradiction_brakes_and_then_ends():
    safety, t_s = engaged()
    fly(safety, t_s, 3.0, Setpoint(2.0))
    modes, t_s = [], t_s + 3.0
    for i in range(1, 150):
        now = t_s + i * DT
        state = flying(now, **obeyed(safety))
        safety.consistency.words, safety.consistency.until_s = "the image does not move", math.inf
        decision = safety.allow(Setpoint(2.0), seen(now), state, now)
        modes.append(decision.mode)
    assert list(dict.fromkeys(modes)) == [Mode.BRAKE, Mode.ENDED]
    assert str(decision.reason) == "stopped: the image does not move"


def outrun(fence_m=300.0, run_m_s=9.0, seconds=120.0):
    """A gate whose servo demands the target's speed and more; returns (time, mode, reason) of each change."""
    limits = replace(LIMITS, fence_m=fence_m, clear_distance=0.0)
    safety, t_s = engaged()
    safety.limits = limits
    north, target, changes = 0.0, 12.0, []
    for i in range(1, round(seconds / DT)):
        now = t_s + i * DT
        north += safety.gate.horizontal.v[0] * DT
        target += run_m_s * DT if i * DT < 60.0 else 0.0
        e = Estimate(now, 0.0, 0.4, target - north, 0.5, north_m_s=run_m_s, seen_t_s=now)
        state = flying(now, north_m=north, **obeyed(safety))
        wanted = Setpoint(forward_m_s=run_m_s + 0.35 * (target - north - 12.0))
        decision = safety.allow(wanted, e, state, now)
        key = (decision.mode.value, decision.reason.cause)
        if not changes or changes[-1][1:] != key:
            changes.append((i * DT, *key))
        if decision.setpoint is None:
            break
    return changes, target - north


def test_a_target_that_outruns_the_vehicle_is_reported_and_given_up_in_hold_which_ends():
    changes, _ = outrun()
    assert [change[1] for change in changes] == ["follow", "follow", "hold", "ended"]
    assert [change[2] for change in changes][1:] == [Cause.OUT_OF_REACH, Cause.OUT_OF_REACH, Cause.HOLD_OVER]
    told_s, hold_s, ended_s = (change[0] for change in changes[1:])
    assert 5.0 <= told_s < 10.0
    assert hold_s - told_s == pytest.approx(LIMITS.out_of_reach_s - LIMITS.reach_after_s, abs=2.0)
    assert ended_s - hold_s == pytest.approx(LIMITS.hold_timeout_s, abs=0.1)


def test_a_target_beyond_the_fence_is_followed_at_a_distance_and_taken_again():
    changes, _ = outrun(fence_m=100.0, run_m_s=3.0, seconds=60.0)
    assert ("follow", Cause.OUT_OF_REACH) in [change[1:] for change in changes]


def test_a_target_that_the_vehicle_approaches_at_the_speed_limit_is_in_reach():
    changes, range_m = outrun(fence_m=1000.0, run_m_s=7.0, seconds=55.0)
    assert [change[1] for change in changes] == ["follow"]
    assert range_m < 20.0
