"""`refly.html`: a recorded flight and the same rounds with other settings, side by side."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from follow.disk import replace_file
from follow.recording.flight_table import Array, FlightTable
from follow.recording.page import Page

CHANNELS = ("forward_m_s", "right_m_s", "down_m_s", "yaw_rate_rad_s")


@dataclass(slots=True)
class Difference:
    """Counts the rounds whose outcome differs from the recorded one in any bit."""

    total: int
    compared: int = 0
    rounds: int = 0
    first_s: float | None = field(default=None)

    def add(self, t_s: float, *, equal: bool) -> None:
        """Add one round, `t_s` after the first one."""
        self.compared += 1
        if not equal:
            self.rounds += 1
            self.first_s = t_s if self.first_s is None else self.first_s

    def sentence(self, *, same: bool) -> str:
        """The result in words; `same`: with the recorded settings."""
        settings = "the recorded settings" if same else "other settings"
        if self.first_s is None:
            return f"{settings}: the outcome of all {self.compared} rounds is equal to the last bit"
        return f"{settings}: {self.rounds} of {self.total} rounds differ, the first at {self.first_s:.1f} s"


def write_comparison(flight: Path, again: Path, result: str, changed: Mapping[str, tuple[str, str]]) -> None:
    """Write `refly.html` beside the second recording.  Raises OSError, ValueError."""
    replace_file(again / "refly.html", comparison(flight, again, result, changed))


def comparison(flight: Path, again: Path, result: str, changed: Mapping[str, tuple[str, str]]) -> str:
    """The page."""
    from follow.recording.plots import comparison_figure  # noqa: PLC0415 - Matplotlib, which no flight needs

    before, after = FlightTable(flight), FlightTable(again)
    page = Page(f"Flight {flight.resolve().name}, flown again", f"{result[0].upper()}{result[1:]}.")
    page.say("The vehicle went where it went: what is shown is what would have been desired and sent on that path.")
    page.section("Settings that differ")
    if changed:
        page.table(("setting", "recorded", "again"), [(name, *pair) for name, pair in changed.items()])
    else:
        page.say("None.")
    page.section("Over time")
    page.plot(comparison_figure(before, after))
    page.section("Setpoints")
    page.table(("", "rms recorded", "rms again", "rms difference", "largest difference"), setpoints(before, after))
    page.section("Seconds in each mode")
    page.table(("mode", "recorded", "again"), _side_by_side(_modes(before), _modes(after)))
    page.section("Limits and stale data, rounds")
    page.table(("note", "recorded", "again"), _side_by_side(_notes(before), _notes(after)))
    return page.text


def setpoints(before: FlightTable, after: FlightTable) -> list[tuple[str, float, float, float, float]]:
    """Root mean squares of each channel, and of the difference where both exist."""
    rows: list[tuple[str, float, float, float, float]] = []
    count = min(len(before.t_s), len(after.t_s))
    for kind in ("desired", "setpoint"):
        for channel in CHANNELS:
            old, new = before.numbers(f"{kind}_{channel}")[:count], after.numbers(f"{kind}_{channel}")[:count]
            difference = np.abs(new - old)
            largest = float(np.nanmax(difference)) if np.isfinite(difference).any() else np.nan
            name = f"{'sent' if kind == 'setpoint' else kind}, {channel}"
            rows.append((name, _rms(old), _rms(new), _rms(difference), largest))
    return rows


def _rms(values: Array) -> float:
    known = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(known**2))) if len(known) else np.nan


def _modes(table: FlightTable) -> dict[str, float]:
    seconds: dict[str, float] = {}
    for span in table.spans(["mode"]):
        seconds[span.what] = seconds.get(span.what, 0.0) + span.seconds
    return seconds


def _notes(table: FlightTable) -> dict[str, float]:
    return {note: float(len(times)) for note, times in table.notes().items()}


def _side_by_side(before: Mapping[str, float], after: Mapping[str, float]) -> list[tuple[str, float, float]]:
    return [(name, before.get(name, 0.0), after.get(name, 0.0)) for name in {**before, **after}]
