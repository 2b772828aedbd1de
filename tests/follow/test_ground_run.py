"""A person at a ground station draws a box, and the vehicle follows: whole processes over UDP.

PX4 is flown from a station of the old dialect that talks to us directly, ArduPilot from one of the new dialect that
hears us through the autopilot.
"""

import contextlib
import os
import socket
import threading
import time
from dataclasses import replace

import pytest

from follow.messages import Autopilot
from sim.camera import SceneCamera
from sim.scenarios import SCENARIOS
from tests.support.ground_station import NEW, OLD, GroundStation
from tests.support.machine import against_the_clock
from tests.support.real_flight import CONTROL, free_ports, real_flight, until

FOLLOW_S = 8.0


class Wire:
    """Carries a GroundStation over UDP to us directly, or over the pilot's own connection to the autopilot."""

    def __init__(self, station, port, pilot):
        self.station, self.pilot, self.direct = station, pilot, port is not None
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.settimeout(0.05)
        self.address = ("127.0.0.1", port)
        self.ending = threading.Event()
        self.thread = threading.Thread(target=self.run, daemon=True)

    def __enter__(self):
        if not self.direct:
            self.pilot.hears = lambda packet: self.station.hear(packet, time.monotonic())
        self.thread.start()
        return self

    def __exit__(self, *_error):
        self.ending.set()
        self.thread.join()
        self.socket.close()

    def send(self, packet):
        if self.direct:
            self.socket.sendto(packet, self.address)
        else:
            self.pilot.link.write(packet)

    def run(self):
        beat_s = 0.0
        while not self.ending.is_set():
            now = time.monotonic()
            if now - beat_s > 0.5:
                beat_s = now
                self.send(self.station.heartbeat())
            for packet in self.station.take():
                self.send(packet)
            if self.direct:
                with contextlib.suppress(TimeoutError, ConnectionError):
                    self.station.hear(self.socket.recv(65536), now)
            else:
                time.sleep(0.05)
            self.station.step(now)


class Standing:
    def __init__(self, place):
        self.place = place

    def advance(self, dt_s):
        self.place = replace(self.place, t_s=self.place.t_s + dt_s)
        return self.place


def walkers_box(rules, since_s):
    """Where the walker appears in shares of the image, seen from the scenario's start, with a person's margin."""
    scenario = SCENARIOS["walker"]
    world = scenario.world(0)
    place = scenario.start(world, 0)
    camera = SceneCamera(world, Standing(place), scenario.camera_settings(Autopilot(rules)))
    _, seen = camera._draw(replace(place, t_s=since_s), since_s, 0)
    box = seen[0].box.scaled(1.15)
    return box.x / 640, box.y / 360, (box.x + box.w) / 640, (box.y + box.h) / 360


@pytest.mark.realtime
@pytest.mark.parametrize(("rules", "variant", "direct"), [("px4", OLD, True), ("ardupilot", NEW, False)])
def test_a_box_drawn_at_the_ground_station_is_followed_until_it_says_stop(
    rules, variant, direct, tmp_path, monkeypatch
):
    monkeypatch.setitem(os.environ, "MAVLINK20", "1")
    (port,) = free_ports(1)
    ground = f"udpin:127.0.0.1:{port}" if direct else "link"
    options = ["--ground", ground, "--ground-follows", "--seconds", "120"]
    station = GroundStation(variant)
    with real_flight(rules, tmp_path, options=options, begins="observe") as real:
        begun_s = time.monotonic()
        with Wire(station, port if direct else None, real.pilot):
            until("the camera was found", lambda: bool(station.camera), 20.0)
            until("its answers came", lambda: "STORAGE_INFORMATION" in station.heard, 20.0)
            assert not real.relay.setpoints(), "nothing is sent before a person points"
            station.drag(time.monotonic(), *walkers_box(rules, time.monotonic() - begun_s - 0.3))
            until("selected", lambda: (2005, 0) in station.acks, 5.0)
            real.application.wait_until_said(": follow", 15.0)
            time.sleep(FOLLOW_S)
            with against_the_clock():
                assert real.pilot.flown_mode() == CONTROL[rules]
            assert len(station.boxes) > 5 * FOLLOW_S
            station.stop(time.monotonic())
            real.application.wait_until_said("OBSERVE ordered by the ground station", 5.0)
            until("given back", lambda: real.pilot.flown_mode() != CONTROL[rules], 5.0)
            with against_the_clock():  # an acknowledgement later than 1.2 s is an error at the station
                assert not station.errors
        assert real.application.end() == 0
