"""A detector beside the loop: when it is free it gets the newest frame, and its detections arrive when they are ready.

The network runs in a process of its own, at the lowest priority, so that it delays no setpoint.  In a simulation
detections arrive after a fixed delay, so that the same flight gets the same detections.
"""

import contextlib
import logging
import os
import signal
from collections import deque
from collections.abc import Callable
from concurrent.futures import CancelledError, Future, ThreadPoolExecutor
from concurrent.futures import TimeoutError as TookTooLong
from multiprocessing import get_context
from multiprocessing.connection import Connection
from pathlib import Path
from types import TracebackType

import cv2
import numpy as np
from numpy.typing import NDArray
from typing_extensions import Self

from follow.control.detector import Detector
from follow.messages import Frame
from follow.selection import DETECTIONS_S, Detection, Detections
from racf.box import Box

log = logging.getLogger(__name__)

UInt8 = NDArray[np.uint8]
Find = Callable[[UInt8], tuple[Detection, ...]]
Answer = tuple[Detection, ...] | Box | str | None
"""The process's answer: the detections, the box of a click, or why the network failed."""

PERIOD_S = 0.2  # least time between two frames for the network
REST = 0.5  # pause before the next frame, as a fraction of the time for the last one: the board stays cool
DELAY_S = 0.3  # in a simulation: two squares of 416 pixels take some 0.2 s of a core; the rest is the camera's delay
CLICK_S = 2.0  # timeout of a click's search for a box
SILENT_S = 10.0  # warn after this long without an answer; loading a large network can take that long on a board
NICEST = 19
FIRST_TO_END = "1000"  # the highest of oom_score_adj, proc(5)
END_S = 2.0  # timeout for the process to end


def is_fresh(found: Detections | None, t_s: float) -> bool:
    """Whether detections may still be shown and offered at `t_s`."""
    return found is not None and t_s - found.t_s <= DETECTIONS_S


class DelayedDetector:
    """The detector of a simulation: `find` runs at once, and its answer is released `delay_s` later."""

    def __init__(self, find: Find, delay_s: float = DELAY_S) -> None:
        self._find, self._delay_s = find, delay_s
        self._next_t_s = -float("inf")
        self._coming: deque[tuple[float, Detections]] = deque()
        self._found: Detections | None = None

    def update(self, frame: Frame | None, t_s: float) -> Detections | None:
        """Take in a round at `t_s` and its frame; returns the last detections, None if they are too old."""
        if frame is not None and t_s >= self._next_t_s:
            self._next_t_s = t_s + max(PERIOD_S, (1 + REST) * self._delay_s)
            try:
                found = Detections(frame.t_s, frame.index, self._find(frame.image))
                self._coming.append((t_s + self._delay_s, found))
            except ValueError as error:
                log.warning("the detector failed: %s", error)
        while self._coming and self._coming[0][0] <= t_s:
            self._found = self._coming.popleft()[1]
        return self._found if is_fresh(self._found, t_s) else None


