"""What is in the world and how it moves: actors, walls, buildings, trees, the sun, the ground's height.  Local NED."""

import itertools
import math
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from sim.scene.terrain import LEVEL, Terrain

Array = NDArray[np.float64]
Colour = tuple[int, int, int]  # BGR, as OpenCV has it

ROUTE_STEP_S = 0.02
ROUTE_MARGIN_S = 5.0  # a route continues after the scenario's end, for a camera that still delivers late frames


class Kind(str, Enum):
    """What an actor is."""

    WALKER = "walker"
    RUNNER = "runner"
    CYCLIST = "cyclist"
    CAR = "car"


@dataclass(frozen=True, slots=True)
class Gait:
    """How one kind moves: usual speed, sideways acceleration in turns and along the path, length of a stride."""

    speed_m_s: float
    turn_m_s2: float
    accel_m_s2: float
    cycle_m: float  # distance of one stride (both legs) or one turn of the pedals


GAITS = {
    Kind.WALKER: Gait(1.4, 1.5, 1.0, 1.4),  # 1.4 m/s: preferred walking speed (Bohannon 1997)
    Kind.RUNNER: Gait(4.0, 2.5, 2.0, 2.8),
    Kind.CYCLIST: Gait(8.0, 2.5, 1.2, 5.6),
    Kind.CAR: Gait(15.0, 3.0, 2.0, 1.9),
}


@dataclass(frozen=True, slots=True)
class Leg:
    """Go to a point at a speed (None: the kind's own), then stand there for a while."""

    north_m: float
    east_m: float
    speed_m_s: float | None = None
    pause_s: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class Route:
    """A path through time: rows of (north, east, heading, speed, distance) every ROUTE_STEP_S from time 0."""

    table: Array

    def at(self, t_s: float) -> "ActorPose":
        """Where the actor is, interpolated; it stands at its first or last position outside the route's time."""
        index = min(max(t_s / ROUTE_STEP_S, 0.0), len(self.table) - 1.0)
        low = min(int(index), len(self.table) - 2)
        fraction = index - low
        north, east, heading, speed, gone = ((1 - fraction) * self.table[low] + fraction * self.table[low + 1]).tolist()
        return ActorPose(north, east, heading, speed, gone)


@dataclass(frozen=True, slots=True)
class ActorPose:
    """Where an actor's feet are, its heading (clockwise from north, unwrapped), speed and the distance it has gone."""

    north_m: float
    east_m: float
    heading_rad: float
    speed_m_s: float
    distance_m: float
    down_m: float = 0.0


def route(kind: Kind, legs: tuple[Leg, ...], duration_s: float) -> Route:
    """Walk the legs: the first is the start; the actor steers toward each next point and turns gradually.

    It turns no faster than its sideways acceleration allows at its speed, speeds up and slows down by its own
    acceleration, and stops at the last point.
    """
    gait = GAITS[kind]
    north, east = legs[0].north_m, legs[0].east_m
    heading = math.atan2(legs[1].east_m - east, legs[1].north_m - north)
    speed = legs[0].speed_m_s if legs[0].speed_m_s is not None else gait.speed_m_s
    pause, following, gone = legs[0].pause_s, 1, 0.0
    if pause > 0.0:
        speed = 0.0
    rows: list[tuple[float, float, float, float, float]] = []
    for _ in range(round((duration_s + ROUTE_MARGIN_S) / ROUTE_STEP_S) + 1):
        rows.append((north, east, heading, speed, gone))
        if pause > 0.0:
            pause -= ROUTE_STEP_S
            continue
        if following >= len(legs):
            continue
        leg = legs[following]
        away_n, away_e = leg.north_m - north, leg.east_m - east
        distance = math.hypot(away_n, away_e)
        stops = leg.pause_s > 0.0 or following == len(legs) - 1
        target_m_s = leg.speed_m_s if leg.speed_m_s is not None else gait.speed_m_s
        if stops:
            target_m_s = min(target_m_s, math.sqrt(2.0 * gait.accel_m_s2 * max(distance, 0.0)) + 0.05)
        turn = math.remainder(math.atan2(away_e, away_n) - heading, math.tau)
        radius = speed * speed / gait.turn_m_s2
        if abs(turn) > 0.5 and radius > 0.3 * distance:
            target_m_s = min(target_m_s, max(0.4 * gait.speed_m_s, 0.5))  # slow down for a sharp corner
        change = gait.accel_m_s2 * ROUTE_STEP_S
        speed += max(-change, min(change, target_m_s - speed))
        limit = min(gait.turn_m_s2 / max(speed, 0.3), 2.5) * ROUTE_STEP_S
        heading += max(-limit, min(limit, turn))
        step = speed * ROUTE_STEP_S
        north, east, gone = north + step * math.cos(heading), east + step * math.sin(heading), gone + step
        if distance < (0.1 if stops else max(0.4 * speed, 0.3)):
            following, pause = following + 1, leg.pause_s
            if stops:
                speed = 0.0
    return Route(np.array(rows))


