"""The figures of a flight, as `summary.json` holds them, gathered tick by tick."""

from collections import Counter

import numpy as np
from typing_extensions import TypedDict

from follow.messages import Tick


class Times(TypedDict):
    """Median, 99th percentile and maximum of a duration, ms."""

    p50: float
    p99: float
    max: float


class Figures(TypedDict, total=False):
    """The fields of `summary.json`; a field is absent if it does not apply.  docs/after_a_flight.md describes each."""

    frames: int
    seconds: float
    started_utc: str
    fps_tracker: float
    tick_ms: Times
    tracker_ms: Times
    setpoints: int
    modes: dict[str, float]
    lost_s: float
    tracker: str
    autopilot: str
    scenario: str
    seed: int
    precision_20px: float
    auc: float
    precision_20px_strict: float
    auc_strict: float
    in_view: float
    centring_rms: float
    centring_x_rms: float
    standoff_rms_m: float
    standoff_rms: float
    off_target_s: float
    decoy_s: float
    reacquired: bool
    worst_t_s: float
    worst_offset: float
    nearest_m: float
    nearest_other_m: float
    violations: dict[str, int]
    recording_dropped: int
    rows_lost: int
    packets_lost: int
    refly_differs: int


class Summary:
    """Accumulates the figures tick by tick; `figures` may be read at any time."""

    def __init__(self) -> None:
        self._frames = 0
        self._setpoints = 0
        self._tick_ms: list[float] = []
        self._tracker_ms: list[float] = []
        self._modes: Counter[str] = Counter()
        self._lost_s = 0.0
        self._first: Tick | None = None
        self._last: Tick | None = None
        self._found = True

    def add(self, tick: Tick) -> None:
        """Add one round.  The time up to it counts for the mode, and the track, of the round before."""
        if self._last is None:
            self._first = tick
        else:
            spent = tick.state.t_s - self._last.state.t_s
            self._modes[self._last.decision.mode.value] += spent  # pyright: ignore[reportArgumentType] - seconds, not a count
            self._lost_s += 0.0 if self._found else spent
        self._last = tick
        self._setpoints += tick.decision.setpoint is not None
        self._tick_ms.append(sum(tick.stage_ms.values()))
        if tick.track is not None:
            self._frames += 1
            self._found = tick.track.found
            if "tracker" in tick.stage_ms:
                self._tracker_ms.append(tick.stage_ms["tracker"])

    @property
    def seconds(self) -> float:
        """From the first round to the last, on the link's clock."""
        return 0.0 if self._first is None or self._last is None else self._last.state.t_s - self._first.state.t_s

    def figures(self) -> Figures:
        """The figures so far."""
        if self._last is not None:
            self._modes[self._last.decision.mode.value] += 0
        figures: Figures = {"frames": self._frames, "seconds": round(self.seconds, 6)}
        spent_ms = sum(self._tracker_ms)
        if spent_ms > 0:
            figures["fps_tracker"] = round(1e3 * len(self._tracker_ms) / spent_ms, 2)
        if self._tick_ms:
            figures["tick_ms"] = times(self._tick_ms)
        if self._tracker_ms:
            figures["tracker_ms"] = times(self._tracker_ms)
        figures["setpoints"] = self._setpoints
        figures["modes"] = {mode: round(seconds, 6) for mode, seconds in sorted(self._modes.items())}
        figures["lost_s"] = round(self._lost_s, 6)
        return figures


def times(spent_ms: list[float]) -> Times:
    """The percentiles of some durations, ms."""
    p50, p99 = np.percentile(spent_ms, (50, 99))
    return {"p50": round(float(p50), 3), "p99": round(float(p99), 3), "max": round(max(spent_ms), 3)}
