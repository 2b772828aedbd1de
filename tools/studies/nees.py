"""Is the estimate's covariance consistent?  Its NEES over hills and flat ground, in closed loop.

    python -m tools.studies.nees --out docs/nees.png
    python -m tools.studies.nees --drawn 20 --out docs/nees_drawn.png

NEES, the normalised estimation error squared, is e' P^-1 e of the target's (north, east, v_north, v_east, ground)
(Bar-Shalom et al., 2001, §5.4).  It is averaged over time for one flight, and over flights for a group: if the
covariance is consistent, the mean of N independent flights at one time lies in the band chi2(5 N) / N for 95 %.  Boxes
have the errors of RACF's (tests/support/ground_flight.py).  With --drawn, size, ground, gradient, the target's
accelerations and the errors of boxes are drawn from the distributions that the filter assumes.  Then NEES must lie in
the band; with boxes as good as RACF's it lies below.
"""

import argparse
import math
from collections.abc import Sequence
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from scipy.stats import chi2

from follow.control.joint_filter import VE, VN, E, N, height_row, with_size
from follow.control.target import TargetConfig
from follow.messages import Autopilot
from racf.parallel import each
from tests.support.ground_flight import BoxErrors, GroundFlight, hill, walk

SLOPES = (0.0, 0.03, 0.05, 0.08, 0.10, 0.20, -0.03, -0.05, -0.08, -0.10, -0.20)
SPEEDS_M_S = (1.4, 3.0)
WAY_M = 115.0
STATES = 5
WAVER, WAVER_S = 0.1, 5.0  # relative variation of a walker's speed, and its correlation time
FROM_S = 6.0  # the estimate is judged from here on
SEEN_S = 0.5  # ... while the target was seen within this time
Flight = tuple[str, float, float, int]


def drawn(seed: int) -> GroundFlight:
    """A flight in a world drawn from the filter's own assumptions; the target ends within a walk of 30 s."""
    random, c, seconds = np.random.default_rng([seed, 5]), TargetConfig(), 30.0
    m, dt = c.motion, 0.1
    steps = round(seconds / dt) + 2
    state, gradient, down = np.array([12.0, 0.0, 0.0, 0.0]), random.normal(0, m.slope_std, 2), random.normal(0, 1.0)
    down *= math.hypot(c.ground.start_std_m, c.ground.slope_std * 12.0)
    rows = [(*state[:2], down)]
    for _ in range(steps):
        density = m.accel_psd + m.turn_psd * float(state[2:] @ state[2:])
        state[2:] += random.normal(0, math.sqrt(density * dt), 2)
        step = state[2:] * dt
        state[:2] += step
        down += float(gradient @ step)
        kept = math.exp(-float(np.linalg.norm(step)) / m.slope_length_m)
        gradient = kept * gradient + math.sqrt(1 - kept**2) * random.normal(0, m.slope_std, 2)
        rows.append((*state[:2], down))
    places = np.array(rows)

    def at(t_s: float, column: int) -> float:
        return float(np.interp(t_s, dt * np.arange(len(places)), places[:, column]))

    size = math.exp(random.normal(math.log(c.size_m), c.size_relative_std))
    errors = BoxErrors(c.bearing_std_rad, m.angle_bias_std_rad, c.box_relative_std, m.size_bias_std, m.bias_s)
    flown = GroundFlight(
        lambda t_s: (at(t_s, 0), at(t_s, 1)),
        end_s=seconds,
        seed=seed,
        size_m=(size / math.sqrt(3), size * math.sqrt(3)),
        errors=errors,
    )
    flown.ground = lambda _north, _east: at(flown.now_s, 2)
    return flown


def over_hill(speed_m_s: float, slope: float, rules: str, seed: int) -> GroundFlight:
    """A flight over a hill; size and height of the ground at the start are drawn as the filter assumes them.

    The target's speed and course vary by a tenth, as those of somebody on foot; boxes have the errors of RACF's.
    """
    random, c, end_s, dt = np.random.default_rng([seed, round(1e3 * slope) % 997, 6]), TargetConfig(), 4.0, 0.1
    end_s += WAY_M / speed_m_s
    kept, waver, place = math.exp(-dt / WAVER_S), random.normal(0, WAVER, 2), np.array([12.0, 0.0])
    places = [place]
    for step in range(round(end_s / dt) + 2):
        waver = kept * waver + math.sqrt(1 - kept**2) * random.normal(0, WAVER, 2)
        moves = speed_m_s * dt if step * dt >= 4.0 else 0.0
        place = place + moves * np.array([1.0 + waver[0], waver[1]])
        places.append(place)
    path = np.array(places)
    lower = random.normal(0, math.hypot(c.ground.start_std_m, c.ground.slope_std * 12.0))
    size = c.size_m * math.exp(random.normal(0, c.size_relative_std))

    def at(t_s: float) -> tuple[float, float]:
        return tuple(float(np.interp(t_s, dt * np.arange(len(path)), path[:, k])) for k in (0, 1))  # pyright: ignore[reportReturnType]

    return GroundFlight(
        at,
        lambda north, east: lower + hill(slope)(north, east),
        Autopilot(rules),
        end_s=end_s,
        seed=seed,
        size_m=(size / math.sqrt(3), size * math.sqrt(3)),
    )


