"""Worlds by seed: the actors' paths and what is beside them.  Every path starts at the origin, northward."""

import math
from dataclasses import replace

import numpy as np

from sim.scene.terrain import slope
from sim.scene.world import (
    GAITS,
    Actor,
    Block,
    Colour,
    Kind,
    Leg,
    Look,
    Road,
    Sun,
    Tree,
    World,
    route,
    scatter,
    wall,
)

Generator = np.random.Generator

SHIRTS: tuple[Colour, ...] = (
    (40, 40, 190),
    (190, 90, 30),
    (40, 170, 220),
    (200, 200, 205),
    (140, 40, 120),
    (50, 50, 55),
)
TROUSERS: tuple[Colour, ...] = ((95, 55, 35), (60, 60, 62), (120, 140, 150), (40, 38, 40))
MARKS: tuple[Colour, ...] = ((225, 225, 220), (40, 200, 230), (60, 60, 200), (200, 140, 60))
PAINTS: tuple[Colour, ...] = (
    (40, 40, 160),
    (160, 80, 30),
    (190, 190, 192),
    (60, 60, 62),
    (215, 218, 220),
    (40, 120, 60),
)


def look(random: Generator, kind: Kind) -> Look:
    """Clothes or paint."""
    if kind is Kind.CAR:
        return Look(PAINTS[random.integers(len(PAINTS))], mark=(60, 62, 64), dark=(38, 34, 32))
    shirt, trousers = SHIRTS[random.integers(len(SHIRTS))], TROUSERS[random.integers(len(TROUSERS))]
    return Look(shirt, trousers, MARKS[random.integers(len(MARKS))])


def sun(random: Generator) -> Sun:
    """Any time of a clear day but noon."""
    return Sun(float(random.uniform(0, 2 * math.pi)), float(random.uniform(0.6, 1.1)))


def winding(random: Generator, length_m: float, piece_m: float, bend_rad: float) -> list[tuple[float, float]]:
    """Points of a path that bends left and right."""
    points, heading = [(0.0, 0.0), (piece_m, 0.0)], 0.0
    while piece_m * (len(points) - 1) < length_m:
        heading += float(random.uniform(-bend_rad, bend_rad))
        north, east = points[-1]
        points.append((north + piece_m * math.cos(heading), east + piece_m * math.sin(heading)))
    return points


def legs(points: list[tuple[float, float]], wait_s: float = 1.0) -> tuple[Leg, ...]:
    """Along the points after a short wait at the first; the speed is the kind's own."""
    return (Leg(*points[0], pause_s=wait_s), *(Leg(*point) for point in points[1:]))


def path(points: list[tuple[float, float]], width_m: float = 2.4) -> Road:
    """A gravel path along the points and on beyond both ends."""
    (n0, e0), (n1, e1) = points[0], points[1]
    (n2, e2), (n3, e3) = points[-2], points[-1]
    before = (n0 - 3 * (n1 - n0), e0 - 3 * (e1 - e0))
    return Road((before, *points, (n3 + 3 * (n3 - n2), e3 + 3 * (e3 - e2))), width_m, paved=False)


def furnished(random: Generator, world: World, extent_m: float = 90.0, trees: int = 70, buildings: int = 7) -> World:
    """The world with a road beside the path, trees and buildings."""
    side, turn = float(random.choice([-1.0, 1.0])) * random.uniform(14, 22), random.uniform(-0.15, 0.15)
    middle = np.array([0.0, side])
    along = np.array([math.cos(turn), math.sin(turn)])
    road = Road(tuple((float(n), float(e)) for n, e in (middle - 250 * along, middle + 250 * along)), 7.0)
    return scatter(
        replace(world, roads=(road, *world.roads), seed=int(random.integers(1 << 31))),
        extent_m,
        buildings,
        trees,
    )


def footpath(random: Generator, kind: Kind, duration_s: float) -> World:
    """One actor on a winding path; a kind faster than a walker is at its speed from the start."""
    return on_path(random, kind, duration_s, rolling=kind is not Kind.WALKER)


def set_off(random: Generator, kind: Kind, duration_s: float) -> World:
    """One actor who stands and then sets off on a winding path."""
    return on_path(random, kind, duration_s, rolling=False)


def on_path(random: Generator, kind: Kind, duration_s: float, *, rolling: bool) -> World:
    """One actor on a winding path, at speed from the start or after a short wait."""
    speed = GAITS[kind].speed_m_s
    points = winding(random, speed * (duration_s + 8), max(4.0 * speed, 8.0), 0.45)
    actor = Actor(kind, route(kind, legs(points, 0.0 if rolling else 1.0), duration_s), look(random, kind))
    texels = 2048 if speed * duration_s < 200 else 4096
    world = World((actor,), roads=(path(points),), sun=sun(random), ground_texels=texels)
    return furnished(random, world, 60.0 + 0.6 * speed * duration_s)


