"""`ticks.csv`: a row a tick, units in the column names, the same bytes for the same simulated flight.

Every time counts from the flight's first tick.  Durations of stages, which differ from run to run, are only in the
recording.
docs/after_a_flight.md describes each column.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass
from datetime import datetime, timezone

from follow.messages import Estimate, Setpoint, Tick, VehicleState
from racf.box import Box
from racf.track import Track

_STATE = (
    *("attitude_t_s", "roll_rad", "pitch_rad", "yaw_rad", "yaw_rate_rad_s"),
    *("position_t_s", "north_m", "east_m", "down_m", "north_m_s", "east_m_s", "down_m_s", "heartbeat_t_s"),
)
_ESTIMATE = (
    *("azimuth_rad", "depression_rad", "range_m", "range_std_m", "north_m_s", "east_m_s", "seen_t_s"),
    *("range_near_m", "ground_below_m", "size_m"),
)  # fmt: skip
_SETPOINT = ("forward_m_s", "right_m_s", "down_m_s", "yaw_rate_rad_s")
_TRACK = ("x_px", "y_px", "w_px", "h_px", "psr", "apce", "confidence", "found", "refined")

COLUMNS = (
    *("tick", "t_s", "utc", "frame", "frame_t_s"),
    *(f"track_{name}" for name in _TRACK),
    *(f"vehicle_{name}" for name in _STATE),
    *("vehicle_mode", "vehicle_in_control", "vehicle_armed"),
    *(f"target_{name}" for name in _ESTIMATE),
    "target_contradiction",
    *(f"desired_{name}" for name in _SETPOINT),
    *(f"setpoint_{name}" for name in _SETPOINT),
    *("mode", "reason", "notes"),
)


@dataclass(frozen=True, slots=True)
class LoggedTick:
    """A tick with its number, its time since the flight's first tick and, if known, the true box in its image."""

    n: int
    t_s: float
    tick: Tick
    truth: Box | None = None


@dataclass(frozen=True, slots=True)
class Desired:
    """The desired stand-off and height above the target, for the curves, m; None in a mode that does not keep it."""

    standoff_m: float | None = None
    height_m: float | None = None


def held_by(notes: Iterable[str]) -> list[str]:
    """The limits that reduced the setpoint, from a round's notes: the text after `slower: ` or `less …: `."""
    return [note.split(": ", 1)[1] for note in notes if note.startswith(("slower: ", "less "))]


def header() -> str:
    """The first line."""
    return ",".join(COLUMNS) + "\n"


def row(n: int, tick: Tick, start_s: float = 0.0, started_unix_s: float | None = None) -> str:
    """One line for tick `n`; a value that does not exist is empty.

    `start_s` is the first tick's time on the link's clock, `started_unix_s` on the wall clock (None: simulated).
    """
    t_s = tick.state.t_s - start_s
    frame = (_text(tick.frame.index), _text(tick.frame.t_s - start_s)) if tick.frame else ("", "")
    cells = (
        *(_text(n), _text(t_s), "" if started_unix_s is None else utc(started_unix_s + t_s), *frame),
        *_track(tick.track, tick.frame.scale if tick.frame else 1),
        *_values(tick.state, _STATE, start_s),
        *(_word(tick.state.mode), _text(tick.state.in_control), _text(tick.state.armed)),
        *_values(tick.estimate, _ESTIMATE, start_s),
        _word(tick.estimate.contradiction),
        *_values(tick.desired, _SETPOINT),
        *(_values(tick.decision.setpoint, _SETPOINT) if tick.decision.setpoint else [""] * len(_SETPOINT)),
        *(_word(tick.decision.mode.value), _word(str(tick.decision.reason)), _word(" | ".join(tick.decision.notes))),
    )
    return ",".join(cells) + "\n"


def utc(unix_s: float) -> str:
    """The date and time, ISO 8601 with milliseconds."""
    return datetime.fromtimestamp(unix_s, timezone.utc).isoformat(timespec="milliseconds").replace("+00:00", "Z")


def _track(track: Track | None, scale: int) -> Iterable[str]:
    """The cells of a track, its box in pixels of the source."""
    if track is None:
        return [""] * len(_TRACK)
    box = track.box.zoomed(scale)
    numbers = (box.x, box.y, box.w, box.h, track.psr, track.apce, track.confidence, track.found, track.refined)
    return [_text(number) for number in numbers]


def _values(message: VehicleState | Estimate | Setpoint, names: Iterable[str], start_s: float = 0.0) -> list[str]:
    """The fields of those names; a time (`t_s` at its end) counts from `start_s`."""
    return [_text(getattr(message, name) - (start_s if name.endswith("_t_s") else 0.0)) for name in names]


def _text(value: float | bool) -> str:
    """Nine digits: times to a microsecond, but no last bits that another processor may round differently."""
    if isinstance(value, bool):
        return str(int(value))
    return f"{value:.9g}" if math.isfinite(value) else ""  # NaN: no value; infinity: never, or unknown


def _word(text: str) -> str:
    """A text cell without commas and quotes, so that it needs no CSV quoting, which not every reader supports."""
    return " ".join(text.split()).replace(",", ";").replace('"', "'")
