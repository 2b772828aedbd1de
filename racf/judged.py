"""Another tracker's boxes, judged by our confidence: for trackers that always answer, whatever they look at.

A correlation filter of ours learns the target at the other tracker's boxes and looks at each new one.  Its response
says how far to believe the box: its PSR and peak against the target's usual ones, as for our own tracker, and its peak
must lie within the box.  A box that is not believed is not found, and nothing is learned there; while the target is
lost our re-detection searches, and starts the other tracker again on what it finds.  A tracker that fails, or answers
without a box, has found nothing in that image.
"""

import logging
from typing import Protocol, cast

import numpy as np
from numpy.typing import NDArray

from racf.box import Box
from racf.confidence import Confidence, Verdict
from racf.params import Params
from racf.redetect import Redetection
from racf.texture import is_featureless
from racf.track import Track
from racf.tracker import MIN_SIDE_PX, checked_next, checked_start
from racf.translation import Match, TranslationFilter

LOG = logging.getLogger("racf")
UInt8 = NDArray[np.uint8]


class JudgedTracker(Protocol):
    """A tracker whose boxes are judged."""

    def init(self, image: UInt8, box: Box) -> Track:
        """Learn the target inside `box`."""
        ...

    def update(self, image: UInt8) -> Track:
        """Find it in the next image."""
        ...


class JudgedBoxes:
    """The boxes of `tracker` with our PSR, confidence and verdict, and with our re-detection while it is lost."""

    def __init__(self, tracker: JudgedTracker, params: Params | None = None) -> None:
        self.tracker, self.params = tracker, params or Params().robust()
        self._frame_shape: tuple[int, ...] | None = None

    def init(self, image: UInt8, box: Box) -> Track:
        """Start both on `box`; raises ValueError for an invalid image or box, and whatever the tracker raises."""
        image = checked_start(image, box)
        self.tracker.init(image, box)
        self._frame_shape, self._has_failed = image.shape, False
        self._filter = TranslationFilter(self.params, box, colour=image.ndim == 3 and self.params.colour_names)
        self._confidence = Confidence(self.params, featureless=is_featureless(image, box))
        self._redetection = Redetection(self.params)
        self._filter.learn(image, box)
        self._box = box
        return Track(box, self._filter.region(box), psr=0.0, apce=0.0, confidence=1.0)

    def update(self, image: UInt8, prior: Box | None = None) -> Track:
        """The tracker's next box, and what our filter says of it; `prior`: where a lost target is searched for.

        The tracker's errors are logged, once after each start.  Raises ValueError as `racf.Racf.update` does.
        """
        image = checked_next(image, self._frame_shape, prior)
        answer = self._answer(image)
        box = self._sized(answer or self._box, image)
        match = self._filter.locate(image, box)
        # The filter may see the target beside the box, sharp as ever: then the box is not on it.
        apart = abs(match.box.centre_x - box.centre_x) > box.w / 2 or abs(match.box.centre_y - box.centre_y) > box.h / 2
        psr = 0.0 if apart or answer is None else match.psr
        verdict = self._confidence.judge(psr, match.value)
        if verdict is Verdict.LOST:
            expected = (
                self._box if prior is None else Box.around(prior.centre_x, prior.centre_y, self._box.w, self._box.h)
            )
            match, verdict = self._redetection.search(image, expected, match, self._filter, self._confidence)
            if verdict is not Verdict.LOST:
                box, psr = self._sized(match.box, image), match.psr
                self._restart(image, box)
        if verdict is Verdict.CLEAR:
            self._filter.learn(image, box)
        if verdict is not Verdict.LOST:
            self._box = box
        return self._track(box, match, psr, verdict)

    def _answer(self, image: UInt8) -> Box | None:
        """The tracker's next box, None if it fails."""
        try:
            box = cast("object", self.tracker.update(image).box)
        except Exception as error:  # noqa: BLE001 - whatever a tracker raises: a flight goes on
            return self._failed(f"{type(error).__name__}: {error}")
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

    def _track(self, box: Box, match: Match, psr: float, verdict: Verdict) -> Track:
        return Track(
            box=box,
            search=self._filter.region(box),
            psr=psr,
            apce=match.apce,
            confidence=self._confidence.ratio(psr, match.value),
            found=verdict is not Verdict.LOST,
            response=match.response,
        )

    def _sized(self, box: Box, image: UInt8) -> Box:
        """The box with sides between two pixels and the image's, and its centre in the image."""
        rows, cols = image.shape[:2]
        w, h = min(max(box.w, MIN_SIDE_PX), cols), min(max(box.h, MIN_SIDE_PX), rows)
        return Box.around(min(max(box.centre_x, 0.0), cols), min(max(box.centre_y, 0.0), rows), w, h)
