"""MAVLink 2 signing: the key file, and a time that never runs backwards.

A signed packet carries a 48-bit time in units of 10 us since 2015 and a signature over itself and a shared key of 32
bytes (https://mavlink.io/en/guide/message_signing.html).  A receiver refuses a time that is not later than the last,
so the time must survive a restart and a clock set back.
"""

import logging
import os
import stat
import time
from pathlib import Path

from pymavlink.dialects.v20 import common as dialect

log = logging.getLogger(__name__)

KEY_BYTES = 32
EPOCH_S = 1_420_070_400  # 2015-01-01 00:00 UTC in Unix time
UNITS_PER_S = 100_000  # of 10 us
# The stored time runs ahead, so that a crash cannot make it repeat: of the clock by so much, or of the last packet by
# so many, each a unit later than the one before.  A vehicle takes a stream that is a minute off for a replay.
SAVE_EVERY = 10 * UNITS_PER_S
SAVE_PACKETS = 10_000


class Signing:
    """A key and its clock.  `path` holds 32 bytes, raw or as 64 hexadecimal digits, and is readable by its owner only.

    The time of the last packet is kept beside it in `<path>.time`.  Raises ValueError for a file that is open to
    others or holds no key, OSError when the time cannot be kept.
    """

    def __init__(self, path: Path):
        self.key = read_key(path)
        self._time_path = path.with_name(path.name + ".time")
        self._floor = _read_time(self._time_path)
        self._saved = self._floor
        _write_time(self._time_path, self._floor)

    def install(self, mav: dialect.MAVLink) -> None:
        """Make `mav` sign what it sends and refuse what is not signed with the same key."""
        mav.signing.secret_key = self.key
        mav.signing.sign_outgoing = True
        mav.signing.allow_unsigned_callback = lambda _mav, _id: False  # without one, refusals are not counted
        self.stamp(mav)

    def stamp(self, mav: dialect.MAVLink) -> None:
        """Move the time of the next packet forward to now, never back; keeps it on disk now and then."""
        now = int((time.time() - EPOCH_S) * UNITS_PER_S)
        mav.signing.timestamp = max(mav.signing.timestamp, now, self._floor)
        if mav.signing.timestamp >= self._saved:
            self._saved = max(now + SAVE_EVERY, mav.signing.timestamp + SAVE_PACKETS)
            try:
                _write_time(self._time_path, self._saved)
            except OSError as error:  # a full disk must not end a flight; the clock will be right after a restart
                log.warning("the signing time is not kept in %s: %s", self._time_path, error)


def read_key(path: Path) -> bytes:
    """The 32 bytes in `path`; raises ValueError when others may read the file or it holds no key."""
    mode = stat.S_IMODE(path.stat().st_mode)
    if mode & 0o077:
        raise ValueError(f"the signing key {path} must be its owner's alone (chmod 600), its mode is {mode:03o}")
    content = path.read_bytes()
    if len(content) == KEY_BYTES:
        return content
    try:
        key = bytes.fromhex(content.decode("ascii").strip())
    except ValueError:
        key = b""
    if len(key) != KEY_BYTES:
        raise ValueError(
            f"the signing key {path} must hold 32 bytes or 64 hexadecimal digits, not {len(content)} bytes"
        )
    return key


def _read_time(path: Path) -> int:
    try:
        return int(path.read_text())
    except (FileNotFoundError, ValueError):
        return 0


def _write_time(path: Path, value: int) -> None:
    """Replace the stored time in one step, so that a power cut leaves the old or the new one."""
    beside = path.with_name(path.name + ".new")
    beside.write_text(f"{value}\n")
    os.replace(beside, path)
