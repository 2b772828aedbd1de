"""A detector's objects while the target is lost, as positions at which the tracker searches for it.

A candidate is only a place to search: the tracker must find the target there, and the estimate must accept the box, by
the same rules as for any box after a loss (`follow.control.regain`).
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, field

from follow.control.joint_filter import JointFilter, Sight
from follow.control.pose_history import Pose
from follow.control.regain import distance_to_segment
from follow.geometry import Array
from follow.messages import NEVER
from follow.selection import Detections
from racf.box import Box

OFFERED = 4
"""Candidates of one frame that are searched: the detector's next answer arrives some eight frames later, and every
second frame searches the predicted position."""


@dataclass(slots=True)
class Candidates:
    """The positions (3,), NED, of the newest detections that were not yet searched, the most probable last.

    `t_s` is the time of their frame.
    """

    t_s: float = NEVER
    places: list[Array] = field(default_factory=list[Array])

    def next(
        self, found: Detections, sight_of: Callable[[Box], Sight], pose: Pose, f: JointFilter, seen_ned: Array
    ) -> Array | None:
        """The next position to search, None if there is none.

        `sight_of` turns a box of the detections' frame into a measurement; `pose` is the vehicle's at that time, `f`
        the target's filter now.  Positions nearest to the path from the last seen position to the predicted one come
        first.
        """
        if found.t_s != self.t_s:
            self.t_s = found.t_s
            places = [place_by_size(sight_of(detection.box), pose, f) for detection in found.objects]

            def distance_m(place: Array) -> float:
                return distance_to_segment(place[:2], seen_ned[:2], f.mean[:2])

            self.places = sorted(places, key=distance_m)[:OFFERED][::-1]
        return self.places.pop() if self.places else None


def place_by_size(sight: Sight, pose: Pose, f: JointFilter) -> Array:
    """The position (3,), NED, of an object as large as the target, by its direction and its size in the image."""
    return pose.position_ned + math.exp(f.mean[7] + f.mean[10] - sight.size_log) * sight.toward
