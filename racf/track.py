"""What a tracker says of one frame."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from racf.box import Box


@dataclass(frozen=True, slots=True, eq=False)
class Track:
    """One frame's answer.

    `box` is where the target is believed to be, `search` the region that was looked at (both in the frame's
    pixels).  `psr` (peak to sidelobe ratio) and `apce` (average peak-to-correlation energy) say how sharp the
    response is; `confidence` in 0..1 says how far it can be believed, and `found` is the tracker's own verdict.
    `refined` tells whether the segmentation's box was accepted.  `response` (rows, columns, float32, peak of a
    perfect match 1) has in its middle the place where the target was expected (the last box, the prior or what its
    motion predicts), or the candidate's where a lost target was looked for further afield.  It and `mask` (GrabCut's
    foreground, uint8 0/1, covering `mask_box`) are there for the eye; they are None when not computed.  `stage_ms`
    holds the time of each stage by name.
    """

    box: Box
    search: Box
    psr: float
    apce: float
    confidence: float
    found: bool = True
    refined: bool = False
    response: NDArray[np.float32] | None = None
    mask: NDArray[np.uint8] | None = None
    mask_box: Box | None = None
    stage_ms: dict[str, float] = field(default_factory=dict)
