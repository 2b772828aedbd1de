"""`follow sim --page`: the simulated pilot brings the vehicle to the target, FOLLOW flies, STOP releases it."""

import json
import math
import signal
import subprocess
import sys
import time

import cv2
import numpy as np
import pytest
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

from follow.messages import Autopilot, Setpoint
from sim.piloted import HOVERS_S, PilotedLink, RealTimePace
from sim.scenarios import SCENARIOS, build
from tests.support.ground_wire import walkers_box
from tests.support.machine import against_the_clock
from tests.support.page_killer import flown_last
from tests.support.page_rig import Window
from tests.support.real_flight import CONTROL, free_ports, program, real_flight, until


def piloted(name="walker", autopilot=Autopilot.PX4):
    scenario = SCENARIOS[name]
    _, link, world = build(scenario, 0, autopilot)
    return PilotedLink(link.vehicle, world.target, scenario.standoff_m, scenario.height_m), world, scenario


def seen_from(link, world):
    """Distance along the ground, m, and angle off the nose, rad."""
    m, pose = link.vehicle.motion, world.target(link.vehicle.motion.t_s)
    north, east = pose.north_m - m.north_m, pose.east_m - m.east_m
    return math.hypot(north, east), math.remainder(math.atan2(east, north) - m.yaw_rad, math.tau)


def passes(link, seconds):
    for _ in range(round(seconds * 30)):
        link.advance(1 / 30)


@pytest.mark.parametrize("autopilot", list(Autopilot))
@pytest.mark.parametrize("name", ["walker", "runner", "cyclist", "car"])
def test_the_simulated_pilot_keeps_the_target_in_the_image(name, autopilot):
    link, world, scenario = piloted(name, autopilot)
    for _ in range(10):
        passes(link, 3.0)
        distance_m, off_rad = seen_from(link, world)
        assert abs(off_rad) < 0.3
        assert 0.5 * scenario.standoff_m < distance_m < 1.6 * scenario.standoff_m
        assert not link.state().in_control


@pytest.mark.parametrize("autopilot", list(Autopilot))
def test_the_vehicle_obeys_after_take_control_and_hovers_after_the_stream(autopilot):
    link, world, _ = piloted(autopilot=autopilot)
    passes(link, 3.0)
    link.take_control()
    for _ in range(90):
        link.send(Setpoint(forward_m_s=-2.0))
        link.advance(1 / 30)
    assert link.state().in_control
    assert link.vehicle.motion.north_m_s < -1.0
    link.send(None)
    assert not link.state().in_control
    passes(link, HOVERS_S - 1.0)
    assert math.hypot(link.vehicle.motion.north_m_s, link.vehicle.motion.east_m_s) < 0.7, "it hovers"
    passes(link, 20.0)
    distance_m, off_rad = seen_from(link, world)
    assert distance_m < 15.0, "the pilot has taken it back"
    assert abs(off_rad) < 0.3


def test_a_late_round_causes_no_burst_of_rounds():
    link, _, _ = piloted()
    now = [10.0]
    pace = RealTimePace(link, lambda: now[0])
    pace.advance(0.0)
    now[0] += 60.0
    began_t_s = link.vehicle.motion.t_s
    for _ in range(15):
        pace.advance(1 / 30)
    assert link.vehicle.motion.t_s - began_t_s == pytest.approx(0.5)
    assert pace._due_s == pytest.approx(now[0], abs=0.05), "half a second late, then in time again"


def blue_walker(jpeg):
    """The walker by its blue shirt, from head to feet, in fractions of the image; None if it does not show."""
    image = cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_COLOR).astype(int)
    blue = (image[..., 0] > image[..., 2] + 60) & (image[..., 0] > image[..., 1] + 40)
    rows, columns = np.nonzero(blue)
    if len(rows) < 100:
        return None
    left, right = np.percentile(columns, (2, 98))
    top, bottom = np.percentile(rows, (2, 98))
    high = bottom - top
    box = (left - 2, top - 0.4 * high, right - left + 4, 2.7 * high)
    return [value / size for value, size in zip(box, (*image.shape[1::-1], *image.shape[1::-1]), strict=True)]


def watch(window, is_so, seconds):
    """Read what the window gets until something is so."""
    end_s = time.monotonic() + seconds
    while not is_so(window):
        assert time.monotonic() < end_s, f"{window.status.get('state')}, {window.status.get('why')}, {window.replies}"
        window.take(0.5)


