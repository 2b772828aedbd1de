"""`follow run` as a process over UDP: it takes over a hovering vehicle, follows, is taken over, and stops sending.

FOLLOW_RUN_S sets how long it follows (12 s; `make faults` flies 60 s and every pair of rules and link).
"""

import csv
import math
import os
import time
from dataclasses import replace

import pytest

from follow.geometry import heading_to_ned
from sim.scenarios import SCENARIOS, Scenario
from tests.support.machine import against_the_clock
from tests.support.real_flight import CONTROL, PILOTS_CHOICE, Real, real_flight, until

FOLLOW_S = float(os.environ.get("FOLLOW_RUN_S", "10"))
EVERY_PAIR = "FOLLOW_RUN_S" in os.environ
PAIRS = [("px4", False), ("ardupilot", True)] + EVERY_PAIR * [("px4", True), ("ardupilot", False)]


def flown(real: Real) -> list[dict[str, str]]:
    with (real.out / "ticks.csv").open() as file:
        return list(csv.DictReader(file))


def true_place(row: dict[str, str], first: dict[str, str], scenario, world) -> tuple[float, float]:
    """The true walker's range along the ground and angle off the nose, from telemetry and the walker's own route."""
    start = scenario.start(world, 0)
    turn = start.yaw_rad - float(first["vehicle_yaw_rad"])
    n, e = (float(row[f"vehicle_{axis}_m"]) - float(first[f"vehicle_{axis}_m"]) for axis in ("north", "east"))
    place = world.target(float(row["frame_t_s"]) - float(first["frame_t_s"]))
    flown = heading_to_ned(n, e, turn)
    north, east = place.north_m - start.north_m - flown[0], place.east_m - start.east_m - flown[1]
    off = math.atan2(east, north) - float(row["vehicle_yaw_rad"]) - turn
    return math.hypot(north, east), math.remainder(off, math.tau)


@pytest.mark.realtime
@pytest.mark.parametrize(("rules", "mavsdk"), PAIRS)
def test_it_follows_the_walker_until_another_client_changes_the_mode_and_then_sends_nothing_more(
    rules, mavsdk, tmp_path, monkeypatch
):
    monkeypatch.setitem(os.environ, "MAVLINK20", "1")
    with real_flight(rules, tmp_path, mavsdk=mavsdk, options=["--seconds", str(FOLLOW_S + 120)]) as real:
        time.sleep(0.5)
        assert not real.relay.setpoints(), "nothing may be sent before the order"
        assert not real.relay.modes_asked()
        real.order()
        until("in control", lambda: real.pilot.flown_mode() == CONTROL[rules], 15.0)
        time.sleep(FOLLOW_S)
        with against_the_clock():
            assert real.pilot.flown_mode() == CONTROL[rules]
        assert len(real.relay.modes_asked()) == 1, "it asks for the mode once"
        real.pilot.mode(PILOTS_CHOICE[rules])
        taken_t_s = time.monotonic()
        time.sleep(3.7)
        late = [packet.t_s - taken_t_s for packet in real.relay.setpoints() if packet.t_s > taken_t_s + 1.2]
        assert not late, "PX4 tells its mode once a second; after that nothing may be sent"
        assert len(real.relay.modes_asked()) == 1
        assert real.pilot.flown_mode() == PILOTS_CHOICE[rules]
        real.application.wait_until_said("ended", 1.5)
        assert real.application.end() == 0
        assert real.application.said(f"leaving: the vehicle is in {PILOTS_CHOICE[rules]}, and no mode is requested")
    with against_the_clock():
        check_that_it_followed(flown(real), replace(SCENARIOS["walker"], duration_s=FOLLOW_S + 120))


def check_that_it_followed(rows: list[dict[str, str]], scenario: Scenario) -> None:
    world = scenario.world(0)
    first = next(row for row in rows if row["frame"])
    free = [row for row in rows if row["mode"] in ("follow", "coast", "search") and row["frame"]]
    assert float(free[-1]["t_s"]) - float(free[0]["t_s"]) > FOLLOW_S - 3.0
    places = [true_place(row, first, scenario, world) for row in free]
    in_view = [abs(off) < math.radians(40.0) for _, off in places]
    assert sum(in_view) > 0.9 * len(in_view)
    range_m, off = places[-1]
    assert abs(off) < math.radians(20.0)
    assert range_m == pytest.approx(scenario.standoff_m, abs=4.0)
    assert world.target(0.0) != world.target(FOLLOW_S)
