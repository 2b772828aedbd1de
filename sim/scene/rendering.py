"""What the camera sees: the ground by one homography per distance, everything else as polygons from far to near."""

import itertools
import math
from dataclasses import dataclass

import cv2
import numpy as np

from follow.geometry import Intrinsics
from racf.box import Box
from sim.scene.bodies import Mesh, body
from sim.scene.buildings import built
from sim.scene.drawing import (
    FRACTION,
    NEAR_M,
    Drawn,
    View,
    capsules,
    drawn_body,
    fill,
    fill_mask,
    fixed,
    outlined,
    outlined_parts,
    outlines,
    overlap,
)
from sim.scene.ground import CELL_M, DETAIL_CELL_M, DETAIL_SIZE, LEVELS, SHADE, Ground, Image, ground
from sim.scene.trees import sprites
from sim.scene.world import Array, Colour, World

FAR_M = 260.0  # nor anything farther but the ground
HAZE: Colour = (214, 206, 196)
SKY: Colour = (232, 205, 170)
TRUNK: Colour = (48, 62, 78)


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
        drafts = [built(block, world.sun) for block in world.blocks]
        self.built = Mesh.of([part for parts in drafts for part in parts])  # one mesh: what stands is projected at once
        self.first_parts = np.cumsum([0, *map(len, drafts)])  # block k has the parts first_parts[k]:first_parts[k + 1]
        self.middles = np.array([(b.north_m, b.east_m, -b.above_m - b.height_m / 2) for b in world.blocks]).reshape(
            -1, 3
        )
        self.radii = np.array([t.radius_m for t in world.trees])
        self.heights = np.array([t.height_m for t in world.trees])
        self.crowns = np.array([(t.north_m, t.east_m, t.radius_m - t.height_m) for t in world.trees]).reshape(-1, 3)

    def draw(self, view: View, t_s: float) -> tuple[Image, tuple[Seen, ...]]:
        """The picture without the faults of lens and sensor, and what is true of each actor.

        It is BGRA with the last channel unused: OpenCV warps four channels three times faster than three.
        """
        image = self._ground(view)
        places = [actor.route.at(t_s) for actor in self.world.actors]
        bodies = [body(a, p, self.world.sun) for a, p in zip(self.world.actors, places, strict=True)]
        for mesh in bodies:
            self._shadow(image, view, mesh)
        actors = [drawn_body(view, p, mesh) for p, mesh in zip(places, bodies, strict=True)]
        things = self._blocks(view) + self._trees(view) + [d for d in actors if d is not None]
        things = [d for d in things if self._inside(d)]
        things.sort(key=lambda d: -d.distance_m)
        for thing in things:
            fill(image, thing)
        return image, tuple(self._seen(d, things) for d in actors)

    def _blocks(self, view: View) -> list[Drawn]:
        """Buildings and walls that may be in the picture."""
        if not self.world.blocks:
            return []
        out: list[Drawn] = []
        parts, polygons = outlined_parts(view, self.built)
        cuts = np.searchsorted(parts, self.first_parts).tolist()
        pixels, depth = view.project(self.middles)
        away = np.hypot(self.middles[:, 0] - view.place[0], self.middles[:, 1] - view.place[1]).tolist()
        for k, block in enumerate(self.world.blocks):
            reach = block.length_m / 2 + block.width_m / 2 + block.height_m
            if away[k] > FAR_M or depth[k] < -reach or (depth[k] > reach and self._beside(pixels[k], reach / depth[k])):
                continue
            near = away[k] - (0.5 * min(block.length_m, block.width_m) if block.windows else 0.0)
            if drawn := outlined(near, polygons[cuts[k] : cuts[k + 1]]):
                out.append(drawn)
        return out

    def _trees(self, view: View) -> list[Drawn]:
        """A trunk and a crown that always faces the camera, for each tree that may be in the picture."""
        if not len(self.crowns):
            return []
        c = self.camera
        pixels, depth = view.project(self.crowns)
        away = np.hypot(self.crowns[:, 0] - view.place[0], self.crowns[:, 1] - view.place[1])
        scale = c.fx / np.maximum(depth, NEAR_M)  # pixels a metre
        radius, height = self.radii * scale, self.heights * scale
        x, y = pixels[:, 0], pixels[:, 1]
        shown = (away < FAR_M) & (depth > NEAR_M + self.radii) & (y > -radius) & (y < c.height + 2 * height)
        shown = np.flatnonzero(shown & (x > -2 * height) & (x < c.width + 2 * height))
        if not len(shown):
            return []
        pixels, radius = pixels[shown], radius[shown]
        below, foot_depth = view.project(self.crowns[shown] * (1, 1, 0))
        thick = 0.07 * self.radii[shown]
        trunks = fixed(capsules(below, pixels, thick * c.fx / np.maximum(foot_depth, NEAR_M), thick * scale[shown]))
        rows = zip(shown.tolist(), away[shown].tolist(), pixels.tolist(), radius.tolist(), strict=True)
        feet = zip(trunks, below[:, 1].tolist(), (foot_depth > NEAR_M).tolist(), strict=True)
        out: list[Drawn] = []
        for (k, distance, (mx, my), r), (trunk, foot_y, stands) in zip(rows, feet, strict=True):
            low_y, high_y = (min(my - r, foot_y), max(my + r, foot_y)) if stands else (my - r, my + r)
            polygons = [(trunk, TRUNK)] if stands else []
            sprite = self.sprites[self.world.trees[k].sprite % len(self.sprites)]
            out.append(Drawn(distance, polygons, (mx - r, low_y), (mx + r, high_y), sprite, (mx, my, r)))
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
        image = np.empty((c.height, c.width, 4), np.uint8)
        rows = np.arange(c.height) + 0.5
        height = max(-float(view.place[2]), 0.2)
        down = view.rotation[2, 1] * (rows - c.cy) / c.fy + view.rotation[2, 2]
        depth = height / np.maximum(down, 1e-3)
        cells = depth / c.fx * np.sqrt(np.maximum(depth / height, 1.0)) / CELL_M
        levels = np.clip(np.round(np.log2(cells) - 0.2), 0, LEVELS - 1).astype(int)
        to_ground = np.asarray(np.linalg.inv(view.homography()), np.float64)
        # Nothing of the ground is in a row that is above the horizon from end to end.
        tilt = abs(float(view.rotation[2, 0])) * max(c.cx, c.width - c.cx) / c.fx
        first = int(np.count_nonzero(np.logical_and.accumulate(down + tilt <= 0)))
        starts = [first, *(np.flatnonzero(np.diff(levels[first:])) + 1 + first).tolist(), c.height]
        for start, end in itertools.pairwise(starts if first < c.height else []):
            self._warp(image, to_ground, start, end, int(levels[start]))
        # Fade the grain in, so that no line shows where it begins.
        strength = np.clip(0.5 * (0.9 - cells), 0.0, 0.35) * (down > 0)
        fine = np.flatnonzero(strength)
        if len(fine):
            self._grain(image, view, to_ground, int(fine[0]), int(fine[-1]) + 1, strength)
        self._sky(image, view, height)
        return image

    def _warp(self, image: Image, to_ground: Array, start: int, end: int, level: int) -> None:
        g = self.ground
        texture, cell_m = g.levels[level], CELL_M * 2**level
        before_m = (len(texture) * cell_m - g.size_m) / 2  # by how much it begins earlier than the finest
        matrix = texels(cell_m, g.north_m - before_m, g.east_m - before_m) @ to_ground @ below(start)
        size, flags = (self.camera.width, end - start), cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        cv2.warpPerspective(texture, matrix, size, image[start:end], flags, cv2.BORDER_WRAP)

    def _grain(self, image: Image, view: View, to_ground: Array, start: int, end: int, strength: Array) -> None:
        """Structure finer than the texture's texels, close by.  The tile repeats, so it is moved under the camera."""
        period = DETAIL_CELL_M * DETAIL_SIZE
        half = DETAIL_CELL_M * len(self.ground.detail) / 2
        north, east = (math.floor((view.place[k] - half) / period + 0.5) * period for k in (0, 1))
        matrix = texels(DETAIL_CELL_M, north, east) @ to_ground @ below(start)
        size, flags = (self.camera.width, end - start), cv2.INTER_NEAREST | cv2.WARP_INVERSE_MAP
        grain = cv2.warpPerspective(self.ground.detail, matrix, size, None, flags, cv2.BORDER_CONSTANT, (128,))
        step = 24
        for row in range(start, end, step):
            band = image[row : min(row + step, end)]
            weight = float(strength[row])
            lines = cv2.cvtColor(grain[row - start : row - start + len(band)], cv2.COLOR_GRAY2BGRA)
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

    def _shadow(self, image: Image, view: View, mesh: Mesh) -> None:
        """Darken the ground where an actor stands in the light."""
        north, east = self.world.sun.shadow()
        points = on_ground(mesh.points, north, east)
        polygons = [polygon for polygon, _ in outlines(view, mesh, points)]
        if not polygons:
            return
        corners = np.concatenate(polygons) >> FRACTION
        x0, y0 = np.maximum(corners.min(axis=0) - 2, 0).tolist()
        x1, y1 = np.minimum(corners.max(axis=0) + 3, (self.camera.width, self.camera.height)).tolist()
        if x0 >= x1 or y0 >= y1:
            return
        whole = np.full(image.shape[:2], 255, np.uint8)
        for polygon in polygons:
            cv2.fillConvexPoly(whole, polygon, (round(255 * SHADE),), cv2.LINE_AA, FRACTION)
        light = cv2.blur(whole[y0:y1, x0:x1], (3, 3))
        region = image[y0:y1, x0:x1]
        cv2.multiply(region, cv2.merge([light] * 4), region, 1 / 255)

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


def texels(cell_m: float, north_m: float, east_m: float) -> Array:
    """(3, 3) from the ground (north, east, 1) to a texture's (column, row, 1), OpenCV's 0 being a texel's middle."""
    return np.array([[0, 1 / cell_m, -east_m / cell_m - 0.5], [1 / cell_m, 0, -north_m / cell_m - 0.5], [0, 0, 1]])


def below(start: int) -> Array:
    """(3, 3) from OpenCV's pixels of a band that begins at row `start` to pixels of the picture."""
    return np.array([[1, 0, 0.5], [0, 1, 0.5 + start], [0, 0, 1]])


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
    out = points + -points[:, 2:] * (north, east, 0.0)
    out[:, 2] = -0.01
    return out
