"""Converts the filter's state to the Estimate relative to the vehicle."""

import math

import numpy as np

from follow.control.ground import GroundSources
from follow.control.joint_filter import JointFilter, height_row, with_size
from follow.control.pose_history import Pose
from follow.geometry import Array, wrap
from follow.messages import Estimate


def seen_from(
    f: JointFilter,
    pose: Pose,
    middle: float,
    seen_t_s: float,
    seen_ned: Array,
    near_sigmas: float,
    sources: GroundSources,
) -> Estimate:
    """The filter's state as an Estimate for a vehicle at `pose`."""
    here = pose.position_ned
    p = with_size(f, here, np.array([pose.north_m_s, pose.east_m_s]))
    away = f.mean[:3] - here
    range_m = max(math.hypot(away[0], away[1]), 0.1)
    toward = away[:2] / range_m
    range_std = math.sqrt(max(float(toward @ p[:2, :2] @ toward), 0.0))
    height, row = height_row(f, here, middle)
    seen_away = seen_ned[:2] - here[:2]
    return Estimate(
        pose.t_s,
        wrap(math.atan2(away[1], away[0]) - pose.yaw_rad),
        math.atan2(away[2], range_m),
        range_m,
        range_std,
        float(f.mean[3]),
        float(f.mean[4]),
        seen_t_s,
        range_near_m=sources.near_ratio * range_m * math.exp(-near_sigmas * range_std / range_m),
        velocity_covariance=(float(p[3, 3]), float(p[3, 4]), float(p[4, 4])),
        ground_below_m=height,
        ground_std_m=math.sqrt(max(float(row @ p @ row), 0.0)),
        target_height_m=2 * (height - float(away[2])),
        size_m=f.size_m,
        size_std_m=f.size_m * math.sqrt(f.size_var),
        seen_range_m=math.hypot(seen_away[0], seen_away[1]),
        seen_azimuth_rad=wrap(math.atan2(seen_away[1], seen_away[0]) - pose.yaw_rad),
        contradiction=sources.contradiction,
    )
