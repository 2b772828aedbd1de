"""A target that a person selects, changes or clears in flight.

A selection names the frame that it was drawn on.  The tracker learns the target in that frame, which is kept, and then
tracks through the frames since, several a round, until it has caught up with the camera.  So a box that was drawn half
a second late is on the target, not where the target was.
"""

from collections.abc import Callable
from concurrent.futures import Executor, Future
from dataclasses import dataclass, replace
from typing import Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from follow.control.click import box_at
from follow.messages import Frame
from follow.selection import Choice, Cleared, Selection
from racf.box import Box
from racf.texture import is_featureless
from racf.track import Track

Image = NDArray[np.uint8]

Snap = Callable[[Image, float, float], Box | None]
"""The box of the object at a place (x, y in pixels) of an image, None without one."""

EARLY_S = 0.1  # a selection may name a frame this much older than the oldest one that is kept
MIN_SIDE_PX = 6.0  # a smaller target has no features to track
MIN_CONTRAST = 3.0  # standard deviation of grey levels: sensor noise alone is 1 to 3
CATCH_UP = 4  # frames tracked in a round while behind: 4 x 5 ms on one core of a Pi 5


class KeepsFrames(Protocol):
    """What keeps the camera's last frames; `follow.camera.recent.RecentFrames` does."""

    @property
    def kept(self) -> tuple[Frame, ...]:
        """The frames that are kept, oldest first."""
        ...


@dataclass(frozen=True, slots=True)
class Start:
    """A box in a frame that is kept, from which the tracker is to start."""

    box: Box
    frame: Frame


class Selector:
    """The loop's tracker for a target that comes from a person: `update` returns None while there is no target.

    `init` learns the target in a box, `track` finds it again, around the prior if there is one.  `begin` is called when
    the tracker has caught up with a new target, so that the estimate forgets the old one.  `box` is the target in the
    first frame, None to wait for a selection.  `looks` runs the search for a click's box outside the loop (None: in
    it); `decided` then gets the reason why there is no box, or "".  `snap` finds an object's box at a click; GrabCut is
    the fallback.
    """

    def __init__(
        self,
        init: Callable[[Image, Box], Track],
        track: Callable[[Image, Box | None], Track],
        recent: KeepsFrames,
        begin: Callable[[], None],
        box: Box | None = None,
        looks: Executor | None = None,
        snap: Snap = lambda _image, _x, _y: None,
    ) -> None:
        self._init, self._track, self._recent, self._begin = init, track, recent, begin
        self._first = self._box_at_start = box
        self._looks, self._snap = looks, snap
        self.decided: Callable[[str], object] = lambda _why: None
        self.out_of_reach: Callable[[Box, float], str] = lambda _box, _t_s: ""
        self._looking: tuple[Future[Box | str], Frame] | None = None
        self._start: Start | None = None
        self._done_t_s: float | None = None  # time of the last frame that was tracked while behind; None: not behind
        self._has_target = False
        self._box = Box(0.0, 0.0, 1.0, 1.0)  # where the target was at `_done_t_s`

    @property
    def has_target(self) -> bool:
        """Whether there is a target; the tracker may still be catching up with it."""
        return self._has_target or self._start is not None or self._first is not None

    @property
    def is_looking(self) -> bool:
        """Whether a search for a click's box is running; `decided` gets its result."""
        return self._looking is not None

    def choose(self, choice: Choice) -> str:
        """Take a selection or a stop; returns why it is refused, or "" if it is accepted."""
        if isinstance(choice, Cleared):
            self.clear()
            return ""
        frame = self.frame_of(choice)
        if isinstance(frame, str):
            return frame
        if choice.is_point and self._looks is not None:
            self._cancel_look()
            self._looking = self._looks.submit(meant, choice, frame.image, self._snap), frame
            return ""
        return self._take(meant(choice, frame.image, self._snap), frame, is_tap=choice.is_point)

    def _take(self, box: Box | str, frame: Frame, *, is_tap: bool) -> str:
        why = box if isinstance(box, str) else self.out_of_reach(box, frame.t_s) if is_tap else ""
        if why or isinstance(box, str):
            return why
        self._start, self._first = Start(box, frame), None
        self._cancel_look()
        return ""

    def _cancel_look(self) -> None:
        """Drop the search for a click's box; a search that is still queued never starts."""
        if self._looking is not None:
            self._looking[0].cancel()
        self._looking = None

    def restart(self) -> None:
        """Start again in the next frame, on the box given at the start."""
        self.clear()
        self._first = self._box_at_start

    def clear(self) -> None:
        """Forget the target."""
        self._start, self._first, self._done_t_s, self._has_target = None, None, None, False
        self._cancel_look()
        self._begin()

    def frame_of(self, selection: Selection) -> Frame | str:
        """The frame that a selection was drawn on, or why there is none."""
        kept = self._recent.kept
        if not kept:
            return "no image yet: nothing selected"
        if selection.frame_t_s < kept[0].t_s - EARLY_S:
            return f"selected {kept[-1].t_s - selection.frame_t_s:.1f} s late: select again"
        return min(kept, key=lambda known: abs(known.t_s - selection.frame_t_s))

    def update(self, image: Image, prior: Box | None = None) -> Track | None:
        """The track of the newest frame; not found while the tracker catches up, None without a target."""
        if self._looking is not None and self._looking[0].done():
            (found, frame), self._looking = self._looking, None
            self.decided(self._take(found.result(), frame, is_tap=True))
        if self._first is not None:
            box, self._first, self._has_target = self._first, None, True
            return self._init(image, box)
        if self._start is not None:
            return self._begin_at(self._start)
        if not self._has_target:
            return None
        if self._done_t_s is not None:
            return self._catch_up(self._done_t_s, self._box)
        return self._track(image, prior)

    def _begin_at(self, start: Start) -> Track:
        self._start, self._has_target = None, True
        track = self._init(start.frame.image, start.box)
        if start.frame.index == self._recent.kept[-1].index:
            self._done_t_s = None
            self._begin()
            return replace(track, found=False)
        return self._catch_up(start.frame.t_s, start.box)

    def _catch_up(self, done_t_s: float, box: Box) -> Track:
        """Track the next frames; `box` is where the target was in the frame of `done_t_s`."""
        waiting = [frame for frame in self._recent.kept if frame.t_s > done_t_s]
        track: Track | None = None
        for frame in waiting[:CATCH_UP]:
            track = self._track(frame.image, None)
            done_t_s, box = frame.t_s, track.box
        if track is None or len(waiting) > CATCH_UP:
            self._done_t_s = done_t_s
            self._box = box
            return Track(box, box, 0.0, 0.0, 0.0, found=False)
        self._done_t_s = None
        self._begin()
        return replace(track, found=False)  # the estimate still holds the old target in this round


