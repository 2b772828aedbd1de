"""What the camera sees: the ground, then everything else as polygons from far to near."""

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
from sim.scene.ground import SHADE, Image
from sim.scene.surface import Surface
from sim.scene.trees import sprites
from sim.scene.world import Array, Colour, World

FAR_M = 260.0  # nothing farther than this is drawn except the ground
TRUNK: Colour = (48, 62, 78)


@dataclass(frozen=True, slots=True)
class Seen:
    """The ground truth of one actor in one image: its whole box and its visible fraction (0..1)."""

    box: Box | None
    visible: float


class Scene:
    """Draws a world.  Same world, view and time: same bytes."""

    def __init__(self, world: World, camera: Intrinsics) -> None:
        self.world, self.camera = world, camera
        self.surface = Surface(world, camera)
        self.sprites = sprites(world.seed)
        drafts = [built(block, world.sun, world.terrain) for block in world.blocks]
        self.built = Mesh.of([part for parts in drafts for part in parts])  # merged: all buildings in one projection
        self.first_parts = np.cumsum([0, *map(len, drafts)])  # block k has the parts first_parts[k]:first_parts[k + 1]
        self.middles = np.array([(b.north_m, b.east_m, -b.height_m / 2) for b in world.blocks]).reshape(-1, 3)
        self.middles[:, 2] -= world.terrain.heights(self.middles)
        self.radii = np.array([t.radius_m for t in world.trees])
        self.heights = np.array([t.height_m for t in world.trees])
        self.crowns = np.array([(t.north_m, t.east_m, t.radius_m - t.height_m) for t in world.trees]).reshape(-1, 3)
        self.feet = self.crowns * (1, 1, 0)
        self.feet[:, 2] -= world.terrain.heights(self.crowns)
        self.crowns[:, 2] += self.feet[:, 2]

    def draw(self, view: View, t_s: float) -> tuple[Image, tuple[Seen, ...]]:
        """The image without the faults of lens and sensor, and the ground truth of each actor.

        It is BGRA with the last channel unused: OpenCV warps four channels three times faster than three.
        """
        image = self.surface.draw(view)
        poses = self.world.poses(t_s)
        bodies = [body(a, p, self.world.sun) for a, p in zip(self.world.actors, poses, strict=True)]
        for mesh in bodies:
            self._shadow(image, view, mesh)
        actors = [drawn_body(view, p, mesh) for p, mesh in zip(poses, bodies, strict=True)]
        hidden = self.world.terrain.hides(
            view.position, np.array([mesh.points.mean(axis=0) for mesh in bodies])
        ).tolist()
        shown = [d for d, behind in zip(actors, hidden, strict=True) if d is not None and not behind]
        things = self._blocks(view) + self._trees(view) + shown
        things = [d for d in things if self._inside(d)]
        things.sort(key=lambda d: -d.distance_m)
        for thing in things:
            fill(image, thing)
        return image, tuple(self._seen(d, things, hidden=h) for d, h in zip(actors, hidden, strict=True))

    def _blocks(self, view: View) -> list[Drawn]:
        """Buildings and walls that may be in the image; a crest hides one whole or not at all, by its middle."""
        if not self.world.blocks:
            return []
        out: list[Drawn] = []
        parts, polygons = outlined_parts(view, self.built)
        cuts = np.searchsorted(parts, self.first_parts).tolist()
        pixels, depth = view.project(self.middles)
        away = np.hypot(self.middles[:, 0] - view.position[0], self.middles[:, 1] - view.position[1])
        away = np.where(self.world.terrain.hides(view.position, self.middles), np.inf, away).tolist()
        for k, block in enumerate(self.world.blocks):
            reach = block.length_m / 2 + block.width_m / 2 + block.height_m
            if away[k] > FAR_M or depth[k] < -reach or (depth[k] > reach and self._beside(pixels[k], reach / depth[k])):
                continue
            near = away[k] - (0.5 * min(block.length_m, block.width_m) if block.windows else 0.0)
            if drawn := outlined(near, polygons[cuts[k] : cuts[k + 1]]):
                out.append(drawn)
        return out

    def _trees(self, view: View) -> list[Drawn]:
        """A trunk and a crown that always faces the camera, for each tree that may be in the image."""
        if not len(self.crowns):
            return []
        c = self.camera
        pixels, depth = view.project(self.crowns)
        away = np.hypot(self.crowns[:, 0] - view.position[0], self.crowns[:, 1] - view.position[1])
        away[self.world.terrain.hides(view.position, self.crowns)] = np.inf
        scale = c.fx / np.maximum(depth, NEAR_M)  # pixels a metre
        radius, height = self.radii * scale, self.heights * scale
        x, y = pixels[:, 0], pixels[:, 1]
        shown = (away < FAR_M) & (depth > NEAR_M + self.radii) & (y > -radius) & (y < c.height + 2 * height)
        shown = np.flatnonzero(shown & (x > -2 * height) & (x < c.width + 2 * height))
        if not len(shown):
            return []
        pixels, radius = pixels[shown], radius[shown]
        below, foot_depth = view.project(self.feet[shown])
        thick = 0.07 * self.radii[shown]
        trunks = fixed(capsules(below, pixels, thick * c.fx / np.maximum(foot_depth, NEAR_M), thick * scale[shown]))
        rows = zip(shown.tolist(), away[shown].tolist(), pixels.tolist(), radius.tolist(), strict=True)
        feet = zip(trunks, below[:, 1].tolist(), (foot_depth > NEAR_M).tolist(), strict=True)
        out: list[Drawn] = []
        for (k, distance, (mx, my), r), (trunk, foot_y, rooted) in zip(rows, feet, strict=True):
            low_y, high_y = (min(my - r, foot_y), max(my + r, foot_y)) if rooted else (my - r, my + r)
            polygons = [(trunk, TRUNK)] if rooted else []
            sprite = self.sprites[self.world.trees[k].sprite % len(self.sprites)]
            out.append(Drawn(distance, polygons, (mx - r, low_y), (mx + r, high_y), sprite, (mx, my, r)))
        return out

    def _beside(self, pixel: Array, reach: float) -> bool:
        """Whether a ball about that pixel, its radius over its depth being `reach`, is outside the image."""
        margin, (x, y) = reach * self.camera.fx * 1.5, pixel.tolist()
        c = self.camera
        return x < -margin or y < -margin or x > c.width + margin or y > c.height + margin

    def _inside(self, thing: Drawn) -> bool:
        across = thing.high[0] > 0 and thing.low[0] < self.camera.width
        return across and thing.high[1] > 0 and thing.low[1] < self.camera.height

    def _shadow(self, image: Image, view: View, mesh: Mesh) -> None:
        """Darken the ground where an actor stands in the light."""
        north, east = self.world.sun.shadow()
        points = self.world.terrain.cast(mesh.points, north, east)
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

    def _seen(self, actor: Drawn | None, things: list[Drawn], *, hidden: bool) -> Seen:
        """The box of all that was drawn of an actor, and the fraction of its silhouette that shows."""
        if actor is None or actor.low[0] == actor.high[0] or actor.low[1] == actor.high[1]:
            return Seen(None, 0.0)  # also an actor that the near plane cuts down to a line
        box = Box(actor.low[0], actor.low[1], actor.high[0] - actor.low[0], actor.high[1] - actor.low[1])
        before = [d for d in things if d.distance_m < actor.distance_m and overlap(d, actor)]
        c = self.camera
        whole = box.x >= 0 and box.y >= 0 and box.x + box.w <= c.width and box.y + box.h <= c.height
        if whole and not before and not hidden:
            return Seen(box, 1.0)
        if hidden or box.w > 4 * c.width or box.h > 4 * c.height:
            return Seen(box, 0.0)
        x0, y0 = math.floor(box.x) - 1, math.floor(box.y) - 1
        mask = np.zeros((math.ceil(box.h) + 3, math.ceil(box.w) + 3), np.uint8)
        fill_mask(mask, actor, x0, y0, 255)
        total = int(np.count_nonzero(mask))
        for thing in before:
            fill_mask(mask, thing, x0, y0, 0)
        inside = mask[max(-y0, 0) : max(c.height - y0, 0), max(-x0, 0) : max(c.width - x0, 0)]
        return Seen(box, float(np.count_nonzero(inside)) / total if total else 0.0)
