"""How high the ground is: level, or a slope in one direction that begins and ends gently.

The height is piecewise linear along one heading and constant across it, so the ground consists of plane strips
(facets): each is drawn by its own homography, so that the drawn height is exactly that of the ground truth.
"""

import itertools
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

BLEND_PARTS = 8  # facets in which a slope begins and ends
SUNK_M = 0.05  # a line of sight that passes this far below the ground is cut off
CAST_ROUNDS = 6  # each reduces the error by grade x shadow length per metre of height: at most 0.3 for 20 %
SHADOW_M = 0.01  # height of a drawn shadow above the ground


@dataclass(frozen=True, slots=True)
class Facet:
    """A plane strip of ground.

    Its height is `offset_m` + `north_grade`·north + `east_grade`·east, between `from_m` and `to_m` along the heading.
    """

    from_m: float = -math.inf
    to_m: float = math.inf
    offset_m: float = 0.0
    north_grade: float = 0.0
    east_grade: float = 0.0


@dataclass(frozen=True, slots=True)
class Terrain:
    """The height of the ground: linear between `points` of (distance along `heading_rad`, height), level beyond them.

    The distance is measured from the origin of the local frame.  Without points the ground is level at 0.
    """

    points: tuple[tuple[float, float], ...] = ()
    heading_rad: float = 0.0

    def height_m(self, north_m: float, east_m: float) -> float:
        """Height of the ground above the local frame's origin, metres."""
        if not self.points:
            return 0.0
        along = north_m * math.cos(self.heading_rad) + east_m * math.sin(self.heading_rad)
        return float(np.interp(along, [s for s, _ in self.points], [h for _, h in self.points]))

    def heights(self, points: Array) -> Array:
        """(N,) heights under points (N, 2 or more) of north, east."""
        if not self.points:
            return np.zeros(len(points))
        return np.interp(self.along(points), [s for s, _ in self.points], [h for _, h in self.points])

    def along(self, points: Array) -> Array:
        """(N,) distances along the heading of points (N, 2 or more) of north, east."""
        return points[:, 0] * math.cos(self.heading_rad) + points[:, 1] * math.sin(self.heading_rad)

    def facets(self) -> tuple[Facet, ...]:
        """The plane strips in their order along the heading; one without bounds if the ground is level."""
        if not self.points:
            return (Facet(),)
        (first, low), (last, high) = self.points[0], self.points[-1]
        edges = ((-math.inf, low), *self.points, (math.inf, high))
        north, east = math.cos(self.heading_rad), math.sin(self.heading_rad)
        out: list[Facet] = []
        for (a, height_a), (b, height_b) in itertools.pairwise(edges):
            grade = 0.0 if a < first or b > last else (height_b - height_a) / (b - a)
            offset = height_a if a < first or b > last else height_a - grade * a
            out.append(Facet(a, b, offset, grade * north, grade * east))
        return tuple(out)

    def hides(self, eye: Array, points: Array) -> NDArray[np.bool_]:
        """Whether the ground lies between the eye (3,) and each of the points (N, 3), all NED."""
        hidden = np.zeros(len(points), bool)
        if not self.points or not len(points):
            return hidden
        begin, ends = float(self.along(eye[None])[0]), self.along(points)
        span = np.where(np.abs(ends - begin) < 1e-6, 1e-6, ends - begin)
        for along, height in self.points:  # between two of them ground and line of sight are both straight
            part = (along - begin) / span
            sight = -(eye[2] + part * (points[:, 2] - eye[2]))
            hidden |= (part > 0.0) & (part < 1.0) & (sight < height - SUNK_M)
        return hidden

    def cast(self, points: Array, north: float, east: float) -> Array:
        """Points (N, 3) moved along the sun's rays, by (north, east) per metre of height, to just above the ground."""
        drop = -points[:, 2:] - self.heights(points)[:, None]
        for _ in range(CAST_ROUNDS if self.points else 0):
            drop = -points[:, 2:] - self.heights(points + drop * (north, east, 0.0))[:, None]
        out = points + drop * (north, east, 0.0)
        out[:, 2] = -self.heights(out) - SHADOW_M
        return out


LEVEL = Terrain()


def slope(grade: float, start_m: float, length_m: float, blend_m: float = 12.0, heading_rad: float = 0.0) -> Terrain:
    """Ground that begins to rise (grade > 0) or fall at `start_m` along the heading, and is level `length_m` later.

    The grade grows linearly over the first `blend_m` and shrinks over the last, so that the slope has no sharp edge.
    Raises ValueError unless two blends fit into the length.
    """
    if not 0.0 < 2.0 * blend_m <= length_m:
        raise ValueError(f"a slope of {length_m:g} m has no room for two blends of {blend_m:g} m: make it longer")
    u = np.linspace(0.0, blend_m, BLEND_PARTS + 1)
    rise = grade * u * u / (2.0 * blend_m)
    top = grade * (length_m - blend_m)
    begin = zip((start_m + u).tolist(), rise.tolist(), strict=True)
    end = zip((start_m + length_m - u[::-1]).tolist(), (top - rise[::-1]).tolist(), strict=True)
    points = dict((*begin, *end))
    return Terrain(tuple(points.items()), heading_rad)
