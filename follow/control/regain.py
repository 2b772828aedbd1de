"""A lost target: where to search for it, and whether a candidate that was found can be it.

A candidate can be the target only where the target can be.  The positions at least as likely as the candidate's cover
an area: within the distance r of the path from the last seen position to the predicted one, of length l, that is
2 r l + pi r^2.  The larger this area, and the longer the target was unseen, the more probably it holds somebody else.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from follow.control.joint_filter import JointFilter
from follow.control.pose_history import Pose
from follow.geometry import Array, wrap
from follow.messages import OtherSighting

LOOK_M, LOOK_ALONG = 10.0, 0.5
"""Largest half-axis of the search ellipse from the covariance, and the least one along the course, as a fraction of
the distance from the last seen position to the predicted one."""

LOOK_REACH_M = 1.5
"""The tracker finds the target within this distance of the position it searches: its search region is 4 m across."""

LOOKS = round((LOOK_M / LOOK_REACH_M) ** 2)
"""Largest number of search positions in the ellipse."""


def looked_for(f: JointFilter, seen_ned: Array, look: int) -> Array:
    """The position (3,), NED, to search in the `look`-th frame after a loss: the predicted one in every second frame.

    The others cover an ellipse around it: two standard deviations across its course and along it, and along it at
    least far enough for half the predicted speed or one and a half times that.
    """
    if look % 2 == 0:
        return f.mean[:3]
    path = f.mean[:2] - seen_ned[:2]
    length = float(np.linalg.norm(path))
    course = path / length if length > 0.1 else np.array([1.0, 0.0])
    across = np.array([-course[1], course[0]])
    stds = [math.sqrt(max(float(axis @ f.covariance[:2, :2] @ axis), 0.0)) for axis in (course, across)]
    ahead, aside = (min(2 * std, LOOK_M) for std in stds)
    ahead = max(ahead, LOOK_ALONG * length)
    looks = min(max(math.ceil(ahead * aside / LOOK_REACH_M**2), 1), LOOKS)
    step = look // 2 % looks
    radius, angle = math.sqrt((step + 0.5) / looks), 2.4 * step  # golden angle: a sunflower spiral covers it evenly
    position = f.mean[:3].copy()
    position[:2] += radius * (ahead * math.cos(angle) * course + aside * math.sin(angle) * across)
    return position


def next_look(f: JointFilter, seen_ned: Array, looks: int, in_image: Callable[[Array], bool]) -> tuple[int, Array]:
    """The number and position (3,) of the next look after `looks`: the first in the image, else the predicted one."""
    for look in range(looks + 1, looks + 1 + 2 * LOOKS):
        position = looked_for(f, seen_ned, look)
        if in_image(position):
            return look, position
    return looks + 1, f.mean[:3]


def distance_to_segment(point: Array, start: Array, end: Array) -> float:
    """Distance (metres) of a point (2,) from the line between two others."""
    along = end - start
    length2 = float(along @ along)
    fraction = min(max(float((point - start) @ along) / length2, 0.0), 1.0) if length2 > 0 else 0.0
    return float(np.linalg.norm(point - start - fraction * along))


WALK_M_S, WALK_S = 1.5, 3.0
"""Walking speed of another person between two sightings, and the longest time over which it is extrapolated."""

COMES_S = 6.0
"""Time in which as many other people enter an area as it holds on average: they walk 8 m."""

NEW_S = 1.0
"""The newest candidate counts for the distance to other people for this long."""

OTHERS = 16
"""Number of other people remembered, those found last."""

NOT_TAKEN = "not taken: may be another"
"""Message to the operator about a candidate that cannot be the target: a person, a thing or bare ground."""

SAID_S = 3.0
"""The message is shown for this long after the last sighting of that candidate."""


@dataclass(frozen=True, slots=True)
class Candidate:
    """A box found after a loss: its position (2,), north and east, by direction and size, with a standard deviation.

    `down_m` is the height of its middle.
    """

    t_s: float
    place: Array
    std_m: float
    down_m: float = 0.0

    def may_be(self, later: "Candidate") -> bool:
        """Whether a later box may show the same person."""
        walked_m = WALK_M_S * min(max(later.t_s - self.t_s, 0.0), WALK_S)
        return float(np.linalg.norm(later.place - self.place)) <= 2 * max(self.std_m, later.std_m) + walked_m


@dataclass(frozen=True, slots=True)
class PathDistance:
    """Where a candidate is, relative to the positions that the target can have.

    `aside_m` is its distance from the path, less its own deviation; `path_m` the path's length.  `is_near` says that
    distance and height are within the filter's own uncertainty.  `unseen_s` is the time since the loss.
    `is_on_ground` says that its height is plausible for the ground there; otherwise it is not a person.
    """

    aside_m: float
    path_m: float
    is_near: bool
    unseen_s: float
    is_on_ground: bool = True

    @property
    def area_m2(self) -> float:
        """Area of the positions that are at least as likely as this one, at least that around one position.

        The area grows with the time since the loss, because other people enter it one by one.
        """
        around = math.pi * self.aside_m**2
        return max(around, (2 * self.aside_m * self.path_m + around) * self.unseen_s / COMES_S)


@dataclass(slots=True)
class OtherPerson:
    """Somebody found where the target could not be: the last sighting, and the number of frames that showed it."""

    last: Candidate
    frames: int = 1


@dataclass(slots=True)
class Regain:
    """What was found since the target was lost: the candidate on trial, and other people.

    Somebody once found where the target could not be stays another person, even if by now the target could be there.
    `frames` is the number of consecutive frames that showed the candidate on trial; `found` is the newest candidate,
    accepted or not.
    """

    frames: int = 0
    found: Candidate | None = None
    begun: Candidate | None = None
    last: Candidate | None = None
    others: list[OtherPerson] = field(default_factory=list[OtherPerson])
    told: str = ""
    told_t_s: float = -math.inf

    def miss(self) -> None:
        """A frame without a candidate: the trial is over."""
        self.frames = 0

    def shift(self, jump_ned: Array) -> None:
        """Move all remembered positions with the vehicle's own position estimate, which jumped by (3,) metres."""
        for other in self.others:
            other.last = replace(other.last, place=other.last.place + jump_ned[:2])
        if self.last is not None:
            self.last = replace(self.last, place=self.last.place + jump_ned[:2])
        if self.found is not None:
            place, down_m = self.found.place + jump_ned[:2], self.found.down_m + float(jump_ned[2])
            self.found = replace(self.found, place=place, down_m=down_m)

    def sighting(self, pose: Pose) -> OtherSighting | None:
        """Where the newest candidate is, seen from the vehicle; None if it is older than `NEW_S`."""
        if self.found is None or not 0.0 <= pose.t_s - self.found.t_s <= NEW_S:
            return None
        away = self.found.place - pose.position_ned[:2]
        range_m = max(float(np.linalg.norm(away)) - 2 * self.found.std_m, 0.0)
        azimuth_rad = wrap(math.atan2(away[1], away[0]) - pose.yaw_rad)
        return OtherSighting(azimuth_rad, range_m, self.found.down_m - float(pose.position_ned[2]))

    def doubt(self, t_s: float) -> str:
        """The message about a rejected candidate; empty if there is none."""
        return self.told if 0.0 <= t_s - self.told_t_s <= SAID_S else ""

    def admits(self, found: Candidate, distance: PathDistance, area_m2: float, confirm: int) -> bool:
        """Whether the candidate can be the target; if so it starts or continues the trial."""
        if not all(map(math.isfinite, (*found.place, found.down_m, found.std_m))):
            self.miss()
            return False
        self.found = found if distance.is_on_ground else self.found
        other = next((other for other in self.others if other.last.may_be(found)), None)
        is_other = other is not None and other.frames >= confirm
        if is_other or distance.area_m2 > area_m2:
            self.miss()
            if other is None:
                self.others = [*self.others[1 - OTHERS :], OtherPerson(found)]
                return False
            other.last, other.frames = found, other.frames + 1
            if other.frames >= confirm:
                self.told, self.told_t_s = f"{NOT_TAKEN} ({distance.aside_m:.0f} m from the target's path)", found.t_s
            return False
        if not distance.is_near:
            self.miss()
            return False
        if self.frames == 0 or self.last is None or not self.last.may_be(found):
            self.frames, self.begun = 0, found
        self.frames, self.last = self.frames + 1, found
        return True

    def confirmed(self, t_s: float, lost_t_s: float, confirm: int, fraction: float) -> bool:
        """Whether the trial lasted enough frames, and a fraction of the time from the loss to its begin."""
        if self.begun is None:
            return False
        needed_s = fraction * (self.begun.t_s - lost_t_s)
        return self.frames >= confirm and t_s - self.begun.t_s >= needed_s - 1e-9
