"""The queue between the reading thread and the loop: bounded, so that a flood fills no memory and delays no round.

The vehicle's address has priority.  Every other address has a short queue, and they take turns, so that the first
packet of the true vehicle, or its first from a new address, is read although somebody floods the port.  Full queues
drop their oldest packets.
"""

import threading
from collections import deque

from follow.link.identity import Source
from follow.messages import NEVER

Arrival = tuple[float, bytes, Source]
"""When it arrived, the bytes, from whom."""

VEHICLE_BYTES = 1 << 17  # queue of the vehicle: more than a serial line at 921600 baud delivers in a second
ADDRESSES = 64  # other than the vehicle's
ADDRESS_DATAGRAMS = 32  # of each
FLOOD = 500  # more dropped packets than this in FLOOD_EVERY_S are a flood
FLOOD_EVERY_S = 10.0


class Arrivals:
    """One thread puts arrivals in, another takes them.  `dropped` counts those that were never taken."""

    def __init__(self) -> None:
        self.dropped = 0
        self._peer: Source = None
        self._lock = threading.Lock()
        self._vehicles: deque[Arrival] = deque()
        self._bytes = 0
        self._others: dict[Source, deque[Arrival]] = {}
        self._looked = (NEVER, 0)  # when `dropped` was looked at, and what it was
        self._told_t_s = NEVER

    def put(self, arrival: Arrival) -> None:
        """Queue an arrival; a full queue drops its oldest."""
        with self._lock:
            if arrival[2] == self._peer:
                self._vehicles.append(arrival)
                self._bytes += len(arrival[1])
                while self._bytes > VEHICLE_BYTES and len(self._vehicles) > 1:
                    self._bytes -= len(self._vehicles.popleft()[1])
                    self.dropped += 1
                return
            if arrival[2] not in self._others and len(self._others) == ADDRESSES:
                self.dropped += len(self._others.pop(next(iter(self._others))))
            waiting = self._others.setdefault(arrival[2], deque(maxlen=ADDRESS_DATAGRAMS))
            self.dropped += len(waiting) == ADDRESS_DATAGRAMS
            waiting.append(arrival)

    def set_peer(self, peer: Source) -> None:
        """Set the vehicle's address; what is queued from it keeps its order."""
        if peer == self._peer:
            return
        with self._lock:
            self._peer = peer
            waiting = self._others.pop(peer, ())
            self._vehicles.extend(waiting)
            self._bytes += sum(len(data) for _, data, _ in waiting)

    def take_vehicles(self) -> Arrival | None:
        """The oldest arrival from the vehicle's address."""
        with self._lock:
            if not self._vehicles:
                return None
            arrival = self._vehicles.popleft()
            self._bytes -= len(arrival[1])
            return arrival

    def take_others(self) -> Arrival | None:
        """The oldest arrival from the next of the other addresses."""
        with self._lock:
            if not self._others:
                return None
            source = next(iter(self._others))
            waiting = self._others.pop(source)
            arrival = waiting.popleft()
            if waiting:
                self._others[source] = waiting  # at the end: the others come first now
            return arrival

    def flood(self, t_s: float) -> int:
        """The number of recently dropped packets if that is a flood and a warning is due; else 0."""
        looked_t_s, before = self._looked
        lost = self.dropped - before
        is_told = lost >= FLOOD and t_s - self._told_t_s > FLOOD_EVERY_S
        if is_told:
            self._told_t_s = t_s
        if is_told or t_s - looked_t_s > FLOOD_EVERY_S:
            self._looked = t_s, self.dropped
        return lost if is_told else 0
