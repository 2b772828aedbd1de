"""Whether a response can be trusted, compared with this target's usual responses.

PSR depends on the target and its surroundings (5 for a dozen pixels, 15 for a high-contrast cyclist), so no fixed
threshold works; the ratio to its own running mean does.  The same holds for the response's peak over the model's own.
"""

import math
from enum import Enum

from racf.params import Params

FEATURELESS = 0.5
"""Highest confidence in a target without features."""

OF_A_START = 2.5
"""Least product of PSR and peak (over the model's own) in the frames after the start, before the running means exist.
Targets have at least 2.7, in all but one (PSR 4) of 400 starts in 20 sequences.  Of positions beside the target with a
PSR of 5, in the same images of 21 sequences, one in twenty reaches 2.7 and none 3 [measured]."""


class Verdict(Enum):
    """The verdict on a frame's response: learn from it; follow it without learning; or neither."""

    CLEAR = "clear"
    DOUBTFUL = "doubtful"
    LOST = "lost"


def ramp(confidence: float, low: float, high: float) -> float:
    """Linear ramp of a confidence: 0 up to `low`, 1 from `high` on, also if `low` equals `high`."""
    if confidence >= high:
        return 1.0
    return max(confidence - low, 0.0) / (high - low) if low < high else 0.0


class Confidence:
    """Running means of PSR and peak, and the verdicts that follow from them.

    A target that started `featureless` is never found, however sharp its responses are: `racf.texture`.
    """

    def __init__(self, params: Params, *, featureless: bool = False) -> None:
        self.params, self.most = params, FEATURELESS if featureless else 1.0
        self.lost_frames = 0
        self._frames = 0
        self._psr, self._value = 0.0, 1.0  # 1 is the filter's response to the model that it was learned from

    def ratio(self, psr: float, value: float) -> float:
        """The geometric mean of both over their running means, in 0..1.

        The running mean of PSR is capped at `usual_psr_max`, so that a sharp response after even sharper ones is not
        doubted, and is at least `usual_psr_min`, so that a target without features is doubted.
        """
        usual_psr = min(max(self._psr, self.params.usual_psr_min), self.params.usual_psr_max)
        peak = max(value / self._value, 0.0) if self._value > 0 else 1.0
        return self.most * min(math.sqrt(max(psr / usual_psr, 0.0) * peak), 1.0)

    def judge(self, psr: float, value: float, near: bool = True) -> Verdict:
        """The verdict on a frame.  A lost target is found again by a response of at least `regain_above`
        that is near the expected position.

        Clear frames update the running means.  Others do so more slowly, so that a target that stays changed is
        accepted in the end.  The first `settle_frames` are clear unless their PSR is below `least_psr`, or PSR times
        peak below OF_A_START (the target vanished right after the start): the very first response, to an image nearly
        the same as the only one that was learned, can be far sharper than any later one.
        """
        params, ratio = self.params, self.ratio(psr, value)
        self._frames += 1
        sharp = psr >= params.least_psr and self.most == 1.0
        settling = sharp and self._frames <= params.settle_frames and psr * value >= OF_A_START
        if self.lost_frames:
            self.lost_frames = 0 if near and sharp and ratio >= params.regain_above else self.lost_frames + 1
        elif not sharp or (ratio < params.lost_below and not settling):
            self.lost_frames = 1
        clear = settling or (ratio >= params.learn_above and not self.lost_frames)
        rate = params.confidence_rate if clear else params.confidence_rate_doubtful
        if clear:
            rate = max(rate, 1.0 / self._frames)  # the plain mean while there are fewer frames than the memory
        self._psr += rate * (psr - self._psr)
        self._value += rate * (value - self._value)
        if self.lost_frames:
            return Verdict.LOST
        return Verdict.CLEAR if clear else Verdict.DOUBTFUL
