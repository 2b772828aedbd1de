"""The age of the bytes in a connection's send buffer: no old setpoint may reach an autopilot.

Linux gives the number of bytes in the buffer, for a TCP socket (SIOCOUTQ, which counts what the peer has not
acknowledged) and for a serial line (TIOCOUTQ); both are one request with two names.  Other systems know it for serial
lines only.
"""

import fcntl
import struct
import termios
from collections import deque

UNSENT_S = 0.35  # older bytes are discarded: setpoints are sent 20 times a second or more


def unsent_bytes(file: int) -> int:
    """The number of bytes in the send buffer of a socket or serial line; 0 if the system does not know it."""
    try:
        (count,) = struct.unpack("i", fcntl.ioctl(file, termios.TIOCOUTQ, bytes(4)))
    except OSError:
        return 0
    return int(count)


class SendQueue:
    """When the bytes in the send buffer were written, for the age of the oldest of them."""

    def __init__(self) -> None:
        self._written = 0
        self._writes: deque[tuple[float, int]] = deque()  # when, and how many bytes had been written in all by then

    def wrote(self, count: int, t_s: float) -> None:
        """Note that `count` bytes were accepted at `t_s`."""
        self._written += count
        self._writes.append((t_s, self._written))

    def age_s(self, waiting: int, t_s: float) -> float:
        """The age of the oldest of the last `waiting` bytes, 0 if the buffer is empty."""
        while self._writes and self._writes[0][1] <= self._written - waiting:
            self._writes.popleft()
        return t_s - self._writes[0][0] if self._writes else 0.0

    def clear(self) -> None:
        """Note that the buffer was emptied."""
        self._writes.clear()
