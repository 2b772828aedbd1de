"""The vehicle's clock seen from ours: when was this measured, in our time?"""

from follow.messages import NEVER

DRIFT = 0.01  # of an old exchange's age: a quartz is 200 times better, a simulation on a loaded machine up to 5 x worse
LONGEST_TRIP_S = 1.0  # an answer later than this is to a question of another life
ROUNDING_S = 1e-6  # nanoseconds on the wire, binary fractions here
AHEAD_S = 0.1  # more than any stamp is rounded by: the vehicle's clock was set forward
BEHIND_S = 1.0  # a time this far behind the last one means that the vehicle restarted, not that packets overtook


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
