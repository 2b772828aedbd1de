"""Fit `sim.dynamics` to measured step responses of two autopilots; print the numbers, the errors and draw the plot.

    python -m tools.studies.fit_vehicle DATA [--fit] [--plot docs/vehicle.png]

DATA holds `px4_1.16_sih_steps.csv` and `arducopter_4.7dev_sitl_steps.csv`, with one row per telemetry sample: time,
step label, the command (body velocity, yaw rate), the measured body velocity, attitude and yaw rate.
Without `--fit` it judges the numbers in the code; with it, it fits them again and prints them.
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
from sim.measured import RESPONSES, ResponseModel

matplotlib.use("Agg")

FILES = {Autopilot.PX4: "px4_1.16_sih_steps.csv", Autopilot.ARDUPILOT: "arducopter_4.7dev_sitl_steps.csv"}
COLUMNS = ("t_s", "v_fwd", "v_right", "vz_ned", "roll", "pitch", "yawrate")
COMMAND = ("cmd_vx", "cmd_vy", "cmd_vz", "cmd_yawrate")
STEP_S = 0.02
DURATION_S = 7.9  # each step was held for 8 s
T = np.arange(0.0, DURATION_S, STEP_S)


def read(path: Path) -> dict[str, tuple[Setpoint, Setpoint, np.ndarray]]:
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
    """The model's own row of COLUMNS[1:] at each T, from the measured velocity of the step's first sample."""
    start = VehicleTruth(
        down_m=-100.0, north_m_s=v0[0], east_m_s=v0[1], down_m_s=v0[2], yaw_rate_rad_s=before.yaw_rate_rad_s
    )
    vehicle = Vehicle(autopilot, start, response=replace(response, drift_m_s=0.0))
    rows = []
    for _ in T:
        m = vehicle.motion
        forward, right = ned_to_heading(m.north_m_s, m.east_m_s, m.yaw_rad)
        rows.append([forward, right, m.down_m_s, m.roll_rad, m.pitch_rad, m.yaw_rate_rad_s])
        vehicle.step(command, STEP_S)
    return np.array(rows)


def curves(autopilot: Autopilot, response: ResponseModel, steps: dict, labels: Iterable[str]) -> dict[str, np.ndarray]:
    """The model's curves of these steps."""
    out = {}
    for label in labels:
        before, command, measured = steps[label]
        out[label] = simulate(autopilot, response, before, command, measured[0, :3])
    return out


@dataclass(frozen=True)
class Group:
    """Parameters fitted together: paths into ResponseModel with bounds, the steps and the columns that show them."""

    labels: tuple[str, ...]
    weights: dict[int, float]  # column of the curves: how much a unit of it counts
    bounds: dict[str, tuple[float, float]]

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
            "yaw_dead_time_s": (0, 0.25),
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
            "dead_time_s": (0, 0.25),
            "horizontal.gain_per_s": (0.3, 8),
            "horizontal.integral_per_s2": (0, 8),
            "horizontal.feed_forward": (0, 1.2),
            "horizontal.omega_rad_s": (4, 30),
            "horizontal.zeta": (0.5, 1.3),
            "horizontal.drag_per_s": (0, 0.6),
        },
    ),
    Group(
        ("vz_up1", "vz0a", "vz_dn1", "vz0b"),
        {2: 1.0},
        {
            "vertical.gain_per_s": (0.3, 15),
            "vertical.integral_per_s2": (0, 8),
            "vertical.feed_forward": (0, 1.2),
            "vertical.omega_rad_s": (4, 25),
            "vertical.drag_per_s": (0, 3),
        },
    ),
)


def fit_group(autopilot: Autopilot, steps: dict, response: ResponseModel, group: Group) -> ResponseModel:
    """Least squares over the parameters of one group."""

    def residual(values: np.ndarray) -> np.ndarray:
        model = curves(autopilot, group.apply(response, values), steps, group.labels)
        columns, weights = list(group.weights), list(group.weights.values())
        return np.concatenate([((model[k] - steps[k][2])[:, columns] * weights).ravel() for k in group.labels])

    start = group.start(response)
    bounds = tuple(np.array(list(group.bounds.values())).T)
    # The dead time acts in whole substeps, so derivatives need a wide difference.
    scale = np.maximum(np.abs(start), 0.05)
    return group.apply(response, least_squares(residual, start, bounds=bounds, x_scale=scale, diff_step=0.05).x)


