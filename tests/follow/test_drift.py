"""The drift of the position against the reported velocity: estimated, separated from manoeuvres and compensated."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from follow.control.drift import GAP_S, Drift
from follow.control.pose_history import PoseHistory
from follow.messages import Autopilot, VehicleState
from tests.support.ground_flight import GroundFlight, walk

RATE_HZ = 30.0


def flown(drift, seconds=6.0, noise_m=0.0, reset_m=0.0):
    """A history fed by a vehicle that weaves, reports that velocity, and whose position moves by `drift` more."""
    history, random, place = PoseHistory(), np.random.default_rng(0), np.zeros(3)
    before = np.zeros(3)
    for n in range(round(seconds * RATE_HZ)):
        t_s = n / RATE_HZ
        v = np.array([2 * math.cos(t_s), 2 * math.sin(2 * t_s), 0.5 * math.sin(t_s)])
        place = place + ((v + before) / 2 + drift) / RATE_HZ if n else place
        before = v
        moved = reset_m if t_s >= seconds / 2 else 0.0
        seen = place + moved + noise_m * random.standard_normal(3)
        state = VehicleState(t_s, t_s, 0, 0, 0, 0, t_s, *seen, *v, resets=int(moved > 0))
        jump = history.jump(state, 1.5)
        if jump is not None:
            history.shift(jump)
        history.add(state)
    return history, v


@given(st.tuples(*[st.floats(-0.5, 0.5)] * 3))
def test_a_steady_drift_is_estimated_within_seconds_in_any_flight(drift):
    history, v = flown(np.array(drift))
    assert history.drift.velocity == pytest.approx(drift, abs=0.02 + 0.05 * float(np.linalg.norm(drift)))
    pose = history.at(6.0 - 1 / RATE_HZ)
    assert [pose.north_m_s, pose.east_m_s, pose.down_m_s] == pytest.approx(v + history.drift.velocity)


def test_noise_of_the_positions_causes_little_estimated_drift():
    history, _ = flown(np.zeros(3), noise_m=0.05)
    assert np.linalg.norm(history.drift.velocity) < 0.15


@pytest.mark.parametrize("reset_m", [0.5, 3.0])
def test_a_reset_of_the_position_is_no_drift(reset_m):
    history, _ = flown(np.array([0.2, 0.0, -0.1]), reset_m=reset_m)
    assert history.drift.velocity == pytest.approx([0.2, 0.0, -0.1], abs=0.05)


def test_a_gap_in_the_telemetry_keeps_the_drift_and_starts_the_position_again():
    drift = Drift()
    for t_s in np.arange(0.0, 4.0, 0.1):
        drift.update(VehicleState(t_s, position_t_s=float(t_s), north_m=0.3 * t_s))
    learnt = drift.velocity.copy()
    drift.update(VehicleState(9.0, position_t_s=4.0 + 2 * GAP_S, north_m=40.0))
    assert drift.velocity == pytest.approx(learnt)
    assert learnt[0] == pytest.approx(0.3, abs=0.03)


def test_a_vehicle_that_flies_by_a_wrong_velocity_keeps_stand_off_and_height_as_one_that_knows_its_own():
    """PX4 drifts by 0.2 m/s horizontally and 0.14 m/s vertically; ArduPilot does not (docs/vehicle.md)."""
    px4, ardupilot = (GroundFlight(walk(1.4), autopilot=a, end_s=60.0, seed=None).fly() for a in Autopilot)
    assert px4.standoff_rms() < ardupilot.standoff_rms() + 0.01
    heights = px4.heights()[len(px4.truths) // 3 :]
    assert np.std(heights) < 0.2


def test_a_state_that_is_not_finite_is_ignored():
    """A user's own link may pass any number; one such state must not corrupt all later estimates."""
    drift = Drift()
    for n in range(90):
        t_s = n / RATE_HZ
        number = {30: math.nan, 45: math.inf}.get(n, 0.2 * t_s)
        drift.update(VehicleState(t_s, t_s, 0, 0, 0, 0, t_s, 0.2 * t_s, 0.0, number, 0.0, 0.0, 0.0))
    assert drift.velocity == pytest.approx((0.2, 0.0, 0.2), abs=0.03)
