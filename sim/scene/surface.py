"""The ground as the camera sees it: each plane of the terrain by one homography, then haze and sky."""

import itertools
import math

import cv2
import numpy as np

from follow.geometry import Intrinsics
from sim.scene.drawing import View
from sim.scene.ground import CELL_M, DETAIL_CELL_M, DETAIL_SIZE, LEVELS, Ground, Image, ground
from sim.scene.terrain import Facet
from sim.scene.world import Array, Colour, World

FAR_GROUND_M = 700.0  # beyond it the ground is haze
HAZE: Colour = (214, 206, 196)
SKY: Colour = (232, 205, 170)
SKY_DOWN = -0.01  # rays that point less far down than this end in the sky, not in the haze
LEAST_HEIGHT_M = 0.2  # of the lens above the ground; from height 0 the ground would project to a line

Corners = list[tuple[float, float]]


class Surface:
    """Draws the ground of a world."""

    def __init__(self, world: World, camera: Intrinsics) -> None:
        self.camera, self.terrain = camera, world.terrain
        self.texture: Ground = ground(world)
        self.facets = world.terrain.facets()

    def draw(self, view: View) -> Image:
        """The BGRA image of ground, haze and sky, the last channel unused."""
        c = self.camera
        facet, *others = self.facets
        if others:
            return self._hills(view)
        image = np.empty((c.height, c.width, 4), np.uint8)
        normal = self._normal(view, facet)
        # Nothing of the ground is in a row that is above the horizon from end to end.
        tilt = abs(float(normal[0])) * max(c.cx, c.width - c.cx) / c.fx
        above = np.logical_and.accumulate(self._down(normal) + tilt <= 0)
        self._plane(image, view, facet, int(np.count_nonzero(above)), c.height)
        height = max(-float(view.position[2]), LEAST_HEIGHT_M)
        for limit, colour in ((height / FAR_GROUND_M, HAZE), (SKY_DOWN, SKY)):
            self._cover_above(image, view, limit, colour)
        return image

    def _hills(self, view: View) -> Image:
        """Sky and haze, then the planes drawn over them from far to near."""
        c = self.camera
        image = np.full((c.height, c.width, 4), (*HAZE, 0), np.uint8)
        self._cover_above(image, view, SKY_DOWN, SKY)
        here = float(self.terrain.along(view.position[None])[0])
        scratch, mask = np.empty_like(image), np.empty((c.height, c.width), np.uint8)
        away = {
            f: 0.0 if f.from_m <= here < f.to_m else min(abs(f.from_m - here), abs(f.to_m - here)) for f in self.facets
        }
        for facet in sorted(self.facets, key=lambda f: -away[f]):
            if self._height(view, facet) < LEAST_HEIGHT_M and away[facet] > 0.0:
                continue  # the camera is below this plane: nearer ground hides it
            corners = np.rint((np.array(self._outline(view, facet)).reshape(-1, 2) - 0.5) * 16).astype(np.int32)
            if len(corners) < 3:
                continue
            first = max(int(corners[:, 1].min() >> 4), 0)
            last = min(int(corners[:, 1].max() >> 4) + 2, c.height)
            if first >= last:
                continue
            self._plane(scratch, view, facet, first, last)
            mask[first:last] = 0
            cv2.fillConvexPoly(mask, corners, (255,), cv2.LINE_8, 4)
            cv2.copyTo(scratch[first:last], mask[first:last], image[first:last])
        return image

    def _outline(self, view: View, facet: Facet) -> Corners:
        """The convex part of the image in which the plane's strip lies, up to FAR_GROUND_M."""
        c = self.camera
        to_ground = np.linalg.inv(view.homography(facet))  # (north, east, 1) over depth
        heading = self.terrain.heading_rad
        along, near = math.cos(heading) * to_ground[0] + math.sin(heading) * to_ground[1], to_ground[2]
        lines = [np.array([0.0, 0.0, 1.0 / FAR_GROUND_M]) - near]
        if math.isfinite(facet.from_m):
            lines.append(facet.from_m * near - along)
        if math.isfinite(facet.to_m):
            lines.append(along - facet.to_m * near)
        outline = frame_of(c)
        for a, b, offset in lines:
            outline = clipped(outline, [a * x + b * y + offset for x, y in outline])
        return outline

    def _height(self, view: View, facet: Facet) -> float:
        """How high the camera is above a plane, measured vertically."""
        north, east, down = view.position.tolist()
        return -down - (facet.offset_m + facet.north_grade * north + facet.east_grade * east)

    def _normal(self, view: View, facet: Facet) -> Array:
        """(3,) how fast a ray along each axis of the camera nears the plane, measured vertically."""
        return np.array([facet.north_grade, facet.east_grade, 1.0]) @ view.rotation

    def _down(self, normal: Array) -> Array:
        """(rows,) how fast the ray through the middle of each row nears the plane."""
        c = self.camera
        return normal[1] * (np.arange(c.height) + 0.5 - c.cy) / c.fy + normal[2]

    def _plane(self, image: Image, view: View, facet: Facet, first: int, last: int) -> None:
        """Warp a plane into some rows, band by band, from the copy whose texels are about a pixel large."""
        down = self._down(self._normal(view, facet))
        height = max(self._height(view, facet), LEAST_HEIGHT_M)
        depth = height / np.maximum(down, 1e-3)
        cells = depth / self.camera.fx * np.sqrt(np.maximum(depth / height, 1.0)) / CELL_M
        levels = np.clip(np.round(np.log2(cells) - 0.2), 0, LEVELS - 1).astype(int)
        to_ground = np.asarray(np.linalg.inv(view.homography(facet)), np.float64)
        starts = [first, *(np.flatnonzero(np.diff(levels[first:last])) + 1 + first).tolist(), last]
        for start, end in itertools.pairwise(starts if first < last else []):
            self._warp(image, to_ground, start, end, int(levels[start]))
        # Fade the grain in, so that its edge is not visible.
        strength = np.clip(0.5 * (0.9 - cells), 0.0, 0.35) * (down > 0)
        fine = np.flatnonzero(strength[first:last]) + first
        if len(fine):
            self._grain(image, view, to_ground, int(fine[0]), int(fine[-1]) + 1, strength)

    def _warp(self, image: Image, to_ground: Array, start: int, end: int, level: int) -> None:
        g = self.texture
        texture, cell_m = g.levels[level], CELL_M * 2**level
        before_m = (len(texture) * cell_m - g.size_m) / 2  # by how much its origin lies before that of the finest
        matrix = texels(cell_m, g.north_m - before_m, g.east_m - before_m) @ to_ground @ below(start)
        size, flags = (self.camera.width, end - start), cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        cv2.warpPerspective(texture, matrix, size, image[start:end], flags, cv2.BORDER_WRAP)

    def _grain(self, image: Image, view: View, to_ground: Array, start: int, end: int, strength: Array) -> None:
        """Structure finer than the texture's texels, close by.  The tile repeats, so it is moved under the camera."""
        period = DETAIL_CELL_M * DETAIL_SIZE
        half = DETAIL_CELL_M * len(self.texture.detail) / 2
        north, east = (math.floor((view.position[k] - half) / period + 0.5) * period for k in (0, 1))
        matrix = texels(DETAIL_CELL_M, north, east) @ to_ground @ below(start)
        size, flags = (self.camera.width, end - start), cv2.INTER_NEAREST | cv2.WARP_INVERSE_MAP
        grain = cv2.warpPerspective(self.texture.detail, matrix, size, None, flags, cv2.BORDER_CONSTANT, (128,))
        step = 24
        for row in range(start, end, step):
            band = image[row : min(row + step, end)]
            weight = float(strength[row])
            lines = cv2.cvtColor(grain[row - start : row - start + len(band)], cv2.COLOR_GRAY2BGRA)
            cv2.addWeighted(band, 1, lines, weight, -128 * weight, band)

    def _cover_above(self, image: Image, view: View, limit: float, colour: Colour) -> None:
        """Fill the part of the image whose rays point down by less than `limit`."""
        c, row = self.camera, view.rotation[2]
        frame = frame_of(c)
        down = [row[0] * (x - c.cx) / c.fx + row[1] * (y - c.cy) / c.fy + row[2] - limit for x, y in frame]
        polygon = clipped(frame, down)
        if len(polygon) >= 3:
            cv2.fillConvexPoly(image, np.round(np.array(polygon) - 0.5).astype(np.int32), colour)


