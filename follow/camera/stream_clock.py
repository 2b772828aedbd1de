"""When a frame was taken, on our clock: from a stream's own time stamps, or from the period of its arrivals."""

from collections import deque
from typing import Protocol

import numpy as np

from follow.camera.seam import CameraError
from follow.messages import NEVER

SETTLE_S = 1.0  # FFmpeg buffers a stream while it probes it: 1.1 s of frames were then read in 0.3 s
WINDOW_S = 10.0  # a stream that stays later for this long has a longer path, and no longer counts as late
LEARN_S = 1.0  # the period of a stream without stamps is learned from the second after the first
JITTER_S = 0.05  # jitter of two arrivals from which the period is learned
MEMORY_S = 50.0  # the period is then known to 1 in 1000; a camera's crystal is off by 1 in 10,000 at most
LATE_S = 0.1  # half of the gate's limit of a frame's age: later frames are soon useless
GIVE_UP_S = 3.0  # late for this long: a new connection is quicker than waiting for the backlog to drain
SAME_S = 1.0  # lateness that stays constant over two such spans comes from lost frames: a queue grows or drains
SAME = 0.005  # ... by at least this fraction of the time, because a link is faster or slower than its stream


class StreamClock:
    """Maps a stream's own time stamps to our clock by the frame with the least delay after its stamp.

    The delay common to all frames (exposure, encoding, transport) cannot be measured here.  The extra delay of single
    frames can, such as those that pile up while a network stalls and then arrive at once.
    """

    def __init__(self) -> None:
        self._settled_t_s: float | None = None
        self._stamp_s = NEVER
        self._delays: deque[tuple[float, float]] = deque()  # arrival, and time since the stamp; both grow from left

    def taken_at(self, stamp_s: float, t_s: float) -> float | None:
        """Our time of a frame stamped `stamp_s` that arrived at `t_s`; None in the first second, which was buffered."""
        if stamp_s <= self._stamp_s:
            self._delays.clear()  # the sender's clock restarted or stopped: earlier stamps are useless
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
    """Computes when a frame was taken, from its stamp and its arrival."""

    def taken_at(self, stamp_s: float, t_s: float) -> float | None:
        """Our time of a frame stamped `stamp_s` that arrived at `t_s`; None: unknown, do not use the frame."""
        ...


class AsItComes:
    """For a source that draws each frame when it is due: nothing can queue up."""

    def taken_at(self, stamp_s: float, t_s: float) -> float | None:
        """The time of arrival."""
        return t_s


