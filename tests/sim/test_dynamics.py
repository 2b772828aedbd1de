import itertools
import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from follow.messages import HOVER, Autopilot, Setpoint
from sim.autopilot.parameters import defaults, flown
from sim.dynamics import Vehicle, VehicleTruth, Wind
from sim.measured import RESPONSES, TOP_M_S, response_of

HIGH = VehicleTruth(down_m=-100.0)
both = pytest.mark.parametrize("autopilot", list(Autopilot))


def still(autopilot: Autopilot, start: VehicleTruth = HIGH, **more) -> Vehicle:
    """A vehicle that does not wander."""
    return Vehicle(autopilot, start, response=response_of(autopilot).steady(), **more)


def fly(vehicle: Vehicle, setpoint: Setpoint, seconds: float, dt: float = 0.05) -> list[VehicleTruth]:
    return [vehicle.step(setpoint, dt) for _ in range(round(seconds / dt))]


def mean(values) -> float:
    values = list(values)
    return sum(values) / len(values)


@both
@pytest.mark.parametrize("axis", ["forward_m_s", "right_m_s", "down_m_s"])
@pytest.mark.parametrize("speed", [-2.0, 0.5, 1.4])
def test_in_calm_air_the_velocity_settles_at_the_command(autopilot, axis, speed):
    vehicle = still(autopilot)
    fly(vehicle, Setpoint(**{axis: speed}), 10.0)
    end = fly(vehicle, Setpoint(**{axis: speed}), 10.0)
    reached = {"forward_m_s": "north_m_s", "right_m_s": "east_m_s", "down_m_s": "down_m_s"}[axis]
    assert mean(getattr(m, reached) for m in end) == pytest.approx(speed, abs=0.03)


@both
def test_a_steady_wind_is_leaned_into_until_the_velocity_is_the_command(autopilot):
    vehicle = still(autopilot, wind=Wind(speed_m_s=6.0, toward_rad=math.pi))  # from the north
    end = fly(vehicle, HOVER, 40.0)[-200:]
    assert mean(m.north_m_s for m in end) == pytest.approx(0.0, abs=0.02)
    assert mean(m.pitch_rad for m in end) < -0.05  # nose down against the wind


@both
def test_yaw_is_the_integral_of_the_yaw_rate(autopilot):
    vehicle, turned = still(autopilot), 0.0
    for _ in range(400):
        turned += 0.01 * vehicle.step(Setpoint(yaw_rate_rad_s=0.5), 0.01).yaw_rate_rad_s
    assert math.remainder(vehicle.motion.yaw_rad - turned, math.tau) == pytest.approx(0.0, abs=1e-9)
    assert turned == pytest.approx(0.5 * 4.0, abs=0.3)


@both
def test_position_is_the_integral_of_velocity(autopilot):
    vehicle, north, east = still(autopilot), 0.0, 0.0
    for k in range(500):
        m = vehicle.step(Setpoint(2.0, math.sin(k / 50), 0.0, 0.3), 0.01)
        north, east = north + 0.01 * m.north_m_s, east + 0.01 * m.east_m_s
    assert (vehicle.motion.north_m, vehicle.motion.east_m) == pytest.approx((north, east), abs=1e-9)


@both
def test_nothing_happens_within_the_dead_time(autopilot):
    calm, pushed = still(autopilot, seed=3), still(autopilot, seed=3)
    for _ in range(5):
        assert calm.step(HOVER, 0.01) == pushed.step(Setpoint(5.0, 5.0, 1.0, 1.0), 0.01)
    fly(calm, HOVER, 1.0)
    fly(pushed, Setpoint(5.0), 1.0)
    assert pushed.motion.north_m_s > calm.motion.north_m_s + 0.5


