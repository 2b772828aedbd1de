"""How well a flight followed: pure functions over its rows, each a tick with the ground truth of its time.

Nothing here trusts the estimate or the gate: offsets and distances are of the true target from the true vehicle, and
the limits are checked again on what was sent and on where the vehicle really went.
"""

import cmath
import math
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

from follow.geometry import Intrinsics, ned_to_heading
from follow.messages import Cause, Setpoint, Tick
from racf.box import Box
from sim.camera import FrameTruth, SceneCamera
from sim.dynamics import VehicleTruth
from sim.scene.world import ActorPose, Kind

ON_TARGET_IOU = 0.1  # a box that overlaps less is not on the target; benchmarks usually count a target as lost at 0
HIDDEN = 0.25  # fraction of the target that shows, below which it counts as occluded
BEHIND = 2.0  # offset, in half widths, of a target behind the camera; larger offsets are clipped to it
SLACK = 1e-6  # relative; rounding of the limits' own arithmetic

PERSON_M = (0.0, 0.0, 1.75)
BODY_M = {Kind.WALKER: PERSON_M, Kind.RUNNER: PERSON_M, Kind.CYCLIST: (1.75, 0.0, 1.75), Kind.CAR: (4.5, 1.8, 1.45)}
"""Length, width, height of each kind as `sim/scene/bodies.py` draws it; somebody on foot is a line up from the feet."""


