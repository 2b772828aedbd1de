"""Draw docs/scenes.png from the scenarios' own worlds, and measure how fast frames are drawn.

python -m tools.docs.scenes [--out docs/scenes.png] [--speed]
"""

import argparse
import time
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

from follow.geometry import heading_to_ned
from follow.messages import Autopilot
from sim.dynamics import VehicleTruth
from sim.scenarios import SCENARIOS, build

PANELS = [("walker", 2, 4.0), ("trees", 1, 2.0), ("cyclist", 3, 5.0), ("car", 4, 6.0)]  # scenario, seed, time
BUDGET_MS = 1000.0 / 30.0 / 5.0  # 5 times faster than 30 frames/s


def panel(name: str, seed: int, t_s: float) -> np.ndarray:
    """The camera's image, with the camera placed about the target as at the scenario's start."""
    scenario = SCENARIOS[name]
    camera, _, world = build(scenario, seed, Autopilot.PX4)
    target = world.target(t_s)
    behind = heading_to_ned(-scenario.standoff_m, 0.0, target.heading_rad)
    vehicle = VehicleTruth(
        t_s=t_s,
        north_m=target.north_m + behind[0],
        east_m=target.east_m + behind[1],
        down_m=-scenario.height_m,
        yaw_rad=target.heading_rad,
        pitch_rad=scenario.down_rad(Autopilot.PX4) - 0.45,
    )
    image = camera._draw(vehicle, t_s, 0)[0]
    return cv2.resize(image, (480, 270), interpolation=cv2.INTER_AREA)


def speed(name: str, seconds: float = 1.0) -> tuple[float, float]:
    """CPU time of one core, ms per frame: median and 95th percentile, in flight, with the vehicle's own."""
    scenario = replace(SCENARIOS[name], duration_s=seconds)
    camera, _, _ = build(scenario, 0, Autopilot.PX4)
    spent = []
    before = time.process_time()
    for frame in camera.frames():
        now = time.process_time()
        if frame is not None:
            spent.append(1e3 * (now - before))
        before = now
    return float(np.median(spent[1:])), float(np.percentile(spent[1:], 95))


def distinct() -> list[str]:
    """The scenarios whose images differ: those that change only frame rate, latency or drops are left out."""
    scenes = {}
    for name, scenario in SCENARIOS.items():
        scene = replace(scenario, name="", about="", latency_s=0.0, drop_fraction=0.0, frames_per_s=30.0)
        scenes.setdefault(repr(scene), name)
    return list(scenes.values())


def speeds(rounds: int = 4) -> None:
    """Print a table of all distinct scenes.  The fastest of several rounds counts: other load only adds time."""
    names = distinct()
    measured = [[speed(name) for name in names] for _ in range(rounds)]
    print(f"budget {BUDGET_MS:.1f} ms a frame\n| scenario | median, ms | 95th percentile, ms |\n|{'---|' * 3}")
    for name, spent in zip(names, zip(*measured, strict=True), strict=True):
        median, late = min(spent)
        print(f"| `{name}` | {median:.1f} | {late:.1f} |")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("docs/scenes.png"))
    parser.add_argument("--speed", action="store_true")
    arguments = parser.parse_args()
    cv2.setNumThreads(1)
    if arguments.speed:
        speeds()
        return
    images = [panel(*what) for what in PANELS]
    sheet = np.vstack([np.hstack(images[:2]), np.hstack(images[2:])])
    cv2.imwrite(str(arguments.out), sheet, [cv2.IMWRITE_PNG_COMPRESSION, 9])


if __name__ == "__main__":
    main()
