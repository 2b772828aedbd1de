"""`follow doctor` as a process over UDP: red at default parameters; green once a person typed the commands it names.

Two of the four pairs of rules and link library; all four with FOLLOW_RUN_S set, as in test_follow_run.py.
"""

import os
import re
import struct
import subprocess
import sys
from pathlib import Path

import pytest
from pymavlink.dialects.v20 import common as dialect

from follow.messages import Autopilot
from sim.autopilot.parameters import DEFAULT_FIRMWARE
from tests.follow.test_mavlink_doctor import RED_AT_DEFAULTS
from tests.support.machine import against_the_clock
from tests.support.real_flight import Pilot, free_ports, program, until

EVERY_PAIR = "FOLLOW_RUN_S" in os.environ
PAIRS = [("px4", False), ("ardupilot", True)] + EVERY_PAIR * [("px4", True), ("ardupilot", False)]


def doctor(link: str, out: Path) -> tuple[int, dict[str, str], str]:
    """Exit status, the red lines as name -> its fix, and the whole output."""
    call = [sys.executable, "-m", "follow.cli", "doctor", "--link", link, "--out", str(out)]
    done = subprocess.run(
        call, capture_output=True, text=True, timeout=120, check=False, env={**os.environ, "COLUMNS": "200"}
    )
    red = dict(re.findall(r"^red (\S+): .* -> (.*)$", done.stderr, re.MULTILINE))
    return done.returncode, red, done.stderr


def typed(pilot: Pilot, command: str) -> None:
    """Do what a ground station does for `param set NAME VALUE`: ask for the type, set, and wait for the echo."""
    verb, noun, name, text = command.split()
    assert (verb, noun) == ("param", "set")

    def told() -> dialect.MAVLink_message:
        """The newest value of the parameter that the autopilot reported."""
        until(f"told {name}", lambda: pilot.known["PARAM_VALUE"][1].param_id == name, 5.0)
        return pilot.known["PARAM_VALUE"][1]

    pilot.link.mav.param_request_read_send(1, 1, name.encode(), -1)
    until("told of a parameter", lambda: "PARAM_VALUE" in pilot.known, 5.0)
    kind = told().param_type
    value = float(text)
    if pilot.rules == "px4" and kind == dialect.MAV_PARAM_TYPE_INT32:
        (value,) = struct.unpack("<f", struct.pack("<i", int(value)))  # PX4 carries a whole number's bytes
    pilot.link.mav.param_set_send(1, 1, name.encode(), value, kind)
    until(f"{name} set", lambda: told().param_value == value, 5.0)


@pytest.mark.realtime
@pytest.mark.parametrize(("rules", "mavsdk"), PAIRS)
def test_the_doctor_is_red_at_defaults_and_green_after_the_commands_it_names(rules, mavsdk, tmp_path, monkeypatch):
    monkeypatch.setitem(os.environ, "MAVLINK20", "1")
    link_port, pilot_port = free_ports(2)
    ways = ["--link", f"udpout:127.0.0.1:{link_port}", "--gcs", f"udpin:127.0.0.1:{pilot_port}"]
    link = f"mavsdk+udpin://127.0.0.1:{link_port}" if mavsdk else f"udpin:127.0.0.1:{link_port}"
    with program([sys.executable, "-m", "sim.autopilot", "--autopilot", rules, "--height-m", "10", *ways]):
        pilot = Pilot(rules, pilot_port)
        try:
            pilot.meet()
            status, red, said = doctor(link, tmp_path)
            assert status == 1, said
            assert red.items() >= RED_AT_DEFAULTS[Autopilot(rules)][DEFAULT_FIRMWARE[Autopilot(rules)]].items(), said
            with against_the_clock():  # its own speed and the link's rates are also judged
                assert red.keys() == RED_AT_DEFAULTS[Autopilot(rules)][DEFAULT_FIRMWARE[Autopilot(rules)]].keys(), said
            for command in red.values():
                typed(pilot, command)
            status, red, said = doctor(link, tmp_path)
            with against_the_clock():
                assert (status, red) == (0, {}), said
        finally:
            pilot.close()
