"""The simulated autopilot keeps the rules that were measured on PX4 1.16 and ArduCopter 4.7, one by one."""

import math
import re
import struct
from pathlib import Path

import pytest
from pymavlink.dialects.v20 import common as dialect

from follow.geometry import ned_to_heading
from follow.messages import Autopilot
from sim.autopilot.parameters import OBEYED, REPORTED
from sim.autopilot.system import AutopilotSystem
from sim.dynamics import Vehicle, VehicleTruth
from tests.support.autopilot_pair import CONTROL

PX4, ARDUPILOT = Autopilot.PX4, Autopilot.ARDUPILOT
BOTH = pytest.mark.parametrize("autopilot", list(Autopilot))
NUMBERS = {
    PX4: {"OFFBOARD": (6, 0), "HOLD": (4, 3), "RTL": (4, 5), "POSCTL": (3, 0)},
    ARDUPILOT: {"GUIDED": (4, 0), "BRAKE": (17, 0), "RTL": (6, 0), "LOITER": (5, 0)},
}
FULL = 0x05C7


class Bench:
    """A raw MAVLink peer of a vehicle that hovers 10 m high; no code of ours on its side."""

    def __init__(self, autopilot: Autopilot, height_m: float = 10.0, **parameters: float):
        vehicle = Vehicle(autopilot, VehicleTruth(down_m=-height_m))
        self.system = AutopilotSystem(autopilot, vehicle)
        self.flight = self.system.flight
        self.flight.parameters.update(parameters)
        self.autopilot = autopilot
        self.mav = dialect.MAVLink(None, 1, 191)
        self.ears = dialect.MAVLink(None)
        self.t_s = 0.0
        self.heard = []

    def say(self, message, mav=None) -> None:
        self.system.receive(message.pack(mav or self.mav))

    def velocity(self, x=0.0, y=0.0, z=0.0, yaw_rate=0.0, frame=8, mask=FULL, mav=None) -> None:
        setpoint = 0, 1, 1, frame, mask, 0, 0, 0, x, y, z, 0, 0, 0, 0, yaw_rate
        self.say(dialect.MAVLink_set_position_target_local_ned_message(*setpoint), mav)

    def mode(self, name: str) -> list[int]:
        self.heard.clear()
        self.say(dialect.MAVLink_command_long_message(1, 1, 176, 0, 1, *NUMBERS[self.autopilot][name], 0, 0, 0, 0))
        self.wait(0.02)
        return [message.result for message in self.heard if message.get_type() == "COMMAND_ACK"]

    def command(self, number: int, *params: float) -> int:
        self.heard.clear()
        self.say(dialect.MAVLink_command_long_message(1, 1, number, 0, *params, *(0.0,) * (7 - len(params))))
        self.wait(0.02)
        return next(message.result for message in self.heard if message.get_type() == "COMMAND_ACK")

    def wait(self, seconds: float) -> None:
        for _ in range(round(seconds / 0.02)):
            self.t_s += 0.02
            self.system.step(self.t_s)
            for packet in self.system.take():
                self.heard.extend(self.ears.parse_buffer(packet) or ())

    def stream(self, seconds: float, rate_hz: float = 25.0, **setpoint) -> None:
        for _ in range(round(seconds * rate_hz)):
            self.velocity(**setpoint)
            self.wait(1 / rate_hz)

    def under_control(self) -> "Bench":
        self.stream(1.5)
        self.mode(CONTROL[self.autopilot])
        assert self.flight.mode == CONTROL[self.autopilot]
        return self

    def body_velocity(self):
        m = self.flight.vehicle.motion
        return *ned_to_heading(m.north_m_s, m.east_m_s, m.yaw_rad), m.down_m_s

    def heard_last(self, kind: str):
        return next(m for m in reversed(self.heard) if m.get_type() == kind)

    def healthy(self) -> int:
        return self.heard_last("SYS_STATUS").onboard_control_sensors_health

    def mode_in_heartbeat(self) -> int:
        return self.heard_last("HEARTBEAT").custom_mode


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


def test_px4_answers_a_mode_request_twice_and_only_the_second_tells():
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


def test_px4_tells_a_new_mode_with_its_next_heartbeat_only():
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


def test_a_lost_ground_station_ends_guided_only_when_asked_to():
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


def override(bench: Bench, *pwm: int) -> None:
    """RC_CHANNELS_OVERRIDE of channels 1 to 8; those that are not given stay as they are."""
    bench.say(dialect.MAVLink_rc_channels_override_message(1, 1, *pwm, *(65535,) * (8 - len(pwm))))
    bench.wait(0.02)


def channels(bench: Bench) -> list[int]:
    """The first six of RC_CHANNELS."""
    bench.command(512, 65)
    message = bench.heard_last("RC_CHANNELS")
    return [getattr(message, f"chan{n}_raw") for n in range(1, 7)]


