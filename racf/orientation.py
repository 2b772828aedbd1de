"""Rotation of a video's images before display: the display matrix of phones and action cameras."""

import math
import struct
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from typing_extensions import Self


@dataclass(frozen=True, slots=True)
class Orientation:
    """A mirroring left to right, then quarter turns counter-clockwise."""

    quarter_turns: int = 0
    mirrored: bool = False

    @classmethod
    def of(cls, frame: Any) -> Self:
        """The orientation in a decoded frame's display matrix; other angles are rounded to quarter turns."""
        try:
            data = bytes(frame.side_data["DISPLAYMATRIX"])
        except KeyError:
            return cls()
        # Fixed point 16.16: row vector (x, y) times ((a, b), (c, d)), y downward.  [FFmpeg, libavutil/display.h]
        a, b, _, c, d = struct.unpack("=5i", data[:20])
        mirrored = a * d - b * c < 0
        if mirrored:
            a, b = -a, -b
        turn = round(-math.degrees(math.atan2(b, a)) / 90) % 4
        return cls(turn, mirrored)

    def applied(self, image: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """The image, ready for display."""
        if self.mirrored:
            image = image[:, ::-1]
        return np.ascontiguousarray(np.rot90(image, self.quarter_turns))
