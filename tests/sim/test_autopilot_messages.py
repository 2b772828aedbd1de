"""The messages that the simulated autopilot understands: sticks, commands, parameters; signing; two links."""

import inspect
import math
import re
import struct
from pathlib import Path

import pytest
from pymavlink.dialects.v20 import common as dialect

from follow.messages import Autopilot
from sim.autopilot.parameters import OBEYED, REPORTED, flown
from sim.autopilot.system import AutopilotSystem
from sim.dynamics import Vehicle, VehicleTruth
from tests.support.autopilot_bench import NUMBERS, Bench
from tests.support.autopilot_pair import CONTROL

PX4, ARDUPILOT = Autopilot.PX4, Autopilot.ARDUPILOT
BOTH = pytest.mark.parametrize("autopilot", list(Autopilot))


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
def test_an_axis_of_32767_is_absent_and_sticks_are_clipped(autopilot):
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
def test_sticks_time_out_when_no_more_arrive(autopilot, parameters, seconds):
    bench = Bench(autopilot, **parameters)
    for _ in range(3):
        override(bench, 1500, 1500, 1500, 1600, 1900)
        bench.wait(seconds - 0.1)
        assert bench.flight.sticks == (0.0, 0.0, 0.0, 0.2)
    bench.wait(0.2)
    assert bench.flight.sticks is None
    assert channels(bench) == [65535] * 6


def test_ardupilot_keeps_sticks_for_ever_if_the_parameter_says_so():
    bench = Bench(ARDUPILOT, RC_OVERRIDE_TIME=-1.0)
    override(bench, 1500, 1500, 1500, 1600)
    bench.wait(20.0)
    assert bench.flight.sticks == (0.0, 0.0, 0.0, 0.2)


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
def test_a_parameter_that_is_set_is_reported_and_kept(autopilot):
    name, value = {PX4: ("COM_OF_LOSS_T", 0.5), ARDUPILOT: ("GUID_TIMEOUT", 0.5)}[autopilot]
    bench = Bench(autopilot)
    bench.say(dialect.MAVLink_param_set_message(1, 1, name.encode(), value, 9))
    bench.wait(0.1)
    assert bench.flight.parameters[name] == value
    assert any(m.get_type() == "PARAM_VALUE" and m.param_value == value for m in bench.heard)


@BOTH
@pytest.mark.parametrize("wild", [math.nan, math.inf])
@pytest.mark.parametrize(("command", "place"), [(176, 1), (511, 0), (512, 0)])  # mode, interval, request
def test_a_command_with_nan_for_an_integer_is_denied(autopilot, wild, command, place):
    bench = Bench(autopilot)
    assert bench.command(command, *(0.0,) * place, wild) == 2
    bench.wait(1.1)
    assert bench.heard_last("HEARTBEAT")


@BOTH
def test_a_sub_mode_of_nan_counts_as_0(autopilot):
    bench = Bench(autopilot)
    bench.stream(1.0)
    assert bench.command(176, 1, NUMBERS[autopilot][CONTROL[autopilot]][0], math.nan) == 0
    assert bench.flight.mode == CONTROL[autopilot]


@pytest.mark.parametrize(
    ("autopilot", "name"), [(PX4, "COM_OF_LOSS_T"), (ARDUPILOT, "GUID_TIMEOUT"), (ARDUPILOT, "FENCE_ACTION")]
)
@pytest.mark.parametrize("wild", [math.nan, math.inf])
def test_a_parameter_is_not_set_to_nan(autopilot, name, wild):
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
def test_a_parameter_is_used_by_the_flight_or_listed_as_not_obeyed(autopilot):
    root = Path(__file__).parents[2]
    flight = "".join((root / "sim/autopilot" / f"{part}.py").read_text() for part in ("core", "rules"))
    flight += inspect.getsource(flown)
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
