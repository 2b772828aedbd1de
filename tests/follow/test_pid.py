import pytest
from hypothesis import given
from hypothesis import strategies as st

from follow.control.pid import Gains, Pid

DT = 0.02


def test_a_lone_proportional_gain_is_a_product():
    assert Pid(Gains(kp=2.0)).update(0.5, 0.0, DT) == 1.0


@given(st.lists(st.tuples(st.floats(-1e6, 1e6), st.floats(-1, 1)), max_size=30), st.floats(0.1, 10))
def test_the_output_never_passes_its_limit(steps, limit):
    pid = Pid(Gains(kp=3.0, ki=1.0, kd=0.5, limit=limit))
    for error, dt in steps:
        assert abs(pid.update(error, -error, dt)) <= limit


def test_the_integral_removes_a_constant_disturbance():
    pid, x = Pid(Gains(kp=2.0, ki=1.0)), 0.0
    for _ in range(2000):
        x += (pid.update(1.0 - x, x, DT) - 0.7) * DT
    assert x == pytest.approx(1.0, abs=1e-3)


def test_after_long_saturation_the_output_leaves_the_limit_as_the_error_turns():
    pid = Pid(Gains(kp=1.0, ki=1.0, limit=1.0))
    for _ in range(1000):
        pid.update(5.0, 0.0, DT)
    assert pid.update(-0.5, 5.5, DT) < 0.6


def test_a_step_of_the_setpoint_causes_no_derivative_kick():
    quiet, jumped = Pid(Gains(kp=0.0, kd=1.0)), Pid(Gains(kp=0.0, kd=1.0))
    for wanted in (0.0, 0.0, 10.0):
        quiet.update(0.0 - 2.0, 2.0, DT)
        out = jumped.update(wanted - 2.0, 2.0, DT)
    assert out == quiet.update(-2.0, 2.0, DT) == 0.0


def test_the_derivative_of_a_ramp_settles_at_its_slope():
    pid, out = Pid(Gains(kp=0.0, kd=1.0, filter_s=0.1)), 0.0
    for i in range(200):
        out = pid.update(0.0, 3.0 * i * DT, DT)
    assert out == pytest.approx(-3.0, rel=1e-3)


@pytest.mark.parametrize("dt", [0.0, -1.0])
def test_a_step_without_time_changes_nothing(dt):
    pid = Pid(Gains(kp=1.0, ki=1.0, kd=1.0))
    pid.update(1.0, 1.0, DT)
    before = pid.integral, pid.measured, pid.rate
    pid.update(9.0, 4.0, dt)
    assert (pid.integral, pid.measured, pid.rate) == before


def test_twice_half_the_step_integrates_the_same():
    once, twice = Pid(Gains(kp=0.0, ki=1.0)), Pid(Gains(kp=0.0, ki=1.0))
    out = once.update(2.0, 0.0, DT)
    twice.update(2.0, 0.0, DT / 2)
    assert twice.update(2.0, 0.0, DT / 2) == pytest.approx(out)


def test_reset_clears_the_state():
    pid = Pid(Gains(kp=1.0, ki=1.0, kd=1.0))
    pid.update(1.0, 3.0, DT)
    pid.reset()
    assert pid == Pid(pid.gains)


@pytest.mark.parametrize("bad", [{"limit": 0.0}, {"filter_s": 0.0}])
def test_a_limit_that_is_not_positive_is_refused(bad):
    with pytest.raises(ValueError, match="positive"):
        Gains(kp=1.0, **bad)
