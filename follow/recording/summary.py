"""What a flight comes to: the figures of `summary.json`, gathered tick by tick."""

from collections import Counter
from typing import Any

import numpy as np

from follow.messages import Tick

Figures = dict[str, Any]
"""Names and values as `summary.json` holds them; a name is absent where it does not apply."""


class Summary:
    """Counts while the ticks pass; `figures` may be read at any time."""

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
        """Take in one round.  The time up to it counts for the mode, and the track, of the round before."""
        if self._last is None:
            self._first = tick
        else:
            spent = tick.state.t_s - self._last.state.t_s
            self._modes[self._last.decision.mode.value] += spent  # pyright: ignore[reportArgumentType] - seconds count too
            self._lost_s += 0.0 if self._found else spent
        self._last = tick
        self._setpoints += tick.decision.setpoint is not None
        self._tick_ms.append(sum(tick.stage_ms.values()))
        if tick.track is not None:
            self._frames += 1
            self._found = tick.track.found
            self._tracker_ms.append(tick.stage_ms.get("tracker", 0.0))

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
        for name, times in (("tick_ms", self._tick_ms), ("tracker_ms", self._tracker_ms)):
            if times:
                p50, p99 = np.percentile(times, (50, 99))
                figures[name] = {"p50": round(float(p50), 3), "p99": round(float(p99), 3), "max": round(max(times), 3)}
        figures["setpoints"] = self._setpoints
        figures["modes"] = {mode: round(seconds, 6) for mode, seconds in sorted(self._modes.items())}
        figures["lost_s"] = round(self._lost_s, 6)
        return figures
