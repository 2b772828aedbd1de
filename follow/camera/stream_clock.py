"""A stream's own time stamps seen from our clock: when a frame was taken, in our time."""

import statistics
from collections import deque
from typing import Protocol

from follow.messages import NEVER

SETTLE_S = 1.0  # FFmpeg buffers a stream while it probes it: 1.1 s of frames were then read in 0.3 s
RELEARN_S = 2.0  # a rhythm that stays another for this long is a new one: a second to notice it, one to learn it
SHORT, LONG = 0.5, 2.5  # usual intervals: a jitter of half of one passes, a single lost frame also
WINDOW_S = 10.0  # a stream later than before for this long has a longer path: no longer late


class StreamClock:
    """Maps a stream's own time stamps to ours by the frame that came soonest after its stamp.

    What every frame needs (exposure, encoding, the way) cannot be told from here; what one came later than the others
    can, as those that pile up while a network stalls and then come at once.
    """

    def __init__(self) -> None:
        self._settled_t_s: float | None = None
        self._stamp_s = NEVER
        self._delays: deque[tuple[float, float]] = deque()  # arrival, and time since the stamp; both grow from left

    def taken_at(self, stamp_s: float, t_s: float) -> float | None:
        """Our time of a frame stamped `stamp_s` that came at `t_s`; None for the first second's, which waited."""
        if stamp_s <= self._stamp_s:
            self._delays.clear()  # the sender's clock restarted or stopped: earlier stamps say nothing
        self._stamp_s = stamp_s
        delay_s = t_s - stamp_s
        while self._delays and self._delays[-1][1] >= delay_s:
            self._delays.pop()
        self._delays.append((t_s, delay_s))
        while self._delays[0][0] < t_s - WINDOW_S:
            self._delays.popleft()
        if self._settled_t_s is None:
            self._settled_t_s = t_s + SETTLE_S
        return t_s - (delay_s - self._delays[0][1]) if t_s >= self._settled_t_s else None


class FrameClock(Protocol):
    """Tells when a frame was taken from its stamp and its arrival."""

    def taken_at(self, stamp_s: float, t_s: float) -> float | None:
        """Our time of a frame stamped `stamp_s` that came at `t_s`; None: it cannot be told, do not use it."""
        ...


class SteadyArrivals:
    """For sources without stamps of their own (MJPEG over HTTP, a program's bare H.264): only the rhythm can tell.

    After a hole of more than `LONG` usual intervals comes what piled up meanwhile, oldest first, and each frame of a
    backlog comes sooner than `SHORT` after the one before: neither is used.  Any other frame counts as taken when it
    came.  The usual interval is the median of those that were used; the first is the mean of the first second.
    """

    def __init__(self) -> None:
        self._began_t_s: float | None = None
        self._count = 0
        self._arrived_t_s = NEVER
        self._odd_since_t_s: float | None = None
        self._intervals_s: deque[float] = deque(maxlen=31)  # a second at 30 frames/s

    def taken_at(self, stamp_s: float, t_s: float) -> float | None:
        """The arrival itself, or None for a frame that may have waited on the way."""
        if self._began_t_s is None:
            self._began_t_s = t_s
        interval_s, self._arrived_t_s = t_s - self._arrived_t_s, t_s
        self._count += 1
        since_s = t_s - self._began_t_s
        if since_s < SETTLE_S:
            return None
        if not self._intervals_s:
            self._intervals_s.append(since_s / max(self._count - 1, 1))
        usual_s = statistics.median(self._intervals_s)
        if SHORT * usual_s <= interval_s <= LONG * usual_s:
            self._intervals_s.append(interval_s)
            self._odd_since_t_s = None
            return t_s
        if self._odd_since_t_s is None:
            self._odd_since_t_s = t_s
        elif t_s - self._odd_since_t_s > RELEARN_S:
            self._began_t_s, self._count = t_s, 1
            self._intervals_s.clear()
        return None
