"""The exchange between the control loop and the page's thread; neither waits for the other.

The loop's newest round replaces the one before (`Shown`).  Acts in the windows wait in two bounded queues: STOP has one
of its own, so that no flood of other acts can displace it.
"""

import contextlib
import itertools
import json
import math
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import Enum
from typing import TypeVar, cast

from follow.messages import Frame
from follow.operator.consoles import ConsoleCommand

EntryT = TypeVar("EntryT")

WAITING_ACTS = 32
WAITING_STOPS = 8
KEPT_LINES = 100
KEPT_REPLIES = 50
MOST_LETTERS = 2000  # of a message; a selection has some 120
LONGEST_LINE = 300


class Doing(str, Enum):
    """What a person can do in a window."""

    SELECT = "select"
    CLEAR = "clear"
    ORDER = "order"
    HAND_OVER = "hand-over"
    SHOWN = "shown"  # the window shows that frame now and can take the next one
    HERE = "here"  # the window is open and in front


@dataclass(frozen=True, slots=True)
class Act:
    """What a person did in the window `by`.

    `frame` is the index of the frame that a selection was drawn on, or that is shown; `box` is left, top, width,
    height in fractions of the image, a tap without size.
    """

    by: str
    doing: Doing
    frame: int = -1
    box: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)
    order: ConsoleCommand | None = None

    @property
    def is_stop(self) -> bool:
        """Whether it ends the flight's stream: STOP, and clearing the target."""
        return self.doing is Doing.CLEAR or self.order is ConsoleCommand.STOP


def read_act(text: str, by: str) -> Act:
    """The act in a window's message.  Raises ValueError with a sentence for anything else."""
    if len(text) > MOST_LETTERS:
        raise ValueError(f"a message has at most {MOST_LETTERS} letters, not {len(text)}")
    try:
        read: object = json.loads(text)
    except (ValueError, RecursionError):
        raise ValueError("the message is not JSON") from None
    if not isinstance(read, dict):
        raise ValueError("the message is not an object")
    message = cast("dict[str, object]", read)
    try:
        doing = Doing(message.get("do"))
    except ValueError:
        raise ValueError(f"do is one of {', '.join(d.value for d in Doing)}") from None
    if doing is Doing.ORDER:
        try:
            return Act(by, doing, order=ConsoleCommand(message.get("order")))
        except ValueError:
            raise ValueError(f"order is one of {', '.join(c.value for c in ConsoleCommand)}") from None
    if doing in (Doing.SELECT, Doing.SHOWN):
        frame = message.get("frame")
        if not isinstance(frame, int) or isinstance(frame, bool) or not 0 <= frame < 2**32:
            raise ValueError("frame is the number of a frame that was shown")
        return Act(by, doing, frame, read_box(message)) if doing is Doing.SELECT else Act(by, doing, frame)
    return Act(by, doing)


def read_box(message: Mapping[str, object]) -> tuple[float, float, float, float]:
    """The box of a selection, clipped to the image.  Raises ValueError."""
    box = message.get("box")
    if not isinstance(box, list) or len(cast("list[object]", box)) != 4:
        raise ValueError("box is [left, top, width, height] in 0..1 of the image")
    numbers: list[float] = []
    for value in cast("list[object]", box):
        # The negated comparison also refuses NaN.
        if not isinstance(value, int | float) or isinstance(value, bool) or not -1.0 <= value <= 2.0:
            raise ValueError("box is [left, top, width, height] in 0..1 of the image")
        numbers.append(float(value))
    if min(numbers[2:]) < 0.0:
        raise ValueError("the width and height of a box are not negative")
    left, top = min(max(numbers[0], 0.0), 1.0), min(max(numbers[1], 0.0), 1.0)
    right, bottom = min(max(numbers[0] + numbers[2], 0.0), 1.0), min(max(numbers[1] + numbers[3], 0.0), 1.0)
    width, height = max(right - left, 0.0), max(bottom - top, 0.0)
    if width == height == 0.0 and max(numbers[2:]) > 0.0:  # it would be taken for a tap
        raise ValueError("the box lies outside the image")
    return left, top, width, height


@dataclass(frozen=True, slots=True)
class NumberedLine:
    """A line for every window, or the reply to an act of one (`by`)."""

    n: int
    text: str
    by: str = ""
    done: bool = True


@dataclass(frozen=True, slots=True, eq=False)
class Shown:
    """What the windows show after one round: the newest frame with its tracked box, and the status for JSON.

    `found` holds a detector's boxes for JSON, None without any.
    """

    frame: Frame | None
    box: tuple[float, float, float, float] | None
    tracking: str
    status: Mapping[str, object]
    found: Mapping[str, object] | None = None


STARTING = Shown(None, None, "idle", {"state": "STARTING", "tone": "calm", "why": "the messages say what it waits for"})


class Exchange:
    """The mailbox of both sides.  It only appends to bounded deques and replaces references: no lock, no wait."""

    def __init__(self) -> None:
        self.shown = STARTING
        self.is_flying = False  # whether the loop takes acts
        self.lines: deque[NumberedLine] = deque(maxlen=KEPT_LINES)
        self.replies: deque[NumberedLine] = deque(maxlen=KEPT_REPLIES)
        self.path: deque[tuple[float, ...]] = deque(maxlen=1200)
        self.wake: Callable[[], None] = lambda: None
        self._acts: deque[Act] = deque(maxlen=WAITING_ACTS)
        self._stops: deque[Act] = deque(maxlen=WAITING_STOPS)
        self._hearts: deque[str] = deque(maxlen=WAITING_ACTS)
        self._count = itertools.count(1)  # its steps are atomic: lines come from several threads

    def put(self, shown: Shown) -> None:
        """Replace what the windows show."""
        self.shown = shown
        self.wake()

    def say(self, text: str) -> None:
        """Add a line for all windows; from any thread."""
        self.lines.append(NumberedLine(next(self._count), text[:LONGEST_LINE]))
        if not self.is_flying:
            self.wake()

    def reply(self, by: str, text: str, *, done: bool) -> None:
        """Answer one window."""
        self.replies.append(NumberedLine(next(self._count), text[:LONGEST_LINE], by, done))
        if not self.is_flying:
            self.wake()

    def act(self, act: Act) -> None:
        """Queue a person's act; a full queue drops its oldest.

        A STOP empties the queue of other acts: an earlier order must not act after it.
        """
        if not act.is_stop:
            self._acts.append(act)
            return
        self._stops.append(act)
        with contextlib.suppress(IndexError):  # until it is empty; the loop may take acts meanwhile
            while True:
                self.reply(self._acts.popleft().by, "not done: STOP came before it", done=False)

    def hear(self, window: str) -> None:
        """Note that a window is open and in front."""
        self._hearts.append(window)

    def heard(self) -> set[str]:
        """The windows with a sign of life since the last call."""
        return {self._hearts.popleft() for _ in range(len(self._hearts))}

    def taken(self, most: int) -> list[Act]:
        """Take the queued acts: every STOP, then others up to `most` in all."""
        acts: list[Act] = []
        while self._stops:
            acts.append(self._stops.popleft())
        while self._acts and len(acts) < most:
            acts.append(self._acts.popleft())
        return acts


def copied(entries: deque[EntryT]) -> list[EntryT]:
    """The entries of a deque to which another thread appends."""
    while True:
        with contextlib.suppress(RuntimeError):  # another thread appended meanwhile: retry
            return list(entries)


def number(value: float, digits: int = 2) -> float | None:
    """A number as JSON can hold it; None for one that is not finite."""
    return round(value, digits) if math.isfinite(value) else None
