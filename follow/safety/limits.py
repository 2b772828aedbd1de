"""The gate's limits: each number with its unit, its meaning and its source."""

from dataclasses import dataclass

from follow.ranges import require_at_least, require_at_most, require_numbers

MAY_BE_ZERO = ("latency_s", "out_of_view_m_s", "clear_distance")

NEVER_S = 1e9
"""Value of `disobey_after_s` that switches its check off, for links behind which nothing flies the setpoints."""

LONG_S = 1800.0
"""A battery's flight time: a larger value is probably in milliseconds."""

MOST = {
    "speed_m_s": 20.0,  # Upper bound of either autopilot's own speed parameter.
    "coast_m_s": 20.0,  # As speed_m_s.
    "climb_m_s": 8.0,  # Upper bound of PX4's own climb parameter.
    "accel_m_s2": 10.0,  # 45 degrees of tilt.
    "jerk_m_s3": 100.0,  # The largest acceleration within 0.1 s, in which no airframe tilts that far.
    "climb_accel_m_s2": 10.0,  # Free fall.
    "yaw_rate_rad_s": 3.5,  # 200 degrees/s: ArduPilot's ATC_SLEW_YAW allows up to 180.
    "search_rad_s": 3.5,  # As yaw_rate_rad_s.
    "yaw_accel_rad_s2": 35.0,  # The largest yaw rate within 0.1 s.
    "floor_m": 500.0,  # As ceiling_m.
    "ceiling_m": 500.0,  # Four times the open category's limit: a hill may rise beside the start.
    "fence_m": 2000.0,  # Far beyond visual line of sight.
    "min_standoff_m": 100.0,  # A person is six pixels high there, in 640x360.
    "above_target_m": 500.0,  # As ceiling_m.
    "clear_distance": 10.0,  # A fraction: 100 is a percentage.
    "range_sigmas": 10.0,  # The range is never that uncertain.
    "half_view_rad": 1.57,  # A right angle: no lens without distortion sees that far.
    "out_of_view_m_s": 20.0,  # As speed_m_s.
    "frame_age_s": 2.0,  # 16 m flown blind at the default maximum speed.
    "latency_s": 2.0,  # As frame_age_s.
    "attitude_age_s": 1.0,  # By then the vehicle may have turned by a whole field of view.
    "position_age_s": 2.0,  # As frame_age_s.
    "heartbeat_age_s": 30.0,  # Thirty missed ones.
    "coast_after_s": 10.0,  # 80 m flown at the default maximum speed without seeing the target.
    "search_after_s": LONG_S,
    "give_up_after_s": LONG_S,
    "stale_grace_s": 10.0,  # PX4's failsafe acts within 1 s of silence, ArduPilot's within 3 s.
    "hold_timeout_s": LONG_S,
    "reach_after_s": LONG_S,
    "out_of_reach_s": LONG_S,
    "ready_after_s": 60.0,  # Nobody waits longer for READY.
    "order_timeout_s": 60.0,  # Nobody expects the vehicle to set off later.
    "engage_timeout_s": 60.0,  # As order_timeout_s.
}
"""Largest plausible value of each limit.  disobey_after_s has no bound: NEVER_S switches its check off."""

LEAST = {
    "floor_m": 1.0,  # 0.3 m of overshoot (docs/faults.md), the rest for the legs and the barometer's error.
    "min_standoff_m": 2.0,  # Braking from a walk takes 1 m, and a person's arm with half a small vehicle reaches 1 m.
}
"""Smallest value of each limit that keeps the vehicle off people and ground; the others need only be positive."""


