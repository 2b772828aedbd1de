"""Third-party clients fly the simulated autopilot over UDP: MAVSDK 4.1, and pymavlink's own connection."""

import math
import os
import re
import subprocess
import sys
import time
from contextlib import AbstractContextManager

import pytest
from mavsdk import ComponentType, Configuration, Mavsdk
from mavsdk.plugins.action import Action
from mavsdk.plugins.offboard import Offboard, VelocityBodyYawspeed
from mavsdk.plugins.telemetry import Telemetry
from pymavlink.dialects.v20 import common as dialect

from sim.autopilot.program import Options, build, main
from tests.support.real_flight import Program, free_ports, program, until

BOTH = pytest.mark.parametrize("rules", ["px4", "ardupilot"])
SPEEDUP = 6.0
START_S = 30.0  # a loaded machine takes that long to start a process
SQUARE = ((1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0))
SIDE_M = 1.0


def autopilot(rules: str, port: int) -> AbstractContextManager[Program]:
    """The program itself, as a person starts it."""
    call = [sys.executable, "-m", "sim.autopilot", "--autopilot", rules, "--link", f"udpout:127.0.0.1:{port}"]
    return program([*call, "--speedup", str(SPEEDUP)])


@BOTH
def test_mavsdk_arms_takes_off_flies_a_square_and_lands(rules):
    (port,) = free_ports(1)
    mavsdk = Mavsdk(Configuration.create_with_component_type(ComponentType.GROUND_STATION))
    try:
        mavsdk.add_any_connection(f"udpin://127.0.0.1:{port}")
        with autopilot(rules, port):
            system = mavsdk.first_autopilot(START_S)
            assert system is not None
            fly_with_mavsdk(Telemetry(system), Action(system), Offboard(system))
    finally:
        mavsdk.destroy()


def fly_with_mavsdk(telemetry: Telemetry, action: Action, offboard: Offboard) -> None:
    until("healthy", telemetry.health_all_ok)
    action.set_takeoff_altitude(3.0)
    action.arm()
    action.takeoff()
    until("up", lambda: telemetry.position().relative_altitude_m > 2.5)
    offboard.set_velocity_body(VelocityBodyYawspeed(0.0, 0.0, 0.0, 0.0))
    offboard.start()
    for forward, right in SQUARE:
        start = telemetry.position_velocity_ned().position
        offboard.set_velocity_body(VelocityBodyYawspeed(forward, right, 0.0, 0.0))

        def went(start=start, forward=forward, right=right) -> bool:
            now = telemetry.position_velocity_ned().position
            return forward * (now.north_m - start.north_m) + right * (now.east_m - start.east_m) > SIDE_M

        until(f"a side along {forward, right}", went)
    offboard.stop()
    action.land()
    until("down and disarmed", lambda: not telemetry.armed() and not telemetry.in_air())


@BOTH
def test_a_plain_pymavlink_client_arms_takes_off_flies_a_square_and_lands(rules, monkeypatch):
    monkeypatch.setitem(os.environ, "MAVLINK20", "1")
    from pymavlink import mavutil  # noqa: PLC0415 (it reads the environment when it is imported)

    (port,) = free_ports(1)
    link = mavutil.mavlink_connection(f"udpin:127.0.0.1:{port}", source_system=255)
    try:
        with autopilot(rules, port):
            assert link.wait_heartbeat(timeout=START_S) is not None
            fly_with_pymavlink(link, guided="GUIDED" if rules == "ardupilot" else "OFFBOARD")
    finally:
        link.close()


def fly_with_pymavlink(link, guided: str) -> None:
    def heard(kind: str):
        message = link.recv_match(type=kind, blocking=True, timeout=5)
        assert message is not None, kind
        return message

    def stream(seconds: float, forward: float = 0.0, right: float = 0.0) -> None:
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            setpoint = 0, 1, 1, 8, 0x05C7, 0, 0, 0, forward, right, 0, 0, 0, 0, 0, 0
            link.mav.set_position_target_local_ned_send(*setpoint)
            time.sleep(0.02)
            while link.recv_msg() is not None:
                pass

    for number in (32, 245):  # LOCAL_POSITION_NED, EXTENDED_SYS_STATE
        link.mav.command_long_send(1, 1, 511, 0, number, 1e6 / 20, 0, 0, 0, 0, 0)
    if guided == "GUIDED":
        link.set_mode(guided)
    link.arducopter_arm()
    link.motors_armed_wait()
    height = 3.0 if guided == "GUIDED" else math.nan  # PX4 counts from the sea; without a number it knows its own
    link.mav.command_long_send(1, 1, 22, 0, 0, 0, 0, 0, 0, 0, height)
    until("up", lambda: heard("LOCAL_POSITION_NED").z < -2.2)
    stream(1.5 / SPEEDUP)
    if guided == "OFFBOARD":
        link.mav.command_long_send(1, 1, 176, 0, 1, 6, 0, 0, 0, 0, 0)
    for forward, right in SQUARE:
        start = heard("LOCAL_POSITION_NED")

        def went(start=start, forward=forward, right=right) -> bool:
            stream(0.05, forward, right)
            now = link.messages["LOCAL_POSITION_NED"]
            return forward * (now.x - start.x) + right * (now.y - start.y) > SIDE_M

        until(f"a side along {forward, right}", went)
    link.mav.command_long_send(1, 1, 21, 0, 0, 0, 0, 0, 0, 0, 0)
    until("landed", lambda: heard("EXTENDED_SYS_STATE").landed_state == 1)
    until("disarmed", lambda: not heard("HEARTBEAT").base_mode & 128)


