"""Accuracy of `follow doctor --wave`: wrong mounts, lenses and delays, measured in the drawn world.

    python -m tools.studies.wave [--seconds 12] [--case NAME ...]

A vehicle is turned in somebody's hands in front of each scene; the table compares the measured with the drawn values.
"""

import argparse
import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from follow.flight.wave import Mounting, WaveError, gather, measure
from follow.geometry import Intrinsics
from follow.messages import Autopilot, Frame, VehicleState
from sim.camera import SceneCamera
from sim.link import SimLink
from sim.scenarios import SCENARIOS
from sim.waving import WavedVehicle


@dataclass(frozen=True)
class Case:
    """One camera as it is drawn; the settings of all are 80 degrees, 43 degrees below the nose and no delay."""

    name: str
    scene: str = "walker"
    down_deg: float = 29.0
    fov_deg: float = 80.0
    upside_down: bool = False
    delay_s: float = 0.0
    amount: float = 1.0  # of the waving


CASES = [
    Case("right mount", down_deg=43.0),
    Case("mount 29 for 43"),
    Case("lens 130 for 80", fov_deg=130.0),
    Case("upside down", upside_down=True),
    # Multiples of 1/30 s: the lockstep delivers frames only at these times.
    *(Case(f"{1000 * n / 30:.0f} ms", delay_s=n / 30) for n in (2, 3, 6, 9, 12)),
    Case("all at once", fov_deg=130.0, upside_down=True, delay_s=0.3),
    Case("narrow lens", fov_deg=50.0, delay_s=0.1),
    Case("on a road", scene="car", delay_s=0.1),
    Case("at dusk", scene="dusk", delay_s=0.1),
    Case("gently", amount=0.3, delay_s=0.1),
    Case("hardly moved", amount=0.03),
]
ATTITUDE_NOISE_RAD = math.radians(0.1)  # white noise of each message, as after the autopilot's own filter
BELIEVED = Intrinsics.from_fov(640, 360, math.radians(80.0))


def waved_frames(case: Case, seconds: float) -> tuple[SceneCamera, SimLink]:
    """The scene's camera in the case's mount, on a vehicle that is turned by hand."""
    scenario = SCENARIOS[case.scene]
    world = scenario.world(0)
    vehicle = WavedVehicle(Autopilot.PX4, scenario.start(world, 0), case.amount)
    link = SimLink(vehicle)
    mount = scenario.camera_settings(
        Autopilot.PX4, math.radians(case.fov_deg), math.radians(case.down_deg), case.delay_s
    )
    return SceneCamera(world, link, mount, seconds), link


def stamped(camera: SceneCamera, link: SimLink, upside_down: bool) -> Iterator[Frame | None]:
    """Frames as from a device: with the time of their arrival."""
    for frame in camera.frames():
        if frame is None:
            yield None
            continue
        image = np.ascontiguousarray(frame.image[::-1, ::-1]) if upside_down else frame.image
        yield replace(frame, image=image, t_s=link.state().t_s)


def measured(case: Case, seconds: float = 20.0) -> Mounting:
    """The measurement of the case by waving; raises WaveError."""
    camera, link = waved_frames(case, seconds)

    def state() -> VehicleState:
        s = link.state()
        noise = np.random.default_rng(round(1e6 * s.attitude_t_s)).normal(0.0, ATTITUDE_NOISE_RAD, 3)
        return replace(
            s, roll_rad=s.roll_rad + noise[0], pitch_rad=s.pitch_rad + noise[1], yaw_rad=s.yaw_rad + noise[2]
        )

    with camera, link:
        return measure(gather(stamped(camera, link, case.upside_down), state, seconds), BELIEVED)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=12.0)
    parser.add_argument("--case", action="append", choices=[case.name for case in CASES])
    options = parser.parse_args()
    print("| case | below the nose, deg | roll, deg | field of view, deg | delay, ms | turns, deg/s |")
    print("|---|---|---|---|---|---|")
    for case in CASES:
        if options.case and case.name not in options.case:
            continue
        try:
            m = measured(case, options.seconds)
        except WaveError as error:
            print(f"| {case.name} | {str(error).split(':')[0]} | | | | |", flush=True)
            continue
        roll = 180.0 if case.upside_down else 0.0
        cells = [
            f"{m.down_deg.value:.2f} ± {m.down_deg.std:.2f} of {case.down_deg:g}",
            f"{math.remainder(m.roll_deg.value - roll, 360.0) + roll:.2f} ± {m.roll_deg.std:.2f} of {roll:g}",
            f"{m.fov_deg.value:.1f} ± {m.fov_deg.std:.1f} of {case.fov_deg:g}",
            f"{1e3 * m.delay_s.value:.0f} ± {1e3 * m.delay_s.std:.0f} of {1e3 * case.delay_s:.0f}",
            f"{math.degrees(m.turn_rad_s):.0f}",
        ]
        print(f"| {case.name} | {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    main()
