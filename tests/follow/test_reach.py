"""A tap selects nothing in the sky or too far to be followed, computed from attitude and height at its frame."""

import math
from concurrent.futures import Future

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from follow.camera.recent import RecentFrames
from follow.control.reach import why_out_of_reach
from follow.control.selector import Selector
from follow.control.target import Target
from follow.geometry import Intrinsics
from follow.messages import Landed, VehicleState
from follow.selection import Selection
from racf.box import Box
from tests.follow.test_selector import Film, Follower

LENS = Intrinsics.from_fov(640, 360, math.radians(80))
REACH_M = 1.5 * LENS.fy / 6.0  # where a car of 1.5 m has the six rows that a selection needs: 95 m


def flying(height_m=10.0, pitch_rad=0.0, roll_rad=0.0, down_rad=0.0, landed=Landed.IN_AIR):
    """An estimate that has heard one state."""
    target = Target(LENS, down_rad)
    target.observe(
        VehicleState(
            5.0,
            attitude_t_s=5.0,
            pitch_rad=pitch_rad,
            roll_rad=roll_rad,
            position_t_s=5.0,
            down_m=-height_m,
            landed_t_s=5.0,
            landed=landed,
        )
    )
    return target


def feet_at(row, column=320.0):
    return Box(column - 5.0, row - 20.0, 10.0, 20.0)


@given(st.floats(5.0, 400.0), st.floats(3.0, 50.0), st.floats(-0.3, 0.3), st.floats(0.0, 0.6))
@example(97.5, 3.0, 0.0, 0.0)  # half a metre, rounded either way
def test_targets_within_reach_are_accepted_and_farther_ones_are_not(away_m, height_m, pitch, down):
    below = math.atan2(height_m, away_m)
    off_axis = below - (down - pitch)  # nose up lifts the optical axis
    if abs(off_axis) > 0.4 or abs(away_m / REACH_M - 1.0) < 1e-6:
        return
    why = why_out_of_reach(flying(height_m, pitch, down_rad=down), feet_at(LENS.cy + LENS.fy * math.tan(off_axis)), 5.0)
    assert bool(why) is (away_m > REACH_M)
    assert not why or any(f"{away_m + rounded:.0f} m away" in why for rounded in (-1e-6, 1e-6))


@pytest.mark.parametrize("pitch", [-0.2, 0.0, 0.2])
def test_the_sky_is_refused_by_the_attitude(pitch):
    horizon = LENS.cy + LENS.fy * math.tan(pitch)
    assert "sky" in why_out_of_reach(flying(pitch_rad=pitch), feet_at(horizon - 3.0), 5.0)
    assert "fly within 95 m" in why_out_of_reach(flying(pitch_rad=pitch), feet_at(horizon + 3.0), 5.0)
    assert why_out_of_reach(flying(pitch_rad=pitch), feet_at(horizon + 60.0), 5.0) == ""


def test_in_a_turn_the_horizon_is_tilted():
    roll = math.radians(20.0)
    left, right = (why_out_of_reach(flying(roll_rad=roll), feet_at(LENS.cy, column), 5.0) for column in (100, 540))
    assert [bool(left), bool(right)] in ([True, False], [False, True])
    assert "sky" in left, "rolled to the right, the horizon sinks on the left"


@pytest.mark.parametrize("target", [flying(landed=Landed.ON_GROUND), flying(height_m=1.0), Target(LENS, 0.0)])
def test_on_the_ground_or_without_telemetry_nothing_is_judged(target):
    assert why_out_of_reach(target, feet_at(LENS.cy - 100.0), 5.0) == ""


class AtOnce:
    def submit(self, function, *arguments):
        done = Future()
        done.set_result(function(*arguments))
        return done


@pytest.mark.parametrize("looks", [None, AtOnce()])
def test_a_tap_out_of_reach_keeps_the_previous_target_and_a_drawn_box_is_accepted(looks):
    recent, follower = RecentFrames(Film(40)), Follower()
    selector = Selector(
        follower.init, follower.track, recent, lambda: None, looks=looks, snap=lambda _i, x, y: Box(x, y, 20, 20)
    )
    heard = []
    selector.decided, selector.out_of_reach = heard.append, lambda _box, t_s: f"200 m away at {t_s:.2f}"
    for frame in recent.frames():
        selector.update(frame.image)
    assert selector.choose(Selection(0.1, 0.3, 0.1, 0.1, frame.t_s, "a test")) == ""
    selector.update(frame.image)
    (before,) = follower.starts
    why = selector.choose(Selection(0.6, 0.6, 0.0, 0.0, frame.t_s, "a test"))
    selector.update(frame.image)
    assert (heard[-1] if looks else why) == f"200 m away at {frame.t_s:.2f}"
    assert follower.starts == [before]
    assert selector.has_target
    assert np.allclose(before.x, 64.0)