@pytest.mark.realtime
def test_a_person_selects_follows_and_stops_in_a_simulated_flight(tmp_path):
    (port,) = free_ports(1)
    host, words = f"127.0.0.1:{port}", ["sim", "walker", "--out", str(tmp_path / "flight"), "--json"]
    command = [sys.executable, "-m", "follow.cli", *words, "--page", host]
    pipe = subprocess.PIPE
    process = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=pipe, stderr=pipe, text=True)
    try:
        assert process.stderr is not None
        assert any(f"page: http://{host}/" in line for line in process.stderr)
        with connect(f"ws://{host}/window", origin=f"http://{host}", compression=None) as socket:
            socket.send("0123456789abcdef")
            window = Window(None, socket)
            watch(window, lambda w: len(w.images) > 10, 30.0)
            header, jpeg = window.images[-1]
            window.send(do="select", frame=header["frame"], box=blue_walker(jpeg))
            watch(window, lambda w: w.status["state"] == "TRACKING", 10.0)
            window.order("follow")
            watch(window, lambda w: w.status["state"] == "FOLLOWING", 10.0)
            began_t_s = window.status["t"]
            watch(window, lambda w: w.status["t"] - began_t_s > 6.0, 20.0)
            with against_the_clock():
                assert window.status["state"] == "FOLLOWING"
                assert 4.0 < window.status["range_m"] < 15.0
            window.order("stop")
            watch(window, lambda w: w.status["state"] == "STOPPED", 5.0)
            assert not window.status["streams"]
    finally:
        process.send_signal(signal.SIGTERM)
        out, said = process.communicate(timeout=60.0)
    assert process.returncode == 0, said
    assert json.loads(out)["modes"]["follow"] > 2.0


@pytest.mark.realtime
def test_a_page_that_fails_in_flight_does_not_change_the_flight(tmp_path):
    """Its thread is killed inside the program while the vehicle follows by an order of its window."""
    (port,) = free_ports(1)
    host, out = f"127.0.0.1:{port}", tmp_path / "flight"
    words = ["sim", "walker", "--out", str(out), "--page", host]
    with program([sys.executable, "-m", "tests.support.page_killer", *words]) as flight:
        flight.wait_until_said("page: ", 60.0)
        with connect(f"ws://{host}/window", origin=f"http://{host}", compression=None) as socket:
            socket.send("0123456789abcdef")
            window = Window(None, socket)
            watch(window, lambda w: len(w.images) > 10, 60.0)
            header, jpeg = window.images[-1]
            window.send(do="select", frame=header["frame"], box=blue_walker(jpeg))
            watch(window, lambda w: w.status["state"] == "TRACKING", 10.0)
            window.order("follow")
            watch(window, lambda w: w.status["state"] == "FOLLOWING", 10.0)
            flight.process.send_signal(signal.SIGUSR2)
            flight.wait_until_said("the page has ended .*: the flight goes on without it", 10.0)
            with pytest.raises(ConnectionClosed):
                watch(window, lambda _w: False, 30.0)
        time.sleep(6.0)
        assert flight.end(signal.SIGTERM) == 0, flight.lines
    modes, sent = flown_last(out, 2.0)  # a loaded machine flies slower than the clock
    assert modes == {"follow"}
    assert sent


@pytest.mark.realtime
@pytest.mark.parametrize("rules", ["px4", "ardupilot"])
def test_a_person_selects_follows_and_stops_over_mavlink(rules, tmp_path):
    host = f"127.0.0.1:{free_ports(1)[0]}"
    with real_flight(rules, tmp_path, options=["--page", host, "--seconds", "120"], begins="observe") as real:
        told = []
        real.pilot.hears = lambda packet: told.append(bytes(packet))
        with connect(f"ws://{host}/window", origin=f"http://{host}", compression=None) as socket:
            socket.send("0123456789abcdef")
            window = Window(None, socket)
            watch(window, lambda w: len(w.images) > 3, 30.0)
            assert not real.relay.setpoints(), "nothing is sent before a person orders"
            soon = window.images[-1][0]["frame"] + 120  # the box takes its time to be found
            left, top, right, bottom = walkers_box(rules, soon / 30)  # the scene's frames a second
            watch(window, lambda w: w.images[-1][0]["frame"] >= soon, 15.0)
            window.send(do="select", frame=window.images[-1][0]["frame"], box=[left, top, right - left, bottom - top])
            watch(window, lambda w: w.status["state"] == "TRACKING", 10.0)
            window.order("spotlight")
            watch(window, lambda w: w.status["state"] == "SPOTLIGHT", 10.0)
            window.order("follow")
            watch(window, lambda w: w.status["state"] == "FOLLOWING", 5.0)
            began_t_s = window.status["t"]
            watch(window, lambda w: w.status["t"] - began_t_s > 5.0, 20.0)
            with against_the_clock():
                assert real.pilot.flown_mode() == CONTROL[rules]
            window.order("stop")
            watch(window, lambda w: w.status["state"] == "STOPPED", 5.0)
            until("given back", lambda: real.pilot.flown_mode() != CONTROL[rules], 5.0)
        assert any(b"Follow: following" in packet for packet in told), "the pilot is told at the ground station also"
        assert real.application.end() == 0
