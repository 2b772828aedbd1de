"""A tracker's result for one frame."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from racf.box import Box


@dataclass(frozen=True, slots=True, eq=False)
class Track:
    """One frame's result.

    box: the target's box; search: the region that was searched; both in the image's pixels.
    psr (peak to sidelobe ratio), apce (average peak-to-correlation energy): how sharp the response is.
    confidence: how far to trust the response, 0..1; found: the tracker's own verdict, False while the target is lost.
    restarted: whether the first box was loose or beside the target, and the tracker started again on what moved in it.
    refined: whether the box of the segmentation was accepted.
    response: (rows, columns) float32, 1 for a perfect match; its middle is where the target was expected (the last box,
        the prior or the predicted place), or the candidate's place if a lost target was searched for further away.
    mask: GrabCut's foreground, uint8 0/1, covering `mask_box`.  Response and mask are for display, or None.
    stage_ms: milliseconds of each stage by name.
    """

    box: Box
    search: Box
    psr: float
    apce: float
    confidence: float
    found: bool = True
    refined: bool = False
    restarted: bool = False
    response: NDArray[np.float32] | None = None
    mask: NDArray[np.uint8] | None = None
    mask_box: Box | None = None
    stage_ms: dict[str, float] = field(default_factory=dict)
