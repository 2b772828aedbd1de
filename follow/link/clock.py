"""Converts the vehicle's timestamps to our clock: when was this measured?"""

from collections import deque

from follow.messages import NEVER

DRIFT = 0.01  # assumed clock drift, s/s: a quartz is 200 times better, a simulator on a loaded machine 5 times worse
ANSWER_S = 10.0  # timeout of a reply: longer than any buffer on the way delays one
ROUNDING_S = 1e-6  # nanoseconds on the wire, binary fractions here
AHEAD_S = 0.1  # a timestamp further in the future than this means that the vehicle's clock was set forward
WRAP_S = 2**32 / 1e3  # `time_boot_ms` starts again at 0 after 49.7 days; TIMESYNC does not
BEHIND_S = 1.0  # a timestamp further behind the last one than this means a restart, not reordered packets


class VehicleClock:
    """Maps the vehicle's time since boot to our clock by TIMESYNC, from the exchange with the smallest error bound.

    Half the round trip bounds an exchange's error; DRIFT times its age adds to that.  A late reply counts like any
    other, so that late telemetry has at least half the round trip as its age.  Until a reply arrives, the assumed age
    is half of the time waited for it, or half of the last known round trip if that is more.  If no reply ever arrived
    within ANSWER_S, the time of arrival replaces the time of measurement: `follow doctor` is red then.
    """

    def __init__(self) -> None:
        self.offset_s: float | None = None  # vehicle's time minus ours
        self.round_trip_s = float("inf")
        self.restarts = 0  # how often the vehicle's time went back
        self._measured_t_s = NEVER
        self._newest: dict[str, float] = {}
        self._asked: deque[float] = deque()  # when requests were sent that may still be answered
        self._waiting_since_t_s: float | None = None
        self._last_round_trip_s = 0.0  # of the last exchange that was used before the clock was set
        self._answers = False

    def ask(self, t_s: float) -> None:
        """Note that a request which holds our time `t_s` is sent now."""
        while self._asked and t_s - self._asked[0] > ANSWER_S:
            self._asked.popleft()
        self._asked.append(t_s)
        if self._waiting_since_t_s is None:
            self._waiting_since_t_s = t_s

    def exchange(self, sent_t_s: float, vehicle_s: float, t_s: float) -> None:
        """Use a reply: sent by us at `sent_t_s`, the vehicle's clock then showed `vehicle_s`, it arrived at `t_s`.

        A reply to a request that is not ours, or that an earlier run of this program sent, is ignored.
        """
        ours = next((asked for asked in self._asked if abs(asked - sent_t_s) <= ROUNDING_S), None)
        if ours is None or t_s - sent_t_s < -ROUNDING_S:
            return
        self._asked.remove(ours)
        self._answers = True
        round_trip_s = max(t_s - sent_t_s, 0.0)
        if round_trip_s / 2 <= self.round_trip_s / 2 + DRIFT * (t_s - self._measured_t_s):
            self.offset_s = vehicle_s - (sent_t_s + t_s) / 2
            self.round_trip_s = round_trip_s
            self._measured_t_s = t_s

    def measured_at(self, kind: str, boot_s: float, t_s: float) -> float | None:
        """The time on our clock of a measurement with timestamp `boot_s` that arrived at `t_s`.

        None if it is not newer than the last one of its kind.
        """
        if self.offset_s is not None:
            boot_s += WRAP_S * round((t_s + self.offset_s - boot_s) / WRAP_S)
        newest = self._newest.get(kind, NEVER)
        if boot_s < newest - BEHIND_S:
            self.restarts += 1
            self._forget()
        elif boot_s <= newest:
            return None  # duplicated or reordered
        self._newest[kind] = boot_s
        if self.offset_s is None:
            return t_s - self._assumed_delay_s(t_s)
        measured = boot_s - self.offset_s
        if measured > t_s + self.round_trip_s + AHEAD_S:  # from the future: the offset is wrong now
            self._forget()
            return t_s - self._assumed_delay_s(t_s)
        return min(measured, t_s)

    def _assumed_delay_s(self, t_s: float) -> float:
        """The assumed age of telemetry that arrives at `t_s` while the vehicle's clock is unknown."""
        waited_s = 0.0 if self._waiting_since_t_s is None else max(t_s - self._waiting_since_t_s, 0.0)
        if waited_s > ANSWER_S and not self._answers:
            return 0.0
        return max(waited_s, self._last_round_trip_s) / 2

    def _forget(self) -> None:
        if self.offset_s is not None:
            self._last_round_trip_s = self.round_trip_s
        self._waiting_since_t_s = None
        self.offset_s = None
        self.round_trip_s = float("inf")
        self._measured_t_s = NEVER
        self._newest.clear()
