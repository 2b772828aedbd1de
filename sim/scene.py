"""What the camera sees: the ground by one homography per distance, everything else as polygons from far to near."""

import itertools
import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from follow.geometry import Intrinsics
from racf.box import Box
from sim.body import AMBIENT, Part, body, facing, shade
from sim.ground import CELL_M, DETAIL_CELL_M, DETAIL_SIZE, LEVELS, SHADE, Ground, Image, block_corners, ground
from sim.trees import Sprite, sprites
from sim.world import Array, Block, Colour, Place, Sun, World

NEAR_M = 0.4  # nothing closer is drawn
FAR_M = 260.0  # nor anything farther but the ground
HAZE: Colour = (214, 206, 196)
SKY: Colour = (232, 205, 170)
TRUNK: Colour = (48, 62, 78)
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


@dataclass(frozen=True, slots=True)
class Seen:
    """What is true of one actor in one picture: its whole box and which part of it shows (0..1)."""

    box: Box | None
    visible: float


class Scene:
    """Draws a world.  Same world, view and time: same bytes."""

    def __init__(self, world: World, camera: Intrinsics) -> None:
        self.world, self.camera = world, camera
        self.ground: Ground = ground(world)
        self.sprites = sprites(world.seed)
        self.built = [built(block, world.sun) for block in world.blocks]
        self.middles = np.array([(b.north_m, b.east_m, -b.above_m - b.height_m / 2) for b in world.blocks]).reshape(
            -1, 3
        )
        self.crowns = np.array([(t.north_m, t.east_m, t.radius_m - t.height_m) for t in world.trees]).reshape(-1, 3)

    def draw(self, view: View, t_s: float) -> tuple[Image, tuple[Seen, ...]]:
        """The picture without the faults of lens and sensor, and what is true of each actor."""
        image = self._ground(view)
        places = [actor.route.at(t_s) for actor in self.world.actors]
        bodies = [body(a, p, self.world.sun) for a, p in zip(self.world.actors, places, strict=True)]
        for parts in bodies:
            self._shadow(image, view, parts)
        actors = [drawn_body(view, p, parts) for p, parts in zip(places, bodies, strict=True)]
        things = self._blocks(view) + self._trees(view) + [d for d in actors if d is not None]
        things = [d for d in things if self._inside(d)]
        things.sort(key=lambda d: -d.distance_m)
        for thing in things:
            fill(image, thing)
        return image, tuple(self._seen(d, things) for d in actors)

    def _blocks(self, view: View) -> list[Drawn]:
        """Buildings and walls that may be in the picture."""
        out: list[Drawn] = []
        pixels, depth = view.project(self.middles)
        away = np.hypot(self.middles[:, 0] - view.place[0], self.middles[:, 1] - view.place[1]).tolist()
        for k, block in enumerate(self.world.blocks):
            reach = block.length_m / 2 + block.width_m / 2 + block.height_m
            if away[k] > FAR_M or depth[k] < -reach or (depth[k] > reach and self._beside(pixels[k], reach / depth[k])):
                continue
            near = away[k] - (0.5 * min(block.length_m, block.width_m) if block.windows else 0.0)
            if drawn := thing(near, outlines(view, self.built[k])):
                out.append(drawn)
        return out

    def _trees(self, view: View) -> list[Drawn]:
        """A trunk and a crown that always faces the camera, for each tree that may be in the picture."""
        out: list[Drawn] = []
        feet = self.crowns * (1, 1, 0)
        (pixels, depth), (below, foot_depth) = view.project(self.crowns), view.project(feet)
        away = np.hypot(feet[:, 0] - view.place[0], feet[:, 1] - view.place[1]).tolist()
        for k, tree in enumerate(self.world.trees):
            if (
                away[k] > FAR_M
                or depth[k] < NEAR_M + tree.radius_m
                or self._beside(pixels[k], tree.height_m / depth[k])
            ):
                continue
            f = self.camera.fx / float(depth[k])
            radius, (x, y) = tree.radius_m * f, pixels[k].tolist()
            low_y, high_y = y - radius, y + radius
            polygons: list[Polygon] = []
            if foot_depth[k] > NEAR_M:
                wide = 0.07 * tree.radius_m
                thick = np.array([wide * self.camera.fx / float(foot_depth[k])])
                trunk = capsules(below[k : k + 1], pixels[k : k + 1], thick, np.array([wide * f]))
                polygons.append((fixed(trunk[0]), TRUNK))
                low_y, high_y = min(low_y, float(below[k, 1])), max(high_y, float(below[k, 1]))
            sprite = self.sprites[tree.sprite % len(self.sprites)]
            out.append(Drawn(away[k], polygons, (x - radius, low_y), (x + radius, high_y), sprite, (x, y, radius)))
        return out

    def _beside(self, pixel: Array, reach: float) -> bool:
        """Whether a ball about that pixel, its radius over its depth being `reach`, is outside the picture."""
        margin, (x, y) = reach * self.camera.fx * 1.5, pixel.tolist()
        c = self.camera
        return x < -margin or y < -margin or x > c.width + margin or y > c.height + margin

    def _inside(self, thing: Drawn) -> bool:
        across = thing.high[0] > 0 and thing.low[0] < self.camera.width
        return across and thing.high[1] > 0 and thing.low[1] < self.camera.height

    def _ground(self, view: View) -> Image:
        """Warp the ground, row band by row band, from the copy whose texels are about a pixel large."""
        c = self.camera
        image = np.empty((c.height, c.width, 3), np.uint8)
        rows = np.arange(c.height) + 0.5
        height = max(-float(view.place[2]), 0.2)
        down = view.rotation[2, 1] * (rows - c.cy) / c.fy + view.rotation[2, 2]
        depth = height / np.maximum(down, 1e-3)
        texels = depth / c.fx * np.sqrt(np.maximum(depth / height, 1.0)) / CELL_M
        levels = np.clip(np.round(np.log2(texels) - 0.2), 0, LEVELS - 1).astype(int)
        homography = view.homography()
        starts = [0, *(np.flatnonzero(np.diff(levels)) + 1).tolist(), c.height]
        for start, end in itertools.pairwise(starts):
            self._warp(image, homography, start, end, int(levels[start]))
        # Fade the grain in, so that no line shows where it begins.
        strength = np.clip(0.5 * (0.9 - texels), 0.0, 0.35) * (down > 0)
        fine = np.flatnonzero(strength)
        if len(fine):
            self._grain(image, view, homography, int(fine[0]), int(fine[-1]) + 1, strength)
        self._sky(image, view, height)
        return image

    def _warp(self, image: Image, homography: Array, start: int, end: int, level: int) -> None:
        cell = CELL_M * 2**level
        texel = np.array(
            [[0, cell, self.ground.north_m + cell / 2], [cell, 0, self.ground.east_m + cell / 2], [0, 0, 1]]
        )
        shift = np.array([[1, 0, -0.5], [0, 1, -0.5 - start], [0, 0, 1.0]])
        matrix = np.linalg.inv(shift @ homography @ texel)
        source = self.ground.levels[level]
        size = (self.camera.width, end - start)
        flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        cv2.warpPerspective(source, matrix, size, image[start:end], flags, cv2.BORDER_WRAP)

    def _grain(self, image: Image, view: View, homography: Array, start: int, end: int, strength: Array) -> None:
        """Structure finer than the texture's texels, close by.  The tile repeats, so it is moved under the camera."""
        period = DETAIL_CELL_M * DETAIL_SIZE
        half = DETAIL_CELL_M * len(self.ground.detail) / 2
        north, east = (math.floor((view.place[k] - half) / period + 0.5) * period for k in (0, 1))
        cell = DETAIL_CELL_M
        texel = np.array([[0, cell, north + cell / 2], [cell, 0, east + cell / 2], [0, 0, 1]])
        shift = np.array([[1, 0, -0.5], [0, 1, -0.5 - start], [0, 0, 1.0]])
        matrix = np.linalg.inv(shift @ homography @ texel)
        size = (self.camera.width, end - start)
        flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        grain = cv2.warpPerspective(self.ground.detail, matrix, size, None, flags, cv2.BORDER_CONSTANT, (128,))
        step = 12
        for row in range(start, end, step):
            band = image[row : min(row + step, end)]
            weight = float(strength[row])
            lines = cv2.cvtColor(grain[row - start : row - start + len(band)], cv2.COLOR_GRAY2BGR)
            cv2.addWeighted(band, 1, lines, weight, -128 * weight, band)

    def _sky(self, image: Image, view: View, height: float) -> None:
        """Cover what lies above the horizon, and the haze before it."""
        c = self.camera
        frame = [(0.0, 0.0), (float(c.width), 0.0), (float(c.width), float(c.height)), (0.0, float(c.height))]
        for reach, colour in ((1.0, HAZE), (-0.01, SKY)):
            limit = height / 700.0 * reach if reach > 0 else reach
            row = view.rotation[2]
            down = [row[0] * (x - c.cx) / c.fx + row[1] * (y - c.cy) / c.fy + row[2] - limit for x, y in frame]
            polygon = clipped(frame, down)
            if len(polygon) >= 3:
                cv2.fillConvexPoly(image, np.round(np.array(polygon) - 0.5).astype(np.int32), colour)

    def _shadow(self, image: Image, view: View, parts: list[Part]) -> None:
        """Darken the ground where an actor stands in the light."""
        north, east = self.world.sun.shadow()
        polygons: list[NDArray[np.int32]] = []
        flat = [Part(on_ground(p.points, north, east), p.colour, p.radii) for p in parts]
        for polygon, _ in outlines(view, flat):
            polygons.append(polygon)
        if not polygons:
            return
        points = np.concatenate(polygons) >> FRACTION
        x0, y0 = np.maximum(points.min(axis=0) - 2, 0).tolist()
        x1, y1 = np.minimum(points.max(axis=0) + 3, (self.camera.width, self.camera.height)).tolist()
        if x0 >= x1 or y0 >= y1:
            return
        light = np.full((y1 - y0, x1 - x0), 255, np.uint8)
        for polygon in polygons:
            moved = polygon - (np.array([x0, y0], np.int32) << FRACTION)
            cv2.fillConvexPoly(light, moved, (round(255 * SHADE),), cv2.LINE_AA, FRACTION)
        light = cv2.blur(light, (3, 3))
        region = image[y0:y1, x0:x1]
        cv2.multiply(region, cv2.merge([light] * 3), region, 1 / 255)

    def _seen(self, actor: Drawn | None, things: list[Drawn]) -> Seen:
        """The box of all that was drawn of an actor, and the share of its silhouette that shows."""
        if actor is None:
            return Seen(None, 0.0)
        box = Box(actor.low[0], actor.low[1], actor.high[0] - actor.low[0], actor.high[1] - actor.low[1])
        before = [d for d in things if d.distance_m < actor.distance_m and overlap(d, actor)]
        c = self.camera
        whole = box.x >= 0 and box.y >= 0 and box.x + box.w <= c.width and box.y + box.h <= c.height
        if whole and not before:
            return Seen(box, 1.0)
        if box.w > 4 * c.width or box.h > 4 * c.height:
            return Seen(box, 0.0)
        x0, y0 = math.floor(box.x) - 1, math.floor(box.y) - 1
        mask = np.zeros((math.ceil(box.h) + 3, math.ceil(box.w) + 3), np.uint8)
        fill_mask(mask, actor, x0, y0, 255)
        total = int(np.count_nonzero(mask))
        for thing in before:
            fill_mask(mask, thing, x0, y0, 0)
        inside = mask[max(-y0, 0) : max(c.height - y0, 0), max(-x0, 0) : max(c.width - x0, 0)]
        return Seen(box, float(np.count_nonzero(inside)) / total if total else 0.0)


