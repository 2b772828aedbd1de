"""The bodies of actors: faces and limbs in local NED that change with heading, stride and pedals."""

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from follow.geometry import ned_to_heading
from sim.scene.world import GAITS, Actor, ActorPose, Array, Colour, Kind, Look, Sun

AMBIENT = 0.5  # fraction of light that comes from the sky, a clear day


Point = tuple[float, float, float]

Draft = tuple[Sequence[Point], Colour, tuple[float, float] | None]
"""A polygon (no radii) or a limb, that is a line of two points, round, with a radius at each end."""


@dataclass(frozen=True, slots=True, eq=False)
class Mesh:
    """Polygons and limbs in local NED, all points in one array; part k has points[starts[k]:starts[k + 1]]."""

    points: Array  # (N, 3)
    starts: NDArray[np.int64]  # (P + 1,)
    colours: list[Colour]
    limbs: NDArray[np.int64]  # which parts are limbs, (L,)
    radii: Array  # (L, 2)

    @classmethod
    def of(cls, drafts: Sequence[Draft]) -> "Mesh":
        """The parts in their order."""
        starts = np.cumsum([0, *(len(points) for points, _, _ in drafts)])
        flat = np.array([point for points, _, _ in drafts for point in points], np.float64)
        limbs = np.array([k for k, draft in enumerate(drafts) if draft[2] is not None], np.int64)
        radii = np.array([draft[2] for draft in drafts if draft[2] is not None], np.float64).reshape(-1, 2)
        return cls(flat, starts, [colour for _, colour, _ in drafts], limbs, radii)


class Frame3:
    """Local axes of an actor: forward, right, up in metres from the ground under its middle."""

    def __init__(self, pose: ActorPose, sun: Sun) -> None:
        self.pose = pose
        c, s = math.cos(pose.heading_rad), math.sin(pose.heading_rad)
        north, east, down = sun.toward()
        self.sun = (*ned_to_heading(north, east, pose.heading_rad), -down)
        self.axes = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, -1.0]])

    def face(self, points: list[Point], colour: Colour) -> Draft:
        """A flat polygon, lit by the sun as its side is turned (corners clockwise seen from outside)."""
        # Up instead of down mirrors the axes, so the order of corners is turned round for the normal.
        light = AMBIENT + (1 - AMBIENT) * 1.3 * max(facing(points[2::-1], self.sun), 0.0)
        return points, shade(colour, light), None

    def limb(self, p: Point, q: Point, rp: float, rq: float, colour: Colour) -> Draft:
        """A round limb from p to q."""
        return [p, q], colour, (rp, rq)

    def box(self, low: Point, high: Point, colour: Colour, inset: float = 0.0) -> list[Draft]:
        """The five faces of a box that can be seen from above; `inset` draws the top in from front and back."""
        (x0, y0, z0), (x1, y1, z1) = low, high
        i = inset
        return [
            self.face([(x0, y0, z0), (x1, y0, z0), (x1 - i, y0, z1), (x0 + i, y0, z1)], colour),
            self.face([(x1, y1, z0), (x0, y1, z0), (x0 + i, y1, z1), (x1 - i, y1, z1)], colour),
            self.face([(x0, y1, z0), (x0, y0, z0), (x0 + i, y0, z1), (x0 + i, y1, z1)], colour),
            self.face([(x1, y0, z0), (x1, y1, z0), (x1 - i, y1, z1), (x1 - i, y0, z1)], colour),
            self.face([(x0 + i, y0, z1), (x1 - i, y0, z1), (x1 - i, y1, z1), (x0 + i, y1, z1)], colour),
        ]

    def built(self, drafts: list[Draft]) -> Mesh:
        """The parts in NED."""
        mesh = Mesh.of(drafts)
        ned = mesh.points @ self.axes + (self.pose.north_m, self.pose.east_m, self.pose.down_m)
        return replace(mesh, points=ned)


def facing(corners: Sequence[Sequence[float]], light: Point) -> float:
    """Cosine between a face's outward normal (corners clockwise seen from outside) and a unit vector."""
    (a0, a1, a2), (b0, b1, b2), (c0, c1, c2) = corners[:3]
    u0, u1, u2, v0, v1, v2 = b0 - a0, b1 - a1, b2 - a2, c0 - b0, c1 - b1, c2 - b2
    n0, n1, n2 = u1 * v2 - u2 * v1, u2 * v0 - u0 * v2, u0 * v1 - u1 * v0
    length = math.sqrt(n0 * n0 + n1 * n1 + n2 * n2)
    return (n0 * light[0] + n1 * light[1] + n2 * light[2]) / max(length, 1e-9)


