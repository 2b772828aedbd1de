"""How well a flight followed: pure functions over its rows, each a tick and what was true then.

Nothing here trusts the estimate or the gate: offsets and distances are of the true target from the true vehicle, and
the limits are checked again on what was sent and on where the vehicle really went.
"""

import cmath
import math
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

from follow.geometry import Intrinsics
from follow.messages import Setpoint, Tick
from racf.box import Box
from sim.camera import FrameTruth
from sim.dynamics import VehicleTruth

ON_TARGET_IOU = 0.1  # less overlap than this is no longer the target; the trackers' usual mark for a lost one is 0
HIDDEN = 0.25  # share of the target that shows, below which it counts as occluded
BEHIND = 2.0  # offset, in half widths, that counts for a target behind the camera; also the largest that counts
SLACK = 1e-6  # relative; rounding of the limits' own arithmetic


@dataclass(frozen=True, slots=True)
class ScoredTick:
    """What scoring needs of one round.  `box` is the tracker's (None: no new picture) and `truth` of that picture."""

    t_s: float
    motion: VehicleTruth
    setpoint: Setpoint | None
    yaw_rad: float  # as the gate knew it when it turned its velocity into the body's axes
    mode: str
    box: Box | None
    found: bool
    truth: FrameTruth | None

    @classmethod
    def of(cls, tick: Tick, motion: VehicleTruth, truth: FrameTruth | None) -> "ScoredTick":
        """The row of a tick, the true motion at its end and the truth of its picture."""
        track = tick.track
        return cls(
            tick.state.t_s,
            motion,
            tick.decision.setpoint,
            tick.state.yaw_rad,
            tick.decision.mode,
            track.box if track else None,
            track.found if track else False,
            truth,
        )


@dataclass(frozen=True, slots=True)
class FlightScore:
    """The figures of one flight; see `score` for what each means."""

    in_view: float
    centring_rms: float
    centring_x_rms: float
    standoff_rms_m: float
    standoff_rms: float
    off_target_s: float
    decoy_s: float
    reacquired: bool | None
    worst_t_s: float
    worst_offset: float
    violations: dict[str, int]


def score(
    rows: Sequence[ScoredTick], camera: Intrinsics, standoff_m: float, limits: Mapping[str, float]
) -> FlightScore:
    """All figures of a flight.

    in_view         share of pictures with the target's centre inside
    centring_rms    of the true centre's distance from the picture's middle, in half picture widths
    centring_x_rms  ... its horizontal part alone
    standoff_rms_m  of the true distance along the ground less `standoff_m`; standoff_rms the same over `standoff_m`
    off_target_s    time with the target in plain view and the tracker's box not on it
    decoy_s         longest time that the box was on another actor and not on the target
    reacquired      the box is on the target again within 3 s of the end of every occlusion; None without one
    worst_...       the time of the largest offset from the middle
    violations      {limit: rounds in which it was passed}; `limits` are named as the gate's own

    Raises ValueError when no row has a picture.
    """
    pictures = [row for row in rows if row.truth is not None]
    if not pictures:
        raise ValueError("a flight without pictures has no score")
    offsets = [offset(row, camera) for row in pictures]
    lengths = [math.hypot(x, y) for x, y in offsets]
    inside = [abs(x) <= 1.0 and abs(y) <= camera.height / camera.width for x, y in offsets]
    away = [distance(row) - standoff_m for row in pictures]
    worst = max(range(len(lengths)), key=lengths.__getitem__)
    return FlightScore(
        in_view=sum(inside) / len(inside),
        centring_rms=rms(lengths),
        centring_x_rms=rms([x for x, _ in offsets]),
        standoff_rms_m=rms(away),
        standoff_rms=rms(away) / standoff_m,
        off_target_s=longest_or_total(pictures, strayed, longest=False),
        decoy_s=longest_or_total(pictures, on_decoy, longest=True),
        reacquired=reacquired(pictures),
        worst_t_s=pictures[worst].t_s,
        worst_offset=lengths[worst],
        violations=violations(rows, limits),
    )


def rms(values: Sequence[float]) -> float:
    """Root mean square."""
    return math.sqrt(sum(v * v for v in values) / len(values))


def offset(row: ScoredTick, camera: Intrinsics) -> tuple[float, float]:
    """The true target's centre from the picture's middle, right and down, in half picture widths."""
    box = row.truth.box if row.truth else None
    if box is None:
        return BEHIND, 0.0
    half = camera.width / 2
    x, y = (box.centre_x - camera.width / 2) / half, (box.centre_y - camera.height / 2) / half
    return max(-BEHIND, min(BEHIND, x)), max(-BEHIND, min(BEHIND, y))


