"""The ground seen from above: one texture in north and east, with coarser copies of it for far away."""

import math
from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from sim.scene.terrain import Terrain
from sim.scene.world import Block, Colour, Road, Tree, World, dense

Image = NDArray[np.uint8]

CELL_M = 0.125  # one texel; finer structure comes from the detail tile
TILE = 1024  # texels after which noise repeats
DETAIL_CELL_M = 0.025
DETAIL_SIZE = 512  # texels after which it repeats: 12.8 m
DETAIL_TIMES = 4
LEVELS = 6
FAR_LEVELS = 2  # the coarsest: laid out many times, because OpenCV is slow where a texture has to wrap
FAR_TIMES = 9  # copies along each side; odd, so that the middle one lies on the ground itself
SHADE = 0.55  # light in shadow over light in the sun, a clear day

FIELDS: tuple[Colour, ...] = (
    (62, 112, 104),
    (58, 128, 118),
    (96, 152, 160),
    (52, 98, 82),
    (84, 128, 150),
    (70, 118, 92),
)


@dataclass(frozen=True, slots=True, eq=False)
class Ground:
    """`levels[k]` has texels of CELL_M·2^k; texel (row 0, column 0) of the finest begins at (`north_m`, `east_m`).

    The ground repeats; the coarsest copies hold it FAR_TIMES over, about the same middle.
    They are BGRA like the scene's images, the last channel unused.
    """

    levels: tuple[Image, ...]
    detail: Image
    north_m: float
    east_m: float

    @property
    def size_m(self) -> float:
        """How long and wide the ground is until it repeats."""
        return len(self.levels[0]) * CELL_M


def noise(random: np.random.Generator, size: int, coarsest: int, finest: int) -> NDArray[np.float32]:
    """Smooth noise that repeats at its edges: octaves from `coarsest` to `finest` texels, deviation about 1."""
    total = np.zeros((size, size), np.float32)
    cell, weight, power = coarsest, 1.0, 0.0
    while cell >= finest:
        count = size // cell
        grid = random.standard_normal((count, count)).astype(np.float32)
        ringed = cv2.copyMakeBorder(grid, 2, 2, 2, 2, cv2.BORDER_WRAP)
        big = cv2.resize(ringed, None, fx=cell, fy=cell, interpolation=cv2.INTER_CUBIC)
        total += weight * big[2 * cell : 2 * cell + size, 2 * cell : 2 * cell + size]
        power += weight * weight
        cell, weight = cell // 2, weight * 0.8
    return np.asarray(total / math.sqrt(power), np.float32)


class Painter:
    """Draws on the texture in metres."""

    def __init__(self, image: Image, north_m: float, east_m: float) -> None:
        self.image, self.north_m, self.east_m = image, north_m, east_m

    def texels(self, points: NDArray[np.float64]) -> NDArray[np.int32]:
        """(N, 2) of (north, east) to OpenCV's fixed-point (column, row), 4 bits of fraction."""
        column = (points[:, 1] - self.east_m) / CELL_M - 0.5
        row = (points[:, 0] - self.north_m) / CELL_M - 0.5
        return np.round(16 * np.stack([column, row], axis=1)).astype(np.int32)

    def area(self, points: NDArray[np.float64], colour: Colour | int) -> None:
        """Fill a polygon."""
        paint = colour if isinstance(colour, tuple) else (colour,)
        cv2.fillPoly(self.image, [self.texels(points)], paint, cv2.LINE_AA, 4)

    def line(self, points: NDArray[np.float64], width_m: float, colour: Colour) -> None:
        """A band along a line."""
        thickness = max(1, round(width_m / CELL_M))
        cv2.polylines(self.image, [self.texels(points)], False, colour, thickness, cv2.LINE_AA, 4)


