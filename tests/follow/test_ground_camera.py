"""The ground station's camera: a model of QGroundControl discovers it, selects, and draws its box."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common as dialect

from follow.link.packets import Packets
from follow.operator.ground_camera import GroundCamera, StreamDescription
from follow.selection import Cleared, Selection, TrackingState, TrackingStatus
from tests.support.ground_station import NEW, OLD, GroundStation

VARIANTS = pytest.mark.parametrize("variant", [OLD, NEW])
STREAM = StreamDescription()


class Rig:
    """A camera and ground stations on one wire; `box` is what the tracker holds."""

    def __init__(self, variant=NEW, why="", stations=1, stream=STREAM, delay_s=0.0):
        self.chosen, self.why, self.box, self.frame_age_s, self.t_s = [], why, None, 0.03, 10.0
        self.camera = GroundCamera((640, 360), self.choose, stream, delay_s)
        self.stations = [GroundStation(variant, system_id=255 - number) for number in range(stations)]
        self.packets, self.sent = Packets(1, 1), []
        self.camera.address(1)

    def choose(self, choice):
        self.chosen.append(choice)
        if not self.why:
            is_selection = isinstance(choice, Selection)
            self.box = (choice.left, choice.top, choice.width, choice.height) if is_selection else None
        return self.why

    def run(self, seconds):
        for _ in range(round(seconds / 0.02)):
            self.t_s += 0.02
            state = TrackingState.ACTIVE if self.box else TrackingState.IDLE
            self.camera.step(self.t_s, TrackingStatus(state, self.box, self.t_s - self.frame_age_s))
            for packet in self.camera.take():
                self.sent.append((self.t_s, packet))
                for station in self.stations:
                    station.hear(packet, self.t_s)
            for station in self.stations:
                for packet in station.take():
                    for message in self.packets.read(packet):
                        self.camera.hear(message, self.t_s)
                station.step(self.t_s)

    def of_kind(self, kind):
        parser = dialect.MAVLink(None)
        messages = [(t_s, message) for t_s, data in self.sent for message in parser.parse_buffer(data) or []]
        return [(t_s, message) for t_s, message in messages if message.get_type() == kind]


@VARIANTS
def test_the_camera_is_discovered_with_its_stream(variant):
    rig = Rig(variant)
    rig.run(3.0)
    (station,) = rig.stations
    assert station.camera == 100
    information = station.heard["CAMERA_INFORMATION"]
    assert information.flags == 256 + 512 + 1024
    assert (information.resolution_h, information.resolution_v) == (640, 360)
    stream = station.heard["VIDEO_STREAM_INFORMATION"]
    assert (stream.type, stream.uri, stream.encoding, stream.stream_id, stream.count) == (1, "5600", 1, 1, 1)
    assert {"CAMERA_SETTINGS", "CAMERA_CAPTURE_STATUS", "STORAGE_INFORMATION"} <= set(station.heard)
    assert all(result == 0 for _command, result in station.acks)
    assert not station.errors
    assert len(rig.of_kind("HEARTBEAT")) == 3


def test_without_a_stream_none_is_announced():
    rig = Rig(stream=None)
    rig.run(2.0)
    assert rig.stations[0].heard["CAMERA_INFORMATION"].flags == 512 + 1024
    assert (512, 3) in rig.stations[0].acks  # UNSUPPORTED, for message 269


@VARIANTS
def test_a_dragged_box_is_selected_drawn_and_stopped(variant):
    rig = Rig(variant, delay_s=0.25)
    rig.run(2.0)
    (station,) = rig.stations
    station.drag(rig.t_s, 0.25, 0.5, 0.375, 0.75)
    rig.run(2.0)
    (selection,) = rig.chosen
    assert (selection.left, selection.top, selection.width, selection.height) == (0.25, 0.5, 0.125, 0.25)
    assert selection.frame_t_s == pytest.approx(12.02 - 0.25, abs=0.03)
    assert selection.by == "the ground station 255/190"
    assert station.boxes[-1] == (0.25, 0.5, 0.375, 0.75)
    assert 18 <= len(station.boxes) <= 21, "ten a second"
    station.stop(rig.t_s)
    rig.run(2.0)
    assert rig.chosen[1:] == [Cleared("the ground station 255/190")]
    statuses = [message.tracking_status for _t_s, message in rig.of_kind("CAMERA_TRACKING_IMAGE_STATUS")]
    assert statuses.count(0) == 1
    assert statuses[-1] == 0
    assert not station.errors


def test_a_click_is_a_selection_without_a_size():
    rig = Rig()
    rig.run(2.0)
    rig.stations[0].click(rig.t_s, 0.5, 0.25)
    rig.run(0.1)
    (selection,) = rig.chosen
    assert selection.is_point
    assert (selection.left, selection.top) == (0.5, 0.25)


def test_a_repeated_command_is_acknowledged_again_and_selects_once():
    rig = Rig()
    rig.run(2.0)
    (station,) = rig.stations
    for _ in range(3):
        station.drag(rig.t_s, 0.25, 0.5, 0.375, 0.75)
        rig.run(0.5)
    assert len(rig.chosen) == 1
    assert station.acks.count((2005, 0)) == 3
    station.stop(rig.t_s)
    station.drag(rig.t_s, 0.25, 0.5, 0.375, 0.75)
    rig.run(0.5)
    assert len(rig.chosen) == 3, "after a stop the same box is a new selection"


def test_a_repeated_click_selects_once_whatever_its_unused_numbers_are():
    rig = Rig()
    rig.run(2.0)
    (station,) = rig.stations
    for _ in range(3):  # MAVSDK fills what it does not use with NaN
        station.command(2004, rig.t_s, 0.5, 0.25, math.nan, math.nan, math.nan, math.nan, math.nan)
        rig.run(0.5)
    assert len(rig.chosen) == 1
    assert station.acks.count((2004, 0)) == 3


def test_a_repeated_stop_stops_again_because_another_console_may_have_ordered_follow():
    rig = Rig()
    rig.run(2.0)
    for _ in range(2):
        rig.stations[0].stop(rig.t_s)
        rig.run(0.5)
    assert rig.chosen == [Cleared("the ground station 255/190")] * 2


@pytest.mark.parametrize(
    ("box", "why"),
    [
        ((math.nan, 0.5, 0.4, 0.7), "not in the image"),
        ((0.1, 0.5, 1.4, 0.7), "not in the image"),
        ((0.4, 0.5, 0.2, 0.7), "too small"),
        ((0.4, 0.5, 0.401, 0.501), "too small"),
    ],
)
def test_an_invalid_box_is_denied_with_a_reason(box, why):
    rig = Rig()
    rig.run(2.0)
    (station,) = rig.stations
    station.drag(rig.t_s, *box)
    rig.run(0.5)
    assert not rig.chosen
    assert (2005, 2) in station.acks
    assert why in station.texts[-1]


def test_a_refusal_of_the_program_reaches_the_person():
    rig = Rig(why="no contrast: draw it round the target")
    rig.run(2.0)
    rig.stations[0].drag(rig.t_s, 0.25, 0.5, 0.375, 0.75)
    rig.run(0.5)
    assert (2005, 2) in rig.stations[0].acks
    assert rig.stations[0].texts == ["no contrast: draw it round the target"]


def test_a_selection_on_an_old_image_is_refused():
    rig = Rig()
    rig.run(2.0)
    rig.frame_age_s = 1.5
    rig.run(0.1)
    rig.stations[0].drag(rig.t_s, 0.25, 0.5, 0.375, 0.75)
    rig.run(0.5)
    assert not rig.chosen
    assert (2005, 1) in rig.stations[0].acks  # TEMPORARILY_REJECTED


def test_two_stations_are_answered_each():
    rig = Rig(stations=2)
    rig.run(2.0)
    for station in rig.stations:
        station.drag(rig.t_s, 0.25, 0.5, 0.375, 0.75)
    rig.run(0.5)
    assert [choice.by for choice in rig.chosen] == ["the ground station 255/190", "the ground station 254/190"]
    for station in rig.stations:
        assert (2005, 0) in station.acks
        assert station.boxes
        assert not station.errors


def test_it_is_silent_before_the_vehicle_is_known():
    camera = GroundCamera((640, 360), lambda _choice: "")
    camera.step(1.0, TrackingStatus(TrackingState.ACTIVE, (0.1, 0.1, 0.1, 0.1), 1.0))
    assert not camera.take()


number = st.floats(width=32)


@given(
    command=st.sampled_from([2004, 2005, 2010, 512, 511, 521, 2502, 9999]),
    target=st.tuples(st.integers(0, 255), st.integers(0, 255)),
    numbers=st.tuples(*(number,) * 7),
    t_s=st.floats(0.0, 1e5),
)
def test_whatever_comes_a_selection_lies_in_the_image_and_only_our_commands_are_answered(command, target, numbers, t_s):
    chosen = []
    camera = GroundCamera((640, 360), lambda choice: chosen.append(choice) or "", STREAM)
    camera.address(1)
    camera.step(t_s, TrackingStatus(TrackingState.IDLE, None, t_s))
    camera.take()
    camera.hear(dialect.MAVLink_command_long_message(*target, command, 0, *numbers), t_s)
    if target != (1, 100):
        assert not camera.take()
        assert not chosen
        return
    parser = dialect.MAVLink(None)
    acks = [m for data in camera.take() for m in parser.parse_buffer(data) or [] if m.get_type() == "COMMAND_ACK"]
    assert [ack.command for ack in acks] == [command]
    for choice in chosen:
        if isinstance(choice, Selection):
            assert 0.0 <= choice.left <= choice.left + choice.width <= 1.0
            assert 0.0 <= choice.top <= choice.top + choice.height <= 1.0
