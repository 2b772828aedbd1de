"""The folder of a flight: its lock, and moving an earlier flight aside."""

import contextlib
import errno
import fcntl
import itertools
import os
import stat
from collections.abc import Generator
from pathlib import Path

from racf.errors import UsageError

FILES = (
    *("flight.rrd", "flight.tlog", "flight.png", "ticks.csv", "messages.jsonl.gz", "settings.toml", "summary.json"),
    *("report.html", "refly.html", "camera.yaml"),
)
"""What a flight leaves in its folder."""

CALIBRATION = "camera.yaml"
"""The copy of the calibration file that a flight was flown with."""


def flight_folder(path: Path) -> Path:
    """The folder of a flight, named itself or by one of its files."""
    return path.parent if path.name in FILES and path.is_file() else path


@contextlib.contextmanager
def claimed(out: Path) -> Generator[None, None, None]:
    """Make the folder and lock it against our other programs; a new folder that stays empty is removed.

    The lock is on the folder itself and ends with the process, however that ends.  Raises OSError, which names the
    folder, the rule and the cause.
    """
    refuse_name(out)
    try:
        made = not out.exists()
        out.mkdir(parents=True, exist_ok=True)
        lock = os.open(out, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
        if not os.access(out, os.W_OK | os.X_OK):
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))
    except OSError as error:
        raise OSError(unwritable(out, error)) from None
    try:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise OSError(f"--out {str(out)!r} is being written by another process: give another folder") from None
        yield
    finally:
        os.close(lock)
        if made:
            with contextlib.suppress(OSError):  # it is not empty
                out.rmdir()


def require_folder(out: Path) -> None:
    """Raise UsageError for a folder that cannot be made or written, before anything is opened; makes nothing."""
    try:
        refuse_name(out)
    except OSError as error:
        raise UsageError(str(error)) from None
    for path in (out, *out.absolute().parents):
        try:
            if not stat.S_ISDIR(path.stat().st_mode):
                raise FileExistsError
            if not os.access(path, os.W_OK | os.X_OK):
                raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))
            return
        except FileNotFoundError:
            continue  # it will be made
        except OSError as error:
            raise UsageError(unwritable(out, error)) from None


def unwritable(out: Path, error: OSError) -> str:
    """The sentence about a folder that cannot be made or written."""
    why = "it is a file" if isinstance(error, FileExistsError) else error.strerror
    return f"--out {str(out)!r} must be a folder that can be written: {why}"


def refuse_name(out: Path) -> None:
    """Raise OSError for a name that no recording can have: Rerun takes UTF-8 only, and a shell expands `~`."""
    try:
        str(out).encode()
    except UnicodeEncodeError:
        raise OSError(f"--out {os.fsencode(out)!r} must be UTF-8: give another name") from None
    if "\0" in str(out):
        raise OSError(f"--out {str(out)!r} must not hold a zero byte: give another name")
    if str(out).startswith("~"):
        raise OSError(f"--out {str(out)!r} begins with ~, which the shell did not expand: give the whole path")


def set_aside(out: Path) -> Path | None:
    """Move the flight that a folder holds into a new folder inside it; None if the folder holds no flight."""
    files = [out / name for name in FILES if (out / name).exists()]
    if not files:
        return None
    folder = next(path for n in itertools.count(1) if not (path := out / f"earlier-{n}").exists())
    folder.mkdir()
    for file in files:
        file.rename(folder / file.name)
    return folder