def test_ardupilot_keeps_its_acceleration_and_jerk_limits():
    vehicle = still(Autopilot.ARDUPILOT)
    fly(vehicle, HOVER, 1.0)
    v = [m.north_m_s for m in fly(vehicle, Setpoint(8.0), 6.0, dt=0.01)]
    acceleration = [100 * (b - a) for a, b in itertools.pairwise(v)]
    assert 2.0 < max(acceleration) < 2.5 * 1.2  # ramped at 2.5 m/s2, the loop overshoots it by less than a fifth


def test_px4_takes_a_step_as_it_comes_and_tilts_far():
    vehicle = still(Autopilot.PX4)
    fly(vehicle, HOVER, 1.0)
    pitch = [m.pitch_rad for m in fly(vehicle, Setpoint(5.0), 2.0)]
    assert math.radians(-50) < min(pitch) < math.radians(-30)  # 43 degrees were measured


def test_ardupilot_turns_no_faster_than_60_degrees_a_second():
    vehicle = still(Autopilot.ARDUPILOT)
    end = fly(vehicle, Setpoint(yaw_rate_rad_s=1.5), 6.0)[-20:]
    assert mean(m.yaw_rate_rad_s for m in end) == pytest.approx(math.radians(60), abs=0.02)


@both
def test_flying_backward_tilts_the_nose_up_and_rightward_the_right_side_down(autopilot):
    vehicle = still(autopilot)
    assert fly(vehicle, Setpoint(forward_m_s=-3.0), 0.8)[-1].pitch_rad > 0.05
    assert fly(vehicle, Setpoint(right_m_s=3.0), 0.8)[-1].roll_rad > 0.05


@both
def test_the_ground_stops_the_descent_and_it_takes_off_again(autopilot):
    vehicle = still(autopilot, VehicleTruth(down_m=-2.0))
    m = fly(vehicle, Setpoint(forward_m_s=1.0, down_m_s=1.0), 6.0)[-1]
    assert (m.landed, m.down_m, m.north_m_s, m.pitch_rad) == (True, 0.0, 0.0, 0.0)
    m = fly(vehicle, Setpoint(down_m_s=-1.0), 4.0)[-1]
    assert not m.landed
    assert m.down_m < -2.0


@both
def test_without_motors_it_falls_as_a_stone_does(autopilot):
    vehicle = still(autopilot)
    for _ in range(100):
        vehicle.step(None, 0.01)
    assert vehicle.motion.down_m == pytest.approx(-100.0 + 0.5 * 9.80665, abs=0.1)


@both
@settings(max_examples=15, deadline=None)
@given(st.lists(st.tuples(*[st.floats(-8, 8)] * 4), min_size=1, max_size=12), st.integers(0, 2**32 - 1))
def test_the_same_seed_gives_the_same_motion_and_it_stays_finite(autopilot, commands, seed):
    gusts = Wind(4.0, 1.0, gust_m_s=1.5)
    one, two = (Vehicle(autopilot, HIGH, gusts, seed) for _ in range(2))
    for command in commands:
        m = one.step(Setpoint(*command), 0.033)
        assert m == two.step(Setpoint(*command), 0.033)
        assert all(math.isfinite(v) for v in (m.north_m, m.east_m, m.down_m, m.roll_rad, m.pitch_rad, m.yaw_rad))


def test_another_seed_gives_other_gusts():
    one, two = (Vehicle(Autopilot.ARDUPILOT, HIGH, Wind(4.0, 1.0, gust_m_s=1.5), seed) for seed in (1, 2))
    assert fly(one, HOVER, 2.0)[-1] != fly(two, HOVER, 2.0)[-1]


@both
def test_a_setpoint_that_is_not_finite_is_refused(autopilot):
    with pytest.raises(ValueError, match="four finite numbers"):
        still(autopilot).step(Setpoint(math.nan), 0.02)