def judge(data: dict) -> list[tuple[str, float, float, float]]:
    """Per step: label, the two autopilots' difference, and each model's error (RMS of body velocity, m/s)."""
    model = {a: curves(a, RESPONSES[a], data[a], list(data[a])) for a in FILES}
    rows = []
    for label in data[Autopilot.PX4]:
        px4, ardupilot = (data[a][label][2][:, :3] for a in FILES)
        errors = [rms(model[a][label][:, :3] - data[a][label][2][:, :3]) for a in FILES]
        rows.append((label, rms(px4 - ardupilot), *errors))
    return rows


def rms(difference: np.ndarray) -> float:
    """Root of the mean squared length of the rows."""
    return float(np.sqrt(np.mean(np.sum(difference**2, axis=1))))


def floors(data: dict, label: str) -> dict[str, float]:
    """How near to PX4's curve of a turn on the spot one could come, knowing that curve (RMS, m/s).

    No movement at all; the best constant velocity of the body, and of the ground, both read off the curve itself; then
    ArduPilot's curve, and the least, mean and largest of that curve moved round in time.
    """
    px4, ardupilot = (data[a][label][2] for a in FILES)
    v, turned = px4[:, :3], np.exp(1j * np.cumsum(px4[:, 5]) * STEP_S)
    ground = (v[:, 0] + 1j * v[:, 1]) * turned
    left = np.stack([(ground - ground.mean()).real, (ground - ground.mean()).imag, v[:, 2] - v[:, 2].mean()], axis=1)
    moved = [rms(v - np.roll(ardupilot[:, :3], shift, axis=0)) for shift in range(len(v))]
    return {
        "none": rms(v),
        "body": rms(v - v.mean(axis=0)),
        "ground": rms(left),
        "ArduPilot": moved[0],
        "least": min(moved),
        "mean": float(np.mean(moved)),
        "largest": max(moved),
    }


def wander(steps: dict) -> tuple[float, float]:
    """Standard deviation (m/s) and correlation time (s) of the sideways velocity in steps that command none."""
    v = [steps[k][2][:, 1] - steps[k][2][:, 1].mean() for k in ("vx2", "vx0", "vx5", "vx0b", "vx0.5", "vx0c")]
    lag = round(0.5 / STEP_S)
    kept = np.mean([np.mean(x[lag:] * x[:-lag]) for x in v]) / np.mean([np.mean(x * x) for x in v])
    return float(np.sqrt(np.mean([np.mean(x * x) for x in v]))), float(-0.5 / np.log(max(kept, 1e-3)))


def draw(data: dict, path: Path) -> None:
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
            before, command, measured = data[autopilot][label]
            model = simulate(autopilot, RESPONSES[autopilot], before, command, measured[0, :3])
            ax.plot(T, measured[:, column], color=colour, alpha=0.35, lw=2.5, label=f"{autopilot.value}, measured")
            ax.plot(T, model[:, column], color=colour, lw=1.2, ls="--", label=f"{autopilot.value}, model")
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
    data = {autopilot: read(arguments.data / name) for autopilot, name in FILES.items()}
    if arguments.fit:
        for autopilot, steps in data.items():
            for group in GROUPS:
                RESPONSES[autopilot] = fit_group(autopilot, steps, RESPONSES[autopilot], group)
            print(autopilot.value, "wanders", wander(steps))
            print(RESPONSES[autopilot])
    print(f"| step | PX4 to ArduPilot | model to PX4 | model to ArduPilot |\n|{'---|' * 4}")
    for label, between, px4, ardupilot in judge(data):
        late = " (above)" if max(px4, ardupilot) > between else ""
        print(f"| {label} | {between:.3f} | {px4:.3f} | {ardupilot:.3f} |{late}")
    for label in ("yr1.5", "yr0b"):
        print(label, *(f"{name} {value:.4f}" for name, value in floors(data, label).items()))
    if arguments.plot:
        draw(data, arguments.plot)


if __name__ == "__main__":
    main()
