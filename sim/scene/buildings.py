"""Buildings and walls as faces lit by the sun."""

import numpy as np

from sim.scene.bodies import AMBIENT, Draft, facing, shade
from sim.scene.ground import block_corners
from sim.scene.terrain import Terrain
from sim.scene.world import Array, Block, Colour, Sun


def built(block: Block, sun: Sun, terrain: Terrain) -> list[Draft]:
    """The faces of a building or of a piece of wall; on a slope it is as high as stated at its middle."""
    corners = block_corners(block)
    low = np.column_stack([corners, np.full(4, -terrain.heights(corners).min())])
    top_m = terrain.height_m(block.north_m, block.east_m) + block.height_m
    high = np.column_stack([corners, np.full(4, -top_m)])
    light = sun.toward()
    parts: list[Draft] = []
    for k in range(4):
        j = (k + 1) % 4
        quad = np.array([low[j], low[k], high[k], high[j]])
        parts.append(lit(quad, block.colour, light))
        if block.windows:
            parts += windows(quad, block)
    return parts + (gable(high, block, light) if block.windows else [lit(high[::-1], block.roof, light)])


def lit(corners: Array, colour: Colour, light: tuple[float, float, float]) -> Draft:
    """A face lit as it is turned; corners run counterclockwise seen from outside."""
    points = corners.tolist()
    # A part's corners run clockwise seen from outside, which `outlined_parts` shows; the normal needs them as given.
    return points[::-1], shade(colour, AMBIENT + (1 - AMBIENT) * 1.2 * max(facing(points, light), 0.0)), None


def windows(quad: Array, block: Block) -> list[Draft]:
    """Rows of windows on a wall given by its corners: bottom, bottom, top, top."""
    base, along, up = quad[0], quad[1] - quad[0], quad[3] - quad[0]
    columns = max(2, int(np.linalg.norm(along) / 3.0))
    floors = max(1, int(block.height_m / 2.8))
    parts: list[Draft] = []
    for column in range(columns):
        for floor in range(floors):
            a, b = (column + 0.3) / columns, (column + 0.7) / columns
            c, d = (floor + 0.35) / floors, (floor + 0.8) / floors
            pane = np.array([base + along * u + up * v for u, v in ((a, c), (b, c), (b, d), (a, d))])
            parts.append((pane.tolist()[::-1], (78, 66, 55) if (3 * column + floor) % 4 else (120, 112, 100), None))
    return parts


def gable(high: Array, block: Block, light: tuple[float, float, float]) -> list[Draft]:
    """A pitched roof over the four upper corners, its ridge along the length (corners 0-1 and 2-3)."""
    rise = np.array([0, 0, -0.3 * block.width_m])
    first, second = (high[0] + high[3]) / 2 + rise, (high[1] + high[2]) / 2 + rise
    return [
        lit(np.array([high[1], high[0], first, second]), block.roof, light),
        lit(np.array([high[3], high[2], second, first]), block.roof, light),
        lit(np.array([high[0], high[3], first]), block.colour, light),
        lit(np.array([high[2], high[1], second]), block.colour, light),
    ]
