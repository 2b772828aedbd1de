"""A target that was lost: where to look for it, and whether somebody who is found can be it.

A candidate is the target only where the target can be.  The places that are as likely as the candidate's, and those
that are likelier, cover an area: within the distance r of the path from the last place seen to the predicted one, of
length l, that is 2 r l + pi r^2.  The larger it is, and the longer the target was unseen, the more probably somebody
else has come to stand in it.
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
"""A lost target is looked for at most this far to either side, and along its course by this part of its way."""

LOOK_REACH_M = 1.5
"""The tracker finds somebody this far from the place at which it looks: its search region is 4 m across."""

LOOKS = round((LOOK_M / LOOK_REACH_M) ** 2)
"""Largest number of places."""


def looked_for(f: JointFilter, seen_ned: Array, look: int) -> Array:
    """Where (3,), NED, to look for a lost target in the `look`-th frame: the predicted place in every second one.

    The others go through an ellipse around it: two standard deviations to either side of its course and along it, and
    along it so far that it may have been half as fast or half as fast again.
    """
    if look % 2 == 0:
        return f.mean[:3]
    way = f.mean[:2] - seen_ned[:2]
    length = float(np.linalg.norm(way))
    course = way / length if length > 0.1 else np.array([1.0, 0.0])
    across = np.array([-course[1], course[0]])
    stds = [math.sqrt(max(float(axis @ f.covariance[:2, :2] @ axis), 0.0)) for axis in (course, across)]
    ahead, aside = (min(2 * std, LOOK_M) for std in stds)
    ahead = max(ahead, LOOK_ALONG * length)
    looks = min(max(math.ceil(ahead * aside / LOOK_REACH_M**2), 1), LOOKS)
    step = look // 2 % looks
    reach, angle = math.sqrt((step + 0.5) / looks), 2.4 * step  # the golden angle: as the seeds of a sunflower lie
    place = f.mean[:3].copy()
    place[:2] += reach * (ahead * math.cos(angle) * course + aside * math.sin(angle) * across)
    return place


def next_look(f: JointFilter, seen_ned: Array, looks: int, in_image: Callable[[Array], bool]) -> tuple[int, Array]:
    """The number of the next look after `looks`, and its place (3,): one in the image, unless there is none."""
    for look in range(looks + 1, looks + 1 + 2 * LOOKS):
        place = looked_for(f, seen_ned, look)
        if in_image(place):
            return look, place
    return looks + 1, f.mean[:3]


def distance_to_segment(point: Array, start: Array, end: Array) -> float:
    """Distance (metres) of a point (2,) from the line between two others."""
    along = end - start
    length2 = float(along @ along)
    fraction = min(max(float((point - start) @ along) / length2, 0.0), 1.0) if length2 > 0 else 0.0
    return float(np.linalg.norm(point - start - fraction * along))


WALK_M_S, WALK_S = 1.5, 3.0
"""Speed of somebody else who was found where the target could not be, and how long he is expected to walk unseen."""

COMES_S = 6.0
"""Time in which as many other people come to stand in an area as it holds on average: they walk 8 m."""

NEW_S = 1.0
"""Somebody who was found keeps his distance from the vehicle for this long."""

OTHERS = 16
"""Number of other people remembered, those found last."""

NOT_TAKEN = "not taken: another person, select again"
"""What the operator is told of a candidate that cannot be the target."""

SAID_S = 3.0
"""The operator is told so for this long after the candidate was found last."""


@dataclass(frozen=True, slots=True)
class Candidate:
    """A box found after a loss: the place (2,), north and east, that direction and size give it, and its deviation.

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
    """Where a candidate stands against where the target can be.

    `aside_m` is its distance from the path, less its own deviation; `path_m` the path's length.  `is_near` says that
    distance and height are within the filter's own uncertainty.  `unseen_s` is the time since the loss.
    `is_on_ground` says that it is as high as the ground there can be: what is not is nobody.
    """

    aside_m: float
    path_m: float
    is_near: bool
    unseen_s: float
    is_on_ground: bool = True

    @property
    def area_m2(self) -> float:
        """Area of the places that are at least as likely, as large as that around one place at least.

        That of the way counts by the time since the loss: others come into it one by one.
        """
        around = math.pi * self.aside_m**2
        return max(around, (2 * self.aside_m * self.path_m + around) * self.unseen_s / COMES_S)


@dataclass(slots=True)
class OtherPerson:
    """Somebody found where the target could not be: where and when last, and the number of frames that showed it."""

    last: Candidate
    frames: int = 1


@dataclass(slots=True)
class Regain:
    """What was found since the target was lost: the candidate on trial, and those who are somebody else.

    Who once stood where the target could not be stays somebody else, also when the target may have come there by now.
    `frames` is the number of consecutive frames that showed the candidate on trial; `found` is the newest candidate,
    whatever came of it.
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
        """Move what is remembered with the vehicle's own position estimate, which jumped by (3,) metres."""
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
        """Who was found and is not taken, in words; empty if there is nobody."""
        return self.told if 0.0 <= t_s - self.told_t_s <= SAID_S else ""

    def admits(self, found: Candidate, distance: PathDistance, area_m2: float, confirm: int) -> bool:
        """Whether the candidate can be the target; if so the trial goes on, or begins with it."""
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
        """Whether the candidate was right in enough consecutive frames, for a fraction of the time since the loss."""
        if self.begun is None:
            return False
        asked_s = fraction * (self.begun.t_s - lost_t_s)
        return self.frames >= confirm and t_s - self.begun.t_s >= asked_s - 1e-9