def test_what_it_reports_is_what_it_was_asked_while_it_wanders_away():
    """PX4 flies by a velocity that is wrong: the position moves by what the reported velocity does not say."""
    vehicle, reported, north = Vehicle(Autopilot.PX4, HIGH, seed=4), [], []
    for _ in range(3000):
        vehicle.step(HOVER, 0.02)
        reported.append(vehicle.reported.north_m_s)
        north.append(vehicle.motion.north_m)
    assert abs(mean(reported)) < 0.02
    error = RESPONSES[Autopilot.PX4][0].velocity_error
    far = math.sqrt(2.0 * error.time_s * 60.0) * error.north_m_s  # a random walk's standard deviation after 60 s
    assert 0.1 * far < max(north) - min(north) < 5.0 * far
    assert vehicle.reported.north_m == vehicle.motion.north_m


def test_the_wrong_velocity_has_its_spread_and_correlation():
    error = RESPONSES[Autopilot.PX4][0].velocity_error
    pieces = []
    for seed in range(40):
        vehicle, off = Vehicle(Autopilot.PX4, HIGH, seed=seed), []
        for _ in range(200):
            m = vehicle.step(HOVER, 0.1)
            off.append(vehicle.reported.down_m_s - m.down_m_s)
        pieces.append(off)
    power = mean(x * x for off in pieces for x in off)
    kept = mean(a * b for off in pieces for a, b in zip(off, off[20:], strict=False)) / power
    assert math.sqrt(power) == pytest.approx(error.down_m_s, rel=0.2)
    assert kept == pytest.approx(math.exp(-2.0 / error.time_s), abs=0.15)


def test_an_estimator_that_knows_its_velocity_reports_the_truth():
    vehicle = Vehicle(Autopilot.ARDUPILOT, HIGH)
    fly(vehicle, Setpoint(2.0), 3.0)
    assert vehicle.reported == vehicle.motion


@pytest.mark.parametrize("seed", [0, 1])
def test_the_tilt_limit_decides_the_top_speed(seed):
    """ArduCopter was seen to top out at 11 to 11.8 m/s with its default 30 degrees."""
    vehicle = Vehicle(Autopilot.ARDUPILOT, HIGH, seed=seed)
    end = fly(vehicle, Setpoint(20.0), 40.0)[-1]
    top_m_s, tilt_rad = TOP_M_S[Autopilot.ARDUPILOT]
    assert end.north_m_s == pytest.approx(top_m_s, abs=0.4)
    assert end.pitch_rad == pytest.approx(-tilt_rad, abs=0.01)


def test_px4_flies_no_faster_than_its_speed_limits():
    vehicle = still(Autopilot.PX4)
    end = fly(vehicle, Setpoint(14.0, 14.0, -5.0), 30.0)[-1]
    assert math.hypot(end.north_m_s, end.east_m_s) == pytest.approx(12.0, abs=0.1)
    assert end.down_m_s == pytest.approx(-3.0, abs=0.05)
    assert fly(vehicle, Setpoint(down_m_s=5.0), 8.0)[-1].down_m_s == pytest.approx(1.5, abs=0.05)


@both
def test_the_default_parameters_are_what_was_measured(autopilot):
    for response in RESPONSES[autopilot]:
        assert flown(response, defaults(autopilot)) == response


@pytest.mark.parametrize(
    ("autopilot", "firmware", "setting"),
    [
        (Autopilot.PX4, "1.16", {"MPC_XY_VEL_MAX": 4.0}),
        (Autopilot.PX4, "1.18", {"MPC_TILTMAX_AIR": 6.0}),
        (Autopilot.ARDUPILOT, "4.7", {"ATC_ANGLE_MAX": 10.0}),
        (Autopilot.ARDUPILOT, "4.5", {"ANGLE_MAX": 1000}),
    ],
)
def test_a_parameter_limits_the_flight_in_the_unit_of_its_version(autopilot, firmware, setting):
    response = response_of(autopilot).steady()
    speeds = [
        fly(Vehicle(autopilot, HIGH, response=flown(response, table)), Setpoint(8.0), 20.0)[-1].north_m_s
        for table in (defaults(autopilot, firmware), defaults(autopilot, firmware) | setting)
    ]
    assert speeds[0] == pytest.approx(8.0, abs=0.3)
    assert 2.0 < speeds[1] < 6.0
