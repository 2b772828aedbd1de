"""The simulated autopilot follows each rule that was measured on PX4 1.16 and ArduCopter 4.7."""

import math

import pytest
from pymavlink.dialects.v20 import common as dialect

from follow.messages import Autopilot
from tests.support.autopilot_bench import FULL, Bench
from tests.support.autopilot_pair import CONTROL

PX4, ARDUPILOT = Autopilot.PX4, Autopilot.ARDUPILOT
BOTH = pytest.mark.parametrize("autopilot", list(Autopilot))


@pytest.mark.parametrize("frame", [1, 8])
@BOTH
def test_frames_1_and_8_are_obeyed_by_both(autopilot, frame):
    bench = Bench(autopilot).under_control()
    bench.stream(4.0, x=2.0, frame=frame)
    assert bench.body_velocity()[0] == pytest.approx(2.0, abs=0.35)


@pytest.mark.parametrize("frame", [7, 9])
def test_frames_7_and_9_are_obeyed_by_ardupilot(frame):
    bench = Bench(ARDUPILOT).under_control()
    bench.stream(4.0, x=2.0, frame=frame)
    assert bench.body_velocity()[0] == pytest.approx(2.0, abs=0.3)


def test_frame_12_stops_ardupilot():
    bench = Bench(ARDUPILOT).under_control()
    bench.stream(4.0, x=2.0, yaw_rate=0.5)
    bench.stream(4.0, x=2.0, yaw_rate=0.5, frame=12)
    assert math.hypot(*bench.body_velocity()) < 0.1
    assert abs(bench.flight.vehicle.motion.yaw_rate_rad_s) < 0.01


@pytest.mark.parametrize("frame", [7, 9, 12])
def test_other_frames_lose_px4_its_offboard_after_about_a_second(frame):
    bench = Bench(PX4).under_control()
    bench.stream(0.9, x=2.0, frame=frame)
    assert bench.flight.mode == "OFFBOARD"
    bench.stream(0.6, x=2.0, frame=frame)
    assert bench.flight.mode != "OFFBOARD"


@BOTH
def test_masking_one_velocity_axis_drops_the_whole_velocity(autopilot):
    bench = Bench(autopilot).under_control()
    bench.stream(3.0, x=2.0, mask=FULL | 1 << 5)
    assert bench.flight.mode == CONTROL[autopilot]
    assert abs(bench.body_velocity()[0]) < 0.3


def test_without_yaw_rate_px4_holds_its_heading_and_ardupilot_turns_to_its_course():
    yaw = {}
    for autopilot in Autopilot:
        bench = Bench(autopilot).under_control()
        bench.stream(4.0, y=2.0, frame=1, mask=FULL | 1 << 11)
        yaw[autopilot] = bench.flight.vehicle.motion.yaw_rad
    assert yaw[PX4] == pytest.approx(0.0, abs=0.05)
    assert yaw[ARDUPILOT] == pytest.approx(math.pi / 2, abs=0.2)


def test_px4_acknowledges_a_mode_request_twice_and_only_the_second_is_the_result():
    bench = Bench(PX4)
    assert bench.mode("OFFBOARD") == [0, 1]
    assert bench.flight.mode == "HOLD"
    bench.stream(1.5)
    assert bench.mode("OFFBOARD") == [0, 0]
    assert bench.flight.mode == "OFFBOARD"


def test_ardupilot_answers_once_and_changes_at_once():
    bench = Bench(ARDUPILOT)
    assert bench.mode("GUIDED") == [0]
    assert bench.mode_in_heartbeat() == 4


def test_px4_reports_a_new_mode_with_its_next_heartbeat_only():
    bench = Bench(PX4).under_control()
    bench.wait(0.9)  # just after a heartbeat
    bench.mode("RTL")
    assert all(message.get_type() != "HEARTBEAT" for message in bench.heard)
    bench.wait(1.0)
    assert bench.mode_in_heartbeat() & 0xFF0000 == 4 << 16