class DetectorProcess:
    """An ONNX file's detector in a process of its own; use it in a `with` block.

    The loop calls `update`, which never waits; `snap` is for the thread that searches a click's box.
    """

    def __init__(self, path: Path) -> None:
        self._pipe, self._theirs = get_context("spawn").Pipe()
        self._process = get_context("spawn").Process(target=serve, args=(path, self._theirs), daemon=True)
        self._calls = ThreadPoolExecutor(1, "detector")
        self._asked: tuple[Future[Answer], Frame, float] | None = None
        self._next_t_s = -float("inf")
        self._found: Detections | None = None
        self._failure = ""
        self._late: Future[Answer] | None = None  # the call of a click that timed out
        self._is_warm = False  # it has answered once: the first answer includes the start of the process
        self._told: set[str] = set()

    def update(self, frame: Frame | None, t_s: float) -> Detections | None:
        """Take in a round at `t_s` and its frame; returns the last detections, None if they are too old."""
        if self._asked is not None and self._asked[0].done():
            (job, looked_at, since_s), self._asked = self._asked, None
            self._next_t_s = max(since_s + PERIOD_S, t_s + REST * (t_s - since_s))
            answer = self._answer(job)
            if isinstance(answer, tuple):
                self._found = Detections(looked_at.t_s, looked_at.index, answer)
                self._judge_age(t_s - looked_at.t_s)
        elif self._asked is not None and t_s - self._asked[2] > SILENT_S:
            self._tell_once(f"the detector has not answered for {SILENT_S:g} s: clicks get the box of what stands out")
        if frame is not None and self._asked is None and t_s >= self._next_t_s and not self._has_ended:
            self._asked = self._calls.submit(self._call, frame.image, None), frame, t_s
        return self._found if is_fresh(self._found, t_s) else None

    def snap(self, image: UInt8, x: float, y: float) -> Box | None:
        """The box of the likeliest object at a pixel of an image; None without one, or after CLICK_S.

        While the call of an earlier click is still pending, no other is queued behind it.
        """
        if self._has_ended or (self._late is not None and not self._late.done()):
            return None
        try:
            job = self._calls.submit(self._call, image, (x, y))
            answer = self._answer(job)
        except (RuntimeError, CancelledError):  # the flight ends
            return None
        self._late = None if job.done() else job
        return answer if isinstance(answer, Box) else None

    def _judge_age(self, age_s: float) -> None:
        """Warn once that detections arrive too late to be used."""
        if self._is_warm and age_s > DETECTIONS_S:
            self._tell_once(
                f"the detector is too slow: it found boxes {age_s:.1f} s after their frame, and older ones than "
                f"{DETECTIONS_S:g} s are not shown; take a smaller network"
            )
        self._is_warm = True

    def _tell_once(self, words: str) -> None:
        kind = words.partition(":")[0]
        if kind not in self._told:
            self._told.add(kind)
            log.warning("%s", words)

    @property
    def _has_ended(self) -> bool:
        return self._pipe.closed

    def _call(self, image: UInt8, place: tuple[float, float] | None) -> Answer:
        """Let the process search an image, at a pixel only or everywhere; runs in the thread of `_calls`."""
        self._pipe.send((image.shape, place))
        self._pipe.send_bytes(np.ascontiguousarray(image).reshape(-1).data)
        return self._pipe.recv()

    def _answer(self, job: "Future[Answer]") -> Answer:
        """The answer of a call; None if it failed, and a warning if the failure is new."""
        try:
            answer = job.result(CLICK_S)
        except TookTooLong:
            return None
        except (OSError, EOFError):
            answer = "its process has ended"
            self._pipe.close()
        if not isinstance(answer, str):
            self._failure = ""
            return answer
        if answer != self._failure:
            self._failure = answer
            log.warning("the detector failed: %s", answer)
        return None

    def __enter__(self) -> Self:
        self._process.start()
        self._theirs.close()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._process.terminate()  # a pending call then ends with EOFError
        self._process.join(END_S)
        if self._process.is_alive():  # stopped, or stuck in its driver
            self._process.kill()
            self._process.join(END_S)
        self._calls.shutdown(wait=False, cancel_futures=True)


def serve(path: Path, pipe: "Connection") -> None:
    """Entry point of the process: answer each image that arrives through `pipe`, until the other side closes it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the loop, which ends this process
    os.setpriority(os.PRIO_PROCESS, 0, NICEST)  # otherwise it inherits the loop's -10 from the service
    with contextlib.suppress(OSError):  # when memory runs out the kernel kills this process, not the one that flies
        Path("/proc/self/oom_score_adj").write_text(FIRST_TO_END, encoding="ascii")
    cv2.setNumThreads(max((os.cpu_count() or 1) - 1, 1))  # a core for the loop
    detector = Detector(path)
    with contextlib.suppress(EOFError, OSError):  # the flight has ended, whatever ended it
        while True:
            shape, place = pipe.recv()
            image = np.frombuffer(pipe.recv_bytes(), np.uint8).reshape(shape)
            try:
                answer: Answer = detector.find(image) if place is None else detector.snap(image, *place)
            except ValueError as error:
                answer = str(error)
            pipe.send(answer)
