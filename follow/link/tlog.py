"""flight.tlog: every packet with its time, in the format of MAVProxy, Mission Planner and pymavlink.

A record is the time in microseconds since 1970 (8 bytes, big-endian) followed by the packet as it was on the wire.
"""

import logging
import struct
from pathlib import Path

from follow.disk import CLOSE_S, BackgroundFile
from follow.messages import Notify

log = logging.getLogger(__name__)


class Tlog:
    """Appends packets to a file, in a thread of its own.  A full or stalled disk costs packets of the log only."""

    def __init__(self, path: Path, report: Notify = log.warning):
        self.path = path
        self._file = BackgroundFile(path, report)

    @property
    def lost(self) -> int:
        """Number of packets that are not in the file."""
        return self._file.lost

    def write(self, packet: bytes, unix_s: float) -> None:
        """Append one packet with the time `unix_s`; never waits for the disk."""
        self._file.write(struct.pack(">Q", round(unix_s * 1e6)) + packet)

    def close(self, timeout_s: float = CLOSE_S) -> None:
        """Write what is waiting and close the file."""
        self._file.close(timeout_s)
