"""MAVLink 2 signing: the key file, and a timestamp that never decreases.

A signed packet carries a 48-bit timestamp (units of 10 us since 2015) and a signature made with a shared key of 32
bytes (https://mavlink.io/en/guide/message_signing.html).  A receiver refuses a timestamp that is not later than the
last one, so the timestamp must survive a restart and a clock that was set back.
"""

import logging
import stat
import time
from pathlib import Path

from pymavlink.dialects.v20 import common as dialect

from follow.disk import BackgroundTask, replace_file

log = logging.getLogger(__name__)

KEY_BYTES = 32
EPOCH_S = 1_420_070_400  # 2015-01-01 00:00 UTC in Unix time
UNITS_PER_S = 100_000  # of 10 us
# The stored timestamp is ahead of the clock by up to SAVE_AHEAD, or of the last packet by SAVE_PACKETS units, so that
# no timestamp repeats after a crash.  A vehicle rejects packets more than a minute off as a replay.  The timestamp is
# stored again when half of the margin is used up: the disk may stall for the other half.
SAVE_AHEAD = 20 * UNITS_PER_S
SAVE_PACKETS = 20_000


class Signing:
    """A key and its clock.  `path` holds 32 bytes, raw or as 64 hexadecimal digits, readable by its owner only.

    The last timestamp is stored in `<path>.time`.  Raises ValueError for a file that others may read or that holds no
    key, OSError if the timestamp cannot be stored.
    """

    def __init__(self, path: Path):
        self.key = read_key(path)
        self._time_path = path.with_name(path.name + ".time")
        self._floor = _read_time(self._time_path)
        self._saved = self._to_save = self._floor
        self._saver = BackgroundTask(self._save, "signing time")
        _write_time(self._time_path, self._floor)

    def install(self, mav: dialect.MAVLink) -> None:
        """Make `mav` sign its packets and refuse packets that are not signed with the same key."""
        mav.signing.secret_key = self.key
        mav.signing.sign_outgoing = True
        # Without a callback pymavlink does not count refused packets.
        mav.signing.allow_unsigned_callback = lambda _mav, _id: False
        self._stamp(mav)
        self._save()  # before the first packet; from now on in a thread

    def stamp(self, mav: dialect.MAVLink) -> None:
        """Move the next packet's timestamp forward to now, never back; a thread stores one that lies ahead of it."""
        now, timestamp = self._stamp(mav)
        if max(now + SAVE_AHEAD // 2, timestamp + SAVE_PACKETS // 2) >= self._saved:
            self._saver.start()

    def _stamp(self, mav: dialect.MAVLink) -> tuple[int, int]:
        """Now, and the next packet's timestamp."""
        now = int((time.time() - EPOCH_S) * UNITS_PER_S)
        mav.signing.timestamp = max(mav.signing.timestamp, now, self._floor)
        self._to_save = max(now + SAVE_AHEAD, mav.signing.timestamp + SAVE_PACKETS)
        return now, mav.signing.timestamp

    def _save(self) -> None:
        value = self._to_save
        try:
            _write_time(self._time_path, value)
        except OSError as error:  # a full disk must not end a flight
            log.warning("the signing timestamp cannot be stored in %s: %s", self._time_path, error)
        self._saved = value


def read_key(path: Path) -> bytes:
    """The 32 bytes in `path`.  Raises ValueError if others may read the file or it holds no key, FileNotFoundError."""
    if not path.exists():
        raise FileNotFoundError(f"there is no signing key {path}: head -c 32 /dev/urandom > {path}; chmod 600 {path}")
    mode = stat.S_IMODE(path.stat().st_mode)
    if mode & 0o077:
        raise ValueError(
            f"the signing key {path} must be readable by its owner only; its mode is {mode:03o}: chmod 600 it"
        )
    content = path.read_bytes()
    if len(content) == KEY_BYTES:
        return content
    try:
        key = bytes.fromhex(content.decode("ascii").strip())
    except ValueError:
        key = b""
    if len(key) != KEY_BYTES:
        raise ValueError(
            f"the signing key {path} must hold 32 bytes or 64 hexadecimal digits, but has {len(content)} bytes"
        )
    return key


def _read_time(path: Path) -> int:
    try:
        return int(path.read_text())
    except (FileNotFoundError, ValueError):
        return 0


def _write_time(path: Path, value: int) -> None:
    replace_file(path, f"{value}\n")
