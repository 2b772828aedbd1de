"""Whether the object at a tap can be a target: on the ground, below the horizon, and near enough to be followed.

Near the horizon a pixel is tens of metres, and a patch of meadow, a hedge or a cloud stands out as well as a person.
The attitude at the frame's time gives the horizon, the height over the start's ground gives the distance of the ground
at the box's lower edge.  A box that a person draws is not checked: the person chose its size.
"""

import math

import numpy as np

from follow.control.ground import start_down_m
from follow.control.selector import MIN_SIDE_PX
from follow.control.target import Target
from follow.geometry import rays
from follow.messages import NEVER, VehicleState
from racf.box import Box

LEAST_HEIGHT_M = 2.0
"""Taps are not checked below this height: from there a person may reach above the horizon."""

TALL_M = 1.5
"""A tap reaches as far as a target of this height (a car, a cyclist) has MIN_SIDE_PX rows: 95 m with 80 degrees of
view in 640 columns."""


def why_out_of_reach(target: Target, box: Box, t_s: float) -> str:
    """Why the box, in the frame of `t_s`, cannot be followed; empty if it can, or if the vehicle's pose is unknown."""
    state = newest(target)
    if state is None or not state.in_air:
        return ""
    pose = target.motion.at(t_s)
    height_m = start_down_m(state) - pose.down_m
    if height_m < LEAST_HEIGHT_M:
        return ""
    feet = box.centre_x, min(box.y + box.h, float(target.camera.height))
    ray = target.rotation(pose) @ rays(target.camera, [feet])[0]
    below = math.atan2(float(ray[2]), float(np.hypot(ray[0], ray[1])))
    if below <= 0.0:
        return "in the sky: draw a box"
    range_m, reach_m = height_m / math.tan(below), TALL_M * target.camera.fy / MIN_SIDE_PX
    if range_m > reach_m:
        return f"{min(range_m, 999):.0f} m away: fly within {reach_m:.0f} m"
    return ""


def newest(target: Target) -> VehicleState | None:
    """The newest state whose attitude and position are both known."""
    motion = target.motion
    if not motion.attitudes or not motion.positions:
        return None
    last = motion.positions[-1]
    return last if last.position_t_s > NEVER and motion.attitudes[-1].attitude_t_s > NEVER else None
