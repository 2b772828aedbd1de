"""Do a camera's images show anything?  Black, flat and saturated ones pass every check of rate and age."""

from collections import Counter
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from follow.flight.finding import Finding, Health
from follow.messages import Frame

COARSE = 4  # every fourth row and column is enough
DARK, BRIGHT = 24, 250  # grey levels of 255: above the noise of a covered sensor; where a sensor clips
NEARLY_ALL = 99.0  # an image is black if this percentage of its pixels is below DARK
CLIPPED = 0.5  # fraction of clipped pixels above which little is left to track
LEAST_CONTRAST = 2.0  # grey levels, standard deviation: fog and a plain wall in focus have more
FIX = {
    "black": "take off the lens cap, look at exposure and cable; interlaced or encrypted video may decode to black",
    "flat": "look at lens, focus and cable: a test image or a covered lens has no texture",
    "saturated": "shorter exposure, lower gain, no sun in the image",
}


def fault_of(image: NDArray[np.uint8]) -> str:
    """What makes an image useless: "black", "flat", "saturated", or "" for none of them."""
    levels = image[::COARSE, ::COARSE]
    if np.percentile(levels, NEARLY_ALL) < DARK:
        return "black"
    if float(levels.reshape(-1, levels.shape[-1]).std(axis=0).max()) < LEAST_CONTRAST:
        return "flat"
    grey = levels.min(axis=2) if levels.ndim == 3 else levels
    return "saturated" if np.mean(grey >= BRIGHT) > CLIPPED else ""


def check_images(frames: Sequence[Frame]) -> Finding:
    """Name frames that show nothing: red when most do, a warning when some do."""
    faults = Counter(fault for frame in frames if (fault := fault_of(frame.image)))
    if not faults:
        return Finding("image", Health.OK, f"{len(frames)} frames looked at: none is black, flat or saturated")
    worst, _ = faults.most_common(1)[0]
    counts = ", ".join(f"{count} {fault}" for fault, count in faults.most_common())
    verdict = Health.RED if 2 * sum(faults.values()) > len(frames) else Health.WARN
    return Finding("image", verdict, f"of {len(frames)} frames: {counts}", FIX[worst])
