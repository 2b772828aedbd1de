"""Plots of a recorded flight over its time: lanes of modes, range and height against the wanted ones, setpoints."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from follow.recording.flight_table import Array, FlightTable, Span
from follow.recording.layout import MODE_COLOURS
from follow.recording.rows import held_by

POINTS = 1500  # along a curve: more than the page has pixels
CHANNELS = (("forward_m_s", "forward, m/s"), ("right_m_s", "right, m/s"), ("down_m_s", "down, m/s"))
GREEN, RED, BLUE, ORANGE, GREY = "#2e9e4f", "#d8392b", "#2a6fd6", "#e07b12", "#8a8a8a"
MODES = {mode.value: "#{:02x}{:02x}{:02x}".format(*colour) for mode, colour in MODE_COLOURS.items()}


def columns(count: int, heights: Sequence[float]) -> tuple[Figure, list[Axes]]:
    """A figure of plots below each other that share the time."""
    figure = Figure(figsize=(11, 1.1 * sum(heights)), layout="constrained")
    axes = figure.subplots(count, 1, sharex=True, gridspec_kw={"height_ratios": list(heights)})
    found: list[Axes] = list(np.atleast_1d(axes))
    for ax in found:
        ax.grid(visible=True, alpha=0.25)
        ax.spines[["top", "right"]].set_visible(False)
    found[-1].set_xlabel("time of the flight, s")
    return figure, found


def line(ax: Axes, t_s: Array, values: Array, label: str, **style: Any) -> None:
    """One curve, decimated to POINTS; each piece keeps its extremes."""
    keep = np.arange(len(t_s))
    if len(t_s) > POINTS:
        size = -(-len(t_s) // (POINTS // 2))
        filled = np.nan_to_num(values)
        keep = np.unique(
            [k + int(pick(filled[k : k + size])) for k in range(0, len(t_s), size) for pick in (np.argmin, np.argmax)]
        )
    if np.isfinite(values).any():
        ax.plot(t_s[keep], values[keep], label=label, **style)


def legend(ax: Axes) -> None:
    """The legend, beside the curves."""
    if ax.get_legend_handles_labels()[0]:
        ax.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False, fontsize="small")


def lane(ax: Axes, row: float, spans: Sequence[Span], colours: dict[str, str]) -> None:
    """A lane of coloured spans."""
    for span in spans:
        if colour := colours.get(span.what):
            ax.broken_barh([(span.start_s, max(span.seconds, 1e-3))], (row - 0.4, 0.8), color=colour, linewidth=0)


def lanes(ax: Axes, table: FlightTable) -> None:
    """Mode, target lost, held back: a lane each."""
    lane(ax, 2, table.spans(["mode"]), MODES)
    lane(ax, 1, table.losses(), {"lost": RED})
    held = [Span(s.start_s, s.end_s, "held") for s in table.spans(["notes"]) if held_by(s.what.split(" | "))]
    lane(ax, 0, held, {"held": ORANGE})
    ax.set_yticks([0, 1, 2], ["held back", "target lost", "mode"])
    ax.set_ylim(-0.6, 2.6)
    for name in dict.fromkeys(table.words("mode")):
        ax.plot([], [], color=MODES.get(name, GREY), linewidth=6, label=name)
    legend(ax)


def flight_figure(table: FlightTable, wanted_m: tuple[float | None, float | None]) -> Figure:
    """What happened over time; `wanted_m` are the stand-off and the height that the servo keeps."""
    figure, axes = columns(6, [1.3, 1.6, 1.4, 1.6, 1.2, 1.0])
    t_s = table.t_s
    lanes(axes[0], table)
    for ax, values, wanted, label, name in (
        (axes[1], table.numbers("target_range_m"), wanted_m[0], "wanted", "range, m"),
        # In fast flight the vehicle leans and its camera looks down more steeply, so the servo keeps more height.
        (axes[2], table.height_m(), wanted_m[1], "wanted at a hover", "above the\ntarget, m"),
    ):
        seen = np.where(np.isfinite(table.numbers("target_seen_t_s")), values, np.nan)
        line(ax, t_s, seen, "flown", color=BLUE)
        if wanted is not None:
            ax.axhline(wanted, color=GREEN, linestyle="--", label=label)
        ax.set_ylabel(name)
        legend(ax)
    for colour, (channel, label) in zip((BLUE, ORANGE, GREEN), CHANNELS, strict=True):
        line(axes[3], t_s, table.numbers(f"desired_{channel}"), f"{label}: desired", color=colour, alpha=0.4)
        line(axes[3], t_s, table.numbers(f"setpoint_{channel}"), "sent", color=colour)
    axes[3].set_ylabel("velocity, m/s")
    line(axes[4], t_s, np.degrees(table.numbers("desired_yaw_rate_rad_s")), "desired", color=BLUE, alpha=0.4)
    line(axes[4], t_s, np.degrees(table.numbers("setpoint_yaw_rate_rad_s")), "sent", color=BLUE)
    axes[4].set_ylabel("yaw rate, °/s")
    line(axes[5], t_s, table.numbers("track_confidence"), "confidence", color=GREEN)
    axes[5].set_ylim(0, 1.05)
    axes[5].set_ylabel("tracker")
    for ax in axes[3:]:
        legend(ax)
    return figure


def timing_figure(table: FlightTable) -> Figure:
    """The time between rounds, and how old frames and telemetry were."""
    figure, axes = columns(2, [1.2, 1.4])
    line(axes[0], table.t_s[1:], 1e3 * np.diff(table.t_s), "between rounds", color=GREY)
    axes[0].set_ylabel("ms")
    for colour, (name, age) in zip((BLUE, ORANGE, GREY, GREEN), table.ages(), strict=True):
        line(axes[1], table.t_s, age, name, color=colour)
    axes[1].set_ylabel("age, s")
    for ax in axes:
        legend(ax)
    return figure


def comparison_figure(before: FlightTable, after: FlightTable) -> Figure:
    """Two outcomes of the same rounds: modes, range, and the desired and sent velocity in each channel."""
    figure, axes = columns(8, [0.9, 0.9, 1.3, 1.3, 1.3, 1.3, 1.3, 1.3])
    for ax, table, name in ((axes[0], before, "recorded"), (axes[1], after, "flown again")):
        lanes(ax, table)
        ax.set_ylabel(name)
    pairs = (("target_range_m", "range, m"), ("target_range_std_m", "range's std, m"))
    for ax, (column, name) in zip(axes[2:4], pairs, strict=True):
        _both(ax, before, after, column)
        ax.set_ylabel(name)
    channels = (*CHANNELS, ("yaw_rate_rad_s", "yaw rate, rad/s"))
    for ax, (channel, name) in zip(axes[4:], channels, strict=True):
        _both(ax, before, after, f"desired_{channel}", " desired", alpha=0.35)
        _both(ax, before, after, f"setpoint_{channel}", " sent")
        ax.set_ylabel(name)
    for ax in axes[2:]:
        legend(ax)
    return figure


def _both(ax: Axes, before: FlightTable, after: FlightTable, column: str, what: str = "", **style: Any) -> None:
    line(ax, before.t_s, before.numbers(column), f"recorded{what}", color=GREY, **style)
    line(ax, after.t_s, after.numbers(column), f"again{what}", color=BLUE, **style)