def shade(colour: Colour, light: float) -> Colour:
    """The colour in that much light."""
    b, g, r = (min(round(v * light), 255) for v in colour)
    return b, g, r


def body(actor: Actor, pose: ActorPose, sun: Sun) -> Mesh:
    """The actor's parts where it is, upright on any slope; faces turned away are still among them."""
    frame = Frame3(pose, sun)
    return frame.built(drafts(frame, actor, pose))


def drafts(frame: Frame3, actor: Actor, pose: ActorPose) -> list[Draft]:
    """The parts in the actor's own axes."""
    if actor.kind is Kind.CAR:
        return car(frame, actor.look)
    phase = 2.0 * math.pi * pose.distance_m / GAITS[actor.kind].cycle_m
    if actor.kind is Kind.CYCLIST:
        return cyclist(frame, actor.look, phase)
    going = min(pose.speed_m_s / GAITS[actor.kind].speed_m_s, 1.0)
    swing = (0.75 if actor.kind is Kind.RUNNER else 0.45) * going
    return person(frame, actor.look, phase, swing, lean=0.12 if actor.kind is Kind.RUNNER else 0.03)


SKIN: Colour = (120, 150, 200)


def person(f: Frame3, look: Look, phase: float, swing: float, lean: float) -> list[Draft]:
    """Someone 1.75 m tall on foot: legs and arms swing against each other (radians)."""
    hip, shoulder, top = 0.92, 1.42, 1.60
    ahead = lean * (shoulder - hip)
    parts: list[Draft] = []
    for side, sign in ((-1.0, 1.0), (1.0, -1.0)):
        thigh = swing * math.sin(phase) * sign
        bend = swing * (0.9 + math.cos(phase) * sign)
        knee = (0.46 * math.sin(thigh), 0.09 * side, hip - 0.46 * math.cos(thigh))
        shin = thigh - bend
        foot = (knee[0] + 0.44 * math.sin(shin), knee[1], max(knee[2] - 0.44 * math.cos(shin), 0.04))
        parts.append(f.limb((0.0, 0.09 * side, hip), knee, 0.1, 0.075, look.lower))
        parts.append(f.limb(knee, foot, 0.075, 0.05, shade(look.lower, 0.85)))
        parts.append(f.limb(foot, (foot[0] + 0.18, foot[1], foot[2] - 0.01), 0.055, 0.04, look.dark))
    torso = [(0.0, 0.0, hip), (ahead * 0.5, 0.0, (hip + shoulder) / 2), (ahead, 0.0, shoulder)]
    parts.append(f.limb(torso[0], torso[1], 0.17, 0.185, shade(look.upper, 0.8)))
    parts.append(f.limb(torso[1], torso[2], 0.185, 0.19, look.upper))
    parts.append(f.limb((ahead, -0.16, shoulder), (ahead, 0.16, shoulder), 0.09, 0.09, shade(look.upper, 1.15)))
    # A small pack on the back, so that back and front look different.
    parts.append(f.limb((-0.17, 0.0, 1.12), (ahead - 0.19, 0.0, 1.36), 0.11, 0.11, look.mark))
    for side, sign in ((-1.0, -1.0), (1.0, 1.0)):
        arm = swing * 0.9 * math.sin(phase) * sign
        start = (ahead, 0.24 * side, shoulder - 0.02)
        elbow = (start[0] + 0.28 * math.sin(arm), 0.27 * side, start[2] - 0.28 * math.cos(arm))
        hand = (elbow[0] + 0.25 * math.sin(arm + 0.5), 0.25 * side, elbow[2] - 0.25 * math.cos(arm + 0.5))
        parts.append(f.limb(start, elbow, 0.06, 0.05, shade(look.upper, 0.9)))
        parts.append(f.limb(elbow, hand, 0.045, 0.04, SKIN))
    parts.append(f.limb((ahead, 0.0, shoulder + 0.08), (ahead + 0.01, 0.0, top), 0.07, 0.1, SKIN))
    parts.append(f.limb((ahead - 0.02, 0.0, top + 0.02), (ahead + 0.01, 0.0, top + 0.06), 0.105, 0.1, look.dark))
    return parts


