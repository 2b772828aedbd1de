"""`follow sim --ground`: any console selects, changes and clears the target while the simulated vehicle flies."""

import json
import os
import re
import signal
import sys
from pathlib import Path

import pytest
from pymavlink.dialects.v20 import common as dialect
from websockets.sync.client import connect

from follow.cli.commands import SimCommand
from follow.messages import VehicleState
from follow.operator.ground import LoneVehicle
from follow.operator.ground_camera import REPEAT_S
from tests.follow.test_page_flight import blue_walker, watch
from tests.support.ground_station import NEW, OLD
from tests.support.ground_wire import Scripted
from tests.support.machine import against_the_clock
from tests.support.page_rig import Window
from tests.support.real_flight import free_ports, program

DOCS = Path(__file__).parents[2] / "docs" / "ground_station.md"


def documented(port):
    """The command of the docs, with a free port."""
    (line,) = re.findall(r"^follow sim .*--ground udpin:.*$", DOCS.read_text(), re.M)
    words = line.partition("#")[0].split()
    return [re.sub(r"^udpin:.*", f"udpin:127.0.0.1:{port}", word) for word in words[1:]]


def corners(window):
    """Left, top, right, bottom of the walker in the newest image, by its shirt."""
    left, top, width, height = blue_walker(window.images[-1][1])
    return left, top, left + width, top + height


def in_state(window, state, seconds=15.0):
    watch(window, lambda w: w.status.get("state") == state, seconds)


def passes(window, seconds):
    """Let the flight go on."""
    t_s = window.status["t"]
    watch(window, lambda w: w.status["t"] - t_s > seconds, 4 * seconds)


@pytest.mark.realtime
@pytest.mark.parametrize("variant", [OLD, NEW])
def test_ground_station_and_page_select_change_and_clear_in_a_simulated_flight(variant, tmp_path, monkeypatch):
    monkeypatch.setitem(os.environ, "MAVLINK20", "1")
    port, page = free_ports(2)
    host, out = f"127.0.0.1:{page}", tmp_path / "flight"
    call = [sys.executable, "-m", "follow.cli", *documented(port), "--page", host, "--out", str(out)]
    with program(call) as flight:
        flight.wait_until_said("page: ", 60.0)
        with (
            Scripted(variant, port, None) as station,
            connect(f"ws://{host}/window", origin=f"http://{host}", compression=None) as socket,
        ):
            socket.send("0123456789abcdef")
            window = Window(None, socket)

            def status():
                return station.station.heard["CAMERA_TRACKING_IMAGE_STATUS"]

            watch(window, lambda w: len(w.images) > 10, 30.0)
            station.draw(corners(window))
            in_state(window, "FOLLOWING")
            passes(window, REPEAT_S + 0.5)
            station.draw(corners(window))
            watch(window, lambda _w: sum("target selected by the ground" in line for line in flight.lines) == 2, 10.0)
            in_state(window, "FOLLOWING")
            window.send(do="clear")  # from the other console
            in_state(window, "STOPPED")
            watch(window, lambda _w: status().tracking_status == 0, 5.0)
            watch(window, lambda w: blue_walker(w.images[-1][1]) is not None, 20.0)
            passes(window, REPEAT_S + 0.5)
            station.draw(corners(window))
            in_state(window, "FOLLOWING")
            station.stop()
            in_state(window, "STOPPED")
            with against_the_clock():
                assert not station.errors
        assert flight.end(signal.SIGTERM) == 0, flight.lines
    figures = json.loads((out / "summary.json").read_text())
    assert figures["modes"]["follow"] > 2.0
    assert figures["off_target_s"] < figures["modes"]["ended"] + 1.0, "off it only while nothing is tracked"


def test_a_vehicle_without_an_autopilot_beats_each_second_and_tells_the_pilot():
    vehicle, reader = LoneVehicle(), dialect.MAVLink(None)
    heard = []
    for k in range(100):
        if k == 40:
            vehicle.tell("Follow: a text that is much longer than fifty letters, and so cut", 4)
            vehicle.tell_value("flw_range", 12.5, 2.0)
        for packet in vehicle.take(VehicleState(k / 20, armed=k >= 50)):
            heard += [(k, message) for message in reader.parse_buffer(packet)]
    beats = [(k, m) for k, m in heard if m.get_type() == "HEARTBEAT"]
    assert [k for k, _ in beats] == [0, 20, 40, 60, 80]
    assert [bool(m.base_mode & 128) for _, m in beats] == [False, False, False, True, True]
    assert {(m.get_srcSystem(), m.get_srcComponent()) for _, m in beats} == {(1, 1)}
    said = [m for k, m in heard if m.get_type() != "HEARTBEAT"]
    assert [m.get_srcComponent() for m in said] == [191, 191]
    assert said[0].text == "Follow: a text that is much longer than fifty lett"
    assert said[1].value == 12.5


@pytest.mark.parametrize(
    ("options", "why"),
    [
        ({"ground": "link"}, "is udpin:HOST:PORT"),
        ({"ground": "udpin:127.0.0.1:5", "all": True}, "leave out --all"),
        ({"ground_follows": True}, "needs --ground"),
        ({"video_out": "rtp://127.0.0.1:5600"}, "needs --ground or --page"),
        ({"ground": "udpin:127.0.0.1:5", "ground_delay_s": 2.0}, "--ground-delay-s lies in 0..1.5"),
    ],
)
def test_what_a_simulation_cannot_do_is_refused_before_it_starts(options, why):
    with pytest.raises(ValueError, match=re.escape(why)):
        SimCommand(**options)
