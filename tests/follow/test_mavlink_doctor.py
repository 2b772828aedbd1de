"""The doctor against both rule sets: red with the exact lines at default parameters, green after the named commands."""

import json
import struct

import numpy as np
import pytest
from pymavlink.dialects.v20 import common as dialect

from follow.camera import CameraError
from follow.cli.program import main
from follow.flight import preflight as doctor
from follow.flight.preflight import Health
from follow.messages import Autopilot, Frame
from tests.support.autopilot_pair import Pair

BOTH = pytest.mark.parametrize("autopilot", list(Autopilot))
RED_AT_DEFAULTS = {
    Autopilot.PX4: {
        "COM_OBL_RC_ACT": "param set COM_OBL_RC_ACT 5",
        "COM_RC_OVERRIDE": "param set COM_RC_OVERRIDE 3",
        "GF_MAX_HOR_DIST": "param set GF_MAX_HOR_DIST 350",
        "GF_MAX_VER_DIST": "param set GF_MAX_VER_DIST 120",
    },
    Autopilot.ARDUPILOT: {
        "GUID_TIMEOUT": "param set GUID_TIMEOUT 1.0",
        "FENCE_ENABLE": "param set FENCE_ENABLE 1",
    },
}


def examined(pair: Pair) -> list[doctor.Finding]:
    return doctor.check_vehicle(pair.client, pair.run, lambda: pair.t_s)


def obey(pair: Pair, command: str) -> None:
    """What a person types into MAVProxy, as it goes over the wire."""
    verb, noun, name, value = command.split()
    assert (verb, noun) == ("param", "set")
    old = pair.system.flight.parameters[name]
    number = type(old)(float(value))
    station = dialect.MAVLink(None, 255, 190)
    if pair.system.flight.autopilot is Autopilot.PX4 and isinstance(old, int):
        packed = dialect.MAVLink_param_set_message(1, 1, name.encode(), 0.0, 6)
        packed.param_value = int_as_float(number)
    else:
        packed = dialect.MAVLink_param_set_message(1, 1, name.encode(), number, 9)
    pair.system.receive(packed.pack(station))


def int_as_float(number: int) -> float:
    return struct.unpack("<f", struct.pack("<i", number))[0]


@BOTH
def test_default_parameters_are_red_and_the_named_commands_mend_them(autopilot):
    pair = Pair(autopilot)
    findings = examined(pair)
    red = {finding.name: finding.fix for finding in findings if finding.verdict is Health.RED}
    assert red == RED_AT_DEFAULTS[autopilot]
    assert not doctor.is_fit(findings)
    assert doctor.is_fit(findings, waived=list(red))
    for fix in red.values():
        obey(pair, fix)
    findings = examined(pair)
    assert doctor.is_fit(findings), [str(finding) for finding in findings]


@BOTH
def test_the_doctor_changes_nothing_on_the_vehicle(autopilot):
    pair = Pair(autopilot)
    before = dict(pair.system.flight.parameters), pair.system.flight.mode, pair.system.flight.armed
    examined(pair)
    assert (pair.system.flight.parameters, pair.system.flight.mode, pair.system.flight.armed) == before


def test_a_silent_link_is_red():
    pair = Pair(Autopilot.PX4)
    pair.to_client = lambda packets: []
    (finding,) = examined(pair)
    assert finding.verdict is Health.RED
    assert "heard" in finding.text


def test_a_second_sender_is_red():
    pair = Pair(Autopilot.PX4)
    other = dialect.MAVLink(None, 1, 192)
    setpoint = other.set_position_target_local_ned_encode(0, 1, 1, 8, 0x05C7, *(0.0,) * 11).pack(other)
    pair.to_client = lambda packets: [*packets, setpoint]
    found = {finding.name: finding for finding in examined(pair)}
    assert found["second-sender"].verdict is Health.RED
    assert "component 192" in found["second-sender"].text


def test_a_parameter_that_is_not_told_is_red_when_it_is_judged():
    pair = Pair(Autopilot.PX4)
    del pair.system.flight.parameters["COM_OBL_RC_ACT"]
    del pair.system.flight.parameters["NAV_RCL_ACT"]
    found = {finding.name: finding.verdict for finding in examined(pair)}
    assert found["COM_OBL_RC_ACT"] is Health.RED
    assert found["NAV_RCL_ACT"] is Health.WARN


def test_a_slow_link_is_red():
    pair = Pair(Autopilot.PX4)
    attitude = 30
    pair.to_client = lambda packets: [p for p in packets if p[7] != attitude or round(pair.t_s / 0.02) % 10 == 0]
    found = {finding.name: finding.verdict for finding in examined(pair)}
    assert found["attitude"] is Health.RED


def test_every_line_that_is_not_ok_is_one_line():
    for finding in examined(Pair(Autopilot.ARDUPILOT)):
        assert "\n" not in str(finding)


def test_a_clock_that_was_never_set_is_red_only_for_signing():
    assert doctor.check_time(signs=False, unix_s=100.0).verdict is Health.WARN
    assert doctor.check_time(signs=True, unix_s=100.0).verdict is Health.RED
    assert doctor.check_time(signs=True, unix_s=1.8e9).verdict is Health.OK


def test_disk_room_is_told(tmp_path):
    assert "GB free" in doctor.check_disk(tmp_path / "not" / "yet").text


class Slideshow:
    """A camera that yields one grey frame again and again."""

    def __init__(self, count: int, period_s: float = 1 / 30, breaks: bool = False):
        self.frames_left, self.period_s, self.breaks = count, period_s, breaks

    def frames(self):
        for index in range(self.frames_left):
            yield Frame(np.zeros((36, 64), np.uint8), index * self.period_s, index)
        if self.breaks:
            raise CameraError("the camera /dev/video9 went away")

    def __enter__(self):
        return self

    def __exit__(self, *_error): ...


def test_a_camera_is_judged_by_its_rate_and_the_age_of_its_pictures():
    kept = []
    verdicts = {finding.name: finding.verdict for finding in doctor.check_camera(Slideshow(60), None, kept)}
    assert verdicts == {"camera": Health.OK}
    assert len(kept) == 30
    (slow,) = doctor.check_camera(Slideshow(60, period_s=0.2), None, [])
    assert slow.verdict is Health.RED
    (none,) = doctor.check_camera(Slideshow(0), None, [])
    assert none.verdict is Health.RED
    (broken,) = doctor.check_camera(Slideshow(60, breaks=True), None, [])
    assert "/dev/video9" in broken.text
    late = {finding.name: finding for finding in doctor.check_camera(Slideshow(60), lambda: 10.0, [])}
    assert late["latency"].verdict is Health.RED


def test_a_tracker_slower_than_the_camera_is_red():
    frames = list(Slideshow(20).frames())
    assert doctor.check_tracker(lambda image: image, frames, fps=30.0).verdict is Health.OK
    assert doctor.check_tracker(lambda image: image, frames, fps=1e9).verdict is Health.RED


def test_the_command_is_red_in_one_line_for_what_cannot_be_opened(tmp_path, capsys):
    camera, link = str(tmp_path / "no.mp4"), f"serial:{tmp_path / 'ttyNONE'}:57600"
    assert main(["doctor", "--camera", camera, "--link", link, "--out", str(tmp_path), "--json"]) == 1
    out, err = capsys.readouterr()
    assert {finding["name"]: finding["verdict"] for finding in json.loads(out)}["link"] == "red"
    assert "not fit to fly: camera, link" in err


def test_the_command_is_green_without_anything_to_look_at(tmp_path):
    assert main(["doctor", "--out", str(tmp_path)]) == 0