@BOTH
def test_an_override_of_65535_keeps_a_channel_and_one_of_0_releases_it(autopilot):
    bench = Bench(autopilot)
    override(bench, 65535, 65535, 65535, 65535, 1900)
    assert bench.flight.sticks is None
    assert channels(bench) == [65535, 65535, 65535, 65535, 1900, 65535]
    override(bench, 1600, 1700, 1800, 1400, 65535, 1200)
    assert channels(bench) == [1600, 1700, 1800, 1400, 1900, 1200]
    override(bench, 65535, 0, 65535, 1500)
    assert channels(bench) == [1600, 1500, 1800, 1500, 1900, 1200]
    override(bench, 0, 0, 0, 0, 0, 0)
    assert bench.flight.sticks is None
    assert channels(bench) == [65535] * 6


@BOTH
def test_an_axis_of_32767_is_none_and_sticks_stay_between_their_ends(autopilot):
    bench = Bench(autopilot)
    absent, pilot = 32767, dialect.MAVLink(None, 255, 190)
    bench.say(pilot.manual_control_encode(1, 500, absent, absent, -30000, 0), pilot)
    assert bench.flight.sticks == (0.5, 0.0, 0.0, -1.0)
    bench.say(pilot.manual_control_encode(1, 0, -30000, 30000, 0, 0), pilot)
    assert bench.flight.sticks == (0.0, -1.0, -1.0, 0.0)
    override(bench, 3000, 3000, 1, 1)
    assert bench.flight.sticks == (-1.0, 1.0, 1.0, -1.0)
    bench.say(pilot.manual_control_encode(1, absent, absent, absent, absent, 0), pilot)
    assert bench.flight.sticks is None


@pytest.mark.parametrize(
    ("autopilot", "parameters", "seconds"),
    [(PX4, {}, 0.5), (ARDUPILOT, {}, 3.0), (ARDUPILOT, {"RC_OVERRIDE_TIME": 1.0}, 1.0)],
)
def test_sticks_are_forgotten_when_nobody_tells_them_any_more(autopilot, parameters, seconds):
    bench = Bench(autopilot, **parameters)
    for _ in range(3):
        override(bench, 1500, 1500, 1500, 1600, 1900)
        bench.wait(seconds - 0.1)
        assert bench.flight.sticks == (0.0, 0.0, 0.0, 0.2)
    bench.wait(0.2)
    assert bench.flight.sticks is None
    assert channels(bench) == [65535] * 6


def test_ardupilot_keeps_sticks_for_ever_when_told_so():
    bench = Bench(ARDUPILOT, RC_OVERRIDE_TIME=-1.0)
    override(bench, 1500, 1500, 1500, 1600)
    bench.wait(20.0)
    assert bench.flight.sticks == (0.0, 0.0, 0.0, 0.2)


@pytest.mark.parametrize(
    ("autopilot", "fence", "mode"),
    [
        (PX4, {"GF_MAX_HOR_DIST": 10.0}, "HOLD"),
        (PX4, {"GF_MAX_HOR_DIST": 10.0, "GF_ACTION": 3}, "RTL"),
        (ARDUPILOT, {"FENCE_ENABLE": 1, "FENCE_RADIUS": 10.0}, "RTL"),
        (ARDUPILOT, {"FENCE_ENABLE": 1, "FENCE_RADIUS": 10.0, "FENCE_ACTION": 4}, "BRAKE"),
    ],
)
def test_a_fence_takes_the_vehicle_over_and_is_told_as_crossed(autopilot, fence, mode):
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


@BOTH
@pytest.mark.parametrize("command", [192, 179, 178])  # DO_REPOSITION, DO_SET_HOME, DO_CHANGE_SPEED
def test_a_command_that_does_nothing_is_not_accepted(autopilot, command):
    assert Bench(autopilot).command(command) == 3


def test_an_unknown_command_is_unsupported_and_a_foreign_one_is_not_answered():
    bench = Bench(PX4)
    assert bench.command(31000) == 3
    bench.heard.clear()
    bench.say(dialect.MAVLink_command_long_message(9, 1, 400, 0, 1, 0, 0, 0, 0, 0, 0))
    bench.wait(0.1)
    assert all(message.get_type() != "COMMAND_ACK" for message in bench.heard)


@BOTH
def test_a_parameter_that_is_set_is_told_and_kept(autopilot):
    name, value = {PX4: ("COM_OF_LOSS_T", 0.5), ARDUPILOT: ("GUID_TIMEOUT", 0.5)}[autopilot]
    bench = Bench(autopilot)
    bench.say(dialect.MAVLink_param_set_message(1, 1, name.encode(), value, 9))
    bench.wait(0.1)
    assert bench.flight.parameters[name] == value
    assert any(m.get_type() == "PARAM_VALUE" and m.param_value == value for m in bench.heard)


