"""What no setpoint may pass: the numbers, each with its source."""

import math
from dataclasses import dataclass

from follow.ranges import require_numbers

MAY_BE_ZERO = ("latency_s", "out_of_view_m_s")


@dataclass(frozen=True, slots=True)
class Limits:
    """The gate's numbers.  Raises ValueError when one is not positive or the altitude band is empty."""

    speed_m_s: float = 8.0  # horizontal; a cyclist's speed
    coast_m_s: float = 4.0  # ... while the target is not seen: half of it
    climb_m_s: float = 2.0  # up and down; ArduPilot's own defaults are 2.5 up and 1.5 down
    accel_m_s2: float = 2.5  # both autopilots fly it at 14 degrees of tilt; PX4 shapes nothing itself
    jerk_m_s3: float = 10.0  # twice ArduPilot's PSC_JERK_XY, which shapes again behind us
    climb_accel_m_s2: float = 2.0  # below both autopilots' own (PX4 3 down, 4 up; ArduPilot 2.5)
    yaw_rate_rad_s: float = 1.5  # above it motion blur at 30 frames/s eats the picture's detail
    search_rad_s: float = 0.5  # turning for a lost target: a new field of view every two seconds
    yaw_accel_rad_s2: float = 6.0  # full rate in a quarter of a second, as both autopilots were seen to answer
    floor_m: float = 2.0  # above the start's ground; a person's reach
    ceiling_m: float = 100.0  # 120 m is the open category's limit in Europe, with margin
    fence_m: float = 300.0  # from where FOLLOW began; visual line of sight of a small drone
    min_standoff_m: float = 4.0  # nearest to the target's head; braking from a walk takes 1 m, from a run 3 m
    range_sigmas: float = 2.0  # the target may be nearer than estimated by so many standard deviations
    half_view_rad: float = math.radians(35.0)  # the camera sees so far to either side of the nose
    out_of_view_m_s: float = 2.0  # horizontal speed out of the camera's view: a walk, which people behind can evade
    frame_age_s: float = 0.2  # six pictures at 30 frames/s
    latency_s: float = 0.0  # the camera's own known delay, added to the frame's age limit
    attitude_age_s: float = 0.1  # turning at the limit the picture is 9 degrees off by then
    position_age_s: float = 0.5  # 4 m at the speed limit: the stand-off
    heartbeat_age_s: float = 3.0  # three missed heartbeats
    coast_after_s: float = 0.25  # unseen for so long is lost
    search_after_s: float = 4.0  # and so long: hover and search; from half of it on slower and slower
    give_up_after_s: float = 20.0  # a walker may by then be 28 m from where it was predicted
    stale_grace_s: float = 1.0  # stale data may come back for so long before the stream stops, or an order is given up
    order_timeout_s: float = 30.0  # an order to follow that could not be obeyed for so long is void
    engage_timeout_s: float = 5.0  # the autopilot has so long to obey; PX4 may take 1 s of stream and 1 s to say so

    def __post_init__(self) -> None:
        require_numbers("limit", self, may_be_zero=MAY_BE_ZERO)
        if self.floor_m >= self.ceiling_m:
            raise ValueError(f"the floor {self.floor_m:g} m must lie below the ceiling {self.ceiling_m:g} m")
        if self.half_view_rad >= math.pi / 2:
            raise ValueError(f"limit half_view_rad must be below a right angle, not {self.half_view_rad:g}")
