"""The doctor against both rule sets: red with the exact lines at default parameters, green after the named commands."""

import json
import re
from types import SimpleNamespace

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega
from pymavlink.dialects.v20 import common as dialect

from follow.camera import CameraError
from follow.cli.program import main
from follow.flight import preflight as doctor
from follow.flight.finding import Health, is_fit, places
from follow.flight.vehicle_checks import check_signing, check_simulator, check_vehicle
from follow.link.transports import Reach
from follow.messages import Autopilot, Frame
from follow.recording.recorder import RecordConfig
from follow.recording.video_encoder import Encoder
from sim.autopilot.parameters import FIRMWARES
from sim.autopilot.system import AutopilotSystem
from sim.dynamics import Vehicle, VehicleTruth
from tests.support.autopilot_pair import Pair
from tests.support.doctor import examined, obey, red
from tests.support.fit import fit
from tools.docs import doctor as doctor_docs

BOTH = pytest.mark.parametrize("autopilot", list(Autopilot))
EVERY_FIRMWARE = pytest.mark.parametrize(
    ("autopilot", "firmware"), [(autopilot, version) for autopilot in Autopilot for version in FIRMWARES[autopilot]]
)
RED_AT_DEFAULTS: dict[Autopilot, dict[str, dict[str, str]]] = {
    Autopilot.PX4: {
        version: {
            "COM_OBL_RC_ACT": "param set COM_OBL_RC_ACT 5",
            **({} if version == "1.18" else {"COM_RC_OVERRIDE": "param set COM_RC_OVERRIDE 3"}),
            "COM_LOW_BAT_ACT": "param set COM_LOW_BAT_ACT 3",
            "GF_MAX_HOR_DIST": "param set GF_MAX_HOR_DIST 350",
            "GF_MAX_VER_DIST": "param set GF_MAX_VER_DIST 120",
        }
        for version in FIRMWARES[Autopilot.PX4]
    },
    Autopilot.ARDUPILOT: {
        version: {
            "GUID_TIMEOUT": "param set GUID_TIMEOUT 1.0",
            "BATT_FS_LOW_ACT": "param set BATT_FS_LOW_ACT 2",
            "FENCE_ENABLE": "param set FENCE_ENABLE 1",
        }
        for version in FIRMWARES[Autopilot.ARDUPILOT]
    },
}


def heartbeat(system: int, component: int, kind: int, autopilot: int) -> bytes:
    mav = dialect.MAVLink(None, system, component)
    return mav.heartbeat_encode(kind, autopilot, 0, 0, 3).pack(mav)


def foreign_packet() -> bytes:
    """A packet of another dialect: ArduPilot's HWSTATUS."""
    mav = ardupilotmega.MAVLink(None, 1, 1)
    return mav.hwstatus_encode(5000, 0).pack(mav)


def test_each_wait_is_announced():
    pair, said = Pair(Autopilot.PX4), list[str]()
    check_vehicle(pair.client, pair.run, lambda: pair.t_s, said.append)
    assert said[0] == "listening for a vehicle, 4 s"
    assert said[1] == "px4 found: measuring its message rates, 4 s"
    assert re.fullmatch(r"reading parameters: (\d+) of \1 to come", said[2])


@EVERY_FIRMWARE
def test_default_parameters_are_red_and_the_named_commands_fix_them(autopilot, firmware):
    pair = Pair(autopilot, firmware=firmware)
    findings = examined(pair)
    wrong = red(findings)
    assert wrong == RED_AT_DEFAULTS[autopilot][firmware]
    assert f"version {firmware}" in next(str(finding) for finding in findings if finding.name == "autopilot")
    assert not is_fit(findings)
    assert is_fit(findings, waived=list(wrong))
    (place,) = places(findings)
    assert "MAVProxy" in place
    for fix in wrong.values():
        obey(pair, fix)
    findings = examined(pair)
    assert is_fit(findings), [str(finding) for finding in findings]
    told = [finding for finding in findings if finding.verdict is not Health.OK]
    assert told == [], "every name of this firmware's is known"


def test_the_page_shows_what_the_doctor_prints():
    assert doctor_docs.PAGE.read_text() == doctor_docs.page(), "run: python -m tools.docs.doctor"


