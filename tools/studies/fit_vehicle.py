"""Fit `sim.dynamics` to measured step responses of two autopilots; print the numbers, the errors and draw the plot.

    python -m tools.studies.fit_vehicle DATA [--fit] [--plot docs/vehicle.png]

DATA holds two samples of each autopilot (`FILES`), with one row per telemetry sample: time, step label, the command
(body velocity, yaw rate), the measured body velocity, attitude, yaw rate and height.  Without `--fit` it evaluates the
numbers in the code; with `--fit` it fits them again and prints them.
"""

import argparse
import csv
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib import pyplot as plt
from scipy.optimize import least_squares

from follow.geometry import ned_to_heading
from follow.messages import Autopilot, Setpoint
from sim.dynamics import Vehicle, VehicleTruth
from sim.measured import RESPONSES, TOP_M_S, ResponseModel, tilt_m_s2

matplotlib.use("Agg")

FILES = {
    Autopilot.PX4: ("px4_1.16_sih_steps.csv", "px4_1.16_sih_steps_2.csv"),
    Autopilot.ARDUPILOT: ("arducopter_4.7dev_sitl_steps.csv", "arducopter_4.7dev_sitl_steps_2.csv"),
}
COLUMNS = ("t_s", "v_fwd", "v_right", "vz_ned", "roll", "pitch", "yawrate", "z")
COMMAND = ("cmd_vx", "cmd_vy", "cmd_vz", "cmd_yawrate")
STEP_S = 0.02
DURATION_S = 7.9  # each step was held for 8 s
T = np.arange(0.0, DURATION_S, STEP_S)

Steps = dict[str, tuple[Setpoint, Setpoint, np.ndarray]]
"""One sample: label -> the command before, the command, the measurements at each T as rows of COLUMNS[1:]."""


def read_samples(folder: Path) -> dict[Autopilot, list[Steps]]:
    """The samples of each autopilot."""
    return {autopilot: [read(folder / name) for name in names] for autopilot, names in FILES.items()}


def model_of(autopilot: Autopilot, sample: int) -> int:
    """The index of the response model of a sample."""
    return min(sample, len(RESPONSES[autopilot]) - 1)


def read(path: Path) -> Steps:
    """Each step's (command before, command, samples resampled onto T as rows of COLUMNS[1:])."""
    steps: dict[str, tuple[Setpoint, list[list[float]]]] = {}
    for row in csv.DictReader(path.read_text().splitlines()):
        if row["label"] == "prestream" or not row["cmd_vx"]:
            continue
        command = Setpoint(*(float(row[name]) for name in COMMAND))
        steps.setdefault(row["label"], (command, []))[1].append([float(row[name]) for name in COLUMNS])
    before = Setpoint()
    out = {}
    for label, (command, rows) in steps.items():
        a = np.array(rows)
        out[label] = (before, command, np.array([np.interp(T, a[:, 0] - a[0, 0], column) for column in a.T[1:]]).T)
        before = command
    return out


def simulate(
    autopilot: Autopilot, response: ResponseModel, before: Setpoint, command: Setpoint, v0: np.ndarray
) -> np.ndarray:
    """The model's own row of COLUMNS[1:7] at each T, from the measured velocity of the step's first sample."""
    start = VehicleTruth(
        down_m=-100.0, north_m_s=v0[0], east_m_s=v0[1], down_m_s=v0[2], yaw_rate_rad_s=before.yaw_rate_rad_s
    )
    vehicle = Vehicle(autopilot, start, response=response.steady())
    rows = []
    for _ in T:
        m = vehicle.motion
        forward, right = ned_to_heading(m.north_m_s, m.east_m_s, m.yaw_rad)
        rows.append([forward, right, m.down_m_s, m.roll_rad, m.pitch_rad, m.yaw_rate_rad_s])
        vehicle.step(command, STEP_S)
    return np.array(rows)


def curves(autopilot: Autopilot, response: ResponseModel, steps: Steps, labels: Iterable[str]) -> dict[str, np.ndarray]:
    """The model's curves of these steps."""
    out = {}
    for label in labels:
        before, command, measured = steps[label]
        out[label] = simulate(autopilot, response, before, command, measured[0, :3])
    return out


@dataclass(frozen=True)
class Group:
    """Parameters fitted together: paths into ResponseModel with bounds, the steps and the columns that show them.

    `apart` fits each model to its own samples, else all models of an autopilot are fitted to all its samples.
    """

    labels: tuple[str, ...]
    weights: dict[int, float]  # column of the curves: how much a unit of it counts
    bounds: dict[str, tuple[float, float]]
    apart: bool = False

    def start(self, response: ResponseModel) -> np.ndarray:
        """The parameters in `response`, just inside their bounds."""
        low, high = np.array(list(self.bounds.values())).T
        return np.clip([reach(response, path) for path in self.bounds], low + 1e-6, high - 1e-6)

    def apply(self, response: ResponseModel, values: np.ndarray) -> ResponseModel:
        """`response` with these parameters."""
        for path, value in zip(self.bounds, values, strict=True):
            head, _, tail = path.partition(".")
            new = replace(getattr(response, head), **{tail: float(value)}) if tail else float(value)
            response = replace(response, **{head: new})
        return response