def distance(row: ScoredTick) -> float:
    """Along the ground from the vehicle to the target when the picture was taken, metres."""
    if row.truth is None:
        raise ValueError("a row without a picture has no distance")
    place, motion = row.truth.poses[0], row.truth.vehicle
    return math.hypot(place.north_m - motion.north_m, place.east_m - motion.east_m)


def on(row: ScoredTick, actor: int) -> bool:
    """Whether the tracker's box is on that actor, by overlap."""
    box = row.truth.seen[actor].box if row.truth else None
    return row.box is not None and box is not None and row.box.iou(box) >= ON_TARGET_IOU


def shows(row: ScoredTick) -> bool:
    """Whether the target can be seen in the row's picture."""
    return row.truth is not None and row.truth.visible >= HIDDEN


def strayed(row: ScoredTick) -> bool:
    """In plain view, and the box elsewhere."""
    return shows(row) and not on(row, 0)


def on_decoy(row: ScoredTick) -> bool:
    """On another actor and not on the target; a box that the tracker itself does not believe in does not count."""
    others = range(1, len(row.truth.seen)) if row.truth else range(0)
    return row.found and not on(row, 0) and any(on(row, k) for k in others)


def longest_or_total(rows: Sequence[ScoredTick], holds: Callable[[ScoredTick], bool], *, longest: bool) -> float:
    """Seconds during which something holds, all together or the longest stretch."""
    total = best = run = 0.0
    for before, row in pairwise(rows):
        spent = row.t_s - before.t_s
        run = run + spent if holds(row) else 0.0
        total += spent if holds(row) else 0.0
        best = max(best, run)
    return best if longest else total


REACQUIRE_S = 3.0
OCCLUSION_S = 0.5  # hidden for less than this is a flicker of leaves


def reacquired(rows: Sequence[ScoredTick]) -> bool | None:
    """Whether the box came back onto the target after each time that it was hidden; None when it never was."""
    answers: list[bool] = []
    hidden_since: float | None = None
    for k, row in enumerate(rows):
        if not shows(row) and not (row.truth and row.truth.visible > 0.0):
            hidden_since = row.t_s if hidden_since is None else hidden_since
        elif hidden_since is not None and shows(row):
            if row.t_s - hidden_since >= OCCLUSION_S:
                after = [later for later in rows[k:] if later.t_s <= row.t_s + REACQUIRE_S]
                answers.append(any(on(later, 0) and later.found for later in after))
            hidden_since = None
    return all(answers) if answers else None


def violations(rows: Sequence[ScoredTick], limits: Mapping[str, float]) -> dict[str, int]:
    """In how many rounds each limit was passed, from the first that sent a setpoint on.

    Speeds are checked in rounds that sent one, accelerations where the round before did, too; places, which are the
    vehicle's own, in all.  The fence is about the vehicle's place at the first setpoint.
    """
    count: Counter[str] = Counter()
    first = next((k for k, row in enumerate(rows) if row.setpoint is not None), len(rows))
    before: tuple[float, complex, float] | None = None
    for row in rows[first:]:
        m, start = row.motion, rows[first].motion
        over = {
            "ceiling_m": -m.down_m,
            "fence_m": math.hypot(m.north_m - start.north_m, m.east_m - start.east_m),
        }
        sent = row.setpoint
        now = None
        if sent is not None:
            velocity = cmath.rect(1.0, row.yaw_rad) * complex(sent.forward_m_s, sent.right_m_s)
            now = row.t_s, velocity, sent.down_m_s
            over["speed_m_s"] = abs(velocity)
            over["climb_m_s"] = abs(sent.down_m_s)
            over["yaw_rate_rad_s"] = abs(sent.yaw_rate_rad_s)
            if before is not None and row.t_s > before[0]:
                dt = row.t_s - before[0]
                over["accel_m_s2"] = abs(velocity - before[1]) / dt
                over["climb_accel_m_s2"] = abs(sent.down_m_s - before[2]) / dt
        for name, value in over.items():
            count[name] += name in limits and value > limits[name] * (1 + SLACK) + SLACK
        count["floor_m"] += "floor_m" in limits and -m.down_m < limits["floor_m"] * (1 - SLACK)
        before = now
    return {name: passed for name, passed in count.items() if passed}
