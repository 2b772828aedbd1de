"""Draw docs/flight.gif: a simulated flight, the camera's image with the tracker's box beside the map.

    python -m tools.docs.moving [--out docs/flight.gif] [--scenario trees] [--begin-s 8] [--end-s 24]

Flies the scenario as `follow sim` does.  The box is green while the target is found and red while it is lost.
"""

import argparse
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from PIL import Image as Pillow

from follow.control.servo import Servo, ServoConfig
from follow.control.target import Target, TargetConfig
from follow.flight.session import acquire, once
from follow.loop import follow
from follow.messages import Autopilot, Mode, Order, Tick
from follow.recording.rerun_log import GREEN, MODE_COLOURS, RED, YELLOW
from follow.safety.gate import Safety
from follow.safety.limits import Limits
from sim.dynamics import VehicleTruth
from sim.scenarios import SCENARIOS, build
from sim.scene.world import World

HEIGHT = 208  # of the drawing, px; the camera's image is 16:9 of it and the map a square
FPS = 5  # of the drawing: a GIF of 3 MB holds some 80 frames of this size
COLOURS = 48  # of the scene; the colours of boxes and text are added
GROUND, TREE, OWN = (225, 232, 222), (120, 170, 110), (220, 120, 40)  # BGR


@dataclass
class Map:
    """The ground from above, north up, with both paths so far."""

    world: World
    middle: tuple[float, float]
    reach_m: float

    def __post_init__(self) -> None:
        self.paths: tuple[list[tuple[int, int]], list[tuple[int, int]]] = ([], [])

    def pixel(self, north_m: float, east_m: float) -> tuple[int, int]:
        scale = HEIGHT / (2 * self.reach_m)
        return (
            round((east_m - self.middle[1]) * scale + HEIGHT / 2),
            round(HEIGHT / 2 - (north_m - self.middle[0]) * scale),
        )

    def draw(self, motion: VehicleTruth, target: tuple[float, float], mode: Mode) -> np.ndarray:
        image = np.full((HEIGHT, HEIGHT, 3), GROUND, np.uint8)
        for tree in self.world.trees:
            radius = round(tree.radius_m * HEIGHT / (2 * self.reach_m))
            cv2.circle(image, self.pixel(tree.north_m, tree.east_m), radius, TREE, -1, cv2.LINE_AA)
        now = self.pixel(motion.north_m, motion.east_m), self.pixel(*target)
        for path, point, colour in zip(self.paths, now, (OWN, RED[::-1]), strict=True):
            path.append(point)
            cv2.polylines(image, [np.array(path)], False, colour, 2, cv2.LINE_AA)
        cv2.line(image, *now, MODE_COLOURS[mode][::-1], 1, cv2.LINE_AA)
        for point, colour, name in zip(now, (OWN, RED[::-1]), ("drone", "target"), strict=True):
            cv2.circle(image, point, 4, colour, -1, cv2.LINE_AA)
            label(image, name, (point[0] + 6, point[1] + 4), colour)
        return image


def label(image: np.ndarray, text: str, corner: tuple[int, int], colour: tuple[int, ...], size: float = 0.4) -> None:
    """Text with a dark edge."""
    for thickness, shade in ((3, (30, 30, 30)), (1, colour)):
        cv2.putText(image, text, corner, cv2.FONT_HERSHEY_SIMPLEX, size, shade, thickness, cv2.LINE_AA)


def camera_view(tick: Tick) -> np.ndarray:
    """The camera's image with the tracker's box and the mode."""
    assert tick.frame is not None
    assert tick.track is not None
    small = HEIGHT / tick.frame.image.shape[0]
    image = cv2.GaussianBlur(tick.frame.image, (0, 0), 1.7)  # noise costs most of a GIF's bytes
    image = cv2.resize(image, None, fx=small, fy=small, interpolation=cv2.INTER_AREA)
    box, colour = tick.track.box.scaled(1.0), GREEN if tick.track.found else RED
    corners = [(round(x * small), round(y * small)) for x, y in ((box.x, box.y), (box.x + box.w, box.y + box.h))]
    cv2.rectangle(image, *corners, colour[::-1], 2)
    text = f"{tick.track.confidence:.2f}" if tick.track.found else "lost"
    label(image, text, (corners[0][0], corners[0][1] - 5), colour[::-1])
    mode = tick.decision.mode
    label(image, f"{tick.state.t_s:.0f} s  {mode.value}", (8, 20), MODE_COLOURS[mode][::-1], 0.55)
    label(image, f"{tick.estimate.range_m:.1f} m away", (8, 38), YELLOW[::-1])
    return image


def flight(name: str, begin_s: float, end_s: float) -> Iterator[np.ndarray]:
    """The frames of the drawing."""
    scenario = replace(SCENARIOS[name], duration_s=end_s)
    camera, link, world = build(scenario, 0, Autopilot.PX4)
    mount = camera.settings
    parts = (
        acquire("racf,robust", camera.first()[1]),
        Target(mount.intrinsics, mount.down_rad, TargetConfig(size_m=scenario.size_m)),
        Servo(mount.down_rad, ServoConfig(standoff_m=scenario.standoff_m)),
        Safety(Limits(half_view_rad=mount.intrinsics.horizontal_fov_rad / 2, latency_s=scenario.latency_s)),
    )
    first, last = world.target(begin_s), world.target(end_s)
    middle = (first.north_m + last.north_m) / 2, (first.east_m + last.east_m) / 2
    reach_m = max(abs(first.north_m - last.north_m), abs(first.east_m - last.east_m)) / 2 + scenario.standoff_m / 2
    sheet, due_s = Map(world, middle, reach_m), begin_s
    with camera, link:
        for tick in follow(camera, link, *parts, once(Order.FOLLOW)):
            if tick.frame is None or tick.track is None or tick.state.t_s < due_s:
                continue
            due_s += 1 / FPS
            place = world.target(tick.frame.t_s)
            above = sheet.draw(link.vehicle.motion, (place.north_m, place.east_m), tick.decision.mode)
            yield np.hstack([camera_view(tick), above])


def palette_of(sheet: Pillow.Image) -> Pillow.Image:
    """One palette for all frames, so that a pixel that does not change takes no bytes."""
    scene = sheet.quantize(COLOURS).getpalette() or []
    bright = [*MODE_COLOURS.values(), RED, YELLOW, GROUND[::-1], TREE[::-1], OWN[::-1], (30, 30, 30)]
    palette = Pillow.new("P", (1, 1))
    palette.putpalette([*scene[: 3 * COLOURS], *(value for colour in bright for value in colour)])
    return palette


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("docs/flight.gif"))
    parser.add_argument("--scenario", default="trees")
    parser.add_argument("--begin-s", type=float, default=8.0)
    parser.add_argument("--end-s", type=float, default=24.0)
    given = parser.parse_args()
    frames = flight(given.scenario, given.begin_s, given.end_s)
    sheets = [Pillow.fromarray(np.ascontiguousarray(sheet[:, :, ::-1])) for sheet in frames]
    palette = palette_of(sheets[len(sheets) // 2])
    drawn = [sheet.quantize(palette=palette, dither=Pillow.Dither.NONE) for sheet in sheets]
    drawn[0].save(given.out, save_all=True, append_images=drawn[1:], duration=1000 // FPS, loop=0, optimize=True)
    print(f"{given.out}: {len(drawn)} frames, {given.out.stat().st_size / 1e6:.2f} MB")


if __name__ == "__main__":
    main()
