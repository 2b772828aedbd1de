"""Other clocks seen from ours: when was this measured, or this picture taken, in our time?"""

from collections import deque

from follow.messages import NEVER

DRIFT = 0.01  # of an old exchange's age: a quartz is 200 times better, a simulation on a loaded machine up to 5 x worse
LONGEST_TRIP_S = 1.0  # an answer later than this is to a question of another life
ROUNDING_S = 1e-6  # nanoseconds on the wire, binary fractions here
AHEAD_S = 0.1  # more than any stamp is rounded by: the vehicle's clock was set forward
BEHIND_S = 1.0  # a time this far behind the last one means that the vehicle restarted, not that packets overtook
SETTLE_S = 1.0  # FFmpeg keeps what comes while it studies a stream and gives it first: 1.1 s of it were read in 0.3 s
WINDOW_S = 10.0  # a stream that is later than it was for this long is late no more: its way has become longer


class VehicleClock:
    """Maps the vehicle's time since boot to ours by TIMESYNC, keeping the exchange that knows it best.

    Half a round trip bounds an exchange's error; with its age the clocks drift apart.  Until an exchange succeeds, a
    message counts as measured when it arrived.
    """

    def __init__(self) -> None:
        self.offset_s: float | None = None  # vehicle's time minus ours
        self.round_trip_s = float("inf")
        self._measured_t_s = NEVER
        self._newest: dict[str, float] = {}

    def exchange(self, sent_t_s: float, vehicle_s: float, t_s: float) -> None:
        """Take in an answer: we sent at `sent_t_s`, the vehicle's clock read `vehicle_s`, it arrived at `t_s`."""
        if not -ROUNDING_S <= t_s - sent_t_s < LONGEST_TRIP_S:
            return
        round_trip_s = max(t_s - sent_t_s, 0.0)
        if round_trip_s / 2 <= self.round_trip_s / 2 + DRIFT * (t_s - self._measured_t_s):
            self.offset_s = vehicle_s - (sent_t_s + t_s) / 2
            self.round_trip_s = round_trip_s
            self._measured_t_s = t_s

    def measured_at(self, kind: str, boot_s: float, t_s: float) -> float | None:
        """Our time of a measurement stamped `boot_s` that arrived at `t_s`; None for one that is not newer."""
        newest = self._newest.get(kind, NEVER)
        if boot_s < newest - BEHIND_S:
            self._forget()  # the vehicle restarted
        elif boot_s <= newest:
            return None  # a duplicate, or overtaken on the way
        self._newest[kind] = boot_s
        if self.offset_s is None:
            return t_s
        measured = boot_s - self.offset_s
        if measured > t_s + self.round_trip_s + AHEAD_S:  # from the future: the offset is no longer true
            self._forget()
            return t_s
        return min(measured, t_s)

    def _forget(self) -> None:
        self.offset_s = None
        self.round_trip_s = float("inf")
        self._measured_t_s = NEVER
        self._newest.clear()


class StreamClock:
    """Maps a stream's own time stamps to ours by the picture that came soonest after its stamp.

    What every picture needs (exposure, encoding, the way) cannot be told from here; what one came later than the others
    can, as those that pile up while a network stalls and then come at once.
    """

    def __init__(self) -> None:
        self._settled_t_s: float | None = None
        self._stamp_s = NEVER
        self._delays: deque[tuple[float, float]] = deque()  # arrival, and time since the stamp; both grow from left

    def taken_at(self, stamp_s: float, t_s: float) -> float | None:
        """Our time of a picture stamped `stamp_s` that came at `t_s`; None for the first second's, which waited."""
        if stamp_s <= self._stamp_s:
            self._delays.clear()  # its clock began anew, or stands still: then there is none
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