def reach(response: ResponseModel, path: str) -> float:
    """The number at a dotted path."""
    for name in path.split("."):
        response = getattr(response, name)
    return response


GROUPS = (
    Group(
        ("yr0.5", "yr0", "yr1.5", "yr0b"),
        {5: 1.0},
        {
            "turn.dead_time_s": (0, 0.25),
            "turn.gain_per_s": (0.5, 30),
            "turn.integral_per_s2": (0, 60),
            "turn.damping_per_s": (0, 3),
            "turn.ramp_rad_s2": (0.5, 20),
        },
    ),
    Group(
        ("vx2", "vx0", "vy2", "vy0", "vx5", "vx0b", "vx0.5", "vx0c", "vx2yr0.5", "zero"),
        {0: 1.0, 1: 1.0, 3: 1.5, 4: 1.5},  # 0.1 rad of tilt counts as much as 0.15 m/s
        {
            "horizontal.dead_time_s": (0, 0.4),
            "horizontal.gain_per_s": (0.3, 8),
            "horizontal.integral_per_s2": (0, 8),
            "horizontal.feed_forward": (0, 1.2),
            "horizontal.omega_rad_s": (4, 30),
            "horizontal.zeta": (0.5, 1.3),
            "horizontal.drag_per_s": (0, 0.6),
            "horizontal.drag_per_m": (0, 0.1),
        },
        apart=True,
    ),
    Group(
        ("vz_up1", "vz0a", "vz_dn1", "vz0b"),
        {2: 1.0},
        {
            "vertical.dead_time_s": (0, 0.25),
            "vertical.gain_per_s": (0.3, 15),
            "vertical.integral_per_s2": (0, 8),
            "vertical.feed_forward": (0, 1.2),
            "vertical.omega_rad_s": (4, 25),
            "vertical.drag_per_s": (0, 3),
        },
    ),
)


def fit_group(autopilot: Autopilot, samples: list[Steps], response: ResponseModel, group: Group) -> ResponseModel:
    """Least squares over the parameters of one group, and the top speed where it was measured."""
    columns, weights = list(group.weights), list(group.weights.values())

    def residual(values: np.ndarray) -> np.ndarray:
        new = group.apply(response, values)
        errors = []
        for steps in samples:
            model = curves(autopilot, new, steps, group.labels)
            errors += [((model[k][:, :6] - steps[k][2][:, :6])[:, columns] * weights).ravel() for k in group.labels]
        if autopilot in TOP_M_S and "horizontal.drag_per_m" in group.bounds:
            top_m_s, tilt_rad = TOP_M_S[autopilot]
            errors.append(TOP_WEIGHT * np.array([abs(new.horizontal.drag(top_m_s)) - tilt_m_s2(tilt_rad)]))
        return np.concatenate(errors)

    start = group.start(response)
    bounds = tuple(np.array(list(group.bounds.values())).T)
    # The dead time acts in whole substeps, so derivatives need a wide difference.
    scale = np.maximum(np.abs(start), 0.05)
    return group.apply(response, least_squares(residual, start, bounds=bounds, x_scale=scale, diff_step=0.05).x)


TOP_WEIGHT = 20.0  # of the top speed's 1 m/s² against the thousands of samples of the steps


def fit(autopilot: Autopilot, samples: list[Steps]) -> tuple[ResponseModel, ...]:
    """The autopilot's models, fitted again."""
    models = list(RESPONSES[autopilot])
    for group in GROUPS:
        for index, model in enumerate(models):
            own = [steps for k, steps in enumerate(samples) if not group.apart or model_of(autopilot, k) == index]
            models[index] = fit_group(autopilot, own, model, group)
    return tuple(models)


@dataclass(frozen=True)
class Judged:
    """One step of one autopilot, RMS of body velocity in m/s: sample against sample, and model against each."""

    label: str
    spread: float
    errors: tuple[float, ...]

    @property
    def held(self) -> bool:
        """Whether the model is as close to each sample as the samples are to each other."""
        return max(self.errors) <= self.spread


def judge(autopilot: Autopilot, samples: list[Steps]) -> list[Judged]:
    """Each step's spread and errors."""
    models = [RESPONSES[autopilot][model_of(autopilot, k)] for k in range(len(samples))]
    flown = [curves(autopilot, model, steps, steps) for model, steps in zip(models, samples, strict=True)]
    rows = []
    for label in samples[0]:
        measured = [steps[label][2][:, :3] for steps in samples]
        errors = tuple(rms(m[label][:, :3] - v) for m, v in zip(flown, measured, strict=True))
        rows.append(Judged(label, rms(measured[0] - measured[1]), errors))
    return rows


def rms(difference: np.ndarray) -> float:
    """Root of the mean squared length of the rows."""
    return float(np.sqrt(np.mean(np.sum(difference**2, axis=1))))