def fields(random: np.random.Generator, size: int) -> Image:
    """A patchwork of meadows and crops, some with rows, parted by hedges."""
    small, count = 1024, 26
    seeds = random.uniform(0, small, (count, 2)).astype(np.float32)
    rows, columns = np.mgrid[0:small, 0:small].astype(np.float32)
    owner = np.zeros((small, small), np.uint8)
    nearest = np.full((small, small), np.inf, np.float32)
    for k, (row, column) in enumerate(seeds):
        away, across = np.abs(rows - row), np.abs(columns - column)
        distance = np.minimum(away, small - away) + np.minimum(across, small - across)  # it repeats at the edges
        owner[distance < nearest] = k
        np.minimum(nearest, distance, out=nearest)
    hedge = cv2.morphologyEx(owner, cv2.MORPH_GRADIENT, np.ones((3, 3), np.uint8))
    hedge = cv2.GaussianBlur(np.where(hedge > 0, 255, 0).astype(np.uint8), (0, 0), 1.2)
    colours = np.zeros((256, 1, 3), np.uint8)
    colours[:count, 0] = [FIELDS[k] for k in random.integers(0, len(FIELDS), count)]
    image = large(cv2.LUT(cv2.merge([owner] * 3), colours), cv2.INTER_NEAREST, size)

    broad, fine = noise(random, TILE, 256, 16), noise(random, TILE, 8, 1)
    plain = 128 + 7 * broad + 9 * fine
    furrows = 5.0 * np.sin(np.arange(TILE, dtype=np.float32) * (2 * math.pi * 102 / TILE))  # rows 1.25 m apart
    ploughed = np.zeros((256, 1), np.uint8)
    ploughed[:count, 0] = np.where(random.random(count) < 0.5, 255, 0)
    texture = tiled(plain, size)
    cv2.copyTo(tiled(plain + furrows, size), large(cv2.LUT(owner, ploughed), cv2.INTER_NEAREST, size), texture)
    image = cv2.addWeighted(image, 1, texture, 1, -128)
    mask = cv2.threshold(large(hedge, cv2.INTER_LINEAR, size), 110, 255, cv2.THRESH_BINARY)[1]
    cv2.copyTo(cv2.addWeighted(np.full_like(image, (46, 78, 62)), 1, texture, 2, -256), mask, image)
    return np.asarray(image, np.uint8)


def large(image: cv2.typing.MatLike, interpolation: int, size: int) -> Image:
    """Brought to the texture's size."""
    return np.asarray(cv2.resize(image, (size, size), interpolation=interpolation), np.uint8)


def tiled(tile: NDArray[np.floating], size: int) -> Image:
    """A grey tile as a colour image of the texture's size."""
    times = size // len(tile)
    grey = np.clip(tile, 0, 255).astype(np.uint8)
    return np.asarray(cv2.repeat(cv2.cvtColor(grey, cv2.COLOR_GRAY2BGR), times, times), np.uint8)


def paint_road(painter: Painter, road: Road, random: np.random.Generator) -> None:
    """Asphalt with edge lines and a broken centre line, or a gravel path."""
    line = np.array(road.points, np.float64)
    if not road.paved:
        painter.line(line, road.width_m + 0.6, (105, 135, 140))
        painter.line(line, road.width_m, (150, 172, 182))
        return
    painter.line(line, road.width_m + 2.0, (110, 140, 145))
    painter.line(line, road.width_m, (102, 100, 98))
    points = dense(road.points, 1.0)
    step = np.gradient(points, axis=0)
    side = np.stack([-step[:, 1], step[:, 0]], axis=1) / np.hypot(step[:, 0], step[:, 1])[:, None].clip(1e-6)
    for sign in (-1, 1):
        painter.line(points + sign * side * (road.width_m / 2 - 0.3), 0.15, (215, 218, 218))
    for start in range(0, len(points) - 4, 9):
        painter.line(points[start : start + 4], 0.15, (220, 222, 222))
    for _ in range(len(points) // 6):  # patches and cracks
        k = random.integers(0, len(points))
        point = points[k] + side[k] * random.uniform(-0.4, 0.4) * road.width_m
        grey = int(random.integers(75, 115))
        corners = point + random.uniform(0.4, 1.6, (4, 1)) * np.array([[1, 1], [1, -1], [-1, -1], [-1, 1]])
        painter.area(corners, (grey, grey, grey))


def block_corners(block: Block) -> NDArray[np.float64]:
    """(4, 2) corners on the ground, clockwise seen from above."""
    c, s = math.cos(block.heading_rad), math.sin(block.heading_rad)
    half = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]]) * (block.length_m / 2, block.width_m / 2)
    turned = half @ np.array([[c, s], [-s, c]])
    return turned + np.array([block.north_m, block.east_m])