@dataclass(frozen=True, slots=True)
class ScoredTick:
    """One round of the flight, with all that scoring uses.

    `box` is the tracker's (None: no new frame) and `truth` that frame's.  `nearest_m` and `nearest_other_m` lead from
    the vehicle to the target's body and to the nearest other actor's (inf: there is nobody else).  `begins` is whether
    the gate restarted its ramps at the vehicle's measured velocity, because the vehicle does not follow the setpoints.
    `home` (north and east, m) is the fence's centre, None as long as the autopilot has not told it.
    """

    t_s: float
    vehicle: VehicleTruth
    setpoint: Setpoint | None
    yaw_rad: float  # as the gate knew it when it turned its velocity into the body's axes
    mode: str
    box: Box | None
    found: bool
    truth: FrameTruth | None
    nearest_m: float = math.inf
    nearest_other_m: float = math.inf
    begins: bool = False
    home: tuple[float, float] | None = None

    @classmethod
    def of(cls, tick: Tick, camera: SceneCamera) -> "ScoredTick":
        """The row of the tick that has just processed the camera's round."""
        track, (vehicle, poses) = tick.track, camera.now()
        away = [body_distance(a.kind, p, vehicle) for a, p in zip(camera.world.actors, poses, strict=True)]
        return cls(
            tick.state.t_s,
            vehicle,
            tick.decision.setpoint,
            tick.state.yaw_rad,
            tick.decision.mode,
            track.box if track else None,
            track.found if track else False,
            camera.truth(tick.frame.index) if tick.frame else None,
            away[0],
            min(away[1:], default=math.inf),
            tick.decision.reason.cause is Cause.NOT_OBEYING,
            camera.home(tick.state),
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
    nearest_m: float
    nearest_other_m: float | None
    violations: dict[str, int]


def score(
    rows: Sequence[ScoredTick], camera: Intrinsics, standoff_m: float, limits: Mapping[str, float]
) -> FlightScore:
    """All figures of a flight.

    in_view         fraction of frames with the target's centre inside
    centring_rms    RMS of the true centre's distance from the image's middle, in half image widths
    centring_x_rms  the same of its horizontal part alone
    standoff_rms_m  RMS of the true distance along the ground less `standoff_m`; standoff_rms the same over `standoff_m`
    off_target_s    time with the target in plain view and the tracker's box not on it
    decoy_s         longest time that the box was on another actor and not on the target
    reacquired      the box is on the target again within 3 s of the end of every occlusion in the image; None without
    worst_t_s       time of the largest offset from the middle, `worst_offset`
    nearest_m       least distance from the vehicle to the target's body, from feet to head
    nearest_other_m the same to anybody else; None without one
    violations      {limit: rounds in which it was exceeded}; `limits` have the names of the gate's limits

    Raises ValueError if no row has a frame.
    """
    framed = [row for row in rows if row.truth is not None]
    if not framed:
        raise ValueError("a flight without frames has no score")
    offsets = [offset(row, camera) for row in framed]
    lengths = [math.hypot(x, y) for x, y in offsets]
    inside = [abs(x) <= 1.0 and abs(y) <= camera.height / camera.width for x, y in offsets]
    away = [distance(row) - standoff_m for row in framed]
    worst = max(range(len(lengths)), key=lengths.__getitem__)
    return FlightScore(
        in_view=sum(inside) / len(inside),
        centring_rms=rms(lengths),
        centring_x_rms=rms([x for x, _ in offsets]),
        standoff_rms_m=rms(away),
        standoff_rms=rms(away) / standoff_m,
        off_target_s=longest_or_total(framed, strayed, longest=False),
        decoy_s=longest_or_total(framed, on_decoy, longest=True),
        reacquired=reacquired(framed, inside),
        worst_t_s=framed[worst].t_s,
        worst_offset=lengths[worst],
        nearest_m=min(row.nearest_m for row in rows),
        nearest_other_m=finite(min(row.nearest_other_m for row in rows)),
        violations=violations(rows, limits),
    )


def body_distance(kind: Kind, pose: ActorPose, vehicle: VehicleTruth) -> float:
    """Distance from the vehicle to an actor's body, metres; 0 inside it."""
    length, width, height = BODY_M[kind]
    north, east = vehicle.north_m - pose.north_m, vehicle.east_m - pose.east_m
    ahead, aside = ned_to_heading(north, east, pose.heading_rad)
    up = pose.down_m - vehicle.down_m
    outside = max(abs(ahead) - length / 2, 0.0), max(abs(aside) - width / 2, 0.0), max(-up, up - height, 0.0)
    return math.hypot(*outside)


def finite(value: float) -> float | None:
    """The value, or None for an infinite one."""
    return value if math.isfinite(value) else None


def rms(values: Sequence[float]) -> float:
    """Root mean square."""
    return math.sqrt(sum(v * v for v in values) / len(values))


def offset(row: ScoredTick, camera: Intrinsics) -> tuple[float, float]:
    """The true target's centre from the image's middle, right and down, in half image widths."""
    box = row.truth.box if row.truth else None
    if box is None:
        return BEHIND, 0.0
    half = camera.width / 2
    x, y = (box.centre_x - camera.width / 2) / half, (box.centre_y - camera.height / 2) / half
    return max(-BEHIND, min(BEHIND, x)), max(-BEHIND, min(BEHIND, y))


def distance(row: ScoredTick) -> float:
    """Along the ground from the vehicle to the target when the frame was taken, metres."""
    if row.truth is None:
        raise ValueError("a row without a frame has no distance")
    target, vehicle = row.truth.poses[0], row.truth.vehicle
    return math.hypot(target.north_m - vehicle.north_m, target.east_m - vehicle.east_m)


def on(row: ScoredTick, actor: int) -> bool:
    """Whether the tracker's box is on that actor, by overlap."""
    box = row.truth.seen[actor].box if row.truth else None
    return row.box is not None and box is not None and row.box.iou(box) >= ON_TARGET_IOU


def shows(row: ScoredTick) -> bool:
    """Whether the target can be seen in the row's frame."""
    return row.truth is not None and row.truth.visible >= HIDDEN


def strayed(row: ScoredTick) -> bool:
    """In plain view, and the box elsewhere."""
    return shows(row) and not on(row, 0)


def on_decoy(row: ScoredTick) -> bool:
    """On another actor and not on the target; a box that the tracker reports as not found does not count."""
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


def reacquired(rows: Sequence[ScoredTick], inside: Sequence[bool]) -> bool | None:
    """Whether the box came back onto the target after each time that it was hidden; None when it never was.

    `inside` says for each row whether the target's centre is in the image: one that left the image is not hidden.
    """
    answers: list[bool] = []
    hidden_since: float | None = None
    for k, row in enumerate(rows):
        if not shows(row) and not (row.truth and row.truth.visible > 0.0):
            hidden_since = row.t_s if hidden_since is None and inside[k] else hidden_since
        elif hidden_since is not None and shows(row):
            if row.t_s - hidden_since >= OCCLUSION_S:
                after = [later for later in rows[k:] if later.t_s <= row.t_s + REACQUIRE_S]
                answers.append(any(on(later, 0) and later.found for later in after))
            hidden_since = None
    return all(answers) if answers else None


def violations(rows: Sequence[ScoredTick], limits: Mapping[str, float]) -> dict[str, int]:
    """In how many rounds each limit was exceeded, from the round of the first setpoint on.

    Speeds and the distance to the target's body are checked in rounds that sent a setpoint, accelerations if the round
    before also did and the ramps did not restart; the vehicle's own position in all.  Heights are above the ground
    below the vehicle.  The fence is centred on home or, if that is unknown, on the position at the first setpoint.
    """
    count: Counter[str] = Counter()
    first = next((k for k, row in enumerate(rows) if row.setpoint is not None), len(rows))
    before: tuple[float, complex, float] | None = None
    had_begun = False
    for row in rows[first:]:
        m, start = row.vehicle, rows[first].vehicle
        centre = row.home or (start.north_m, start.east_m)
        over = {"ceiling_m": m.height_m, "fence_m": math.dist((m.north_m, m.east_m), centre)}
        sent = row.setpoint
        now = None
        if sent is not None:
            velocity = cmath.rect(1.0, row.yaw_rad) * complex(sent.forward_m_s, sent.right_m_s)
            now = row.t_s, velocity, sent.down_m_s
            over["speed_m_s"] = abs(velocity)
            over["climb_m_s"] = abs(sent.down_m_s)
            over["yaw_rate_rad_s"] = abs(sent.yaw_rate_rad_s)
            if before is not None and row.t_s > before[0] and not (row.begins and not had_begun):
                dt = row.t_s - before[0]
                over["accel_m_s2"] = abs(velocity - before[1]) / dt
                over["climb_accel_m_s2"] = abs(sent.down_m_s - before[2]) / dt
        for name, value in over.items():
            count[name] += name in limits and value > limits[name] * (1 + SLACK) + SLACK
        least = {"floor_m": m.height_m, "min_standoff_m": row.nearest_m if sent is not None else math.inf}
        for name, value in least.items():
            count[name] += name in limits and value < limits[name] * (1 - SLACK)
        before, had_begun = now, row.begins
    return {name: passed for name, passed in count.items() if passed}
