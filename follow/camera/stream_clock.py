"""A stream's own time stamps seen from our clock: when a frame was taken, in our time."""

from collections import deque

from follow.messages import NEVER

SETTLE_S = 1.0  # FFmpeg buffers a stream while it probes it: 1.1 s of frames were then read in 0.3 s
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