def car_road(random: Generator, kind: Kind, duration_s: float) -> World:
    """A car on a country road with wide bends."""
    points = winding(random, GAITS[kind].speed_m_s * (duration_s + 8), 45.0, 0.35)
    actor = Actor(kind, route(kind, legs(points, 0.0), duration_s), look(random, kind))
    (n1, e1), (n2, e2) = points[-2:]
    line = ((-120.0, 0.0), *actor_line(actor), (n2 + 2 * (n2 - n1), e2 + 2 * (e2 - e1)))
    world = World(
        (actor,),
        roads=(Road(line, 7.5),),
        sun=sun(random),
        seed=int(random.integers(1 << 31)),
        keep_clear_m=18,
        ground_texels=5120,
    )
    return scatter(world, 260.0, 16, 160)


def actor_line(actor: Actor) -> tuple[tuple[float, float], ...]:
    """The path that an actor really takes, every half second."""
    return tuple((float(n), float(e)) for n, e in actor.route.table[::25, :2])


def stops(random: Generator, kind: Kind, duration_s: float) -> World:
    """The actor stands still for a few seconds at some corners."""
    points = winding(random, GAITS[kind].speed_m_s * duration_s, 7.0, 0.6)
    stages = [Leg(*points[0], pause_s=1.0)]
    for k, point in enumerate(points[1:]):
        stages.append(Leg(*point, pause_s=float(random.uniform(2, 4)) if k % 2 == 0 else 0.0))
    actor = Actor(kind, route(kind, tuple(stages), duration_s), look(random, kind))
    return furnished(random, World((actor,), roads=(path(points),), sun=sun(random)))


def turn_back(random: Generator, kind: Kind, duration_s: float) -> World:
    """Out, a U-turn, and back past the drone's side."""
    speed = GAITS[kind].speed_m_s
    side = float(random.choice([-1.0, 1.0]))
    far = speed * 0.35 * duration_s
    width = max(3.0, 2.2 * speed * speed / GAITS[kind].turn_m_s2)
    corner = 0.35 * width
    points = [(0.0, 0.0), (far, 0.0), (far + corner, side * corner), (far + corner, side * (width - corner))]
    points += [(far, side * width), (-speed * duration_s, side * width)]
    rolling = kind is not Kind.WALKER
    actor = Actor(kind, route(kind, legs(points, 0.0 if rolling else 1.0), duration_s), look(random, kind))
    return furnished(random, World((actor,), roads=(path(points),), sun=sun(random)), 90.0)


def corner(random: Generator) -> tuple[list[tuple[float, float]], float]:
    """A path that turns off at a right angle after some steps, and to which side (+1: east)."""
    side = float(random.choice([-1.0, 1.0]))
    ahead = float(random.uniform(9, 12))
    return [(0.0, 0.0), (ahead, 0.0), (ahead + 1.0, side * 1.0), (ahead + 1.0, side * 60.0)], side


def wall_between(random: Generator, kind: Kind, duration_s: float) -> World:
    """The actor turns off behind a wall that hides it for about 3 s."""
    points, side = corner(random)
    actor = Actor(kind, route(kind, legs(points), duration_s), look(random, kind))
    # The drone comes round the corner meanwhile and looks along the wall, which then hides more than its length.
    long = 2.2 * GAITS[kind].speed_m_s
    north = points[-1][0] - 1.3
    blocks = wall(north, side * 6.0, long, side * math.pi / 2, 4.0)
    return furnished(random, World((actor,), blocks, roads=(path(points),), sun=sun(random)))


def trees_between(random: Generator, kind: Kind, duration_s: float) -> World:
    """The actor turns off behind a row of bushy trees for about 3 s."""
    points, side = corner(random)
    actor = Actor(kind, route(kind, legs(points), duration_s), look(random, kind))
    long = 1.3 * GAITS[kind].speed_m_s
    north = points[-1][0] - 2.2
    row: list[Tree] = []
    for k in range(4):
        east = side * (6.8 + long * k / 4)
        shift = float(random.uniform(-0.2, 0.2))
        row.append(Tree(north + shift, east, float(random.uniform(3.6, 4.0)), 1.7, int(random.integers(6))))
        row.append(Tree(north + shift, east + side * 0.4, 2.4, 1.3, int(random.integers(6))))
    return furnished(random, World((actor,), trees=tuple(row), roads=(path(points),), sun=sun(random)))