def clipped(polygon: list[tuple[float, float]], down: list[float]) -> list[tuple[float, float]]:
    """The part of a convex polygon where `down`, linear over the picture and given at the corners, is negative."""
    out: list[tuple[float, float]] = []
    for k, (x, y) in enumerate(polygon):
        following = (k + 1) % len(polygon)
        a, b = down[k], down[following]
        if a < 0:
            out.append((x, y))
        if (a < 0) != (b < 0):
            share = a / (a - b)
            out.append((x + share * (polygon[following][0] - x), y + share * (polygon[following][1] - y)))
    return out


def on_ground(points: Array, north: float, east: float) -> Array:
    """Points moved along the sun's rays to the ground, a hand above it."""
    height = -points[:, 2]
    return np.stack([points[:, 0] + north * height, points[:, 1] + east * height, np.full(len(points), -0.01)], axis=1)


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


def thing(distance_m: float, polygons: list[Polygon]) -> Drawn | None:
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
    return thing(distance, outlines(view, parts))


def built(block: Block, sun: Sun) -> list[Part]:
    """The faces of a building or of a piece of wall."""
    corners = block_corners(block)
    low = np.column_stack([corners, np.full(4, -block.above_m)])
    high = low - (0, 0, block.height_m)
    light = sun.toward()
    parts: list[Part] = []
    for k in range(4):
        j = (k + 1) % 4
        quad = np.array([low[j], low[k], high[k], high[j]])
        parts.append(lit(quad, block.colour, light))
        if block.windows:
            parts += windows(quad, block)
    return parts + (gable(high, block, light) if block.windows else [lit(high[::-1], block.roof, light)])


