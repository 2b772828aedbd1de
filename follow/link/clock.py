"""The vehicle's clock seen from ours: when was this measured, in our time?"""

from follow.messages import NEVER

DRIFT = (
    0.01  # assumed clock drift, s/s: a quartz is 200 times better, a simulator on a loaded machine up to 5 times worse
)
LONGEST_TRIP_S = 1.0  # drop replies older than this: they predate a restart
ROUNDING_S = 1e-6  # nanoseconds on the wire, binary fractions here
AHEAD_S = 0.1  # a timestamp further in the future than this means that the vehicle's clock was set forward
WRAP_S = 2**32 / 1e3  # `time_boot_ms` starts again at 0 after 49.7 days; TIMESYNC does not
BEHIND_S = 1.0  # a timestamp further behind the last one than this means a restart, not reordered packets


class VehicleClock:
    """Maps the vehicle's time since boot to our clock by TIMESYNC, from the exchange with the smallest error bound.

    Half the round trip bounds an exchange's error; DRIFT times its age adds to that.  Until an exchange succeeds, the
    time of arrival stands for the time of measurement.
    """

    def __init__(self) -> None:
        self.offset_s: float | None = None  # vehicle's time minus ours
        self.round_trip_s = float("inf")
        self.restarts = 0  # how often the vehicle's time went back
        self._measured_t_s = NEVER
        self._newest: dict[str, float] = {}

    def exchange(self, sent_t_s: float, vehicle_s: float, t_s: float) -> None:
        """Use a reply: sent by us at `sent_t_s`, the vehicle's clock then showed `vehicle_s`, it arrived at `t_s`."""
        if not -ROUNDING_S <= t_s - sent_t_s < LONGEST_TRIP_S:
            return
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
            return t_s
        measured = boot_s - self.offset_s
        if measured > t_s + self.round_trip_s + AHEAD_S:  # from the future: the offset is wrong now
            self._forget()
            return t_s
        return min(measured, t_s)

    def _forget(self) -> None:
        self.offset_s = None
        self.round_trip_s = float("inf")
        self._measured_t_s = NEVER
        self._newest.clear()
