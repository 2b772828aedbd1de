import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from follow.messages import NEVER, Estimate, Setpoint, VehicleState
from follow.servo import Servo, ServoConfig

DOWN = math.radians(30)
CONFIG = ServoConfig()
STATE = VehicleState(t_s=0.0, yaw_rad=0.4)


def estimate(azimuth=0.0, depression=DOWN, range_m=CONFIG.standoff_m, **more):
    return Estimate(0.0, azimuth, depression, range_m, 0.5, seen_t_s=0.0, **more)


def wish(e, state=STATE):
    return Servo(DOWN).update(e, state)


@given(st.floats(0.01, 1.0))
def test_a_target_right_of_centre_turns_right_and_its_mirror_left(azimuth):
    right, left = wish(estimate(azimuth)), wish(estimate(-azimuth))
    assert right.yaw_rate_rad_s > 0
    assert right.yaw_rate_rad_s == pytest.approx(-left.yaw_rate_rad_s)


@given(st.floats(0.05, 0.5))
def test_a_target_low_in_the_picture_descends_and_a_high_one_climbs(angle):
    assert wish(estimate(depression=DOWN + angle)).down_m_s > 0
    assert wish(estimate(depression=DOWN - angle)).down_m_s < 0


@given(st.floats(0.5, 10))
def test_a_target_too_far_is_approached_and_one_too_near_is_left(metres):
    assert wish(estimate(range_m=CONFIG.standoff_m + metres)).forward_m_s > 0
    assert wish(estimate(range_m=CONFIG.standoff_m - metres)).forward_m_s < 0


def test_a_target_where_it_is_wanted_asks_for_nothing():
    still = wish(estimate())
    assert (still.forward_m_s, still.right_m_s, still.down_m_s, still.yaw_rate_rad_s) == pytest.approx((0, 0, 0, 0))


@given(st.floats(-3, 3))
def test_a_target_that_runs_away_is_followed_at_its_speed(yaw):
    ran = estimate(north_m_s=3 * math.cos(yaw), east_m_s=3 * math.sin(yaw))
    assert wish(ran, VehicleState(t_s=0.0, yaw_rad=yaw)).forward_m_s == pytest.approx(3.0)


def test_a_target_crossing_to_the_right_turns_right_at_the_rate_of_its_bearing():
    crossing = estimate(north_m_s=-2 * math.sin(0.4), east_m_s=2 * math.cos(0.4))
    assert wish(crossing).yaw_rate_rad_s == pytest.approx(2 / CONFIG.standoff_m)


def test_a_target_never_seen_asks_for_nothing():
    assert Servo(DOWN).update(Estimate(0.0, 1.0, 0.0, 50.0, 1.0, seen_t_s=NEVER), STATE) == Setpoint()