def meant(selection: Selection, image: Image, snap: Snap = lambda _image, _x, _y: None) -> Box | str:
    """The box of a selection in the image's pixels, or why there is none."""
    rows, columns = image.shape[:2]
    left, top = selection.left * columns, selection.top * rows
    if selection.is_point:
        box = snap(image, left, top)
        if box is None or min(box.w, box.h) < MIN_SIDE_PX or is_outside(box, rows, columns):
            box = box_at(image, left, top)
        if box is not None and max(box.w, box.h) < MIN_SIDE_PX:  # a speck of the ground
            box = None
        return "nothing stands out there: draw a box" if box is None else box
    sides = selection.width * columns, selection.height * rows
    if min(sides) < MIN_SIDE_PX:
        return f"box under {MIN_SIDE_PX:g} pixels: go nearer"
    box = Box(left, top, *sides)
    if is_outside(box, rows, columns):
        return "box outside the image: draw it again"
    if contrast(image, box.scaled(1.5)) < MIN_CONTRAST or is_featureless(image, box):
        return "nothing to hold on to: choose a target with edges"
    return box


def is_outside(box: Box, rows: int, columns: int) -> bool:
    """Whether more than half of a box lies outside an image."""
    return not box.intersection(Box(0, 0, columns, rows)) >= 0.5 * box.area


def contrast(image: Image, box: Box) -> float:
    """Standard deviation of the grey levels in the box."""
    rows, columns = image.shape[:2]
    left, top = max(int(box.x), 0), max(int(box.y), 0)
    right, bottom = min(int(np.ceil(box.x + box.w)), columns), min(int(np.ceil(box.y + box.h)), rows)
    part = image[top:bottom, left:right]
    if part.size == 0:
        return 0.0
    grey = part if part.ndim == 2 else cv2.cvtColor(part, cv2.COLOR_BGR2GRAY)
    return float(np.std(grey))