class SteadyArrivals:
    """For sources without time stamps (MJPEG over HTTP, a program's bare H.264): only the period of arrivals is known.

    A camera takes frames at a steady period; a queue on the path delivers them later, never sooner.  So a frame was
    taken at most one period after the one before it, and not after its arrival:

        taken[n] = min(arrival[n], taken[n-1] + period)

    Lateness shrinks only while frames arrive faster than the camera takes them.  `period` is the longest that the
    arrivals allow: the least, over all pairs of frames at least a second apart, of (taken[n] - taken[m] + JITTER_S) /
    (n - m).  It never grows, so that neither a backlog nor an overload is learned as the period.  The caller must pass
    every frame, also those that it drops.

    Lateness that neither grows nor shrinks is not a queue's: the camera or the path lost frames, and it is subtracted.
    Frames that stay more than LATE_S late for GIVE_UP_S raise CameraError: a new connection empties every queue, and
    learns the period again, which may have become longer.

    Law: if the path drops nothing, was empty when the period was learned, and its queues grow or drain by 1 in 50 of
    the time or more, no frame's age is understated by more than `most_understated_s`: 0.1 s for a backlog that lasts no
    longer than the stream was watched before it, or 50 s.  It is overstated by a period for each lost frame until that
    is subtracted.  A delay that all frames have from the start cannot be measured.
    """

    def __init__(self) -> None:
        self._began_t_s: float | None = None
        self._learned: list[float] = []
        self._period_s = 0.0
        self._taken_t_s = NEVER
        self._count = 0
        self._marks: deque[tuple[int, float]] = deque()  # number and time of one frame each second
        self._lateness: deque[tuple[float, float]] = deque()  # arrival and lateness of the last two SAME_S
        self._late_since_t_s: float | None = None

    def taken_at(self, stamp_s: float, t_s: float) -> float | None:
        """When the frame that arrived at `t_s` was taken; None in the first two seconds.

        Raises CameraError when the frames are too late for too long.
        """
        if self._began_t_s is None:
            self._began_t_s = t_s
        if not self._period_s:
            self._learn(t_s)
            return None
        self._step(t_s)
        self._forgive(t_s)
        self._check_late(t_s)
        return self._taken_t_s

    def _learn(self, t_s: float) -> None:
        """Collect the arrivals of the second after the first, then compute the period from those that waited least."""
        assert self._began_t_s is not None
        if t_s - self._began_t_s < SETTLE_S:
            return
        self._learned.append(t_s)
        if len(self._learned) < 2 or t_s - self._learned[0] < LEARN_S:
            return
        arrivals_s = np.array(self._learned)
        numbers = np.arange(len(arrivals_s))
        mean_s = (arrivals_s[-1] - arrivals_s[0]) / numbers[-1]
        early_s = arrivals_s - numbers * mean_s
        third = -(-len(arrivals_s) // 3)
        first, last = np.argmin(early_s[:third]), len(arrivals_s) - third + np.argmin(early_s[-third:])
        self._period_s = float((arrivals_s[last] - arrivals_s[first] + JITTER_S) / (last - first))
        self._taken_t_s = float(np.min(arrivals_s - (numbers + 1) * self._period_s))
        for arrival_t_s in self._learned:
            self._step(arrival_t_s)

    def _step(self, t_s: float) -> None:
        self._taken_t_s = min(t_s, self._taken_t_s + self._period_s)
        self._count += 1
        if not self._marks or self._taken_t_s - self._marks[-1][1] >= 1.0:
            for number, taken_t_s in self._marks:
                spanned_s = self._taken_t_s - taken_t_s + JITTER_S
                self._period_s = min(self._period_s, spanned_s / (self._count - number))
            self._marks.append((self._count, self._taken_t_s))
            while self._taken_t_s - self._marks[0][1] > MEMORY_S:
                self._marks.popleft()

    def _forgive(self, t_s: float) -> None:
        """Subtract the lateness common to the frames of the last two SAME_S, if it stayed constant."""
        self._lateness.append((t_s, t_s - self._taken_t_s))
        if t_s - self._lateness[0][0] < 2 * SAME_S:
            return
        while t_s - self._lateness[0][0] > 2 * SAME_S:
            self._lateness.popleft()
        earlier = min((late_s for when, late_s in self._lateness if t_s - when > SAME_S), default=0.0)
        later = min(late_s for when, late_s in self._lateness if t_s - when <= SAME_S)
        if min(earlier, later) > 0.0 and abs(later - earlier) < SAME * SAME_S:
            self._taken_t_s += min(earlier, later)
            self._lateness.clear()

    def _check_late(self, t_s: float) -> None:
        late_s = t_s - self._taken_t_s
        if late_s <= LATE_S:
            self._late_since_t_s = None
        elif self._late_since_t_s is None:
            self._late_since_t_s = t_s
        elif t_s - self._late_since_t_s > GIVE_UP_S:
            raise CameraError(f"its frames have come {late_s:.1f} s late for {GIVE_UP_S:g} s")


def most_understated_s(watched_s: float, backlog_s: float) -> float:
    """By how much `SteadyArrivals` may understate an age in a backlog that has lasted `backlog_s`, s.

    watched_s: how long the stream was watched before the backlog, s, since its period was learned.
    """
    known_s = max(min(watched_s, MEMORY_S), LEARN_S)
    return 2 * JITTER_S * max(backlog_s / known_s, 1.0)
