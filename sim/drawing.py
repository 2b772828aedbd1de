"""Solid things as polygons in the picture, and how they are filled."""

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from follow.geometry import Intrinsics
from sim.body import Part
from sim.ground import Image
from sim.trees import Sprite
from sim.world import Array, Colour, Place

NEAR_M = 0.4  # nothing closer is drawn
FRACTION = 4  # bits of fraction in OpenCV's polygon corners

Polygon = tuple[NDArray[np.int32], Colour]


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """Where a camera is and how it looks: `rotation` is camera axes to NED, `place` (3,) NED."""

    camera: Intrinsics
    rotation: Array
    place: Array

    def project(self, points: Array) -> tuple[Array, Array]:
        """(N, 2) pixels of an ideal pinhole and (N,) depths; what lies behind has no meaning but its depth."""
        seen = (points - self.place) @ self.rotation
        depth = seen[:, 2]
        safe = np.where(depth > 1e-3, depth, 1e-3)[:, None]
        return seen[:, :2] / safe * (self.camera.fx, self.camera.fy) + (self.camera.cx, self.camera.cy), depth

    def homography(self) -> Array:
        """(3, 3) from (north, east, 1) on the ground to pixels."""
        inner = np.array([[self.camera.fx, 0, self.camera.cx], [0, self.camera.fy, self.camera.cy], [0, 0, 1.0]])
        ground_to_ned = np.array([[1, 0, -self.place[0]], [0, 1, -self.place[1]], [0, 0, -self.place[2]]])
        return np.asarray(inner @ self.rotation.T @ ground_to_ned)


@dataclass(frozen=True, slots=True, eq=False)
class Drawn:
    """One thing in the picture, ready to be filled: polygons in order, then perhaps a crown."""

    distance_m: float
    polygons: list[Polygon]
    low: tuple[float, float]
    high: tuple[float, float]
    sprite: Sprite | None = None
    crown: tuple[float, float, float] = (0.0, 0.0, 0.0)  # centre x, y and radius in pixels


_ARC = np.arange(5) * math.pi / 4
_ROUND = np.stack([np.cos(_ARC), np.sin(_ARC)], axis=1)


def capsules(p: Array, q: Array, rp: Array, rq: Array) -> Array:
    """(N, 10, 2) outlines of limbs between points (N, 2) of the picture, round at both ends with radii (N,)."""
    away = q - p
    along = away / np.maximum(np.hypot(away[:, 0], away[:, 1]), 1e-6)[:, None]
    side = np.stack([-along[:, 1], along[:, 0]], axis=1)
    arc = _ROUND[None, :, :1] * side[:, None] + _ROUND[None, :, 1:] * along[:, None]
    return np.concatenate([q[:, None] + rq[:, None, None] * arc, p[:, None] - rp[:, None, None] * arc], axis=1)


def outlines(view: View, parts: list[Part]) -> list[Polygon]:
    """Each part's polygon in fixed-point pixels, in the parts' own order; faces turned away are left out."""
    pixels, depth = view.project(np.concatenate([part.points for part in parts]))
    flat, far = fixed(pixels), depth.tolist()
    starts = np.cumsum([0] + [len(part.points) for part in parts]).tolist()
    limbs = [k for k, part in enumerate(parts) if part.radii is not None]
    rounds: dict[int, NDArray[np.int32]] = {}
    if limbs:
        first = np.array([starts[k] for k in limbs])
        radii = np.array([parts[k].radii for k in limbs]) * view.camera.fx
        near = np.maximum(depth, NEAR_M)
        shapes = capsules(pixels[first], pixels[first + 1], radii[:, 0] / near[first], radii[:, 1] / near[first + 1])
        rounds = dict(zip(limbs, fixed(shapes), strict=True))
    out: list[Polygon] = []
    for k, part in enumerate(parts):
        start, end = starts[k], starts[k + 1]
        if min(far[start:end]) < NEAR_M:
            continue
        if k in rounds:
            out.append((rounds[k], part.colour))
        elif not turned_away(flat[start:end].tolist()):
            out.append((flat[start:end], part.colour))
    return out


def turned_away(corners: list[list[int]]) -> bool:
    """Whether a face's corners run counter-clockwise in the picture: its back is seen."""
    (x0, y0), (x1, y1), (x2, y2) = corners[:3]
    return (x1 - x0) * (y2 - y1) - (y1 - y0) * (x2 - x1) <= 0


def fixed(points: Array) -> NDArray[np.int32]:
    """Pixels (0 is a pixel's edge) to OpenCV's corners (0 is a pixel's middle)."""
    return np.rint(np.clip((points - 0.5) * (1 << FRACTION), -1e6, 1e6)).astype(np.int32)


def outlined(distance_m: float, polygons: list[Polygon]) -> Drawn | None:
    """What is filled by these polygons."""
    if not polygons:
        return None
    points = np.concatenate([p for p, _ in polygons]) / float(1 << FRACTION) + 0.5
    low, high = points.min(axis=0), points.max(axis=0)
    return Drawn(distance_m, polygons, (float(low[0]), float(low[1])), (float(high[0]), float(high[1])))


def drawn_body(view: View, place: Place, parts: list[Part]) -> Drawn | None:
    """An actor: limbs from far to near, faces in the order of their body (hull, then cabin)."""
    if parts[-1].radii is not None:
        away = [float(np.sum((part.points.mean(axis=0) - view.place) ** 2)) for part in parts]
        parts = [parts[k] for k in sorted(range(len(parts)), key=lambda k: -away[k])]
    distance = math.hypot(place.north_m - view.place[0], place.east_m - view.place[1])
    return outlined(distance, outlines(view, parts))


def fill(image: Image, thing: Drawn) -> None:
    """Draw one thing over what is there."""
    for polygon, colour in thing.polygons:
        cv2.fillConvexPoly(image, polygon, colour, cv2.LINE_AA, FRACTION)
    if thing.sprite is not None:
        thing.sprite.blend(image, *thing.crown)


def fill_mask(mask: Image, thing: Drawn, x0: int, y0: int, value: int) -> None:
    """Fill a thing's silhouette on a mask whose first pixel is the picture's (x0, y0)."""
    for polygon, _ in thing.polygons:
        moved = polygon - (np.array([x0, y0], np.int32) << FRACTION)
        cv2.fillConvexPoly(mask, moved, (value,), cv2.LINE_8, FRACTION)
    if thing.sprite is not None:
        x, y, radius = thing.crown
        thing.sprite.cover(mask, x - x0, y - y0, radius, value)


def overlap(one: Drawn, other: Drawn) -> bool:
    """Whether two things' boxes touch."""
    across = one.low[0] < other.high[0] and other.low[0] < one.high[0]
    return across and one.low[1] < other.high[1] and other.low[1] < one.high[1]