def nees(flight: Flight) -> tuple[Flight, np.ndarray, dict[str, float]]:
    """Fly once: times and NEES (T, 2), and the flight's other results."""
    rules, speed, slope, seed = flight
    if speed and seed:
        flown = over_hill(speed, slope, rules, seed)
    elif speed:
        flown = GroundFlight(walk(speed), hill(slope), Autopilot(rules), end_s=4.0 + WAY_M / speed)
    else:
        flown = drawn(seed)
    rows: list[tuple[float, float]] = []
    flown.watch = lambda: rows.append((flown.now_s, error_squared(flown)))
    flown.fly()
    kept = [row for row in rows if row[0] >= FROM_S]
    figures = {"nearest_m": float(flown.to_body().min()), "standoff": flown.standoff_rms()}
    return flight, np.array(kept), figures


def error_squared(flown: GroundFlight) -> float:
    """e' P^-1 e of the filter now."""
    target, m = flown.estimator, flown.link.vehicle.motion
    if target.filter is None or m.t_s - target.seen_t_s > SEEN_S:
        return math.nan
    f = target.carried(m.t_s)
    here, velocity = np.array([m.north_m, m.east_m, m.down_m]), np.array([m.north_m_s, m.east_m_s])
    north, east = flown.path(m.t_s)
    north1, east1 = flown.path(m.t_s - 0.01)
    height, row = height_row(f, here, target.middle)
    pick = np.zeros((STATES, len(f.mean)))
    pick[range(4), [N, E, VN, VE]] = 1.0
    pick[4] = row
    truth = np.array([north, east, (north - north1) / 0.01, (east - east1) / 0.01, flown.ground(north, east) - here[2]])
    error = np.array([*f.mean[[N, E, VN, VE]], height]) - truth
    return float(error @ np.linalg.solve(pick @ with_size(f, here, velocity) @ pick.T, error))


def draw(flights: Sequence[tuple[Flight, np.ndarray, dict[str, float]]], path: Path) -> None:
    """Mean NEES over the seeds against slope, and over time, with the 95 % bands."""
    figure, (left, right) = plt.subplots(1, 2, figsize=(11, 4))
    for speed in sorted({f[1] for f, _, _ in flights}):
        of = [(f[2], np.nanmean(rows[:, 1])) for f, rows, _ in flights if f[1] == speed]
        slopes = sorted({slope for slope, _ in of})
        left.plot(
            [100 * s for s in slopes],
            [np.mean([v for t, v in of if t == s]) for s in slopes],
            "o-",
            label=f"{speed} m/s",
        )
    count = len({(f[0], f[3]) for f, _, _ in flights})
    for axis, n in ((left, count), (right, len(flights))):
        low, high = chi2.ppf((0.025, 0.975), STATES * n) / n
        axis.axhspan(low, high, color="tab:green", alpha=0.2, label=f"95 % of {n} flights")
        axis.set_ylabel("NEES, 5 degrees of freedom")
        axis.set_ylim(bottom=0)
    left.set_xlabel("slope, %")
    shortest = min(len(rows) for _, rows, _ in flights)
    right.plot(
        flights[0][1][:shortest, 0],
        np.nanmean([rows[:shortest, 1] for _, rows, _ in flights], axis=0),
        label="all flights",
    )
    right.set_xlabel("time, s")
    left.legend()
    right.legend()
    figure.tight_layout()
    figure.savefig(path, dpi=90)


def main() -> None:
    """Fly all flights and print a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("nees.png"), help="where the plot goes")
    parser.add_argument("--seeds", type=int, default=2, help="flights of each kind")
    parser.add_argument("--autopilot", choices=[a.value for a in Autopilot], action="append", help="one or both")
    parser.add_argument("--drawn", type=int, default=0, help="this many flights in drawn worlds instead of hills")
    parser.add_argument("--exact", action="store_true", help="one flight of each kind, its start and size as believed")
    chosen = parser.parse_args()
    kinds = [("px4", 0.0, 0.0, seed) for seed in range(chosen.drawn)] or [
        (rules, speed, slope, seed)
        for rules in chosen.autopilot or [a.value for a in Autopilot]
        for speed in SPEEDS_M_S
        for slope in SLOPES
        for seed in ((0,) if chosen.exact else range(1, chosen.seeds + 1))
    ]
    flights = [result for _, result in each(nees, kinds)]
    flights.sort(key=lambda flight: kinds.index(flight[0]))
    seen = [flight for flight in flights if np.isfinite(flight[1][:, 1]).any()]
    for (rules, speed, slope, seed), rows, figures in flights:
        nees_word = (
            f"{np.nanmean(rows[:, 1]):.2f}" if np.isfinite(rows[:, 1]).any() else "none, the target was not seen"
        )
        print(
            f"{rules} {speed} m/s {100 * slope:+.0f} % seed {seed}: NEES {nees_word}, "
            f"nearest {figures['nearest_m']:.1f} m, stand-off {100 * figures['standoff']:.1f} %"
        )
    low, high = chi2.ppf((0.025, 0.975), STATES * len(seen)) / len(seen)
    mean = np.mean([np.nanmean(rows[:, 1]) for _, rows, _ in seen])
    print(f"{len(seen)} of {len(flights)}: NEES {mean:.2f}, 95 % band {low:.2f} to {high:.2f}")
    draw(seen, chosen.out)


if __name__ == "__main__":
    main()
