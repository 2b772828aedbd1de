"""Estimate, servo and gate in closed loop: over ground that is not flat, and before someone who comes near."""

import math
from dataclasses import replace

import pytest

from follow.messages import Autopilot
from follow.safety.gate import Limits
from tests.support.ground_flight import GroundFlight, flat, hill, walk


@pytest.mark.parametrize("slope", [0.10, -0.10, 0.20])
def test_over_a_hill_the_distance_is_kept(slope):
    flight = GroundFlight(walk(3.0, after_s=2.0), hill(slope), Autopilot.ARDUPILOT, end_s=24.0).fly()
    risen = abs(flight.ground(*flight.path(24.0)))
    assert risen > 5.0
    assert flight.to_body().min() > Limits().min_standoff_m * 2
    assert flight.standoff_rms(after_s=8.0) < 0.15
    error = [
        abs(t.estimate.range_m - r) / t.estimate.range_std_m for t, r in zip(flight.ticks, flight.ranges(), strict=True)
    ]
    assert max(error[60:]) < 3.0


def test_on_flat_ground_a_wrong_height_of_home_is_said_and_not_flown_into_the_ground():
    def lower(state):
        return replace(state, down_m=state.down_m - 8.0)

    flight = GroundFlight(walk(1.4, after_s=2.0), flat, end_s=12.0, height_m=6.0, state=lower).fly()
    assert flight.ticks[60].estimate.contradiction
    assert flight.to_body().min() > Limits().min_standoff_m


@pytest.mark.parametrize(("speed", "least"), [(1.4, 4.0), (3.0, 4.0), (6.0, 2.3)])
@pytest.mark.parametrize("down", [0.2, 0.5])
def test_someone_who_comes_toward_it_does_not_meet_it(speed, least, down):
    def comes(t_s):
        return 12.0 - speed * max(t_s - 3.0, 0.0), 0.0

    flight = GroundFlight(
        comes, flat, end_s=3.0 + 20.0 / speed, height_m=4.0 if down < 0.4 else 8.0, down_rad=down
    ).fly()
    assert math.isfinite(flight.ticks[-1].estimate.range_m)
    assert flight.to_body().min() > least
