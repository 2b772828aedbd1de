"""Gains of measured over predicted image motion: a sound camera against frozen images, wrong mounts and lenses.

    python -m tools.studies.consistency [--seconds 15] [--scenario walker ...] [--fault none ...] [--plot FILE]

Flies each scenario in the drawn world with the true boxes, puts a fault into the camera after `FAULT_S`, and prints the
percentiles of the three gains (whole, turn, box; see follow/safety/consistency.py), the time of the first
contradiction, the braking distance from there, and every false alarm.
"""

import argparse
import math
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from follow.config import Config, resolve
from follow.control.image_motion import ImageMotionMeter
from follow.control.servo import Servo
from follow.control.target import Target
from follow.flight.session import once
from follow.geometry import Intrinsics
from follow.loop import follow
from follow.messages import Autopilot, Frame, Order
from follow.safety.consistency import LONG_S, SHORT_S, box_gain, turn_gain, whole_gain
from follow.safety.gate import Safety
from racf.parallel import each
from racf.track import Track
from sim.camera import SceneCamera
from sim.scenarios import SCENARIOS, build

FAULT_S = 6.0
FAULTS = ("none", "noise", "clock", "two buffers", "upside down", "lens 130", "riding")
NAMES = ("whole", "turn", "box")


@dataclass
class FaultyCamera:
    """The scene's camera with a fault from `from_s` on; an upside-down camera is upside down from the start."""

    camera: SceneCamera
    fault: str
    from_s: float = FAULT_S
    held: list[Frame] = field(default_factory=list)
    shown: int = 0  # index of the frame whose image was delivered last

    def frames(self) -> Iterator[Frame | None]:
        random = np.random.default_rng(0)
        for frame in self.camera.frames():
            yield None if frame is None else self.spoiled(frame, random)

    def spoiled(self, frame: Frame, random: np.random.Generator) -> Frame:
        self.shown = frame.index
        if self.fault == "upside down":
            return replace(frame, image=np.ascontiguousarray(frame.image[::-1, ::-1]))
        if self.fault not in ("noise", "clock", "two buffers") or frame.t_s < self.from_s:
            return frame
        if len(self.held) < (2 if self.fault == "two buffers" else 1):
            self.held.append(frame)
        held = self.held[frame.index % len(self.held)]
        self.shown = held.index
        image = held.image.copy()
        if self.fault == "noise":
            image = np.clip(image + random.normal(0, 3, image.shape), 0, 255).astype(np.uint8)
        elif self.fault == "clock":
            image[4:20, 4:100] = random.integers(0, 255, (16, 96, 3))
        return replace(frame, image=image)

    def __enter__(self) -> "FaultyCamera":
        return self

    def __exit__(self, *_: object) -> None:
        return None


@dataclass
class TrueBoxes:
    """A tracker that returns the true box of the image that it gets, or a box that never moves."""

    camera: FaultyCamera
    last: Track | None = None

    def update(self, image: np.ndarray, prior: object = None) -> Track:
        truth = self.camera.camera.truth(self.camera.shown)
        box, visible = truth.box, truth.visible > 0.3
        rides = self.camera.fault == "riding" and truth.t_s >= self.camera.from_s
        if (rides or box is None or not visible) and self.last is not None:
            return self.last if rides else replace(self.last, found=False)
        if self.camera.fault == "upside down":
            height, width = image.shape[:2]
            box = box.moved(width - 2 * box.centre_x, height - 2 * box.centre_y)
        self.last = Track(box, box.scaled(2.0), 20.0, 1.0, 1.0)
        return self.last


@dataclass(frozen=True)
class Flown:
    """One flight: gains at each measurement, the first contradiction, and where the vehicle was then and at the end."""

    scenario: str
    fault: str
    gains: np.ndarray
    alarm_s: float
    words: str
    braking_m: float
    end: str