def lit(corners: Array, colour: Colour, light: tuple[float, float, float]) -> Part:
    """A face lit as it is turned; corners run clockwise seen from outside."""
    return Part(corners, shade(colour, AMBIENT + (1 - AMBIENT) * 1.2 * max(facing(corners, light), 0.0)))


def windows(quad: Array, block: Block) -> list[Part]:
    """Rows of windows on a wall given by its corners: bottom, bottom, top, top."""
    base, along, up = quad[0], quad[1] - quad[0], quad[3] - quad[0]
    columns = max(2, int(np.linalg.norm(along) / 3.0))
    floors = max(1, int(block.height_m / 2.8))
    parts: list[Part] = []
    for column in range(columns):
        for floor in range(floors):
            a, b = (column + 0.3) / columns, (column + 0.7) / columns
            c, d = (floor + 0.35) / floors, (floor + 0.8) / floors
            pane = np.array([base + along * u + up * v for u, v in ((a, c), (b, c), (b, d), (a, d))])
            parts.append(Part(pane, (78, 66, 55) if (3 * column + floor) % 4 else (120, 112, 100)))
    return parts


def gable(high: Array, block: Block, light: tuple[float, float, float]) -> list[Part]:
    """A pitched roof over the four upper corners, its ridge along the length (corners 0-1 and 2-3)."""
    rise = np.array([0, 0, -0.3 * block.width_m])
    first, second = (high[0] + high[3]) / 2 + rise, (high[1] + high[2]) / 2 + rise
    return [
        lit(np.array([high[1], high[0], first, second]), block.roof, light),
        lit(np.array([high[3], high[2], second, first]), block.roof, light),
        lit(np.array([high[0], high[3], first]), block.colour, light),
        lit(np.array([high[2], high[1], second]), block.colour, light),
    ]


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