@dataclass(frozen=True, slots=True)
class Limits:
    """The gate's numbers.  Raises ValueError for one that is not positive, plausible or safe, or a floor above the
    ceiling.

    A derived number is None until it is set.  The gate then uses the strictest value: no view to either side of the
    nose, and frames that arrive without delay.
    """

    speed_m_s: float = 8.0  # Maximum horizontal speed; that of a cyclist.
    coast_m_s: float = 4.0  # Maximum horizontal speed while the target is not seen: half of a cyclist's.
    climb_m_s: float = 2.0  # Maximum speed up and down; ArduPilot's own defaults are 2.5 up and 1.5 down.
    accel_m_s2: float = 2.5  # Maximum horizontal acceleration: 14 degrees of tilt; PX4 itself does not shape setpoints.
    jerk_m_s3: float = 10.0  # Maximum jerk: twice ArduPilot's PSC_JERK_XY, which limits our setpoints once more.
    climb_accel_m_s2: float = 2.0  # Maximum vertical acceleration; PX4's own is 3 down and 4 up, ArduPilot's 2.5.
    yaw_rate_rad_s: float = 1.5  # Maximum yaw rate; above it motion blur at 30 frames/s destroys the image's detail.
    search_rad_s: float = 0.5  # Maximum yaw rate while searching: a new field of view every two seconds.
    yaw_accel_rad_s2: float = 6.0  # Maximum yaw acceleration: full rate in 0.25 s, as both autopilots were measured.
    floor_m: float = 2.0  # Minimum height above the start's ground: out of a person's reach.
    ceiling_m: float = 100.0  # Maximum height; the open category's limit in Europe is 120 m.
    fence_m: float = 300.0  # Maximum distance from home, or from the first FOLLOW if home is unknown: line of sight.
    min_standoff_m: float = 4.0  # Minimum distance to the target's head; braking takes 1 m from a walk, 3 m from a run.
    above_target_m: float = 25.0  # Maximum height above the target for a climb; 12 m away at 30 degrees it is 7 m.
    clear_distance: float = 1.0  # The vehicle must be able to stop within this fraction of the range; 0 means no limit.
    range_sigmas: float = 2.0  # The target is assumed nearer than estimated by this many standard deviations.
    half_view_rad: float | None = None  # How far the camera sees to either side. Derived: half of its field of view.
    out_of_view_m_s: float = 2.0  # Maximum horizontal speed out of the camera's view; people there can evade a walk.
    frame_age_s: float = 0.2  # Maximum age of the newest frame: six frames at 30 frames/s.
    latency_s: float | None = None  # The camera's own known delay, added to frame_age_s. Derived: camera.delay_s.
    attitude_age_s: float = 0.1  # Maximum age of the attitude; at the maximum yaw rate it is 9 degrees off by then.
    position_age_s: float = 0.5  # Maximum age of the position: at the maximum speed 4 m, as much as min_standoff_m.
    heartbeat_age_s: float = 3.0  # Maximum age of the autopilot's heartbeat: three missed ones.
    coast_after_s: float = 0.25  # A target not seen for this long counts as lost.
    search_after_s: float = 4.0  # A target not seen for this long: SEARCH; COAST scales down from half of it on.
    give_up_after_s: float = 20.0  # A target not seen for this long: HOLD; a walker may be 28 m from its prediction.
    stale_grace_s: float = 1.0  # Grace period for stale data before the stream stops or an order is void.
    hold_timeout_s: float = 30.0  # Timeout of HOLD, then the autopilot's own Hold, which also holds the position.
    reach_after_s: float = 5.0  # A limit that keeps the vehicle from its target for this long is reported.
    out_of_reach_s: float = 35.0  # Timeout of a target out of reach, then HOLD: at 1 m/s more than ours it gains 35 m.
    disobey_after_s: float = 2.0  # A vehicle whose velocity differs from the setpoint for this long does not obey.
    ready_after_s: float = 0.5  # FOLLOW must be possible for this long before READY is shown; against flicker.
    order_timeout_s: float = 3.0  # An order that cannot be carried out within this time is void.
    engage_timeout_s: float = 5.0  # Timeout for the autopilot to obey; PX4 needs 1 s of stream and 1 s to report.

    def __post_init__(self) -> None:
        require_numbers("limit", self, may_be_zero=MAY_BE_ZERO)
        require_at_most("limit", self, MOST)
        require_at_least("limit", self, LEAST, "because it keeps the vehicle off people and ground")
        if self.floor_m >= self.ceiling_m:
            raise ValueError(f"the floor {self.floor_m:g} m must lie below the ceiling {self.ceiling_m:g} m")
