"""Threads that write a flight's data without blocking the control loop.

Each has two queues: one for light entries (rows, curves, messages), up to ten minutes long, and one for heavy ones
(images), half a second long.  A full queue drops its oldest entry and counts it.
"""

import threading
from collections import deque
from collections.abc import Callable
from typing import Generic, Protocol, TypeVar

from follow.messages import Notify

LIGHT = 20_000  # rounds in the light queue: ten minutes at 30 rounds/s, some 60 MB
CLOSE_S = 60.0  # timeout at the end for a disk or a viewer that does not answer
QUIET_S = 3.0  # after waiting this long at the end, report the wait


class Sink(Protocol):
    """What a worker writes to."""

    def close(self) -> None:
        """Write the rest.  Raises OSError."""
        ...


SinkT = TypeVar("SinkT", bound=Sink)


class Worker(Generic[SinkT]):
    """A thread that makes a sink and calls the queued acts with it, in order.

    An OSError ends the writing and is reported once: the disk is full, the viewer is gone.  Any other error also sets
    `failure`: it is a bug, and the run must not count as good.  With `waits` the caller waits for room in a queue
    instead of dropping the oldest entry.  `dropped` counts heavy entries, `lost` light ones.
    """

    def __init__(self, name: str, make: Callable[[], SinkT], report: Notify, heavy: int, *, waits: bool) -> None:
        self.name = name
        self.dropped = self.lost = 0
        self.failure = ""
        self._make, self._report, self._waits = make, report, waits
        self._most_heavy = heavy
        self._change = threading.Condition()
        self._light: deque[Callable[[SinkT], None]] = deque()
        self._heavy: deque[Callable[[SinkT], None]] = deque()
        self._closing = self._ended = False
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        self._thread.start()

    def put(self, act: Callable[[SinkT], None], heavy: Callable[[SinkT], None] | None = None) -> None:
        """Queue an act on the sink; `heavy` may be dropped earlier."""
        with self._change:
            if self._waits and not self._closing:  # a report at the end must not wait for room
                self._change.wait_for(self._has_room)
            if self._ended:
                return
            if len(self._light) >= LIGHT:
                self._light.popleft()
                self.lost += 1
            self._light.append(act)
            if heavy is not None:
                if len(self._heavy) >= self._most_heavy:
                    self._heavy.popleft()
                    self.dropped += 1
                self._heavy.append(heavy)
            self._change.notify_all()

    def close(self, timeout_s: float = CLOSE_S) -> None:
        """Write the rest of the queue; reports if that takes long, and if it gives up after `timeout_s`."""
        with self._change:
            self._closing = True
            self._change.notify_all()
        quiet_s = QUIET_S if timeout_s > 2 * QUIET_S else timeout_s
        self._thread.join(quiet_s)
        if self._thread.is_alive() and (rest_s := timeout_s - quiet_s) > 0:
            self._report(
                f"{self.name} is not written yet: waiting up to {rest_s:g} s; Ctrl-C leaves now, without its end"
            )
            self._thread.join(rest_s)
        if self._thread.is_alive():
            self._report(f"{self.name} is not finished: no answer within {timeout_s:g} s")

    def _has_room(self) -> bool:
        return self._ended or (len(self._light) < LIGHT and len(self._heavy) < self._most_heavy)

    def _run(self) -> None:
        word = ""
        try:
            sink = self._make()
            while (acts := self._next()) is not None:
                for act in acts:
                    act(sink)
            sink.close()
        except OSError as error:
            word = str(error)
        except Exception as error:  # noqa: BLE001 - whatever it was, the flight goes on and the run counts as failed
            word = self.failure = (
                f"{self.name} ended by an error: {type(error).__name__}: {' '.join(str(error).split())}"
            )
        finally:
            self._end()
        if word:
            self._report(
                word
            )  # after the end, because the report is also put into this worker and must not wait for it

    def _end(self) -> None:
        with self._change:
            self._ended = True
            self.lost += len(self._light)
            self.dropped += len(self._heavy)
            self._light.clear()
            self._heavy.clear()
            self._change.notify_all()

    def _next(self) -> "list[Callable[[SinkT], None]] | None":
        """Wait for entries: all light ones and one heavy one; None when the queues are closed and empty."""
        with self._change:
            self._change.wait_for(lambda: self._light or self._heavy or self._closing)
            acts = list(self._light)
            self._light.clear()
            if self._heavy:
                acts.append(self._heavy.popleft())
            self._change.notify_all()
            return acts or None