def blob(random: np.random.Generator, radius: float, count: int = 18) -> NDArray[np.float64]:
    """A ragged circle."""
    angle = np.arange(count) * (2 * math.pi / count)
    reach = radius * random.uniform(0.8, 1.1, count)
    return np.stack([reach * np.cos(angle), reach * np.sin(angle)], axis=1)


def shadows(shape: tuple[int, int], north_m: float, east_m: float, world: World) -> Image:
    """Light on the ground, 255 in the sun: trees and buildings throw shadows."""
    terrain = world.terrain
    light = np.full(shape, 255, np.uint8)
    painter = Painter(light, north_m, east_m)
    sun_north, sun_east = world.sun.shadow()
    random = np.random.default_rng([world.seed, 3])
    dark = round(255 * SHADE)
    for block in world.blocks:
        low = block_corners(block)
        top_m = terrain.height_m(block.north_m, block.east_m) + block.height_m
        high = terrain.cast(np.column_stack([low, np.full(4, -top_m)]), sun_north, sun_east)[:, :2]
        hull = cv2.convexHull(np.concatenate([low, high]).astype(np.float32))[:, 0].astype(np.float64)
        painter.area(hull, dark)
    for tree in world.trees:
        painter.area(tree_shadow(tree, terrain, random, sun_north, sun_east), dark)
    return np.asarray(cv2.GaussianBlur(light, (5, 5), 0), np.uint8)


def tree_shadow(
    tree: Tree, terrain: Terrain, random: np.random.Generator, sun_north: float, sun_east: float
) -> NDArray[np.float64]:
    """A crown's shadow, drawn out along the sun's direction."""
    middle = terrain.height_m(tree.north_m, tree.east_m) + tree.height_m - tree.radius_m
    outline = blob(random, tree.radius_m)
    along = np.array([sun_north, sun_east]) / max(math.hypot(sun_north, sun_east), 1e-6)
    outline += np.outer(outline @ along, along) * 0.4
    return outline + terrain.cast(np.array([[tree.north_m, tree.east_m, -middle]]), sun_north, sun_east)[0, :2]


@lru_cache(maxsize=2)
def ground(world: World) -> Ground:
    """Paint the ground of a world: the same world gives the same bytes."""
    random = np.random.default_rng([world.seed, 2])
    centre = world.actors[0].route.table[:, :2].mean(axis=0)
    size = world.ground_texels
    north, east = (centre - size * CELL_M / 2).tolist()
    image = fields(random, size)
    painter = Painter(image, north, east)
    for _ in range(45 * size * size // TILE**2):  # tufts, bare patches, stones
        point = random.uniform(0, size * CELL_M, 2) + np.array([north, east])
        shade = random.uniform(0.65, 1.3)
        base = np.array(FIELDS[random.integers(len(FIELDS))]) * shade
        colour = (int(base[0]), int(base[1]), int(base[2]))
        painter.area(point + blob(random, random.uniform(0.3, 2.2), 10), colour)
    for road in world.roads:
        paint_road(painter, road, random)
    image = cv2.addWeighted(image, 1, tiled(128 + 5 * noise(random, TILE, 4, 1), size), 1, -128)
    light = shadows((size, size), north, east, world)
    image = cv2.multiply(image, cv2.cvtColor(light, cv2.COLOR_GRAY2BGR), scale=1 / 255)
    levels = [np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2BGRA), np.uint8)]
    while len(levels) < LEVELS:
        half = cv2.resize(levels[-1], None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
        levels.append(np.asarray(half, np.uint8))
    levels[-FAR_LEVELS:] = [np.asarray(cv2.repeat(far, FAR_TIMES, FAR_TIMES), np.uint8) for far in levels[-FAR_LEVELS:]]
    tile = noise(random, DETAIL_SIZE, 32, 2)
    detail = np.clip(128 + 40 * tile, 0, 255).astype(np.uint8)
    return Ground(tuple(levels), np.asarray(cv2.repeat(detail, DETAIL_TIMES, DETAIL_TIMES), np.uint8), north, east)
