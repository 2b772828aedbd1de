"""Fraction in view and centring against the camera's delay, with and without delay compensation.

    python -m tools.studies.latency_sweep --tracker racf-,robust --seeds 1

Flies walker and cyclist at 0, 100, 200 and 400 ms in the simulator with the drawn scene and the real tracker, prints a
table.  A target that is never found again counts as out of view from then on.
"""

import argparse
from dataclasses import asdict, replace

from follow.control.servo import Servo, ServoConfig
from follow.control.target import Target, TargetConfig
from follow.loop import follow
from follow.messages import Autopilot, Order
from follow.safety.gate import Limits, Safety
from racf.evaluate.trackers import TrackerSpec
from racf.threads import one_core
from sim.scenarios import SCENARIOS, Scenario, build
from sim.score import FlightScore, ScoredTick, score


def fly(scenario: Scenario, seed: int, autopilot: Autopilot, tracker: str, *, compensate: bool) -> FlightScore:
    """One flight's score."""
    camera, link, _ = build(scenario, seed, autopilot)
    lens, down_rad = camera.settings.intrinsics, camera.settings.down_rad
    target = Target(lens, down_rad, TargetConfig(size_m=scenario.size_m, compensate=compensate))
    servo = Servo(down_rad, ServoConfig(standoff_m=scenario.standoff_m))
    suggested = {"latency_s": scenario.latency_s, "half_view_rad": lens.horizontal_fov_rad / 2}
    safety = Safety(Limits(**{**suggested, **scenario.limits}))
    safety.order(Order.FOLLOW)
    finder = TrackerSpec.parse(tracker).build()
    frame, box = camera.first()
    finder.init(frame.image, box)
    rows = []
    for tick in follow(camera, link, finder, target, servo, safety):
        rows.append(ScoredTick.of(tick, camera))
    return score(rows, lens, scenario.standoff_m, asdict(safety.limits))


def main() -> None:
    one_core()
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--tracker", default="racf-,robust")
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--autopilot", type=Autopilot, default=Autopilot.PX4)
    args = parser.parse_args()
    print(f"{'':<10}{'':>8}{'compensated':>24}{'as it comes':>24}")
    print(f"{'scenario':<10}{'delay ms':>8}{'in view':>12}{'centring':>12}{'in view':>12}{'centring':>12}")
    for name in ("walker", "cyclist"):
        for delay_s in (0.0, 0.1, 0.2, 0.4):
            scenario = replace(SCENARIOS[name], latency_s=delay_s)
            cells = []
            for compensate in (True, False):
                flown = [
                    fly(scenario, seed, args.autopilot, args.tracker, compensate=compensate)
                    for seed in range(args.seeds)
                ]
                cells += [sum(s.in_view for s in flown) / len(flown), sum(s.centring_rms for s in flown) / len(flown)]
            print(f"{name:<10}{1e3 * delay_s:>8.0f}" + "".join(f"{v:>12.3f}" for v in cells), flush=True)


if __name__ == "__main__":
    main()
