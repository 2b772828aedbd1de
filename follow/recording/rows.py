"""`ticks.csv`: a row a tick, units in the column names, the same bytes for the same flight.

Only what flowed through the loop is here; wall-clock times differ from run to run and are in the recording.
"""

import math
from collections.abc import Iterable

from follow.messages import Estimate, Setpoint, Tick, VehicleState
from racf.track import Track

_STATE = (
    *("attitude_t_s", "roll_rad", "pitch_rad", "yaw_rad", "yaw_rate_rad_s"),
    *("position_t_s", "north_m", "east_m", "down_m", "north_m_s", "east_m_s", "down_m_s", "heartbeat_t_s"),
)
_ESTIMATE = (
    *("azimuth_rad", "depression_rad", "range_m", "range_std_m", "north_m_s", "east_m_s", "seen_t_s"),
)  # fmt: skip
_SETPOINT = ("forward_m_s", "right_m_s", "down_m_s", "yaw_rate_rad_s")
_TRACK = ("x_px", "y_px", "w_px", "h_px", "psr", "apce", "confidence", "found", "refined")

COLUMNS = (
    *("tick", "t_s", "frame", "frame_t_s"),
    *(f"track_{name}" for name in _TRACK),
    *(f"vehicle_{name}" for name in _STATE),
    *("vehicle_mode", "vehicle_in_control", "vehicle_armed"),
    *(f"target_{name}" for name in _ESTIMATE),
    *(f"desired_{name}" for name in _SETPOINT),
    *(f"setpoint_{name}" for name in _SETPOINT),
    *("mode", "notes"),
)


def header() -> str:
    """The first line."""
    return ",".join(COLUMNS) + "\n"


def row(n: int, tick: Tick) -> str:
    """One line for tick `n`; a value that is not there is empty."""
    frame = (_text(tick.frame.index), _text(tick.frame.t_s)) if tick.frame else ("", "")
    fields = (
        *(_text(n), _text(tick.state.t_s), *frame),
        *_track(tick.track),
        *_values(tick.state, _STATE),
        *(_word(tick.state.mode), _text(tick.state.in_control), _text(tick.state.armed)),
        *_values(tick.estimate, _ESTIMATE),
        *_values(tick.desired, _SETPOINT),
        *(_values(tick.decision.setpoint, _SETPOINT) if tick.decision.setpoint else [""] * len(_SETPOINT)),
        *(_word(tick.decision.mode), _word("; ".join(tick.decision.notes))),
    )
    return ",".join(fields) + "\n"


def _track(track: Track | None) -> Iterable[str]:
    if track is None:
        return [""] * len(_TRACK)
    box = track.box
    numbers = (box.x, box.y, box.w, box.h, track.psr, track.apce, track.confidence, track.found, track.refined)
    return [_text(number) for number in numbers]


def _values(message: VehicleState | Estimate | Setpoint, names: Iterable[str]) -> list[str]:
    return [_text(getattr(message, name)) for name in names]


def _text(value: float | bool) -> str:
    """Nine digits: times to a microsecond, and nothing of a last bit that another processor rounds otherwise."""
    if isinstance(value, bool):
        return str(int(value))
    return "" if value == -math.inf else f"{value:.9g}"


def _word(text: str) -> str:
    """A field that may hold commas, quoted as spreadsheets read it (RFC 4180)."""
    clean = " ".join(text.split())
    return '"' + clean.replace('"', '""') + '"' if any(c in clean for c in ',"') else clean