UNFIT = [
    (Autopilot.PX4, "1.16", {"COM_RC_STICK_OV": 100.0}),
    (Autopilot.PX4, "1.16", {"COM_FAIL_ACT_T": 25.0}),
    (Autopilot.PX4, "1.14", {"NAV_RCL_ACT": 0}),
    (Autopilot.PX4, "1.18", {"COM_RCL_EXCEPT": 4}),
    (Autopilot.PX4, "1.16", {"COM_RC_IN_MODE": 4}),
    (Autopilot.PX4, "1.18", {"MAN_OVERRIDE_SPD": -1.0}),
    (Autopilot.PX4, "1.16", {"COM_LOW_BAT_ACT": 0}),
    (Autopilot.PX4, "1.16", {"GF_MAX_HOR_DIST": 50000.0}),
    (Autopilot.PX4, "1.16", {"GF_MAX_VER_DIST": 5000.0}),
    (Autopilot.PX4, "1.16", {"COM_OF_LOSS_T": 2.0}),
    (Autopilot.ARDUPILOT, "4.5", {"FENCE_RADIUS": 30000.0}),
    (Autopilot.ARDUPILOT, "4.7", {"FENCE_ALT_MAX": 1000.0}),
    (Autopilot.ARDUPILOT, "4.7", {"BATT_FS_LOW_ACT": 0}),
    (Autopilot.ARDUPILOT, "4.5", {"FS_THR_ENABLE": 0}),
    (Autopilot.ARDUPILOT, "4.7", {"FS_EKF_ACTION": 0}),
    (Autopilot.ARDUPILOT, "4.7", {"FS_OPTIONS": 20}),
]


@pytest.mark.parametrize(("autopilot", "firmware", "wrong"), UNFIT)
def test_a_value_that_leaves_the_vehicle_without_a_failsafe_is_red_by_its_name(autopilot, firmware, wrong):
    pair = Pair(autopilot, firmware=firmware)
    pair.system.flight.parameters.update(fit(autopilot, firmware) | wrong)
    fixes = red(examined(pair))
    assert list(fixes) == list(wrong)
    for fix in fixes.values():
        obey(pair, fix)
    assert red(examined(pair)) == {}


@pytest.mark.parametrize(
    ("firmware", "told"),
    [
        ("4.5", {"WPNAV_ACCEL": "2.5 m/s2", "RTL_ALT": "15 m", "LAND_SPEED": "0.5 m/s", "ANGLE_MAX": "30 deg"}),
        ("4.7", {"WP_ACC": "2.5 m/s2", "RTL_ALT_M": "15 m", "LAND_SPD_MS": "0.5 m/s", "ATC_ANGLE_MAX": "30 deg"}),
    ],
)
def test_the_same_value_is_reported_alike_whatever_the_firmwares_name_and_unit(firmware, told):
    found = {finding.name: finding.text for finding in examined(Pair(Autopilot.ARDUPILOT, firmware=firmware))}
    for name, text in told.items():
        assert found[name].startswith(f"{text} (")


@BOTH
def test_without_a_remote_control_it_is_red(autopilot):
    pair = Pair(autopilot)
    flight = pair.system.flight
    flight.parameters.update(fit(autopilot))
    flight.sticks = None
    assert list(red(examined(pair))) == ["remote-control"]
    flight.resting_sticks = None  # never bound
    assert list(red(examined(pair))) == ["remote-control"]


@BOTH
def test_without_the_landed_state_it_is_red_because_unknown_counts_as_landed(autopilot):
    pair = Pair(autopilot)
    pair.system.flight.parameters.update(fit(autopilot))
    pair.to_client = lambda packets: [p for p in packets if int.from_bytes(p[7:10], "little") != 245]
    assert list(red(examined(pair))) == ["extended_sys_state"]
    assert not pair.state.in_air


@BOTH
def test_a_battery_below_the_autopilots_own_level_is_red(autopilot):
    pair = Pair(autopilot)
    pair.system.flight.parameters.update(fit(autopilot) | {"COM_LOW_BAT_ACT": 0, "BATT_FS_LOW_ACT": 0})
    pair.system.flight.battery = 0.09  # PX4: low below 0.15, critical below 0.07
    assert "battery" in red(examined(pair))


@BOTH
def test_the_doctor_changes_nothing_on_the_vehicle(autopilot):
    pair = Pair(autopilot)
    before = dict(pair.system.flight.parameters), pair.system.flight.mode, pair.system.flight.armed
    examined(pair)
    assert (pair.system.flight.parameters, pair.system.flight.mode, pair.system.flight.armed) == before


@pytest.mark.parametrize(
    ("heard", "told", "fix"),
    [
        ([], "nothing is heard", "check address"),
        ([b"\x55" * 400], "no MAVLink packet", "baud rate"),
        ([heartbeat(1, 1, dialect.MAV_TYPE_FIXED_WING, 12)], "FIXED_WING with PX4", "check what is connected"),
        ([heartbeat(255, 190, dialect.MAV_TYPE_GCS, 8)], "system 255 component 190 (GCS)", "check what is connected"),
        ([heartbeat(1, 1, dialect.MAV_TYPE_QUADROTOR, 3)], "no system 5 is heard, but system 1", "--system-id 1"),
        ([foreign_packet()], "MAVLink packets, but no heartbeat", "check what is connected"),
    ],
)
def test_a_link_without_the_vehicle_names_the_other_senders(heard, told, fix):
    pair = Pair(Autopilot.PX4, system_id=5)
    pair.to_client = lambda _packets: heard if round(pair.t_s * 50) % 50 == 0 else []
    (finding,) = examined(pair)
    assert finding.verdict is Health.RED
    assert told in finding.text
    assert fix in finding.fix