@pytest.mark.parametrize(("action", "mode"), [(0, "POSCTL"), (3, "RTL"), (4, "LAND"), (5, "HOLD")])
def test_a_stopped_stream_makes_px4_fly_on_for_a_second_and_fall_back(action, mode):
    bench = Bench(PX4, COM_OBL_RC_ACT=action).under_control()
    bench.stream(4.0, x=2.0)
    bench.wait(1.0)
    assert bench.flight.mode == "OFFBOARD"
    assert bench.body_velocity()[0] > 1.6
    bench.wait(0.4)
    assert bench.flight.mode == mode


def test_px4s_default_fall_back_without_rc_sinks():
    bench = Bench(PX4).under_control()
    bench.stream(1.0)
    bench.wait(4.0)
    assert bench.body_velocity()[2] == pytest.approx(0.6, abs=0.2)


def test_a_stopped_stream_makes_ardupilot_fly_on_for_three_seconds_and_stop_in_guided():
    bench = Bench(ARDUPILOT).under_control()
    bench.stream(4.0, x=2.0, yaw_rate=0.2)
    bench.wait(2.9)
    assert bench.body_velocity()[0] == pytest.approx(2.0, abs=0.3)
    assert bench.flight.vehicle.motion.yaw_rate_rad_s == pytest.approx(0.2, abs=0.05)
    start = bench.flight.vehicle.motion
    bench.wait(5.0)
    end = bench.flight.vehicle.motion
    assert math.hypot(*bench.body_velocity()) < 0.1
    assert math.hypot(end.north_m - start.north_m, end.east_m - start.east_m) < 3.0
    assert bench.flight.mode == "GUIDED"
    bench.stream(3.0, x=2.0)
    assert bench.body_velocity()[0] == pytest.approx(2.0, abs=0.4)


def test_a_resumed_stream_re_enters_offboard_by_itself_unless_somebody_chose_a_mode():
    bench = Bench(PX4).under_control()
    bench.wait(2.0)
    assert bench.flight.mode == "POSCTL"
    bench.stream(0.2)
    assert bench.flight.mode == "OFFBOARD"
    bench.wait(2.0)
    bench.mode("RTL")
    bench.stream(1.0)
    assert bench.flight.mode == "RTL"


@BOTH
def test_a_return_stays_one_until_it_has_landed_at_home_and_disarmed(autopilot):
    bench = Bench(autopilot, height_m=5.0).under_control()
    bench.stream(4.0, x=2.0)
    bench.mode("RTL")
    states = set()
    for _ in range(40):
        bench.wait(1.0)
        assert bench.mode_in_heartbeat() == {PX4: 4 << 16 | 5 << 24, ARDUPILOT: 6}[autopilot]
        states.add(bench.heard_last("EXTENDED_SYS_STATE").landed_state)
    assert states == {1, 2, 4}  # on the ground, in the air, landing
    assert not bench.flight.armed
    motion = bench.flight.vehicle.motion
    assert math.hypot(motion.north_m, motion.east_m) < 0.5


def test_a_resumed_stream_re_enters_offboard_while_the_return_lands():
    bench = Bench(PX4, COM_OBL_RC_ACT=3).under_control()
    bench.wait(6.0)  # it is at home, on its way down
    assert bench.flight.mode == "RTL"
    assert bench.body_velocity()[2] > 0.4
    bench.stream(0.2)
    assert bench.flight.mode == "OFFBOARD"


def test_px4_keeps_offboard_at_1_2_setpoints_a_second_and_flaps_at_0_8():
    for rate_hz, kept in ((1.2, True), (0.8, False)):
        bench = Bench(PX4).under_control()
        modes = set()
        for _ in range(6):
            bench.velocity()
            for _ in range(round(50 / rate_hz)):
                bench.wait(0.02)
                modes.add(bench.flight.mode)
        assert (modes == {"OFFBOARD"}) is kept


def test_ardupilot_is_content_with_one_setpoint_in_two_seconds():
    bench = Bench(ARDUPILOT).under_control()
    bench.stream(10.0, rate_hz=0.5, x=2.0)
    assert bench.body_velocity()[0] == pytest.approx(2.0, abs=0.2)


@BOTH
def test_in_another_mode_the_stream_is_ignored_and_a_request_is_granted_even_in_rtl(autopilot):
    bench = Bench(autopilot).under_control()
    bench.mode("RTL")
    bench.stream(2.0, x=3.0)
    assert bench.flight.mode == "RTL"
    assert math.hypot(*bench.body_velocity()[:2]) < 0.5
    bench.mode(CONTROL[autopilot])
    assert bench.flight.mode == CONTROL[autopilot]