def cyclist(f: Frame3, look: Look, phase: float) -> list[Draft]:
    """Someone on a bicycle, 1.75 m long and as high."""
    parts: list[Draft] = []
    metal = (60, 60, 62)
    for hub in (-0.52, 0.52):
        rim = [(hub + 0.34 * math.cos(a), 0.0, 0.34 + 0.34 * math.sin(a)) for a in np.linspace(0, 2 * math.pi, 9)]
        parts += [f.limb(p, q, 0.028, 0.028, look.dark) for p, q in itertools.pairwise(rim)]
    saddle, crank, head = (-0.25, 0.0, 0.95), (-0.05, 0.0, 0.3), (0.42, 0.0, 0.95)
    for p, q in (
        (saddle, crank),
        (crank, head),
        (saddle, head),
        ((-0.52, 0.0, 0.34), saddle),
        ((0.52, 0.0, 0.34), head),
    ):
        parts.append(f.limb(p, q, 0.03, 0.03, metal))
    hip, shoulder = (-0.22, 0.0, 1.02), (0.22, 0.0, 1.45)
    for side, turn in ((-1.0, phase), (1.0, phase + math.pi)):
        pedal = (crank[0] + 0.17 * math.cos(-turn), 0.1 * side, crank[2] + 0.17 * math.sin(-turn))
        knee = ((hip[0] + pedal[0]) / 2 + 0.28, 0.11 * side, (hip[2] + pedal[2]) / 2 + 0.08)
        parts.append(f.limb((hip[0], 0.1 * side, hip[2]), knee, 0.1, 0.075, look.lower))
        parts.append(f.limb(knee, pedal, 0.07, 0.05, shade(SKIN, 0.9)))
        start = (shoulder[0], 0.18 * side, shoulder[2])
        parts.append(f.limb(start, (head[0] + 0.05, 0.22 * side, 1.02), 0.055, 0.045, shade(look.upper, 0.9)))
    middle = (0.0, 0.0, 1.26)
    parts.append(f.limb(hip, middle, 0.17, 0.18, shade(look.upper, 0.85)))
    parts.append(f.limb(middle, shoulder, 0.18, 0.19, look.upper))
    parts.append(f.limb((-0.1, 0.0, 1.33), (0.12, 0.0, 1.5), 0.09, 0.09, look.mark))
    parts.append(f.limb((0.3, 0.0, 1.58), (0.34, 0.0, 1.64), 0.1, 0.1, SKIN))
    parts.append(f.limb((0.27, 0.0, 1.68), (0.36, 0.0, 1.7), 0.125, 0.11, look.mark))
    return parts


def car(f: Frame3, look: Look) -> list[Draft]:
    """A saloon of 4.5 x 1.8 x 1.45 m; the cabin's faces come after the hull's, so that they are drawn over it."""
    parts: list[Draft] = []
    for x in (-1.35, 1.35):
        for y in (-0.91, 0.91):
            ring = [(x + 0.32 * math.cos(a), y, 0.32 + 0.32 * math.sin(a)) for a in np.linspace(0, 2 * math.pi, 10)]
            parts.append((ring[:-1], look.dark, None))
    parts += f.box((-2.25, -0.9, 0.28), (2.25, 0.9, 0.85), look.upper)
    for y0, y1 in ((-0.85, -0.5), (0.5, 0.85)):
        parts.append(f.face([(-2.26, y1, 0.6), (-2.26, y0, 0.6), (-2.26, y0, 0.78), (-2.26, y1, 0.78)], (40, 40, 220)))
        parts.append(f.face([(2.26, y0, 0.6), (2.26, y1, 0.6), (2.26, y1, 0.78), (2.26, y0, 0.78)], (235, 240, 240)))
    plate = [(-2.26, 0.25, 0.42), (-2.26, -0.25, 0.42), (-2.26, -0.25, 0.54), (-2.26, 0.25, 0.54)]
    parts.append(f.face(plate, (200, 215, 220)))
    parts.append(f.face([(1.0, 0.15, 0.86), (1.0, 0.4, 0.86), (2.2, 0.4, 0.86), (2.2, 0.15, 0.86)][::-1], look.mark))
    parts += f.box((-1.75, -0.8, 0.85), (1.05, 0.8, 1.42), look.dark, inset=0.5)
    roof = [(-1.2, -0.74, 1.44), (0.5, -0.74, 1.44), (0.5, 0.74, 1.44), (-1.2, 0.74, 1.44)]
    parts.append(f.face(roof, look.upper))
    parts.append(f.face([(x * 0.5 - 0.2, y * 0.35, z + 0.01) for x, y, z in roof], look.mark))
    return parts