@BOTH
@pytest.mark.parametrize("wild", [math.nan, math.inf])
@pytest.mark.parametrize(("command", "place"), [(176, 1), (511, 0), (512, 0)])  # mode, interval, request
def test_a_command_whose_whole_number_is_none_is_denied(autopilot, wild, command, place):
    bench = Bench(autopilot)
    assert bench.command(command, *(0.0,) * place, wild) == 2
    bench.wait(1.1)
    assert bench.heard_last("HEARTBEAT")


@BOTH
def test_a_sub_mode_that_is_none_counts_as_0(autopilot):
    bench = Bench(autopilot)
    bench.stream(1.0)
    assert bench.command(176, 1, NUMBERS[autopilot][CONTROL[autopilot]][0], math.nan) == 0
    assert bench.flight.mode == CONTROL[autopilot]


@pytest.mark.parametrize(
    ("autopilot", "name"), [(PX4, "COM_OF_LOSS_T"), (ARDUPILOT, "GUID_TIMEOUT"), (ARDUPILOT, "FENCE_ACTION")]
)
@pytest.mark.parametrize("wild", [math.nan, math.inf])
def test_a_parameter_is_not_set_to_what_is_no_number(autopilot, name, wild):
    bench = Bench(autopilot)
    before = bench.flight.parameters[name]
    bench.say(dialect.MAVLink_param_set_message(1, 1, name.encode(), wild, 9))
    assert bench.flight.parameters[name] == before


def test_a_negative_whole_number_reaches_px4_though_its_bytes_read_as_nan():
    bench = Bench(PX4)
    (as_float,) = struct.unpack("<f", struct.pack("<i", -1))
    assert math.isnan(as_float)
    bench.say(dialect.MAVLink_param_set_message(1, 1, b"GF_ACTION", as_float, 6))
    assert bench.flight.parameters["GF_ACTION"] == -1


@BOTH
def test_the_whole_list_of_parameters_comes_on_request(autopilot):
    bench = Bench(autopilot)
    bench.say(dialect.MAVLink_param_request_list_message(1, 1))
    bench.wait(0.1)
    told = [m for m in bench.heard if m.get_type() == "PARAM_VALUE"]
    assert [m.param_index for m in told] == list(range(told[0].param_count))
    assert {m.param_id for m in told} == set(bench.flight.parameters)


@BOTH
def test_a_parameter_is_read_by_the_flight_or_told_as_not_obeyed(autopilot):
    root = Path(__file__).parents[2]
    flight = "".join((root / "sim/autopilot" / f"{part}.py").read_text() for part in ("core", "rules"))
    sentence = (root / "docs/links.md").read_text().partition("reports but does not obey")[2].partition(".")[0]
    told = set(re.findall("[A-Z_]+", sentence))
    assert all(f'"{name}"' in flight for name in OBEYED[autopilot])
    assert not [name for name in REPORTED[autopilot] if f'"{name}"' in flight or name not in told]
    assert not told & OBEYED[autopilot].keys()


def test_the_signing_time_begins_where_it_is_told_and_goes_with_the_callers_clock():
    key, begin = bytes(range(32)), 36_000_000_000_000  # in 2026
    system = AutopilotSystem(PX4, Vehicle(PX4, VehicleTruth(down_m=-5.0)), key=key, signing_time=begin)
    for t_s in (0.02, 600.0):
        system.step(t_s)
        packet = system.take()[-1]
        late = int.from_bytes(packet[-12:-6], "little") - begin - t_s * 1e5  # units of 10 us
        assert 0 <= late < 1000


def test_two_links_hear_each_others_broadcasts_and_only_their_own_answers():
    system = AutopilotSystem(PX4, Vehicle(PX4, VehicleTruth(down_m=-5.0)), links=2)
    station, companion = dialect.MAVLink(None, 255, 190), dialect.MAVLink(None, 1, 191)
    system.receive(companion.heartbeat_encode(18, 8, 0, 0, 4).pack(companion), link=0)
    system.receive(station.heartbeat_encode(6, 8, 0, 0, 4).pack(station), link=1)
    system.receive(station.command_long_encode(1, 1, 400, 0, 1, 0, 0, 0, 0, 0, 0).pack(station), link=1)
    kinds = []
    for link in (0, 1):
        ears = dialect.MAVLink(None)
        messages = [m for packet in system.take(link) for m in ears.parse_buffer(packet)]
        kinds.append([(m.get_type(), m.get_srcSystem()) for m in messages])
    assert kinds == [[("HEARTBEAT", 255)], [("COMMAND_ACK", 1)]]
