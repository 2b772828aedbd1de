"""Who sends on the link: the vehicle's address, and whether a second sender uses its id.

Without signing nothing authenticates a sender.  Two checks remain: the vehicle keeps one address, and two senders of
one id show in their sequence numbers and in their times since boot.
"""

from collections import deque
from dataclasses import dataclass, field

from follow.messages import NEVER

Source = tuple[str, int] | None
"""A datagram's address; None on a line with only two ends."""

PEER_LOST_S = 10.0  # a vehicle silent for this long may have a new address: longer than the timeout of any failsafe
NEW_PEER_S = 2.0  # a new address must have sent for this long, and NEW_PEER_DATAGRAMS
NEW_PEER_DATAGRAMS = 10
MOST_STRANGERS = 64  # addresses that are remembered: a forger may use a new one for each datagram
BACKWARD = range(128, 236)  # a sequence number 21 to 128 behind the last: beyond reordering, and not a gap by loss
STRANGE_PACKETS = 3  # in CONTESTED_S: an outage of more than 128 packets, or a restart, causes fewer
CONTESTED_S = 5.0


@dataclass(slots=True)
class PeerAddress:
    """The vehicle's address: the first one, until it has been silent for PEER_LOST_S or a signed packet moves it.

    `strangers` holds the other addresses that claimed to be the vehicle, with the time of the last datagram of each:
    the MOST_STRANGERS latest ones.  `stranger_t_s` is when the last of them sent.
    """

    address: Source = None
    heard_t_s: float = NEVER
    strangers: dict[Source, float] = field(default_factory=dict)
    stranger_t_s: float = NEVER
    _since_t_s: float = NEVER
    _count: int = 0

    def admits(self, source: Source, t_s: float, *, signed: bool) -> bool:
        """Whether to accept the vehicle's packets from this address; `signed`: they have the right signature."""
        if source is None:
            return True
        if self.address is None or source == self.address or signed:
            self.address, self.heard_t_s, self._count = source, t_s, 0
            return True
        if self.strangers.get(source, NEVER) < t_s - CONTESTED_S or not self._count:
            self._since_t_s, self._count = t_s, 0
        self.strangers.pop(source, None)  # move it to the end: the first entry has been silent for longest
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
    """Detects two senders with one id: their sequence numbers or times since boot go back and forth."""

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
