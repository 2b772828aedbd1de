"""The transcripts of docs/ground_station.md: a ground station draws a box, the vehicle follows for a minute, and stops.

    python -m tools.docs.ground_station [--seconds 60] [--flight "MAVSDK, behind PX4" ...]

Four flights of `follow run` beside `python -m sim.autopilot` over UDP, in real time: the scripted station in
QGroundControl's old dialect, directly, and in its new one, behind the autopilot; MAVSDK's own Camera client both ways.
A flight whose vehicle does not follow, or is not returned to the pilot, raises; the others' transcripts are kept.
"""

import argparse
import csv
import itertools
import json
import os
import re
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

os.environ["MAVLINK20"] = "1"

from tests.support.ground_station import NEW, OLD
from tests.support.ground_wire import ByMavsdk, Scripted, walkers_box
from tests.support.real_flight import CONTROL, free_ports, real_flight, until

PAGE = Path(__file__).parents[2] / "docs" / "ground_station.md"
MAVSDK = "MAVSDK"
FLIGHTS = {
    "QGroundControl's old dialect, directly, PX4": ("px4", OLD, True),
    "QGroundControl's new dialect, behind ArduPilot": ("ardupilot", NEW, False),
    "MAVSDK, behind PX4": ("px4", MAVSDK, False),
    "MAVSDK, directly, ArduPilot": ("ardupilot", MAVSDK, True),
}
TOLD = re.compile(r"selected by|commands|ordered|: (observe|ready|engage|follow|coast|search|hold|brake|ended)\b|mode ")
SHOWN_S = 0.3  # age of the image in which the box is drawn: the default of --ground-delay-s
LOST_S = 2.0  # a flight that is off its target for longer counts as failed
NUMBERS = re.compile(r"-?\d+\.\d+")

Log = list[tuple[float, str]]


def station_of(variant: str, port: int | None, real) -> Scripted | ByMavsdk:
    """The ground station of a flight; without a port it is behind the autopilot."""
    if variant == MAVSDK:
        return ByMavsdk(port, real.pilot)
    return Scripted(variant, port, real.pilot)


def fly(rules: str, variant: str, direct: bool, seconds: float, out: Path) -> list[str]:
    """One flight; the lines of its transcript."""
    (port,) = free_ports(1)
    ground = f"udpin:127.0.0.1:{port}" if direct else "link"
    options = ["--ground", ground, "--ground-follows", "--video-out", "rtp://127.0.0.1:5600"]
    with real_flight(rules, out, options=options, begins="observe") as real:
        begun_s = time.monotonic()
        walkers_box(rules, 0.0)  # builds the scene, so that the box below is not late
        with station_of(variant, port if direct else None, real) as station:
            drawn_s = time.monotonic()
            station.draw(walkers_box(rules, drawn_s - begun_s - SHOWN_S))
            real.application.wait_until_said(": follow", 20.0)
            boxes = station.boxes
            time.sleep(seconds)
            assert real.pilot.flown_mode() == CONTROL[rules], real.application.lines
            seen = (station.boxes - boxes) / seconds
            station.stop()
            real.application.wait_until_said("OBSERVE ordered by", 5.0)
            until("given back", lambda: real.pilot.flown_mode() != CONTROL[rules], 5.0)
            mode = real.pilot.flown_mode()
            log = [(t_s - drawn_s, words) for t_s, words in station.log]
            assert not station.errors, station.errors
        assert real.application.end() == 0
        lines = [line for line in real.application.lines if TOLD.search(line) and "recorded in" not in line]
    return [*shortened(log), "", *lines, "", f"{seen:.1f} boxes a second; given back in {mode}; {flown(out)}"]


def shortened(log: Log) -> Iterator[str]:
    """A line for each message except the camera's later heartbeats; repeated messages become one line with a count."""
    beats = [entry for entry in log if "HEARTBEAT" in entry[1]]
    shown = [entry for entry in log if entry not in beats[1:]]
    for _, run in itertools.groupby(shown, key=lambda entry: NUMBERS.sub("", entry[1])):
        (t_s, words), *others = run
        yield f"{t_s:7.2f} s {words}"
        if others:
            yield f"{'':11}... {len(others) + 1} in {others[-1][0] - t_s:.1f} s, the last:"
            yield f"{others[-1][0]:7.2f} s {others[-1][1]}"


def flown(out: Path) -> str:
    """How well it followed: from the flight's own figures and rows."""
    summary = json.loads((out / "summary.json").read_text())
    assert summary["off_target_s"] < LOST_S, f"it followed something else: {summary}"
    with (out / "ticks.csv").open() as file:
        sent = sum(bool(row["setpoint_forward_m_s"]) for row in csv.DictReader(file))
    figures = ", ".join(f"{name} {summary[name]:.3g}" for name in ("in_view", "centring_rms", "nearest_m"))
    return f"{sent} setpoints, modes {summary['modes']}, {figures}"


def written(flights: dict[str, list[str]]) -> None:
    """Replace the transcripts of these flights in the page."""
    page = PAGE.read_text()
    for name, lines in flights.items():
        block = f"### {name}\n\n```\n" + "\n".join(lines) + "\n```\n"
        page, count = re.subn(rf"### {re.escape(name)}\n.*?\n```\n.*?\n```\n", lambda _m, b=block: b, page, flags=re.S)
        page = page if count else f"{page}\n{block}"
    PAGE.write_text(page)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--flight", nargs="+", choices=FLIGHTS, default=list(FLIGHTS))
    options = parser.parse_args()
    for name in options.flight:
        rules, variant, direct = FLIGHTS[name]
        with tempfile.TemporaryDirectory() as out:
            written({name: fly(rules, variant, direct, options.seconds, Path(out))})
        print(f"{name}: flown", flush=True)


if __name__ == "__main__":
    main()