@dataclass(frozen=True, slots=True)
class Look:
    """Colours of an actor: upper (shirt, paint), lower (trousers), a mark on back or roof, hair or glass."""

    upper: Colour = (40, 40, 190)
    lower: Colour = (95, 55, 35)
    mark: Colour = (225, 225, 220)
    dark: Colour = (30, 28, 30)


@dataclass(frozen=True, slots=True)
class Actor:
    """Something that moves."""

    kind: Kind
    route: Route
    look: Look = Look()


@dataclass(frozen=True, slots=True)
class Block:
    """A box on the ground: a building or a piece of wall; `heading_rad` turns its length from north."""

    north_m: float
    east_m: float
    length_m: float
    width_m: float
    height_m: float
    heading_rad: float = 0.0
    colour: Colour = (150, 165, 180)
    roof: Colour = (70, 80, 130)
    windows: bool = False


@dataclass(frozen=True, slots=True)
class Tree:
    """A tree: its crown is a ball of `radius_m` whose top is at `height_m`."""

    north_m: float
    east_m: float
    height_m: float
    radius_m: float
    sprite: int = 0


@dataclass(frozen=True, slots=True)
class Road:
    """A band of ground along a line of (north, east) points."""

    points: tuple[tuple[float, float], ...]
    width_m: float
    paved: bool = True  # with markings; else a gravel path


@dataclass(frozen=True, slots=True)
class Sun:
    """Where light comes from, and how much of it there is."""

    azimuth_rad: float = 2.4
    elevation_rad: float = 0.85
    light: float = 1.0  # 1: noon; 0.2: dusk

    def toward(self) -> tuple[float, float, float]:
        """Unit vector to the sun, NED."""
        level = math.cos(self.elevation_rad)
        return level * math.cos(self.azimuth_rad), level * math.sin(self.azimuth_rad), -math.sin(self.elevation_rad)

    def shadow(self) -> tuple[float, float]:
        """(north, east) length of a shadow per metre of height."""
        length = 1.0 / math.tan(self.elevation_rad)
        return -length * math.cos(self.azimuth_rad), -length * math.sin(self.azimuth_rad)


@dataclass(frozen=True, slots=True)
class World:
    """Everything there is; actor 0 is the target."""

    actors: tuple[Actor, ...]
    blocks: tuple[Block, ...] = ()
    trees: tuple[Tree, ...] = ()
    roads: tuple[Road, ...] = ()
    terrain: Terrain = LEVEL
    sun: Sun = Sun()
    seed: int = 0
    keep_clear_m: float = 14.0
    ground_texels: int = 2048  # side of the ground's texture, a multiple of 1024; 2048 are 256 m, then it repeats

    def target(self, t_s: float) -> ActorPose:
        """Where the target is."""
        return self._pose(self.actors[0], t_s)

    def poses(self, t_s: float) -> tuple[ActorPose, ...]:
        """Where each actor is, the target first."""
        return tuple(self._pose(actor, t_s) for actor in self.actors)

    def _pose(self, actor: Actor, t_s: float) -> ActorPose:
        pose = actor.route.at(t_s)
        if not self.terrain.points:
            return pose
        return replace(pose, down_m=-self.terrain.height_m(pose.north_m, pose.east_m))