QUIET = ("vx2", "vx0", "vx5", "vx0b", "vx0.5", "vx0c")
"""Steps without a turn and without a command sideways or down."""


def wander(v: list[np.ndarray]) -> tuple[float, float]:
    """Standard deviation (m/s) about the mean and correlation time (s) of pieces of a velocity, sampled on T."""
    v = [x - x.mean() for x in v]
    lag = round(0.25 / STEP_S)
    kept = np.mean([np.mean(x[lag:] * x[:-lag]) for x in v]) / np.mean([np.mean(x * x) for x in v])
    return float(np.sqrt(np.mean([np.mean(x * x) for x in v]))), float(-0.25 / np.log(max(kept, 1e-3)))


def velocity_error(samples: list[Steps]) -> tuple[float, float]:
    """Standard deviation (m/s) and correlation time (s) of the reported vertical velocity's error.

    The reported height changes by more than the integral of the reported velocity.  For a first-order Gauss-Markov
    error of the velocity, the mean square of this difference over a lag L is 2σ²τ²(L/τ - 1 + exp(-L/τ)).
    """
    lags_s = (0.5, 1.0, 2.0, 4.0, 6.0)  # within a step
    left = [m[:, 6] - np.cumsum(m[:, 2]) * STEP_S for steps in samples for _, _, m in steps.values()]
    n = [round(lag / STEP_S) for lag in lags_s]
    seen = np.array([np.sqrt(np.mean([np.mean((x[k:] - x[:-k]) ** 2) for x in left])) for k in n]) / lags_s

    def residual(values: np.ndarray) -> np.ndarray:
        sigma, tau = values
        x = np.array(lags_s) / tau
        return sigma * np.sqrt(2.0 * (x - 1.0 + np.exp(-x))) / x - seen

    sigma, tau = least_squares(residual, (0.1, 3.0)).x
    return float(sigma), float(tau)


def draw(data: dict[Autopilot, list[Steps]], path: Path) -> None:
    """Model over measurement, for both autopilots."""
    panels = [
        ("vx2", 0),
        ("vx5", 0),
        ("vx0b", 0),
        ("vy2", 1),
        ("vx2yr0.5", 1),
        ("vz_up1", 2),
        ("vz_dn1", 2),
        ("vx2", 4),
        ("vx5", 4),
        ("yr0.5", 5),
        ("yr0", 5),
        ("yr1.5", 5),
    ]
    names = ["forward, m/s", "right, m/s", "down, m/s", "roll, rad", "pitch, rad", "yaw rate, rad/s"]
    colours = {Autopilot.PX4: "tab:red", Autopilot.ARDUPILOT: "tab:blue"}
    figure, axes = plt.subplots(3, 4, figsize=(13, 8), layout="constrained")
    for ax, (label, column) in zip(axes.flat, panels, strict=True):
        for autopilot, colour in colours.items():
            for sample, steps in enumerate(data[autopilot]):
                before, command, measured = steps[label]
                which, line = model_of(autopilot, sample), ("--", ":")[sample]
                model = simulate(autopilot, RESPONSES[autopilot][which], before, command, measured[0, :3])
                name = f"{autopilot.value} {sample + 1}"
                ax.plot(T, measured[:, column], color=colour, alpha=0.35, lw=2.5, ls=("-", "-.")[sample], label=name)
                ax.plot(T, model[:, column], color=colour, lw=1.2, ls=line, label=f"{name}, model")
        ax.set_title(label, fontsize=9)
        ax.set_ylabel(names[column], fontsize=8)
        ax.grid(alpha=0.3)
    axes[0, 0].legend(fontsize=7)
    for ax in axes[-1]:
        ax.set_xlabel("time after the command, s", fontsize=8)
    figure.savefig(path, dpi=80)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data", type=Path)
    parser.add_argument("--fit", action="store_true")
    parser.add_argument("--plot", type=Path)
    arguments = parser.parse_args()
    data = read_samples(arguments.data)
    for autopilot, samples in data.items():
        if arguments.fit:
            RESPONSES[autopilot] = fit(autopilot, samples)
            print(*RESPONSES[autopilot], sep="\n")
        quiet = [steps[label][2] for steps in samples for label in QUIET]
        for axis, column in {"right": 1, "down": 2}.items():
            print(f"{autopilot.value} wanders {axis}: {wander([m[:, column] for m in quiet])} m/s, s")
        print(f"{autopilot.value}'s vertical velocity is wrong by {velocity_error(samples)} m/s, s")
    print(f"| step | PX4 to itself | model to each | held | ArduPilot to itself | the same | |\n|{'---|' * 7}")
    for rows in zip(*(judge(autopilot, samples) for autopilot, samples in data.items()), strict=True):
        cells = [f"{row.spread:.3f} | {', '.join(f'{e:.3f}' for e in row.errors)}" for row in rows]
        cells = [f"{cell} | {'yes' if row.held else 'no'}" for cell, row in zip(cells, rows, strict=True)]
        print(f"| {rows[0].label} | {' | '.join(cells)} |")
    if arguments.plot:
        draw(data, arguments.plot)


if __name__ == "__main__":
    main()
