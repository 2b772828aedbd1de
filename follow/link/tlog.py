"""flight.tlog: every packet with its time, in the format of MAVProxy, Mission Planner and pymavlink.

A record is the time in microseconds since 1970 (8 bytes, big-endian) followed by the packet as it was on the wire.
"""

import logging
import struct
from pathlib import Path

log = logging.getLogger(__name__)


class Tlog:
    """Appends packets to a file.  A full disk ends the log, not the flight."""

    def __init__(self, path: Path):
        self.path = path
        self._file = path.open("wb")
        self._ended = False

    def write(self, packet: bytes, unix_s: float) -> None:
        """Append one packet with the time `unix_s`."""
        if self._ended:
            return
        try:
            self._file.write(struct.pack(">Q", round(unix_s * 1e6)) + packet)
        except OSError as error:
            self._end(error)

    def close(self) -> None:
        """Flush and close the file."""
        try:
            self._file.close()
        except OSError as error:
            self._end(error)

    def _end(self, error: OSError) -> None:
        self._ended = True
        log.warning("%s ends here: %s", self.path, error)
