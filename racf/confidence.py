"""Whether a response can be trusted, compared with this target's usual responses.

PSR depends on the target and its surroundings (5 for a dozen pixels, 15 for a striking cyclist), so no fixed threshold
works; the ratio to its own running mean does.  The same holds for the response's peak over the model's own.
"""

import math
from enum import Enum

from racf.params import Params


class Verdict(Enum):
    """What a frame's response allows: learn from it; follow it, without learning; or neither."""

    CLEAR = "clear"
    DOUBTFUL = "doubtful"
    LOST = "lost"


class Confidence:
    """Running means of PSR and peak, and the verdicts that follow from them."""

    def __init__(self, params: Params) -> None:
        self.params = params
        self.lost_frames = 0
        self._frames = 0
        self._psr = self._value = 0.0

    def ratio(self, psr: float, value: float) -> float:
        """The geometric mean of both over their running means, in 0..1."""
        if self._psr <= 0 or self._value <= 0:
            return 1.0
        return min(math.sqrt(max(psr / self._psr, 0.0) * max(value / self._value, 0.0)), 1.0)

    def judge(self, psr: float, value: float) -> Verdict:
        """The verdict on a frame.  A lost target is found again by a response of at least `regain_above`.

        Clear frames make the running means.  Others also count, but slowly: a target that stays changed becomes normal
        in the end.  The first `settle_frames` always count as clear: the very first response, of a filter that has seen
        one image to a nearly identical second one, can be far sharper than any later one.
        """
        params, ratio = self.params, self.ratio(psr, value)
        self._frames += 1
        settling = self._frames <= params.settle_frames
        if self.lost_frames:
            self.lost_frames = 0 if ratio >= params.regain_above else self.lost_frames + 1
        elif ratio < params.lost_below and not settling:
            self.lost_frames = 1
        clear = settling or (ratio >= params.learn_above and not self.lost_frames)
        rate = params.confidence_rate if clear else params.confidence_rate_doubtful
        rate = max(rate, 1.0 / self._frames) if clear else rate  # the plain mean, until it is as long as the memory
        self._psr += rate * (psr - self._psr)
        self._value += rate * (value - self._value)
        if self.lost_frames:
            return Verdict.LOST
        return Verdict.CLEAR if clear else Verdict.DOUBTFUL