def test_a_client_with_the_same_key_and_the_clocks_time_takes_what_a_new_autopilot_signs(tmp_path):
    key = tmp_path / "key"
    key.write_bytes(bytes(range(32)))
    key.chmod(0o600)
    system = build(Options(signing_key=key))
    ears = dialect.MAVLink(None, 1, 191)
    ears.signing.secret_key = key.read_bytes()
    ears.signing.timestamp = int((time.time() - 1_420_070_400) * 1e5)  # it refuses a stream a minute behind
    system.step(0.1)
    packets = system.take()
    assert packets
    for packet in packets:
        ears.parse_buffer(packet)  # raises MAVError for a refused signature


FROM_0 = ("height-m", "wind-m-s", "seconds")
NUMBER = "must be a finite number of at least 0, not"
PORT = "must be udpout:HOST:PORT or udpin:HOST:PORT with a port up to 65535, not"
SETTING = "--set must be NAME=VALUE with a finite number, not"


@pytest.mark.parametrize(
    ("option", "value", "said"),
    [
        ("--link", "nowhere", f"--link {PORT} 'nowhere'"),
        ("--link", "udpout:127.0.0.1:99999", f"--link {PORT} 'udpout:127.0.0.1:99999'"),
        ("--gcs", "udpin:127.0.0.1:99999", f"--gcs {PORT} 'udpin:127.0.0.1:99999'"),
        ("--link", "udpin:192.0.2.1:14540", "--link must be an address that can be had, not 'udpin:192.0.2.1"),
        ("--set", "GF_ACTION", f"{SETTING} 'GF_ACTION'"),
        ("--set", "GF_ACTION=abc", f"{SETTING} 'GF_ACTION=abc'"),
        ("--set", "GF_ACTION=nan", f"{SETTING} 'GF_ACTION=nan'"),
        ("--set", "COM_OF_LOSS_T=inf", f"{SETTING} 'COM_OF_LOSS_T=inf'"),
        ("--set", "GUID_TIMEOUT=1", "--set must name a parameter that this autopilot has, not 'GUID_TIMEOUT'"),
        *[(f"--{name}", bad, f"--{name} {NUMBER} {bad}") for name in FROM_0 for bad in ("nan", "-1", "inf")],
        ("--seed", "-1", f"--seed {NUMBER} -1"),
        *[("--speedup", bad, f"--speedup must be a finite number above 0, not {bad}") for bad in ("nan", "0", "-2")],
        ("--heading-deg", "nan", "--heading-deg must be a finite number, not nan"),
        ("--height", "6", "there is no option --height"),
        ("--set", "GUID_TIMEOUT", "--set must be NAME=VALUE with a finite number, not 'GUID_TIMEOUT'"),
    ],
)
def test_a_bad_option_is_one_sentence_that_names_option_rule_and_value(option, value, said, monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["sim.autopilot", "--link", "udpout:127.0.0.1:9", option, value])
    monkeypatch.setattr("sim.autopilot.program.run", lambda *_: pytest.fail("it started"))
    with pytest.raises(SystemExit) as left:
        main()
    stderr = capsys.readouterr().err
    assert left.value.code == 2
    assert stderr.startswith(f"sim.autopilot: {said}")
    assert stderr.count("\n") == 1


def test_a_wrong_address_is_one_line_and_no_trace():
    call = [sys.executable, "-m", "sim.autopilot", "--link", "nowhere"]
    done = subprocess.run(call, capture_output=True, text=True, timeout=30, check=False)
    assert done.returncode == 2
    assert done.stderr.strip().count("\n") == 0
    assert "udpout:HOST:PORT" in done.stderr


def test_the_program_prints_what_it_simulates_and_each_change_of_mode():
    (port,) = free_ports(1)
    words = ["--autopilot", "ardupilot", "--height-m", "6", "--link", f"udpout:127.0.0.1:{port}", "--seconds", "4"]
    words += ["--set", "FENCE_ENABLE=1", "--set", "FENCE_ALT_MAX=5", "--speedup", "10"]
    call = [sys.executable, "-m", "sim.autopilot", *words]
    done = subprocess.run(call, capture_output=True, text=True, timeout=30, check=False)
    first, *later = done.stderr.splitlines()
    assert first == f"sim.autopilot: ardupilot 4.7 in LOITER at 6 m, remote control on; --link udpout:127.0.0.1:{port}"
    assert any(re.fullmatch(r"sim\.autopilot: \d\.\d s: Fence Breached", line) for line in later)
    assert any(re.fullmatch(r"sim\.autopilot: \d\.\d s: mode LOITER -> RTL", line) for line in later)
