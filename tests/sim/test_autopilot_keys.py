"""The pilot's keys of the simulated autopilot: what each does under both rules, and the terminal they are typed in."""

import fcntl
import itertools
import os
import pty
import re
import select
import subprocess
import sys
import termios
import time

import pytest

from follow.messages import Autopilot
from sim.autopilot.core import AutopilotCore
from sim.autopilot.keys import KEPT_LINES, MODES, Console, Pilot
from sim.autopilot.rules import RULES
from sim.autopilot.telemetry import REPORTS, dialect
from sim.dynamics import Vehicle, VehicleTruth

BOTH = pytest.mark.parametrize("autopilot", list(Autopilot))


def piloted(autopilot: Autopilot, height_m: float = 8.0, remote: bool = True) -> tuple[Pilot, list[str]]:
    flight = RULES[autopilot](Vehicle(autopilot, VehicleTruth(down_m=-height_m)))
    if remote:
        flight.resting_sticks = flight.sticks = (0.0, 0.0, 0.0, 0.0)
    lines: list[str] = []
    return Pilot(flight, lines.append), lines


def advance(pilot: Pilot, seconds: float) -> list[float]:
    """Rounds of the program; the roll stick in each."""
    rolls: list[float] = []
    end_t_s = pilot.flight.t_s + seconds
    while pilot.flight.t_s < end_t_s:
        pilot.step()
        pilot.flight.advance(pilot.flight.t_s + 0.02)
        rolls.append(pilot.flight.sticks[1] if pilot.flight.sticks else 0.0)
    return rolls


def remote_healthy(flight: AutopilotCore) -> bool:
    status = REPORTS[dialect.MAVLINK_MSG_ID_SYS_STATUS](flight, 1.0)
    return bool(status.onboard_control_sensors_health & dialect.MAV_SYS_STATUS_SENSOR_RC_RECEIVER)


@BOTH
def test_every_mode_key_requests_its_mode_and_is_reported(autopilot):
    for key, mode in MODES[autopilot].items():
        pilot, lines = piloted(autopilot)
        assert f"{key} {mode}" in pilot.help()
        pilot.press(key)
        refused = mode == "OFFBOARD"  # PX4 without a stream of setpoints
        assert (pilot.flight.mode == mode) is not refused
        assert lines == [f"0.0 s: the pilot commands mode {mode}: {'TEMPORARILY_REJECTED' if refused else 'ACCEPTED'}"]


@BOTH
def test_w_arms_and_disarms_on_the_ground_and_not_in_the_air(autopilot):
    pilot, lines = piloted(autopilot, height_m=0.0)
    pilot.press("w")
    assert pilot.flight.armed
    pilot.press("w")
    assert not pilot.flight.armed
    flying, said = piloted(autopilot)
    flying.press("w")
    assert flying.flight.armed
    assert [line.split("commands ")[1] for line in lines] == ["arming: ACCEPTED", "disarming: ACCEPTED"]
    assert said[0].endswith(", it is in the air")


def test_a_pushed_stick_takes_px4_over_and_comes_to_rest():
    pilot, _ = piloted(Autopilot.PX4)
    pilot.flight.parameters["COM_RC_OVERRIDE"] = 3
    pilot.press("s")
    rolls = advance(pilot, 0.98)
    assert pilot.flight.mode == "POSCTL"
    assert max(rolls) > 0.8
    assert max(abs(b - a) for a, b in itertools.pairwise(rolls)) < 0.1  # moved by a hand, no jump
    assert pilot.flight.vehicle.motion.east_m > 0.5
    assert advance(pilot, 1.0)[-1] == 0.0
    assert pilot.flight.sticks == pilot.flight.resting_sticks


@BOTH
def test_x_loses_the_remote_control_and_finds_it_again_also_with_a_stick_off_its_rest(autopilot):
    pilot, lines = piloted(autopilot)
    pilot.press("s")
    advance(pilot, 0.3)
    pilot.press("x")
    assert not remote_healthy(pilot.flight)
    pilot.press("s")
    advance(pilot, 3.0)
    assert pilot.flight.sticks is None
    pilot.press("x")
    assert remote_healthy(pilot.flight)
    assert not any(advance(pilot, 0.5))
    assert [line.split(": ", 1)[1] for line in lines[1:]] == [
        "the remote control is lost",
        "no stick moves: the remote control is lost, x brings it back",
        "the remote control is back",
    ]


@BOTH
def test_without_a_remote_control_its_keys_say_so_and_other_keys_do_nothing(autopilot):
    pilot, lines = piloted(autopilot, remote=False)
    for key in "sxzé7\x1b\n":
        pilot.press(key)
    assert len(lines) == 2
    assert all("start without --no-remote" in line for line in lines)
    assert pilot.flight.sticks is None
    pilot.press("?")
    assert lines[-1] == pilot.help()


