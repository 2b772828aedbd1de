"""Solid things as polygons in the image, and how they are filled."""

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from follow.geometry import Intrinsics
from sim.scene.bodies import Mesh
from sim.scene.ground import Image
from sim.scene.terrain import Facet
from sim.scene.trees import Sprite
from sim.scene.world import ActorPose, Array, Colour

NEAR_M = 0.4  # nothing closer is drawn: faces are cut there, limbs left out
FRACTION = 4  # bits of fraction in OpenCV's polygon corners

Polygon = tuple[NDArray[np.int32], Colour]


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """Where a camera is and how it looks: `rotation` is camera axes to NED, `position` (3,) NED."""

    camera: Intrinsics
    rotation: Array
    position: Array

    def project(self, points: Array) -> tuple[Array, Array]:
        """(N, 2) pixels of an ideal pinhole and (N,) depths; the pixels of points behind the camera are meaningless."""
        seen = (points - self.position) @ self.rotation
        depth = seen[:, 2]
        safe = np.maximum(depth, 1e-3)[:, None]
        return seen[:, :2] / safe * (self.camera.fx, self.camera.fy) + (self.camera.cx, self.camera.cy), depth

    def homography(self, facet: Facet) -> Array:
        """(3, 3) from (north, east, 1) on a plane of the ground to pixels times depth."""
        inner = np.array([[self.camera.fx, 0, self.camera.cx], [0, self.camera.fy, self.camera.cy], [0, 0, 1.0]])
        north, east, down = self.position
        below = [-facet.north_grade, -facet.east_grade, -facet.offset_m - down]
        ground_to_ned = np.array([[1, 0, -north], [0, 1, -east], below])
        return np.asarray(inner @ self.rotation.T @ ground_to_ned)


@dataclass(frozen=True, slots=True, eq=False)
class Drawn:
    """One thing in the image, ready to be filled: polygons in order, then perhaps a crown."""

    distance_m: float
    polygons: list[Polygon]
    low: tuple[float, float]
    high: tuple[float, float]
    sprite: Sprite | None = None
    crown: tuple[float, float, float] = (0.0, 0.0, 0.0)  # centre x, y and radius in pixels


_ARC = np.arange(5) * math.pi / 4
_COS, _SIN = np.cos(_ARC)[None, :, None], np.sin(_ARC)[None, :, None]


def capsules(p: Array, q: Array, rp: Array, rq: Array) -> Array:
    """(N, 10, 2) outlines of limbs between points (N, 2) of the image, round at both ends with radii (N,)."""
    away = q - p
    along = away / np.maximum(np.sqrt((away * away).sum(axis=1)), 1e-6)[:, None]
    side = along[:, ::-1] * (-1.0, 1.0)
    arc = _COS * side[:, None] + _SIN * along[:, None]
    out = np.empty((len(p), 2 * len(_ARC), 2))
    out[:, : len(_ARC)] = q[:, None] + rq[:, None, None] * arc
    out[:, len(_ARC) :] = p[:, None] - rp[:, None, None] * arc
    return out


def outlines(view: View, mesh: Mesh, points: Array | None = None) -> list[Polygon]:
    """Each part's polygon in fixed-point pixels, in the parts' own order; faces turned away are left out.

    `points` are the mesh's points where they are to be drawn elsewhere (as a shadow).
    """
    return outlined_parts(view, mesh, points)[1]


