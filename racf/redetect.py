"""Search for a lost target: near its expected position first, then further away, where several matches compete."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import chain

import numpy as np
from numpy.typing import NDArray

from racf.box import Box
from racf.confidence import Confidence, Verdict
from racf.params import Params
from racf.translation import Match, TranslationFilter

UInt8 = NDArray[np.uint8]

RIVALS = 5  # most matches far from the expected position that are compared at a time
LEAST_FRAMES = 3  # least number of frames in which a rival must have matched before it can be the target


@dataclass(frozen=True, slots=True, eq=False)
class Rival:
    """A match far from the expected position, the number of consecutive frames with it, and their summed sharpness."""

    match: Match
    frames: int
    total: float

    def mean(self) -> float:
        """Its mean sharpness: the geometric mean of PSR and peak."""
        return self.total / self.frames


class Redetection:
    """Where to search for a lost target, and which match is the target.

    Search positions: the expected one, the eight a target's side from it, and further ones the longer the target is
    lost; each frame searches the next few.  A match near the expected position is the target at once.  A match further
    away may be a look-alike while the target itself is still occluded: it is tracked for `redetect_agree` frames
    together with the other matches, and the best in the mean is the target.  When the target has been lost so long that
    it may have reached all positions, the expected one is weak evidence, and three frames are enough.
    """

    def __init__(self, params: Params) -> None:
        self.params = params
        reach, side = params.redetect_reach, 2 / params.search_area  # in half search regions
        further = [(i * 1.0, j * 1.0) for i in range(-reach, reach + 1) for j in range(-reach, reach + 1)]
        beside = [(i * side, j * side) for i in (-1, 0, 1) for j in (-1, 0, 1)]
        self._further, self._places = (
            sorted((place for place in places if place != (0, 0)), key=lambda place: math.hypot(*place))
            for places in (further, beside + further)
        )
        self._least_reach = math.hypot(side, side)
        self._next = 0
        self._rivals: list[Rival] = []

    def search(
        self, image: UInt8, places: tuple[Box, ...], here: Match, translation: TranslationFilter, confidence: Confidence
    ) -> tuple[Match, Verdict]:
        """The match that is the target, or `here`, the match at the first expected position, if there is none yet.

        The search spreads around the first position and includes the others; a match near any of them is the target.
        """
        if confidence.lost_frames <= 1:
            self._next, self._rivals = 0, []
        known, self._rivals = self._rivals, []
        for match, before in self._matches(image, places, here, known, translation, confidence):
            if self.near(match.box, *places):
                confidence.lost_frames = 0
                return match, Verdict.CLEAR
            if not any(self.near(match.box, other.match.box) for other in self._rivals):
                frames, total = (before.frames, before.total) if before is not None else (0, 0.0)
                sharpness = math.sqrt(match.psr * match.value)  # unlike the confidence it has no upper bound
                self._rivals.append(Rival(match, frames + 1, total + sharpness))
        early = self._reach(confidence) < self.params.redetect_reach
        agree = self.params.redetect_agree if early else min(LEAST_FRAMES, self.params.redetect_agree)
        if not any(rival.frames >= agree for rival in self._rivals):
            self._rivals = sorted(self._rivals, key=Rival.mean, reverse=True)[:RIVALS]
            return here, Verdict.LOST
        confidence.lost_frames = 0
        established = (rival for rival in self._rivals if rival.frames >= min(LEAST_FRAMES, agree))
        return max(established, key=Rival.mean).match, Verdict.CLEAR

    def near(self, box: Box, *places: Box) -> bool:
        """Whether a match is near enough to an expected position to need no comparison."""
        return any(
            math.hypot(box.centre_x - place.centre_x, box.centre_y - place.centre_y)
            <= self.params.redetect_near * math.sqrt(place.area)
            for place in places
        )

    def _matches(
        self, image: UInt8, expected: tuple[Box, ...], here: Match, known: list[Rival],
        translation: TranslationFilter, confidence: Confidence,
    ) -> Iterator[tuple[Match, Rival | None]]:  # fmt: skip
        """The trusted matches of this frame, each with the rival that it continues."""
        for rival in known:
            match = translation.locate(image, rival.match.box)
            # A rival is dropped at the same confidence at which a found target counts as lost.
            if self._trusted(match, confidence, self.params.lost_below) and self.near(match.box, rival.match.box):
                yield match, rival
        places = chain(expected[1:], self._turn(image, expected[0], confidence))
        for first in chain([here], (translation.locate(image, place) for place in places)):
            # Search again, centred on the match, so that the cosine window no longer attenuates it.
            if confidence.ratio(first.psr, first.value) >= self.params.redetect_glance:
                match = translation.locate(image, first.box)
                if self._trusted(match, confidence, self.params.regain_above):
                    yield match, None

    def _reach(self, confidence: Confidence) -> float:
        """How far the target may have moved since it was lost, in half search regions."""
        return max(confidence.lost_frames / self.params.redetect_patience, self._least_reach)

    def _trusted(self, match: Match, confidence: Confidence, least: float) -> bool:
        return match.psr >= self.params.least_psr and confidence.ratio(match.psr, match.value) >= least

    def _turn(self, image: UInt8, expected: Box, confidence: Confidence) -> Iterator[Box]:
        """The search positions of this frame.

        A target just lost is probably near, behind an occluder.  Once all positions are within its reach, the near ones
        have already been searched.
        """
        rows, cols = image.shape[:2]
        step = math.sqrt(expected.area) * self.params.search_area / 2
        reach = self._reach(confidence)
        places = self._places if reach < self.params.redetect_reach else self._further
        reached = [place for place in places if math.hypot(*place) <= reach]
        for _ in range(min(self.params.redetect_places, len(reached))):
            again, turn = divmod(self._next, len(reached))
            i, j = reached[turn]
            self._next += 1
            # Every second time offset by half a step: at the edge of a search region the window attenuates the target.
            aside = 0.5 * (again % 2) if places is self._further else 0.0
            place = expected.moved((i + aside) * step, (j + aside) * step)
            if 0 <= place.centre_x < cols and 0 <= place.centre_y < rows:
                yield place
