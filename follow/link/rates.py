"""Which messages we request from the autopilot, and how often."""

from collections import Counter
from dataclasses import dataclass, field

from pymavlink.dialects.v20 import common as dialect

from follow.messages import NEVER, Autopilot

CHECK_EVERY_S = 2.0  # long enough to count a few messages of the slowest required stream
OPTIONAL_TIMES = 3  # a stream that not every autopilot has is requested this often ...
OPTIONAL_AGAIN_S = 60.0  # ... and then again after this: the autopilot may have restarted

REQUIRED: dict[str, float] = {
    "ATTITUDE": 50.0,  # above the frame rate, so that the attitude of a frame is never 20 ms old
    "LOCAL_POSITION_NED": 25.0,  # 0.2 m at 5 m/s between two of them
    "EXTENDED_SYS_STATE": 2.0,
    "SYS_STATUS": 1.0,
    "RC_CHANNELS": 5.0,  # 0.2 s is fast enough for a switch moved by hand
}
"""Message -> Hz."""

OPTIONAL: dict[Autopilot, dict[str, float]] = {
    Autopilot.PX4: {
        "HOME_POSITION": 0.5,
        "GLOBAL_POSITION_INT": 5.0,
        "BATTERY_STATUS": 1.0,
        "ODOMETRY": 2.0,  # for its reset counter
        "DISTANCE_SENSOR": 5.0,
        "ALTITUDE": 2.0,  # for its height above the ground
    },
    Autopilot.ARDUPILOT: {
        "HOME_POSITION": 0.5,
        "GPS_GLOBAL_ORIGIN": 0.5,
        "GLOBAL_POSITION_INT": 5.0,
        "BATTERY_STATUS": 1.0,
        "DISTANCE_SENSOR": 5.0,
        "TERRAIN_REPORT": 1.0,
    },
}
"""Message -> Hz, for messages that an autopilot may lack: a vehicle needs no rangefinder or battery monitor."""


def number_of(name: str) -> int:
    """The message id of a message name."""
    return int(getattr(dialect, f"MAVLINK_MSG_ID_{name}"))


@dataclass(slots=True)
class StreamRates:
    """Requests each stream that delivered less than half of its rate since the last check.

    So a restarted autopilot, which has forgotten the rates, gets the requests again.
    """

    _looked_t_s: float = NEVER
    _counted: dict[str, int] = field(default_factory=dict[str, int])
    _asked: dict[str, tuple[int, float]] = field(default_factory=dict[str, tuple[int, float]])  # times, last time

    def missing(self, counts: Counter[str], autopilot: Autopilot, t_s: float) -> list[tuple[int, float]]:
        """(message id, Hz) of the streams to request now; `counts` holds the messages received so far."""
        if t_s - self._looked_t_s < CHECK_EVERY_S:
            return []
        self._looked_t_s = t_s
        out: list[tuple[int, float]] = []
        for name, rate_hz in (REQUIRED | OPTIONAL[autopilot]).items():
            came = counts[name] - self._counted.get(name, 0)
            self._counted[name] = counts[name]
            if came < 0.5 * rate_hz * CHECK_EVERY_S and (name in REQUIRED or self._may_ask(name, t_s)):
                out.append((number_of(name), rate_hz))
        return out

    def _may_ask(self, name: str, t_s: float) -> bool:
        times, last_t_s = self._asked.get(name, (0, NEVER))
        if times >= OPTIONAL_TIMES and t_s - last_t_s < OPTIONAL_AGAIN_S:
            return False
        self._asked[name] = times % OPTIONAL_TIMES + 1, t_s
        return True
