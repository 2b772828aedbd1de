"""Boxes that a person draws late: with and without the catch-up of `follow.control.selector`.

    python -m tools.studies.late_selection --starts 20

A vehicle hovers beside the path of the drawn cyclist and runner and does not turn, so that the target crosses the
image.  The true box of a frame is passed 0, 0.3, 0.6 and 1 s later: with the frame on which it was drawn (catch-up),
and as a box of the newest frame (without).  Prints in how many starts the tracker's box is on the target (IoU of at
least 0.3) two seconds after the box was passed.  Takes some four minutes on one core.
"""

import argparse
import itertools
import math
import sys
from dataclasses import replace

import numpy as np

from follow.control.selector import Selector
from follow.messages import Autopilot, Frame
from follow.selection import Selection
from racf.evaluate.trackers import TrackerSpec
from sim.camera import SceneCamera
from sim.dynamics import VehicleTruth
from sim.scenarios import SCENARIOS

LATE_S = (0.0, 0.3, 0.6, 1.0)
AFTER_S = 2.0
RATE_HZ = 30
ASIDE_M, HEIGHT_M = 25.0, 10.0
ON_TARGET = 0.3
SCENES = ("cyclist", "runner")
TRIES = 3  # films for each start: in some the target leaves the image


class Hovering:
    """A vehicle that stands still."""

    def __init__(self, place: VehicleTruth) -> None:
        self.place = place

    def advance(self, dt_s: float) -> VehicleTruth:
        self.place = replace(self.place, t_s=self.place.t_s + dt_s)
        return self.place


def filmed(name: str, seed: int, from_s: float):
    """Frames of the crossing target with its true boxes: `LATE_S[-1]` before the selection to AFTER_S after it."""
    scenario = SCENARIOS[name]
    world = scenario.world(seed)
    middle_s = from_s + (LATE_S[-1] + AFTER_S) / 2
    pose = world.poses(middle_s)[0]
    side = pose.heading_rad + (math.pi / 2 if seed % 2 else -math.pi / 2)
    north, east = pose.north_m + ASIDE_M * math.cos(side), pose.east_m + ASIDE_M * math.sin(side)
    ground = world.terrain.height_m(north, east)
    yaw = math.remainder(side + math.pi, math.tau)
    place = VehicleTruth(0.0, north, east, -ground - HEIGHT_M, yaw_rad=yaw, ground_m=ground)
    camera = SceneCamera(world, Hovering(place), replace(scenario.camera_settings(Autopilot.PX4), latency_s=0.0))
    film = []
    for k in range(round((LATE_S[-1] + AFTER_S) * RATE_HZ) + 1):
        t_s = from_s + k / RATE_HZ
        image, seen = camera._draw(replace(place, t_s=t_s), t_s, k)
        film.append((Frame(image, t_s, k), seen[0].box))
    return film


class Kept:
    def __init__(self) -> None:
        self.kept: tuple[Frame, ...] = ()


def holds(film, late_s: float, catches_up: bool, tracker_name: str) -> bool:
    """Whether the tracker is on the target AFTER_S after its late box was passed."""
    tracker = TrackerSpec.parse(tracker_name).build()
    given = round(LATE_S[-1] * RATE_HZ)
    drawn = given - round(late_s * RATE_HZ)
    recent = Kept()
    selector = Selector(tracker.init, tracker.update, recent, lambda: None)
    track = None
    for k, (frame, _) in enumerate(film):
        recent.kept = (*recent.kept, frame)
        if k == given:
            box = film[drawn][1]
            rows, columns = frame.image.shape[:2]
            share = box.x / columns, box.y / rows, box.w / columns, box.h / rows
            seen_t_s = film[drawn][0].t_s if catches_up else frame.t_s
            if why := selector.choose(Selection(*share, seen_t_s, "the study")):
                print(f"refused: {why}")
                return False
        track = selector.update(frame.image)
    truth = film[-1][1]
    return track is not None and truth is not None and track.box.iou(truth) >= ON_TARGET


def crossing(name: str, start: int):
    """The film of one start, None unless the whole target is in the image all the time."""
    film = filmed(name, start, 3.0 + 0.7 * start)
    width = film[0][0].image.shape[1]
    is_whole = all(box is not None and box.x >= 0 and box.x + box.w <= width for _, box in film)
    return film if is_whole else None


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--starts", type=int, default=20, help="of each scene")
    parser.add_argument("--tracker", default="racf,robust")
    args = parser.parse_args()
    held: dict[tuple[float, bool], list[bool]] = {(late_s, catch): [] for late_s in LATE_S for catch in (True, False)}
    speeds: list[float] = []
    for name in SCENES:
        films = filter(None, (crossing(name, start) for start in range(TRIES * args.starts)))
        for film in itertools.islice(films, args.starts):
            speeds.append(abs(film[-1][1].centre_x - film[0][1].centre_x) / (LATE_S[-1] + AFTER_S))
            at_once = holds(film, 0.0, True, args.tracker)
            for (late_s, catch), results in held.items():
                results.append(holds(film, late_s, catch, args.tracker) if late_s else at_once)
            print(f"{name}: {len(speeds)} starts", file=sys.stderr)
    middle, fastest = np.median(speeds), max(speeds)
    print(f"{len(speeds)} starts, {middle:.0f} px/s across the image (median; fastest {fastest:.0f})")
    print("| drawn before, s | with catch-up | without |\n|---|---|---|")
    for late_s in LATE_S:
        with_, without = (f"{sum(held[late_s, catch])} of {len(speeds)}" for catch in (True, False))
        print(f"| {late_s:g} | {with_} | {without} |")


if __name__ == "__main__":
    main()