def look_alike(random: Generator, kind: Kind, duration_s: float) -> World:
    """Two others dressed as the target come toward it and cross its path within two metres."""
    points = winding(random, GAITS[kind].speed_m_s * (duration_s + 8), 9.0, 0.3)
    clothes = look(random, kind)
    target = Actor(kind, route(kind, legs(points), duration_s), clothes)
    actors = [target]
    for meet_s in (8.0, 18.0):
        met = target.route.at(meet_s)
        side = float(random.choice([-1.0, 1.0]))
        away = met.heading_rad + side * float(random.uniform(1.3, 2.0))
        reach, gap = meet_s * GAITS[kind].speed_m_s, float(random.uniform(0.8, 1.8))
        north = met.north_m + gap * math.cos(met.heading_rad)
        east = met.east_m + gap * math.sin(met.heading_rad)
        ends = [(north - s * math.cos(away), east - s * math.sin(away)) for s in (reach, -60.0)]
        actors.append(Actor(kind, route(kind, (Leg(*ends[0]), Leg(*ends[1])), duration_s), clothes))
    return furnished(random, World(tuple(actors), roads=(path(points),), sun=sun(random)))


def going(legs: tuple[Leg, ...], random: Generator, kind: Kind, duration_s: float) -> World:
    """One actor alone on a gravel path along its legs."""
    actor = Actor(kind, route(kind, legs, duration_s), look(random, kind))
    road = path([(leg.north_m, leg.east_m) for leg in legs])
    return World((actor,), roads=(road,), sun=sun(random))


def hillside(random: Generator, kind: Kind, duration_s: float, *, grade: float, speed_m_s: float) -> World:
    """Straight up (grade > 0) or down a hill that begins 6 m ahead and goes on beyond the flight's end."""
    length = speed_m_s * (duration_s + 8)
    world = going((Leg(0, 0, speed_m_s, pause_s=1.0), Leg(length, 0, speed_m_s)), random, kind, duration_s)
    return furnished(random, replace(world, terrain=slope(grade, 6.0, length + 30.0)))


def straight_at(random: Generator, kind: Kind, duration_s: float, *, speed_m_s: float) -> World:
    """The actor waits for 6 s, then comes straight at the drone and passes below it."""
    legs = Leg(0, 0, speed_m_s, pause_s=6.0), Leg(speed_m_s * duration_s, 0, speed_m_s)
    return furnished(random, going(legs, random, kind, duration_s))


def straight_back(random: Generator, kind: Kind, duration_s: float, *, speed_m_s: float) -> World:
    """The actor runs away for 8 s, turns about and comes back along its own line, toward the drone."""
    far = 8.0 * speed_m_s
    legs = Leg(0, 0, speed_m_s), Leg(far, 0, speed_m_s), Leg(far - 5, 0, speed_m_s), Leg(-9 * far, 0, speed_m_s)
    return furnished(random, going(legs, random, kind, duration_s))


def through_door(random: Generator, kind: Kind, duration_s: float, *, speed_m_s: float) -> World:
    """After 8 s at this speed the actor runs through a door into a house, and stops inside.

    The house is block 0, its wall 8 s ahead; block 1 is the door.
    """
    wall_m, stop_m = 8.0 * speed_m_s, 1.0 + speed_m_s**2 / GAITS[kind].accel_m_s2  # it brakes only behind the door
    length = 2.0 * (stop_m + 1.0)
    house = Block(
        wall_m + length / 2, 0.0, length, 2.0 * length, 5.0, 0.0, (130, 150, 170), (60, 70, 140), windows=True
    )
    door = Block(wall_m - 0.05, 0.0, 0.1, 1.1, 2.1, 0.0, (52, 50, 48), (52, 50, 48))
    legs = Leg(0, 0, speed_m_s), Leg(wall_m + stop_m, 0, speed_m_s)
    return furnished(random, replace(going(legs, random, kind, duration_s), blocks=(house, door)))


def speeding_away(
    random: Generator, kind: Kind, duration_s: float, *, from_m_s: float, to_m_s: float, after_m: float = 30.0
) -> World:
    """The actor goes at one speed for a while and then at another."""
    legs = Leg(0, 0, from_m_s), Leg(after_m, 0, from_m_s), Leg(after_m + to_m_s * (duration_s + 8), 0, to_m_s)
    world = replace(going(legs, random, kind, duration_s), ground_texels=4096)
    return furnished(random, world, 60.0 + 0.6 * to_m_s * duration_s)
