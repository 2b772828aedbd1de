"""The installed service files agree with the program."""

import configparser
import re
import shlex
from pathlib import Path

from follow.cli.commands import RunCommand
from follow.cli.layers import read
from follow.flight.live_flight import LEAVE_S
from follow.flight.service import ALIVE_EVERY_S
from follow.link.connection import HOLD_S

FOLDER = Path(__file__).parents[2] / "docs" / "service"


def unit() -> configparser.ConfigParser:
    parser = configparser.ConfigParser(interpolation=None, strict=True)
    parser.optionxform = str
    parser.read(FOLDER / "follow-me.service")
    return parser


def test_the_watchdog_outlives_the_pauses_of_a_sound_loop_and_the_stop_outlives_the_ramp():
    service = unit()["Service"]
    assert service["Type"] == "notify"
    assert float(service["WatchdogSec"]) > max(4 * ALIVE_EVERY_S, 2 * HOLD_S)
    assert float(service["TimeoutStopSec"]) > LEAVE_S + HOLD_S


def test_the_options_are_those_of_follow_run_and_do_not_follow_by_themselves():
    text = (FOLDER / "follow-me.conf").read_text()
    options = re.search(r'^FOLLOW_OPTIONS="(.*)"$', text, re.MULTILINE)
    assert options is not None
    words = shlex.split(options[1])
    installed_at = words[words.index("--settings") + 1]
    words[words.index("--settings") + 1] = str(FOLDER / "settings.toml")
    command = read(["run", *words, "--out", "somewhere"])
    assert isinstance(command, RunCommand)
    assert not command.follow
    assert command.ground == "link", "a ground station can select, the page also"
    assert command.page is not None
    token = str(command.page_token)
    assert f"sudo install -m 600 -o follow /dev/stdin {token}" in (FOLDER / "README.md").read_text()
    installed = f"sudo cp docs/service/settings.toml {installed_at}"
    assert installed in (FOLDER / "README.md").read_text()


def test_the_program_listens_where_the_router_sends():
    router = configparser.ConfigParser()
    router.read(FOLDER / "mavlink-router.conf")
    end = router["UdpEndpoint follow-me"]
    assert f"udpin:{end['Address']}:{end['Port']}" in (FOLDER / "follow-me.conf").read_text()


def test_the_unit_starts_the_command_with_its_options():
    start = unit()["Service"]["ExecStart"]
    assert "exec /opt/follow-me/.venv/bin/follow run $FOLLOW_OPTIONS" in start
    assert "--follow" not in start
