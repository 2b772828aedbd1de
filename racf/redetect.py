"""Search for a lost target further afield, a few places in each frame, with a second look at each candidate."""

import math

import numpy as np
from numpy.typing import NDArray

from racf.box import Box
from racf.confidence import Confidence, Verdict
from racf.params import Params
from racf.translation import Match, TranslationFilter

UInt8 = NDArray[np.uint8]


class Redetection:
    """Places around the expected one, further away the longer the target is lost; each frame looks at the next few."""

    def __init__(self, params: Params) -> None:
        self.params = params
        reach = params.redetect_reach
        steps = [(i, j) for i in range(-reach, reach + 1) for j in range(-reach, reach + 1) if (i, j) != (0, 0)]
        self._places = sorted(steps, key=lambda step: math.hypot(*step))
        self._next = 0

    def search(
        self, image: UInt8, expected: Box, here: Match, translation: TranslationFilter, confidence: Confidence
    ) -> tuple[Match, Verdict]:
        """The first trusted match among this frame's places, or `here` if no place has one."""
        if confidence.lost_frames <= 1:
            self._next = 0
        rows, cols = image.shape[:2]
        step = translation.region(expected).w / 2
        if (again := self.closer(image, here, translation, confidence)) is not None:
            return again, Verdict.CLEAR
        # A target just lost is near, most likely behind something: a match far away this early is another object.
        reach = confidence.lost_frames / self.params.redetect_patience
        reached = [step for step in self._places if math.hypot(*step) <= reach]
        for _ in range(min(self.params.redetect_places, len(reached))):
            i, j = reached[self._next % len(reached)]
            self._next += 1
            place = expected.moved(i * step, j * step)
            if not (0 <= place.centre_x < cols and 0 <= place.centre_y < rows):
                continue
            first = translation.locate(image, place)
            if (again := self.closer(image, first, translation, confidence)) is not None:
                return again, Verdict.CLEAR
        return here, Verdict.LOST

    def closer(
        self, image: UInt8, first: Match, translation: TranslationFilter, confidence: Confidence
    ) -> Match | None:
        """A second look, centred: the cosine window no longer dims the candidate, its surroundings are whole."""
        if confidence.ratio(first.psr, first.value) < self.params.redetect_glance:
            return None
        again = translation.locate(image, first.box)
        sharp = again.psr >= self.params.least_psr
        if not sharp or confidence.ratio(again.psr, again.value) < self.params.regain_above:
            return None
        confidence.lost_frames = 0
        return again