def outlined_parts(view: View, mesh: Mesh, points: Array | None = None) -> tuple[NDArray[np.int64], list[Polygon]]:
    """Which parts of a mesh are not left out, and the `outlines` of these."""
    pixels, depth = view.project(mesh.points if points is None else points)
    flat = fixed(pixels)
    first = mesh.starts[:-1]
    # In the image a face seen from outside turns clockwise: its first corner turns to the right.
    u, w = pixels[first + 1] - pixels[first], pixels[np.minimum(first + 2, len(pixels) - 1)] - pixels[first + 1]
    shown = u[:, 0] * w[:, 1] - u[:, 1] * w[:, 0] > 0
    shown[mesh.limbs] = True
    whole = np.minimum.reduceat(depth, first) >= NEAR_M
    reaching = ~whole & (np.maximum.reduceat(depth, first) > NEAR_M)
    reaching[mesh.limbs] = False
    shown &= whole
    rounds: dict[int, NDArray[np.int32]] = {}
    for k in np.flatnonzero(reaching).tolist():
        part = slice(mesh.starts[k], mesh.starts[k + 1])
        if len(corners := cut_near(view, (mesh.points if points is None else points)[part])):
            rounds[k], shown[k] = fixed(corners), True
    if len(mesh.limbs):
        start = first[mesh.limbs]
        radii, near = mesh.radii * view.camera.fx, np.maximum(depth, NEAR_M)
        shapes = capsules(pixels[start], pixels[start + 1], radii[:, 0] / near[start], radii[:, 1] / near[start + 1])
        rounds |= zip(mesh.limbs.tolist(), fixed(shapes), strict=True)
    edges, parts = mesh.starts.tolist(), np.flatnonzero(shown)
    return parts, [
        (rounds[k] if k in rounds else flat[edges[k] : edges[k + 1]], mesh.colours[k]) for k in parts.tolist()
    ]


def cut_near(view: View, corners: Array) -> Array:
    """(M, 2) pixels of the part beyond NEAR_M of a flat convex face (N, 3) NED; empty if it is turned away."""
    seen = (corners - view.position) @ view.rotation
    if np.linalg.det(seen[:3]) <= 0:  # the sign of its turn in the image, which needs no projection
        return np.empty((0, 2))
    depth, out = seen[:, 2], list[Array]()
    for k in range(len(seen)):
        j = (k + 1) % len(seen)
        if depth[k] >= NEAR_M:
            out.append(seen[k])
        if (depth[k] >= NEAR_M) != (depth[j] >= NEAR_M):
            out.append(seen[k] + (seen[j] - seen[k]) * ((NEAR_M - depth[k]) / (depth[j] - depth[k])))
    cut = np.array(out)
    return cut[:, :2] / cut[:, 2:] * (view.camera.fx, view.camera.fy) + (view.camera.cx, view.camera.cy)


def fixed(points: Array) -> NDArray[np.int32]:
    """Pixels (0 is a pixel's edge) to OpenCV's corners (0 is a pixel's middle)."""
    return np.rint(np.clip((points - 0.5) * (1 << FRACTION), -1e6, 1e6)).astype(np.int32)


def outlined(distance_m: float, polygons: list[Polygon]) -> Drawn | None:
    """The thing that these polygons draw; None without polygons."""
    if not polygons:
        return None
    points = np.concatenate([p for p, _ in polygons]) / float(1 << FRACTION) + 0.5
    low, high = points.min(axis=0), points.max(axis=0)
    return Drawn(distance_m, polygons, (float(low[0]), float(low[1])), (float(high[0]), float(high[1])))


def drawn_body(view: View, pose: ActorPose, mesh: Mesh) -> Drawn | None:
    """An actor: limbs from far to near, faces in the order of their body (hull, then cabin)."""
    distance = math.hypot(pose.north_m - view.position[0], pose.east_m - view.position[1])
    polygons = outlines(view, mesh)
    if len(mesh.limbs) == len(mesh.colours) == len(polygons):
        first = mesh.starts[:-1]
        middles = (mesh.points[first] + mesh.points[first + 1]) / 2 - view.position
        polygons = [polygons[k] for k in np.argsort(-(middles * middles).sum(axis=1), kind="stable").tolist()]
    return outlined(distance, polygons)


def fill(image: Image, thing: Drawn) -> None:
    """Draw one thing over what is there."""
    for polygon, colour in thing.polygons:
        cv2.fillConvexPoly(image, polygon, colour, cv2.LINE_AA, FRACTION)
    if thing.sprite is not None:
        thing.sprite.blend(image, *thing.crown)


def fill_mask(mask: Image, thing: Drawn, x0: int, y0: int, value: int) -> None:
    """Fill a thing's silhouette on a mask whose first pixel is the image's (x0, y0)."""
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