def frame_of(camera: Intrinsics) -> Corners:
    """The image's own outline."""
    w, h = float(camera.width), float(camera.height)
    return [(0.0, 0.0), (w, 0.0), (w, h), (0.0, h)]


def texels(cell_m: float, north_m: float, east_m: float) -> Array:
    """(3, 3) from the ground (north, east, 1) to a texture's (column, row, 1), OpenCV's 0 being a texel's middle."""
    return np.array([[0, 1 / cell_m, -east_m / cell_m - 0.5], [1 / cell_m, 0, -north_m / cell_m - 0.5], [0, 0, 1]])


def below(start: int) -> Array:
    """(3, 3) from OpenCV's pixels of a band that begins at row `start` to pixels of the image."""
    return np.array([[1, 0, 0.5], [0, 1, 0.5 + start], [0, 0, 1]])


def clipped(polygon: Corners, side: list[float]) -> Corners:
    """The part of a convex polygon where `side`, linear over the image and given at the corners, is negative."""
    out: Corners = []
    for k, (x, y) in enumerate(polygon):
        following = (k + 1) % len(polygon)
        a, b = side[k], side[following]
        if a < 0:
            out.append((x, y))
        if (a < 0) != (b < 0):
            fraction = a / (a - b)
            out.append((x + fraction * (polygon[following][0] - x), y + fraction * (polygon[following][1] - y)))
    return out