@BOTH
def test_of_two_senders_the_last_wins(autopilot):
    bench = Bench(autopilot).under_control()
    other = dialect.MAVLink(None, 1, 192)
    for _ in range(80):
        bench.velocity(x=2.0)
        bench.velocity(x=-2.0, mav=other)
        bench.wait(0.04)
    assert bench.body_velocity()[0] < -1.0


def test_a_nan_velocity_leaves_px4_in_offboard():
    bench = Bench(PX4).under_control()
    bench.stream(2.0, x=math.nan)
    assert bench.flight.mode == "OFFBOARD"
    assert math.isfinite(bench.flight.vehicle.motion.north_m)


def test_a_nan_yaw_rate_keeps_ardupilot_from_arming_until_a_restart():
    bench = Bench(ARDUPILOT).under_control()
    bench.velocity(x=1.0, yaw_rate=math.nan)
    bench.command(400, 0, 21196)
    bench.wait(5.0)
    assert not bench.flight.armed
    assert bench.command(400, 1) != 0
    assert not bench.flight.armed
    assert Bench(ARDUPILOT, height_m=0.0).command(400, 1) == 0


def test_zero_velocity_holds_ardupilot_within_2_cm_and_lets_px4_drift():
    moved = {}
    for autopilot in Autopilot:
        bench = Bench(autopilot).under_control()
        bench.stream(2.0)
        start = bench.flight.vehicle.motion
        bench.stream(5.0)
        end = bench.flight.vehicle.motion
        moved[autopilot] = math.hypot(end.north_m - start.north_m, end.east_m - start.east_m)
    assert moved[ARDUPILOT] < 0.02
    assert moved[PX4] > 0.02


@BOTH
def test_without_our_heartbeat_it_keeps_flying(autopilot):
    bench = Bench(autopilot).under_control()
    bench.stream(12.0, x=1.0)
    assert bench.flight.mode == CONTROL[autopilot]


def test_a_lost_ground_station_ends_guided_only_if_the_parameter_says_so():
    for enabled, mode in ((0, "GUIDED"), (1, "RTL")):
        bench = Bench(ARDUPILOT, FS_GCS_ENABLE=enabled).under_control()
        station = dialect.MAVLink(None, 255, 190)
        bench.say(station.heartbeat_encode(6, 8, 0, 0, 4), station)
        bench.stream(4.5, x=1.0)
        assert bench.flight.mode == "GUIDED"
        bench.stream(1.0, x=1.0)
        assert bench.flight.mode == mode


@pytest.mark.parametrize(("override", "mode"), [(1, "OFFBOARD"), (3, "POSCTL")])
def test_sticks_break_offboard_only_with_bit_1_of_com_rc_override(override, mode):
    bench = Bench(PX4, COM_RC_OVERRIDE=override).under_control()
    pilot = dialect.MAVLink(None, 255, 190)
    bench.say(pilot.manual_control_encode(1, 900, 0, 500, 0, 0), pilot)
    bench.stream(0.2)
    assert bench.flight.mode == mode


@pytest.mark.parametrize(
    ("autopilot", "fence", "mode"),
    [
        (PX4, {"GF_MAX_HOR_DIST": 10.0}, "HOLD"),
        (PX4, {"GF_MAX_HOR_DIST": 10.0, "GF_ACTION": 3}, "RTL"),
        (ARDUPILOT, {"AVOID_ENABLE": 0, "FENCE_ENABLE": 1, "FENCE_RADIUS": 10.0}, "RTL"),
        (ARDUPILOT, {"AVOID_ENABLE": 0, "FENCE_ENABLE": 1, "FENCE_RADIUS": 10.0, "FENCE_ACTION": 4}, "BRAKE"),
    ],
)
def test_a_fence_takes_the_vehicle_over_and_is_reported_as_breached(autopilot, fence, mode):
    bench = Bench(autopilot, **fence).under_control()
    bench.stream(4.0, x=2.0)
    assert bench.flight.mode == CONTROL[autopilot]
    assert bench.healthy() & dialect.MAV_SYS_STATUS_GEOFENCE
    for _ in range(100):
        bench.stream(0.1, x=2.0)
        if bench.flight.mode != CONTROL[autopilot]:
            break
    assert bench.flight.mode == mode
    bench.stream(1.1)
    assert not bench.healthy() & dialect.MAV_SYS_STATUS_GEOFENCE


