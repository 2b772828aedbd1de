"""A tracker that starts by itself on the first image it gets, and again after `restart`."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from racf.box import Box
from racf.track import Track

Image = NDArray[np.uint8]


class Acquire:
    """Starts a tracker on `box` in the first image, then lets it track: the loop only ever calls `update`.

    `init` learns the target in the box, `track` finds it again, around the prior if there is one.
    """

    def __init__(
        self, init: Callable[[Image, Box], Track], track: Callable[[Image, Box | None], Track], box: Box
    ) -> None:
        self._init, self._track, self._start = init, track, box
        self._box: Box | None = box

    def restart(self) -> None:
        """Start again in the next image, on the same box."""
        self._box = self._start

    def update(self, image: Image, prior: Box | None = None) -> Track:
        """Return the track of this image.  Raises ValueError when the box does not fit the first image."""
        if self._box is None:
            return self._track(image, prior)
        track = self._init(image, self._box)
        self._box = None
        return track