PROGRAM = "-m", "sim.autopilot", "--link", "udpout:127.0.0.1:9"


class Terminal:
    """A process in a terminal of its own, and the person before it."""

    def __init__(self, *words: str, program: tuple[str, ...] = PROGRAM) -> None:
        self.person, terminal = pty.openpty()
        self.said = ""

        def controlling() -> None:
            os.setsid()
            fcntl.ioctl(0, termios.TIOCSCTTY, 0)

        call = [sys.executable, *program, *words]
        streams = {"stdin": terminal, "stdout": terminal, "stderr": terminal}
        self.process = subprocess.Popen(call, **streams, preexec_fn=controlling)  # noqa: PLW1509 - one thread
        self.terminal = terminal

    def type(self, keys: str) -> None:
        os.write(self.person, keys.encode())

    def until(self, pattern: str, timeout_s: float = 60.0) -> None:
        """Read until the pattern stands on the screen."""
        end_s = time.monotonic() + timeout_s
        while not re.search(pattern, self.said):
            assert select.select([self.person], [], [], max(end_s - time.monotonic(), 0.0))[0], self.said
            self.said += os.read(self.person, 4096).decode(errors="replace")

    def echoes(self) -> bool:
        return bool(termios.tcgetattr(self.terminal)[3] & termios.ECHO)

    def __enter__(self) -> "Terminal":
        return self

    def __exit__(self, *_error: object) -> None:
        self.process.kill()
        self.process.wait()
        os.close(self.person)
        os.close(self.terminal)


def test_keys_of_a_terminal_act_and_q_leaves_it_as_it_was():
    with Terminal("--autopilot", "ardupilot", "--height-m", "6") as t:
        t.until(r"keys: p POSHOLD, l LOITER, .* q quit, h this list")
        t.type("P")
        t.until(r"the pilot commands mode POSHOLD: ACCEPTED\r\n.*mode LOITER -> POSHOLD")
        assert not t.echoes()
        t.type("hq")
        t.until(r"(?s)keys: .*keys: ")
        assert t.process.wait(30) == 0
        assert t.echoes()


def test_a_stopped_terminal_stops_nothing_and_gets_its_lines_later():
    with Terminal("--height-m", "6", "--seconds", "600") as t:
        t.until("this list")
        t.type("\x13a")  # Ctrl-S stops the terminal's output
        t.type("lalq")
        assert t.process.wait(60) == 0
        assert t.echoes()
    with Terminal("--height-m", "6") as t:
        t.until("this list")
        t.type("\x13a")
        t.type("\x11l")  # Ctrl-Q
        t.until("(?s)commands mode ALTCTL.*commands mode HOLD")


BEHIND = """
import os, signal, subprocess, sys, time
child = subprocess.Popen([sys.executable, "-m", "sim.autopilot", *sys.argv[1:]], preexec_fn=os.setpgrp)
print("waits", child.wait(), flush=True)
print(os.read(0, 9))
"""


def test_in_the_background_of_a_shell_it_flies_on_and_takes_no_key():
    words = ("--link", "udpout:127.0.0.1:9", "--height-m", "6", "--seconds", "20", "--speedup", "10")
    with Terminal(*words, program=("-c", BEHIND)) as t:
        t.type("l\n")
        t.until(r"waits 0\r\n(?s:.*)b'l\\n'")
        assert "ACCEPTED" not in t.said


def test_sigterm_leaves_the_terminal_as_it_was():
    with Terminal("--height-m", "6") as t:
        t.until("this list")
        t.type("a")
        t.until("ALTCTL: ACCEPTED")
        t.process.terminate()
        assert t.process.wait(30) == 0
        assert t.echoes()


def test_without_a_terminal_nothing_is_read_and_no_key_is_told():
    call = [sys.executable, "-m", "sim.autopilot", "--link", "udpout:127.0.0.1:9", "--height-m", "6"]
    call += ["--seconds", "4", "--speedup", "10"]
    done = subprocess.run(call, input="aq", capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 0
    assert done.stderr.count("\n") == 1
    assert "keys" not in done.stderr


def test_of_too_many_lines_for_a_stopped_terminal_the_newest_are_kept(monkeypatch, capsys):
    console = Console()
    monkeypatch.setattr("sim.autopilot.keys.takes_text", lambda: False)
    for n in range(KEPT_LINES + 5):
        console.report(f"line {n}")
    assert capsys.readouterr().err == ""
    monkeypatch.setattr("sim.autopilot.keys.takes_text", lambda: True)
    console.flush()
    told = capsys.readouterr().err.splitlines()
    assert (told[0], told[-1]) == ("sim.autopilot: line 5", f"sim.autopilot: line {KEPT_LINES + 4}")
