"""Who is on the line: the address that speaks for the vehicle, and whether a second sender uses its id.

Without signing nothing proves a sender.  What can be checked is checked: one address is kept for the vehicle, and two
senders of one id give themselves away by their sequence numbers and by their times since boot.
"""

from collections import deque
from dataclasses import dataclass, field

from follow.messages import NEVER

Source = tuple[str, int] | None
"""A datagram's address; None on a line with only two ends."""

PEER_LOST_S = 10.0  # a vehicle silent for this long may have a new address: longer than any failsafe waits
NEW_PEER_S = 2.0  # ... and the new address must have spoken for this long
NEW_PEER_DATAGRAMS = 10
MOST_STRANGERS = 64  # addresses that are remembered: a forger may use a new one for each datagram
BACKWARD = range(128, 236)  # a sequence number 21 to 128 behind the last: more than reordering does, less than a loss
STRANGE_PACKETS = 3  # in CONTESTED_S: fewer happen after an outage of more than 128 packets, or a restart
CONTESTED_S = 5.0


@dataclass(slots=True)
class PeerAddress:
    """The address that speaks for the vehicle.  The first one is kept; an unsigned datagram never moves it.

    `strangers` holds the other addresses that claimed to be the vehicle, with the time of the last datagram of each:
    the MOST_STRANGERS latest ones.  `stranger_t_s` is when the last of them spoke.
    """

    address: Source = None
    heard_t_s: float = NEVER
    strangers: dict[Source, float] = field(default_factory=dict)
    stranger_t_s: float = NEVER
    _since_t_s: float = NEVER
    _count: int = 0

    def admits(self, source: Source, t_s: float, *, signed: bool) -> bool:
        """Whether packets of the vehicle from this address are believed; `signed`: they bear the right signature."""
        if source is None:
            return True
        if self.address is None or source == self.address or signed:
            self.address, self.heard_t_s, self._count = source, t_s, 0
            return True
        if self.strangers.get(source, NEVER) < t_s - CONTESTED_S or not self._count:
            self._since_t_s, self._count = t_s, 0
        self.strangers.pop(source, None)  # to the end: the first one is the one that has been silent for longest
        self.strangers[source] = self.stranger_t_s = t_s
        if len(self.strangers) > MOST_STRANGERS:
            del self.strangers[next(iter(self.strangers))]
        self._count += 1
        silent = t_s - self.heard_t_s > PEER_LOST_S
        if silent and self._count >= NEW_PEER_DATAGRAMS and t_s - max(self._since_t_s, self.heard_t_s) >= NEW_PEER_S:
            self.address, self.heard_t_s, self._count = source, t_s, 0
            del self.strangers[source]
            self.stranger_t_s = max(self.strangers.values(), default=NEVER)
            return True
        return False


@dataclass(slots=True)
class SenderWatch:
    """Whether packets of one id come from two senders: sequence numbers or times since boot that go back and forth."""

    contested_t_s: float = NEVER
    _sequence: int | None = None
    _restarts: int = 0
    _strange: deque[float] = field(default_factory=lambda: deque[float](maxlen=STRANGE_PACKETS))

    def hear(self, sequence: int, t_s: float, restarts: int) -> None:
        """Use a packet's sequence number (0..255) and how often the vehicle's clock has gone back so far."""
        gap = 0 if self._sequence is None else (sequence - self._sequence) & 0xFF
        if gap in BACKWARD or restarts > self._restarts:
            self._strange.append(t_s)
            if len(self._strange) == STRANGE_PACKETS and t_s - self._strange[0] <= CONTESTED_S:
                self.contested_t_s = t_s
        self._sequence, self._restarts = sequence, restarts

    def is_contested(self, t_s: float) -> bool:
        """Whether a second sender was noticed within the last seconds."""
        return t_s - self.contested_t_s <= CONTESTED_S
