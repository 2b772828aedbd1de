"""Files that a control loop writes without waiting for the disk: each file has a thread that waits instead.

A full, slow or stalled disk loses data, but never delays the loop.
"""

import errno
import os
import threading
from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import Protocol

from follow.messages import Notify

WAITING_BYTES = 8_000_000  # largest queue of one file: ten minutes of rows or packets
CLOSE_S = 30.0  # timeout at the end for a disk that does not answer
FULL_BYTES = 2_000_000  # a disk with less room counts as full: the recording writes images in blocks of up to 1 MB


class ByteFile(Protocol):
    """The methods that an open file must have."""

    def write(self, data: bytes, /) -> object:
        """Write the bytes."""
        ...

    def flush(self) -> object:
        """Hand them to the operating system."""
        ...

    def close(self) -> object:
        """Close the file."""
        ...


def unwritten(file: Path | str, error: Exception) -> str:
    """The report about a file that is no longer written; the same one for all files of a folder whose disk is full."""
    if isinstance(file, Path) and (getattr(error, "errno", 0) == errno.ENOSPC or is_full(file.parent)):
        return (
            f"the disk of {file.parent} is full: its files are no longer written, what is in them stays, and the "
            "flight goes on; make room before the next one"
        )
    return f"{file} is no longer written: {getattr(error, 'strerror', None) or error}; the flight goes on"


def is_full(folder: Path) -> bool:
    """Whether the folder's disk has no room for a block of images; False for a disk that was removed."""
    try:
        disk = os.statvfs(folder)
    except OSError:
        return False
    return disk.f_bavail * disk.f_frsize < FULL_BYTES


class OnceEach:
    """Passes each line on once, because a full disk breaks every file at about the same time."""

    def __init__(self, report: Notify) -> None:
        self._report = report
        self._told: set[str] = set()
        self._lock = threading.Lock()

    def __call__(self, line: str) -> None:
        """Report the line unless it was reported before."""
        with self._lock:
            is_new = line not in self._told
            self._told.add(line)
        if is_new:
            self._report(line)


def opened(path: Path) -> ByteFile:
    """An empty file."""
    return path.open("wb")


class WholeFile:
    """A file that stands under its name only when all of it is written, and closed; an error leaves nothing of it."""

    def __init__(self, path: Path) -> None:
        self._path, self._beside = path, beside(path)
        self._file = opened(self._beside)
        self._broken = False

    def write(self, data: bytes) -> None:
        """Write the bytes beside the file."""
        self._act(lambda: self._file.write(data))

    def flush(self) -> None:
        """Hand them to the operating system."""
        self._act(self._file.flush)

    def close(self) -> None:
        """Give the file its name, unless a write failed."""
        try:
            self._act(self._file.close)
            if not self._broken:
                self._act(lambda: self._beside.replace(self._path))
        finally:
            self._beside.unlink(missing_ok=True)

    def _act(self, act: Callable[[], object]) -> None:
        try:
            act()
        except OSError:
            self._broken = True
            raise


class BackgroundFile:
    """Appends to a file in the order of the calls, in a thread; `write` returns at once.

    `lost` counts the dropped writes: those beyond `waiting_bytes` in the queue, and those after an error of the disk,
    which is reported once.  Raises OSError if the file cannot be opened.
    """

    def __init__(
        self,
        path: Path,
        report: Notify,
        waiting_bytes: int = WAITING_BYTES,
        open_file: Callable[[Path], ByteFile] = opened,
    ) -> None:
        self.path = path
        self.lost = 0
        self._report, self._most = report, waiting_bytes
        self._waiting: deque[bytes] = deque()
        self._bytes = 0
        self._change = threading.Condition()
        self._closing = self._broken = False
        self._file = open_file(path)
        self._thread = threading.Thread(target=self._run, name=f"writer of {path.name}", daemon=True)
        self._thread.start()

    def write(self, data: bytes) -> None:
        """Queue the bytes."""
        with self._change:
            if self._broken or self._closing or self._bytes + len(data) > self._most:
                self.lost += 1
                return
            self._waiting.append(data)
            self._bytes += len(data)
            self._change.notify()

    def close(self, timeout_s: float = CLOSE_S) -> None:
        """Wait until everything is written, at most `timeout_s`; the rest then counts as lost, and is reported."""
        with self._change:
            self._closing = True
            self._change.notify()
        self._thread.join(timeout_s)
        if self._thread.is_alive():
            with self._change:
                self.lost += len(self._waiting)
            self._report(f"{self.path} is not written to its end: the disk did not answer within {timeout_s:g} s")

    def _run(self) -> None:
        while True:
            with self._change:
                self._change.wait_for(lambda: self._waiting or self._closing)
                batch = list(self._waiting)
                self._waiting.clear()
                self._bytes = 0
                ending = self._closing and not batch
            try:
                if ending:
                    self._file.close()
                    return
                self._file.write(b"".join(batch))
                self._file.flush()
            except OSError as error:
                self._break(error, len(batch))
                return

    def _break(self, error: OSError, count: int) -> None:
        with self._change:
            self._broken = True
            self.lost += count + len(self._waiting)
            self._waiting.clear()
        self._report(unwritten(self.path, error))
        try:
            self._file.close()
        except OSError:
            return  # the report above covers its last bytes


class BackgroundTask:
    """Runs a task in a thread, one run at a time; `start` returns at once, False if the last run is still going."""

    def __init__(self, task: Callable[[], None], name: str) -> None:
        self._task, self._name = task, name
        self._thread: threading.Thread | None = None

    def start(self) -> bool:
        """Begin a run unless one is going on."""
        if self._thread is not None and self._thread.is_alive():
            return False
        self._thread = threading.Thread(target=self._task, name=self._name, daemon=True)
        self._thread.start()
        return True


def replace_file(path: Path, text: str) -> None:
    """Replace a file's content atomically: a power cut leaves the old or the new one.  Raises OSError."""
    new = beside(path)
    new.write_text(text)
    new.replace(path)


def beside(path: Path) -> Path:
    """The name under which a file is written before it gets its own."""
    return path.with_name(path.name + ".new")