@pytest.mark.parametrize(("autopilot", "name"), [(PX4, "COM_LOW_BAT_ACT"), (ARDUPILOT, "BATT_FS_LOW_ACT")])
def test_a_low_battery_takes_the_vehicle_over_when_it_is_set_to(autopilot, name):
    for action, taken in ((0, False), (2, True)):
        bench = Bench(autopilot, **{name: action}).under_control()
        bench.flight.battery = 0.05
        bench.stream(0.5)
        assert (bench.flight.mode != CONTROL[autopilot]) is taken


@pytest.mark.parametrize("speed_m_s", [2.0, 6.0])
def test_ardupilot_by_default_stops_two_metres_inside_a_fence_in_guided_and_slides_along_it(speed_m_s):
    bench = Bench(ARDUPILOT, FENCE_ENABLE=1, FENCE_RADIUS=30.0).under_control()
    bench.stream(25.0, x=speed_m_s)
    motion = bench.flight.vehicle.motion
    assert bench.flight.mode == "GUIDED"
    assert motion.north_m == pytest.approx(28.0, abs=0.5)
    assert math.hypot(*bench.body_velocity()) < 0.1
    bench.stream(4.0, x=2.0, y=2.0)
    assert bench.body_velocity()[1] > 1.0
    assert math.hypot(bench.flight.vehicle.motion.north_m, bench.flight.vehicle.motion.east_m) < 29.0
    assert bench.flight.mode == "GUIDED"


@pytest.mark.parametrize(
    ("moves_by", "within_s", "taken"),
    [(0.05, 0.0, True), (0.1, 0.0, True), (0.25, 0.5, True), (0.02, 0.0, False), (0.25, 1.0, False), (0.4, 4.0, False)],
)
def test_a_sticks_speed_takes_px4_over_and_not_how_far_it_is(moves_by, within_s, taken):
    """As flown on PX4 1.16 with COM_RC_STICK_OV 30."""
    bench = Bench(PX4, firmware="1.16", COM_RC_OVERRIDE=3)
    bench.flight.sticks = (0.0, 0.0, 0.0, 0.0)
    bench.wait(2.0)
    bench.under_control()
    bench.stream(1.0)
    steps = max(round(within_s * 50), 1)
    for k in range(steps):
        bench.flight.sticks = (0.0, moves_by * (k + 1) / steps, 0.0, 0.0)
        bench.stream(0.02, rate_hz=50)
    bench.stream(0.3)
    assert bench.flight.mode == ("POSCTL" if taken else "OFFBOARD")


@pytest.mark.parametrize(
    ("firmware", "parameters", "taken"),
    [
        ("1.16", {"COM_RC_OVERRIDE": 3}, True),
        ("1.16", {"COM_RC_OVERRIDE": 1}, False),
        ("1.18", {}, True),
        ("1.18", {"MAN_OVERRIDE_SPD": -1.0}, False),
        ("1.18", {"MAN_OVERRIDE_SPD": 3.0}, False),
    ],
)
def test_px4s_sticks_take_over_when_they_move_and_not_while_they_rest_anywhere(firmware, parameters, taken):
    bench = Bench(PX4, firmware=firmware, **parameters)
    bench.flight.sticks = (0.0, 0.0, 1.0, 0.0)  # the throttle rests at its lower end
    bench.wait(2.0)
    bench.under_control()
    bench.stream(1.0)
    assert bench.flight.mode == "OFFBOARD"
    bench.flight.sticks = (0.7, 0.0, 1.0, 0.0)
    bench.stream(0.3)
    assert bench.flight.mode == ("POSCTL" if taken else "OFFBOARD")
    bench.stream(2.0)
    bench.mode("OFFBOARD")
    bench.stream(1.0)
    assert bench.flight.mode == "OFFBOARD", "held still, it takes over nothing"
