"""What a detector found while the target is lost, as places at which the tracker looks for it.

A candidate is only looked at: the tracker must find the target there, and the estimate must accept what it finds, by
the rules for whoever is found after a loss (`follow.control.regain`).
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
"""Candidates of one frame that are looked at: the detector's next answer comes some eight frames later, and every
second frame is searched at the predicted place."""


@dataclass(slots=True)
class Candidates:
    """The places (3,), NED, of the newest detections that were not yet looked at, the most probable last.

    `t_s` is the time of their frame.
    """

    t_s: float = NEVER
    places: list[Array] = field(default_factory=list[Array])

    def next(
        self, found: Detections, sight_of: Callable[[Box], Sight], pose: Pose, f: JointFilter, seen_ned: Array
    ) -> Array | None:
        """The next place to look at, None if there is none.

        `sight_of` makes a box of the detections' frame a measurement, `pose` is the vehicle's at that time and `f` the
        target's now.  Those nearest to the path from where the target was seen last to where it should be come first.
        """
        if found.t_s != self.t_s:
            self.t_s = found.t_s
            places = [place_by_size(sight_of(detection.box), pose, f) for detection in found.objects]

            def distance_m(place: Array) -> float:
                return distance_to_segment(place[:2], seen_ned[:2], f.mean[:2])

            self.places = sorted(places, key=distance_m)[:OFFERED][::-1]
        return self.places.pop() if self.places else None


def place_by_size(sight: Sight, pose: Pose, f: JointFilter) -> Array:
    """Where (3,), NED, something as large as the target is, by its direction and its size in the image."""
    return pose.position_ned + math.exp(f.mean[7] + f.mean[10] - sight.size_log) * sight.toward