def wall(
    north_m: float,
    east_m: float,
    length_m: float,
    heading_rad: float,
    height_m: float,
    colour: Colour = (120, 135, 165),
) -> tuple[Block, ...]:
    """A wall that begins at a point, as pieces of at most 2 m so that each is clearly before or behind an actor."""
    count = max(1, math.ceil(length_m / 2.0))
    piece = length_m / count
    return tuple(
        Block(
            north_m + (k + 0.5) * piece * math.cos(heading_rad),
            east_m + (k + 0.5) * piece * math.sin(heading_rad),
            piece,
            0.3,
            height_m,
            heading_rad,
            colour,
            roof=(165, 175, 190),
        )
        for k in range(count)
    )


def scatter(world: World, extent_m: float, buildings: int, trees: int) -> World:
    """The world with buildings and trees at random (by its seed), clear of roads and of every actor's path."""
    random = np.random.default_rng([world.seed, 1])
    lines = [actor.route.table[::50, :2] for actor in world.actors]
    lines += [dense(road.points) for road in world.roads]
    paths = np.concatenate(lines)
    centre = world.actors[0].route.table[:, :2].mean(axis=0)
    blocks, green = list(world.blocks), list(world.trees)
    walls = ((60, 90, 150), (170, 190, 205), (130, 150, 170), (195, 200, 205))
    roofs = ((60, 70, 140), (80, 80, 85), (60, 95, 150), (110, 115, 120))
    for _ in range(40 * buildings):
        if len(blocks) - len(world.blocks) == buildings:
            break
        north, east = centre + random.uniform(-extent_m, extent_m, 2)
        length, width = random.uniform(9, 20), random.uniform(8, 13)
        # A building near the path would hide the target from a camera behind it, so it keeps its length more distance.
        if clear(paths, north, east) < world.keep_clear_m + length or any(
            math.hypot(north - b.north_m, east - b.east_m) < 30 for b in blocks
        ):
            continue
        height, turn = random.uniform(4, 9), random.uniform(0, math.pi)
        colours = walls[random.integers(4)], roofs[random.integers(4)]
        blocks.append(Block(float(north), float(east), length, width, height, turn, *colours, windows=True))
    for _ in range(20 * trees):
        if len(green) - len(world.trees) == trees:
            break
        north, east = centre + random.uniform(-extent_m, extent_m, 2)
        height = random.uniform(5, 11)
        if clear(paths, north, east) < world.keep_clear_m or any(
            math.hypot(north - b.north_m, east - b.east_m) < 0.6 * b.length_m + 4 for b in blocks
        ):
            continue
        green.append(
            Tree(float(north), float(east), height, height * random.uniform(0.28, 0.4), int(random.integers(6)))
        )
    return replace(world, blocks=tuple(blocks), trees=tuple(green))


def dense(points: tuple[tuple[float, float], ...], step_m: float = 3.0) -> Array:
    """Points along a line, at most `step_m` apart."""
    pieces: list[Array] = []
    for (n0, e0), (n1, e1) in itertools.pairwise(points):
        count = max(2, math.ceil(math.hypot(n1 - n0, e1 - e0) / step_m))
        pieces.append(np.linspace((n0, e0), (n1, e1), count))
    return np.concatenate(pieces)


def clear(paths: Array, north_m: float, east_m: float) -> float:
    """Distance to the nearest point of the paths."""
    return float(np.hypot(paths[:, 0] - north_m, paths[:, 1] - east_m).min())