def test_two_vehicles_are_red_until_one_is_chosen():
    for system_id, names in ((None, ["vehicles"]), (1, [])):
        pair = Pair(Autopilot.PX4, system_id=system_id)
        pair.system.flight.parameters.update(fit(Autopilot.PX4))
        pair.to_client = lambda packets: [*packets, heartbeat(2, 1, dialect.MAV_TYPE_QUADROTOR, 12)]
        assert list(red(examined(pair))) == names


@pytest.mark.parametrize("boot_s", [100.0, 417.0])
def test_two_vehicles_of_one_id_are_red(boot_s):
    pair = Pair(Autopilot.PX4)
    pair.system.flight.parameters.update(fit(Autopilot.PX4))
    start = VehicleTruth(north_m=60.0, down_m=-30.0)
    twin = AutopilotSystem(Autopilot.PX4, Vehicle(Autopilot.PX4, start), boot_s=boot_s)
    for _ in range(60 if boot_s == 100.0 else 0):  # apart in their sequence numbers only, or in their clocks only
        twin.step(0.0)
        twin._report(dialect.MAVLINK_MSG_ID_ATTITUDE, twin._links[0])

    def both(packets: list[bytes]) -> list[bytes]:
        twin.step(pair.t_s)
        return [*packets, *twin.take()]

    pair.to_client = both
    found = red(examined(pair))
    assert "identity" in found
    assert "MAV_SYS_ID" in found["identity"]


def test_an_unsigned_link_is_red_where_strangers_reach_it():
    client = Pair(Autopilot.PX4).client
    assert check_signing(client, False, Reach.NETWORK).verdict is Health.RED
    for reach in (Reach.LOOPBACK, Reach.SERIAL):
        assert check_signing(client, False, reach).verdict is Health.OK
    assert check_signing(client, True, Reach.NETWORK).verdict is Health.OK


@BOTH
def test_only_a_simulator_may_be_flown_by_a_file_or_a_scene(autopilot):
    pair = Pair(autopilot)
    examined(pair)
    assert check_simulator(pair.client, Reach.LOOPBACK, said=False).verdict is Health.OK
    for reach in (Reach.SERIAL, Reach.NETWORK):
        assert check_simulator(pair.client, reach, said=False).verdict is Health.RED
        assert check_simulator(pair.client, reach, said=True).verdict is Health.OK
    for name in ("SIM_BAT_DRAIN", "SIM_SPEEDUP"):
        pair.client.heard.parameters.pop(name, None)
    assert check_simulator(pair.client, Reach.LOOPBACK, said=False).verdict is Health.RED


def test_a_second_sender_is_red():
    pair = Pair(Autopilot.PX4)
    other = dialect.MAVLink(None, 1, 192)
    setpoint = other.set_position_target_local_ned_encode(0, 1, 1, 8, 0x05C7, *(0.0,) * 11).pack(other)
    pair.to_client = lambda packets: [*packets, setpoint]
    found = {finding.name: finding for finding in examined(pair)}
    assert found["second-sender"].verdict is Health.RED
    assert "component 192" in found["second-sender"].text


def test_a_parameter_without_a_reply_is_red_if_it_is_checked():
    pair = Pair(Autopilot.PX4)
    del pair.system.flight.parameters["COM_OBL_RC_ACT"]
    del pair.system.flight.parameters["RTL_RETURN_ALT"]
    found = {finding.name: finding.verdict for finding in examined(pair)}
    assert found["COM_OBL_RC_ACT"] is Health.RED
    assert found["RTL_RETURN_ALT"] is Health.WARN


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


def test_free_disk_space_is_reported(tmp_path):
    assert "GB free" in doctor.check_disk(tmp_path / "not" / "yet").text


def test_the_needed_disk_space_follows_from_frames_and_flight_time(tmp_path, monkeypatch):
    needed = doctor.flight_bytes((640, 360), RecordConfig(), 600.0)
    assert needed == pytest.approx(10 * 7.8e6, rel=0.05)  # 4.5 MB a minute of frames, 3.3 of the rest
    assert doctor.flight_bytes((1280, 720), RecordConfig(encoder=Encoder.JPEG), 600.0) > 20 * needed
    for free, verdict in ((0.9, Health.RED), (1.5, Health.WARN), (3.5, Health.OK)):
        usage = SimpleNamespace(free=free * needed)
        monkeypatch.setattr(doctor.shutil, "disk_usage", lambda _path, usage=usage: usage)
        finding = doctor.check_disk(tmp_path, (640, 360), RecordConfig(), 600.0)
        assert finding.verdict is verdict
        assert "10 min at 640x360 take 0.08 GB" in finding.text


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


def test_a_camera_is_judged_by_its_rate_and_the_age_of_its_images():
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


def test_the_command_with_nothing_to_check_is_wrong_use(tmp_path, capsys):
    assert main(["doctor", "--out", str(tmp_path)]) == 2
    assert "give --camera SOURCE, --link ADDRESS or both" in capsys.readouterr().err
