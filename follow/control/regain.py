"""A target that was lost: where to look for it, and how far from its way a box found again lies."""

import math

import numpy as np

from follow.control.joint_filter import JointFilter
from follow.geometry import Array

LOOKS, LOOK_ASIDE_M, LOOK_ALONG = 24, 5.0, 0.5
"""Places at which a lost target is looked for, how far to either side, and along its course as a part of its way."""


def looked_for(f: JointFilter, seen_ned: Array, look: int) -> Array:
    """Where (3,), NED, to look for a lost target in the `look`-th frame: the predicted place in every second one.

    The others go through an ellipse around it: to either side as far as it may be, along its course so far that it
    may have been half as fast or half as fast again.
    """
    step = look // 2 % LOOKS
    if look % 2 == 0:
        return f.mean[:3]
    way = f.mean[:2] - seen_ned[:2]
    length = float(np.linalg.norm(way))
    std = math.sqrt(max(float(np.linalg.eigvalsh(f.covariance[:2, :2])[-1]), 0.0))
    aside = min(2 * std, LOOK_ASIDE_M)
    ahead = max(LOOK_ALONG * length, aside)
    reach, angle = math.sqrt((step + 0.5) / LOOKS), 2.4 * step  # the golden angle: as the seeds of a sunflower lie
    course = way / length if length > 0.1 else np.array([1.0, 0.0])
    place = f.mean[:3].copy()
    place[:2] += reach * (
        ahead * math.cos(angle) * course + aside * math.sin(angle) * np.array([-course[1], course[0]])
    )
    return place


def distance_to_segment(point: Array, start: Array, end: Array) -> float:
    """Distance (metres) of a point (2,) from the line between two others."""
    along = end - start
    length2 = float(along @ along)
    fraction = min(max(float((point - start) @ along) / length2, 0.0), 1.0) if length2 > 0 else 0.0
    return float(np.linalg.norm(point - start - fraction * along))
