"""Writes lines for a person in a thread of its own, so that the control loop never waits for a terminal.

A terminal stopped by Ctrl-S, or a pipe that nobody reads, may block a write without end.
"""

import os
import select
import threading
from collections import deque
from queue import SimpleQueue

LINES = 200
"""Maximum number of waiting lines; beyond it the oldest is dropped, because the newest is the most useful."""

FLUSH_S = 0.5
"""Maximum wait for the waiting lines to be written before the program ends."""


class BackgroundWriter:
    """Writes lines to a file descriptor, in their order.

    It writes to the descriptor itself, because Python's own file object would hold a lock while a write is blocked, and
    the interpreter cannot exit without that lock.
    """

    def __init__(self, descriptor: int) -> None:
        self._descriptor = descriptor
        self._lines: deque[bytes] = deque(maxlen=LINES)
        self._dropped = 0
        self._lock = threading.RLock()  # reentrant: a signal handler may report while the loop reports
        self._wake: SimpleQueue[threading.Event | None] = SimpleQueue()
        self._closed = False
        threading.Thread(target=self._run, name="terminal", daemon=True).start()

    def put(self, line: str) -> None:
        """Take a line and return at once."""
        with self._lock:
            self._dropped += len(self._lines) == LINES
            self._lines.append(line.encode(errors="backslashreplace") + b"\n")
        if self._wake.empty():
            self._wake.put(None)

    def flush(self) -> None:
        """Wait until every line is written, at most `FLUSH_S`."""
        written = threading.Event()
        self._wake.put(written)
        written.wait(FLUSH_S)

    def _run(self) -> None:
        while True:
            waiting = self._wake.get()
            while self._lines:
                with self._lock:
                    line, dropped, self._dropped = self._lines.popleft(), self._dropped, 0
                if dropped:
                    self._write(b"%d older messages not shown: the terminal was stopped\n" % dropped)
                self._write(line)
            if waiting is not None:
                waiting.set()

    def _write(self, data: bytes) -> None:
        """Write everything, however long it takes; nothing once the terminal is closed."""
        while data and not self._closed:
            try:
                data = data[os.write(self._descriptor, data) :]
            except BlockingIOError:  # another program that shares the terminal made it non-blocking
                select.select([], [self._descriptor], [])
            except OSError:  # the terminal was closed
                self._closed = True
