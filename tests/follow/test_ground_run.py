"""A person at a ground station draws a box, and the vehicle follows: whole processes over UDP.

PX4 is flown from a station of the old dialect that talks to us directly, ArduPilot from one of the new dialect that
hears us through the autopilot.  `python -m tools.docs.ground_station` flies a minute of each, and MAVSDK's own client.
"""

import json
import os
import time

import pytest

from tests.support.ground_station import NEW, OLD
from tests.support.ground_wire import Scripted, walkers_box
from tests.support.machine import against_the_clock
from tests.support.real_flight import CONTROL, free_ports, real_flight, until

FOLLOW_S = 8.0


@pytest.mark.realtime
@pytest.mark.parametrize(("rules", "variant", "direct"), [("px4", OLD, True), ("ardupilot", NEW, False)])
def test_a_box_drawn_at_the_ground_station_is_followed_until_it_says_stop(
    rules, variant, direct, tmp_path, monkeypatch
):
    monkeypatch.setitem(os.environ, "MAVLINK20", "1")
    (port,) = free_ports(1)
    ground = f"udpin:127.0.0.1:{port}" if direct else "link"
    options = ["--ground", ground, "--ground-follows", "--seconds", "120"]
    with real_flight(rules, tmp_path, options=options, begins="observe") as real:
        begun_s = time.monotonic()
        walkers_box(rules, 0.0)  # builds the scene, so that the box below is not late
        with Scripted(variant, port if direct else None, real.pilot) as station:
            assert not real.relay.setpoints(), "nothing is sent before a person points"
            station.draw(walkers_box(rules, time.monotonic() - begun_s - 0.3))
            real.application.wait_until_said(": follow", 15.0)
            time.sleep(FOLLOW_S)
            with against_the_clock():
                assert real.pilot.flown_mode() == CONTROL[rules]
            assert station.boxes > 5 * FOLLOW_S
            station.stop()
            real.application.wait_until_said("OBSERVE ordered by the ground station", 5.0)
            until("given back", lambda: real.pilot.flown_mode() != CONTROL[rules], 5.0)
            with against_the_clock():  # an acknowledgement later than 1.2 s is an error at the station
                assert not station.errors
        assert real.application.end() == 0
    assert json.loads((tmp_path / "summary.json").read_text())["off_target_s"] < 2.0, "what was drawn is followed"
