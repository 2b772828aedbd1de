"""Another tracker's boxes, checked by a tracker of ours: for trackers that always return a box, even of a lost target.

Ours finds the target independently, with its confidence, gate and re-detection, and takes only the target's size from
the other one.  So they are rarely wrong at the same place: of the frames in which NanoTrack and `racf,robust` agreed,
the target was elsewhere in 0.7 %; NanoTrack alone is elsewhere in 14 % (twenty sequences, docs/confidence.md).  If
both agree, the result is the other tracker's box; if not, the target counts as not found.  After a lasting
disagreement ours prevails, because it has a confidence: the other tracker starts again on our box.  If the other
tracker fails, returns no box, or reports that it has not found the target, ours follows alone.
"""

import logging
import time
from dataclasses import replace
from typing import Protocol, cast

import numpy as np
from numpy.typing import NDArray

from racf.box import Box
from racf.params import Params
from racf.track import Track
from racf.tracker import Racf, checked_next, checked_start

LOG = logging.getLogger("racf")
UInt8 = NDArray[np.uint8]
AGREE_IOU = 0.3  # least overlap of two boxes on one target: boxes of one size are at most half a side apart
MOST_GROWTH = 1.3  # limit on a side's factor per frame: a filter with a size wrong by 1.8 in one frame loses its target


class JudgedTracker(Protocol):
    """A tracker whose boxes are judged."""

    def init(self, image: UInt8, box: Box) -> Track:
        """Learn the target inside `box`."""
        ...

    def update(self, image: UInt8) -> Track:
        """Find it in the next image."""
        ...


class JudgedBoxes(Racf):
    """The boxes of `tracker` while ours agrees with them, with our PSR, confidence and verdict.

    After `params.redetect_agree` frames of disagreement, and when ours has found a lost target again, `tracker` is
    restarted.  Ours is `racf-,robust` without prediction of the size, unless `params` is given.  A slowly growing error
    of the tracker's size is not noticed.
    """

    def __init__(self, tracker: JudgedTracker, params: Params | None = None) -> None:
        super().__init__(params or replace(Params().robust(), predict_scale=False))
        self.tracker = tracker

    def init(self, image: UInt8, box: Box) -> Track:
        """Start both on `box`; raises ValueError for an invalid image or box, and whatever the tracker raises."""
        image = checked_start(image, box)
        self.tracker.init(image, box)  # first: while it refuses to start, there is no target
        self._theirs, self._apart, self._has_failed = None, 0, False
        return super().init(image, box)

    def update(self, image: UInt8, prior: Box | None = None) -> Track:
        """The tracker's next box if ours agrees, with our verdict; `prior`: where the caller expects it.

        The tracker's errors are logged, once after each start.  Raises ValueError as `racf.Racf.update` does.
        """
        image = checked_next(image, self._frame_shape, prior)
        was_lost, since = self._confidence.lost_frames > 0, time.perf_counter()
        answer, spent_ms = self._answer(image), (time.perf_counter() - since) * 1e3
        self._theirs = None if answer is None else self._kept_inside(answer)
        track = super().update(image, prior)
        track.stage_ms["other tracker"] = spent_ms
        if not track.found:
            self._apart = 0
            return track
        if self._theirs is not None and self._agrees(self._theirs):
            self._apart = 0
            return replace(track, box=self._theirs)
        self._apart += 1
        if was_lost or self._apart >= self.params.redetect_agree:
            self._apart = 0
            self._restart(image, track.box)
        elif self._theirs is not None:
            return replace(track, found=False, confidence=0.0)
        return track

    def _agrees(self, theirs: Box) -> bool:
        return self._box.iou(theirs) >= AGREE_IOU

    def _estimate_scale(self, image: UInt8) -> None:
        """Take the size of the other tracker, while both agree."""
        if self._theirs is not None and self._agrees(self._theirs):
            at, theirs = self._box, self._theirs
            w = min(max(theirs.w, at.w / MOST_GROWTH), at.w * MOST_GROWTH)
            h = min(max(theirs.h, at.h / MOST_GROWTH), at.h * MOST_GROWTH)
            self._box = self._kept_inside(Box.around(at.centre_x, at.centre_y, w, h))

    def _learn_scale(self, image: UInt8) -> None:
        """Do nothing: the size comes from the other tracker."""

    def _answer(self, image: UInt8) -> Box | None:
        """The tracker's next box, None if it fails or reports that it has not found the target."""
        try:
            track = self.tracker.update(image)
            box, has_found = cast("object", track.box), track.found
        except Exception as error:  # noqa: BLE001 - no exception of a tracker may end a flight
            return self._failed(f"{type(error).__name__}: {error}")
        if not has_found:
            return None
        return box if isinstance(box, Box) else self._failed(f"it answered {box!r} instead of a racf.Box")

    def _restart(self, image: UInt8, box: Box) -> None:
        try:
            self.tracker.init(image, box)
        except Exception as error:  # noqa: BLE001 - the target is there: our filter found it
            self._failed(f"{type(error).__name__}: {error}")

    def _failed(self, why: str) -> None:
        if not self._has_failed:
            LOG.warning("%s failed and counts as having found nothing: %s", type(self.tracker).__name__, why)
        self._has_failed = True
