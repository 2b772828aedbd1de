"""`follow report`: one page about a flight, from `ticks.csv`, `summary.json`, `settings.toml` and the messages."""

from pathlib import Path

import numpy as np

from follow.disk import replace_file
from follow.recording.exact import read_said
from follow.recording.flight_table import Array, FlightTable, settings_of, summary_of
from follow.recording.page import Page
from racf.errors import UsageError

BEGINS = b'<!doctype html><html><head><meta charset="utf-8"><title>Flight '  # of every page written here
HEAD = ("tracker", "autopilot", "scenario", "started_utc", "frames", "setpoints")
HIDDEN = ("modes", "tick_ms", "tracker_ms", *HEAD)


def write_report(flight: Path, out: Path | None = None) -> Path:
    """Write the page of a flight and return its file.

    Raises UsageError for a file that cannot be one, OSError, ValueError for a folder that holds no flight.
    """
    path = out or flight / "report.html"
    if path.is_dir():
        raise UsageError(f"--out {str(path)!r} is a folder: give the name of a file, as {str(path / 'report.html')!r}")
    if not path.parent.is_dir():
        raise UsageError(f"--out {str(path)!r} cannot be written: there is no folder {str(path.parent)!r}")
    if path.is_file() and not is_report(path):
        raise UsageError(f"--out {str(path)!r} exists and is no report: give another name")
    text = report(flight)
    try:
        replace_file(path, text)
    except OSError as error:
        raise OSError(f"{str(path)!r} cannot be written: {error.strerror}; give another file with --out") from None
    return path


def is_report(path: Path) -> bool:
    """Whether a file begins as the pages written here; a video is not read whole for that."""
    with path.open("rb") as file:
        return file.read(len(BEGINS)) == BEGINS


def report(flight: Path) -> str:
    """The page of a flight."""
    from follow.recording.plots import flight_figure, timing_figure  # noqa: PLC0415 - Matplotlib, which no flight needs

    table, summary = FlightTable(flight), summary_of(flight)
    page = Page(f"Flight {flight.resolve().name}", lead(table))
    if not summary:
        page.say("summary.json is missing: the flight did not end as it should, it was killed, or the disk was full.")
    page.section("What happened")
    page.plot(flight_figure(table, wanted(flight)))
    modes(page, table)
    losses(page, table)
    limits(page, table)
    timing(page, table, summary)
    page.plot(timing_figure(table))
    link(page, table)
    told(page, flight)
    page.section("Figures")
    page.table(("field", "value"), [(name, _shown(value)) for name, value in summary.items() if name not in HIDDEN])
    page.table(("of the flight", ""), [(name, _shown(summary[name])) for name in HEAD if name in summary])
    if (flight / "settings.toml").is_file():
        page.fold("Settings", (flight / "settings.toml").read_text(errors="replace"))
    return page.text


def wanted(flight: Path) -> tuple[float | None, float | None]:
    """Stand-off and height that the servo keeps, by the settings; None in a mode that keeps neither."""
    settings = settings_of(flight)
    keeps = settings.get("servo.mode", '"chase"').strip('"') in ("chase", "orbit", "profile")
    if not keeps or "servo.standoff_m" not in settings:
        return None, None
    standoff_m, down_deg = float(settings["servo.standoff_m"]), float(settings.get("camera.down_deg", "nan"))
    height_m = standoff_m * float(np.tan(np.radians(np.clip(down_deg, 0.0, 75.0))))
    return standoff_m, height_m if np.isfinite(height_m) else None


def lead(table: FlightTable) -> str:
    """The flight in a sentence or two."""
    spans = table.spans(["mode"], "reason")
    follow_s = sum(span.seconds for span in spans if span.what == "follow")
    lost = table.losses()
    text = f"{table.t_s[-1] - table.t_s[0]:.1f} s, of which {follow_s:.1f} s in follow. "
    if lost:
        text += f"The target was lost {len(lost)} times, {sum(s.seconds for s in lost):.1f} s in all. "
    else:
        text += "The target was never lost. "
    return text + f"At the end: {spans[-1].what} ({spans[-1].why})."


def modes(page: Page, table: FlightTable) -> None:
    """Each mode with its time and reason, and the autopilot's own mode."""
    from follow.recording.plots import GREY, MODES  # noqa: PLC0415

    page.section("Modes and why")
    spans = table.spans(["mode", "vehicle_mode"], "reason")
    rows = [(f"{s.start_s:.1f}", s.seconds, *s.what.split(", ", 1), s.why) for s in spans]
    dots = [MODES.get(s.what.split(", ")[0], GREY) for s in spans]
    page.table(("from, s", "for, s", "mode", "autopilot's mode", "because"), rows, dots)


def losses(page: Page, table: FlightTable) -> None:
    """When the tracker did not find the target."""
    page.section("Losses of the target")
    spans = table.losses()
    if spans:
        page.table(("from, s", "to, s", "for, s"), [(f"{s.start_s:.1f}", f"{s.end_s:.1f}", s.seconds) for s in spans])
    else:
        page.say("The tracker found the target in every frame.")


def limits(page: Page, table: FlightTable) -> None:
    """The limits that acted, and the stale data."""
    page.section("Limits and stale data")
    notes = table.notes()
    if not notes:
        page.say("No limit acted, and no data were stale.")
        return
    step_s = float(np.median(np.diff(table.t_s))) if len(table.t_s) > 1 else 0.0
    rows = [
        (note, len(times), len(times) * step_s, f"{times[0]:.1f}", f"{times[-1]:.1f}")
        for note, times in sorted(notes.items(), key=lambda item: -len(item[1]))
    ]
    page.table(("note", "rounds", "about, s", "first, s", "last, s"), rows)


def timing(page: Page, table: FlightTable, summary: dict[str, object]) -> None:
    """The time between rounds, and the computing time of a round."""
    page.section("Timing")
    rows = [percentiles("between rounds, ms", 1e3 * np.diff(table.t_s))]
    for name, label in (("tick_ms", "time of a round, ms"), ("tracker_ms", "tracker's part, ms")):
        times = summary.get(name)
        if isinstance(times, dict):
            rows.append((label, times.get("p50", np.nan), times.get("p99", np.nan), times.get("max", np.nan)))
    page.table(("", "median", "99 %", "largest"), rows)


def link(page: Page, table: FlightTable) -> None:
    """How old telemetry and frames were when they were used."""
    page.section("Link and camera: age of what was used, s")
    page.table(("", "median", "99 %", "largest"), [percentiles(name, age) for name, age in table.ages()])


def told(page: Page, flight: Path) -> None:
    """The lines shown to the person at the terminal."""
    page.section("What the pilot was told")
    messages = read_said(flight / "messages.jsonl.gz")
    if messages:
        page.table(("at, s", "line"), [(f"{t_s:.1f}", text) for t_s, text in messages])
    else:
        page.say("messages.jsonl.gz, which keeps it, is missing or holds no line.")


def percentiles(name: str, values: Array) -> tuple[str, float, float, float]:
    """A row of a table: median, 99th percentile and maximum of the finite values."""
    known = values[np.isfinite(values)]
    if not len(known):
        return name, np.nan, np.nan, np.nan
    p50, p99 = np.percentile(known, (50, 99))
    return name, float(p50), float(p99), float(known.max())


def _shown(value: object) -> str | float:
    if isinstance(value, dict):
        return ", ".join(f"{name} {number:g}" for name, number in value.items()) or "none"
    return value if isinstance(value, float) else str(value)