def fly(job: tuple[str, str, float]) -> Flown:
    name, fault, seconds = job
    scenario = replace(SCENARIOS[name], duration_s=seconds)
    scene, link, _ = build(scenario, 0, Autopilot.PX4)
    lens, down_rad, late_s = scene.settings.intrinsics, scene.settings.down_rad, scene.settings.latency_s
    if fault.startswith("lens"):
        lens = Intrinsics.from_fov(lens.width, lens.height, math.radians(float(fault.split()[1])))
    config = resolve(Config(), lens, down_rad, late_s)
    limits = replace(config.limits, **scenario.limits)
    camera = FaultyCamera(scene, fault)
    meter = ImageMotionMeter(lens, down_rad)
    target = replace(config.target, size_m=scenario.size_m)
    servo = replace(config.servo, standoff_m=scenario.standoff_m)
    parts = TrueBoxes(camera), Target(lens, down_rad, target), Servo(down_rad, servo), Safety(limits)
    gains: list[list[float]] = []
    alarm_s, words, at, braking_m, end = math.nan, "", (0.0, 0.0), math.nan, ""
    with link:
        for tick in follow(camera, link, *parts, once(Order.FOLLOW), meter):
            motions, s = parts[3].consistency.motions, tick.state
            if motions and (not gains or motions[-1].t_s != gains[-1][-1]):
                t_s = motions[-1].t_s
                short = [m for m in motions if t_s - m.from_t_s <= SHORT_S + 1e-6]
                long = [m for m in motions if t_s - m.from_t_s <= LONG_S + 1e-6]
                found = (whole_gain(short), turn_gain(long), box_gain(long))
                gains.append([math.nan if g is None else g.value for g in found] + [t_s])
            if parts[3].consistency.words and math.isnan(alarm_s):
                alarm_s, words, at = s.t_s, parts[3].consistency.words, (s.north_m, s.east_m)
            if not math.isnan(alarm_s):
                braking_m = math.hypot(s.north_m - at[0], s.east_m - at[1])
            end = tick.decision.mode.value
            if fault != "none" and s.t_s > FAULT_S + 8.0:
                break
    return Flown(name, fault, np.array(gains).reshape(-1, 4), alarm_s, words, braking_m, end)


def percentiles(values: np.ndarray) -> str:
    known = values[np.isfinite(values)]
    return " ".join(f"{v:5.2f}" for v in np.percentile(known, (0, 5, 50, 95, 100))) if len(known) else f"{'-':>29}"


def draw(flights: list[Flown], path: Path) -> None:
    """The distributions of the three gains, a row for each fault."""
    from matplotlib.figure import Figure  # noqa: PLC0415 - only a plot needs it

    figure = Figure(figsize=(9, 6), layout="constrained")
    for axes, (column, name) in zip(figure.subplots(1, 3, sharey=True), enumerate(NAMES), strict=True):
        for row, fault in enumerate(FAULTS):
            of = [
                f.gains[(f.gains[:, 3] > FAULT_S + SHORT_S) | (fault == "none"), column]
                for f in flights
                if f.fault == fault
            ]
            values = np.concatenate([*of, np.empty(0)])
            values = values[np.isfinite(values)]
            axes.plot(values, np.full(len(values), row) + np.linspace(-0.3, 0.3, len(values)), ".", markersize=2)
        axes.set(title=f"{name} gain", xlim=(-1.5, 2.0), yticks=range(len(FAULTS)), yticklabels=FAULTS)
        axes.axvline(1.0, color="0.7", linewidth=0.8)
    figure.savefig(path, dpi=120)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenario", action="append", choices=list(SCENARIOS))
    parser.add_argument("--fault", action="append", choices=FAULTS)
    parser.add_argument("--seconds", type=float, default=15.0)
    parser.add_argument("--plot", type=Path)
    options = parser.parse_args()
    scenarios = options.scenario or list(SCENARIOS)
    jobs = [(s, f, options.seconds) for f in options.fault or FAULTS for s in scenarios]
    flights: list[Flown] = []
    print(f"{'fault':<12} {'scenario':<20} alarm s  braked m  end        " + " | ".join(f"{n:^29}" for n in NAMES))
    for _, one in each(fly, jobs):
        flights.append(one)
        after = one.gains[(one.gains[:, 3] > FAULT_S + SHORT_S) | (one.fault == "none")]
        columns = " | ".join(percentiles(after[:, k]) for k in range(3))
        alarm = one.alarm_s - (0.0 if one.fault in ("none", "upside down", "lens 130") else FAULT_S)
        print(
            f"{one.fault:<12} {one.scenario:<20} {alarm:7.2f} {one.braking_m:9.1f}  {one.end:<9} {columns}", flush=True
        )
        if one.words:
            print(f"{'':<12} {one.words}", flush=True)
    alarms = [one for one in flights if one.fault == "none" and one.words]
    print(f"false alarms: {len(alarms)} of {sum(one.fault == 'none' for one in flights)} sound flights")
    if options.plot:
        draw(flights, options.plot)


if __name__ == "__main__":
    main()
