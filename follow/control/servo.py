"""The visual servo: yaw centres the target horizontally, climb vertically, and translation keeps the stand-off.

Horizontal motion is split into two directions: along the line of sight to the target, and across it (positive to the
right).  The modes differ only in the velocity they desire in these two.
"""

import math
from dataclasses import dataclass, field, replace
from enum import Enum

from follow.control.pid import Gains, Pid
from follow.control.trend import Trend
from follow.geometry import heading_to_ned, ned_to_heading, wrap
from follow.messages import NEVER, Estimate, Setpoint, VehicleState
from follow.ranges import require_at_most, require_numbers
from follow.selection import AS_SET, HOVER_HERE, NOT_KEPT, KeptStandoff, Wanted


class ServoMode(str, Enum):
    """How to follow the target."""

    CHASE = "chase"  # keep the stand-off along the line of sight, whatever its direction
    SPOTLIGHT = "spotlight"  # hold position: turn and climb only
    ORBIT = "orbit"  # keep the stand-off and fly around
    PROFILE = "profile"  # keep the stand-off at right angles to the target's course
    TOP_DOWN = "top-down"  # above it, for a camera that looks steeply down: keep height and heading


YAW = Gains(
    kp=3.0, limit=1.5
)  # 1/s: below the bandwidth of both autopilots' yaw (0.08 s dead time, 0.2 s time constant)
CLIMB = Gains(kp=0.6, limit=3.0)  # 1/s, on metres of height; m/s
APPROACH = Gains(kp=0.35, ki=0.02, limit=6.0)  # 1/s, on metres; the vehicle reaches a velocity within 0.7 s; m/s

MOST = {
    "standoff_m": 200.0,  # A person is three pixels high there, in 640x360.
    "orbit_m_s": 20.0,  # The gate's fastest.
    "abeam_m_s": 20.0,  # The gate's fastest.
    "velocity_filter_s": 5.0,  # A walk's turn takes two seconds.
}
"""Largest plausible values: larger ones are in another unit."""


@dataclass(frozen=True, slots=True)
class ServoConfig:
    """The desired geometry and the gains.  Raises ValueError for a number out of its range."""

    mode: ServoMode = ServoMode.CHASE
    """Geometry to keep: chase behind, spotlight (turn and climb only), orbit, profile (beside), top-down (above)."""
    standoff_m: float = 12.0  # Distance along the ground: a person of 1.8 m is some 50 pixels high in 640x360.
    orbit_m_s: float = 2.0  # Speed in orbit, positive to the right: a turn at 12 m takes 38 s.
    yaw: Gains = YAW
    climb: Gains = CLIMB
    approach: Gains = APPROACH
    feed_forward: float = 1.0  # Fraction of the target's own velocity added to the setpoint.
    velocity_filter_s: float = 1.0  # Time constant for small changes of the target's velocity: pitching causes some.
    pitch_filter_s: float = 1.0  # Time constant of the pitch filter: height follows steady flight only.
    abeam_per_s: float = 0.3  # Gain on the angle off abeam in profile.
    abeam_m_s: float = 3.0  # Fastest speed across the line of sight in profile.
    near_fraction: float = 0.7  # Least fraction of the stand-off that the nearest possible range keeps.
    top_rad: float | None = None  # How far the camera sees above its middle row. Derived: half of its vertical view.
    band_rad: float = 0.3  # How far from the middle row a target out of reach may appear before the height follows it.
    height_ratio: float = 2.0  # Highest flight over the target, as a multiple of the height at the stand-off.
    evade_fraction: float = 0.6  # Fraction of the stand-off; nearer than this to the head, climb as fast as allowed.
    evade_s: float = 2.5  # Climb as well if the target comes that near within this time.
    course_m_s: float = 0.5  # Speed below which a target has no course in profile.

    def __post_init__(self) -> None:
        may_be_zero = ("feed_forward", "velocity_filter_s", "pitch_filter_s", "abeam_per_s", "abeam_m_s", "course_m_s")
        require_numbers("servo setting", self, may_be_zero=may_be_zero, any_sign=("orbit_m_s",))
        require_at_most("servo setting", self, MOST)


FAR_BELOW = "the target is far below: nearer, it would leave the image"
UNCERTAIN = "its range is uncertain: it may be nearer than it seems"
"""Why the vehicle keeps a larger stand-off than the desired one."""


FARTHEST = 2.5
"""At most this multiple of the stand-off is kept to a target far below."""

KEPT_M = 5.5
"""Height over the target's ground that the gate keeps at the nearest stand-off, 6 m: 3.4 m over a head at 2 m."""

FEET = 0.6
"""The target's feet are kept within this fraction of the way from the middle row to the bottom edge."""

SEEN_S = 1.0
"""A target seen within this time counts as seen: longer than a camera's delay (0.4 s)."""

NEAR_EDGE, EDGE = 0.5, 0.9
"""Fractions of the way from the middle row to the top edge: up to the first the vehicle speeds up freely, from the
second on not at all."""

FASTER_M_S = 2.0
"""Just above the first the desired speed is this much above the present one, so that the lean changes smoothly."""

LEAN_S = 0.5
"""Time constant of the pitch that limits speeding up.  The pitch follows the desired speed half a second late, by the
gate's ramp and the autopilot's response: fed back unfiltered, it swings once a second."""

STEEPEST_RAD = math.radians(75.0)
"""Steeper lines of sight are clipped to this: the tangent of a vertical one is infinite."""


@dataclass(slots=True)
class Servo:
    """Estimate in, desired setpoint out.

    `down_rad` is the camera's angle below the nose, radians; it decides the depression of the image's middle row.
    """

    down_rad: float
    config: ServoConfig = field(default_factory=ServoConfig)
    yaw: Pid = field(init=False)
    climb: Pid = field(init=False)
    approach: Pid = field(init=False)
    aside: Pid = field(init=False)  # top-down: as `approach`, to the right
    pitch_rad: float | None = None
    lean_rad: float = 0.0  # the pitch, filtered by LEAN_S
    moves: Trend | None = None  # the target's velocity, filtered by velocity_filter_s
    t_s: float = NEVER
    wanted: Wanted = AS_SET
    kept: KeptStandoff = NOT_KEPT
    settings: ServoConfig = field(init=False)  # as configured; `config` also has a person's trims

    def __post_init__(self) -> None:
        self.settings = c = self.config
        self.yaw, self.climb, self.approach, self.aside = Pid(c.yaw), Pid(c.climb), Pid(c.approach), Pid(c.approach)

    def update(self, estimate: Estimate, state: VehicleState, wanted: Wanted = AS_SET) -> Setpoint:
        """Return the velocity that keeps the target at its desired position; zero before the target was ever seen.

        `wanted` is how a person wants it now.  Without control nothing is integrated, so that waiting for the order
        does not wind up the integrators.
        """
        self.want(wanted)
        self.kept = NOT_KEPT
        dt = max(estimate.t_s - self.t_s, 0.0) if self.t_s > NEVER else 0.0
        self.t_s = estimate.t_s
        if self.pitch_rad is None:
            self.pitch_rad = self.lean_rad = state.pitch_rad
        self.pitch_rad += (state.pitch_rad - self.pitch_rad) * dt / (self.config.pitch_filter_s + dt)
        self.lean_rad += (state.pitch_rad - self.lean_rad) * dt / (LEAN_S + dt)
        if not state.in_control:
            for pid in (self.yaw, self.climb, self.approach, self.aside):
                pid.reset()
        if estimate.seen_t_s == NEVER or wanted.mode == HOVER_HERE:
            self.moves = None  # else the next target's velocity would begin at this one's
            return Setpoint()
        desired = self.desired(estimate, positions_rate(estimate, state), dt)
        forward, right = ned_to_heading(estimate.drift_north_m_s, estimate.drift_east_m_s, state.yaw_rad)
        # The autopilot controls the velocity that it reports, so the drift of its position is subtracted.
        return replace(
            desired,
            forward_m_s=desired.forward_m_s - forward,
            right_m_s=desired.right_m_s - right,
            down_m_s=desired.down_m_s - estimate.drift_down_m_s,
        )

    def desired(self, estimate: Estimate, state: VehicleState, dt: float) -> Setpoint:
        """Return the velocity at which the vehicle's position should move; `state` has that at which it moves now."""
        steady = self.steadied(estimate, dt)
        if self.config.mode is ServoMode.TOP_DOWN:
            return self.above(steady, state, dt)
        radial, sideways = self.accompany(steady, state, *sight_components(steady, state.yaw_rad), dt)
        _, across = sight_components(estimate, state.yaw_rad)
        forward, right, _ = state.body_velocity_m_s()
        # The line of sight turns when the target or the vehicle moves across it.
        turning = (across - ned_to_heading(forward, right, estimate.azimuth_rad)[1]) / max(estimate.range_m, 1.0)
        with_target = self.config.feed_forward * turning
        flown = state.yaw_rate_rad_s - with_target
        yaw_rate = self.yaw.update(estimate.azimuth_rad, -estimate.azimuth_rad, dt, flown) + with_target
        down = self.descend(estimate, state, dt)
        return Setpoint(*heading_to_ned(radial, sideways, estimate.azimuth_rad), down, yaw_rate)

    def steadied(self, estimate: Estimate, dt: float) -> Estimate:
        """Return the estimate with the target's velocity low-pass filtered; large changes are filtered less.

        While the vehicle pitches, an image whose time is wrong by 10 ms makes the target appear to move.  Fed forward
        unfiltered, that motion pitches the vehicle again: a limit cycle.  The filter follows the velocity's trend, so
        that it does not lag behind a target that brakes or turns steadily.
        """
        if not math.isfinite(estimate.north_m_s + estimate.east_m_s):
            return estimate  # not kept: the gate judges it
        if self.moves is None:
            self.moves = Trend(estimate.north_m_s, estimate.east_m_s)
        self.moves.follow(estimate.north_m_s, estimate.east_m_s, dt, self.config.velocity_filter_s)
        return replace(estimate, north_m_s=self.moves.north_m_s, east_m_s=self.moves.east_m_s)

    def want(self, wanted: Wanted) -> None:
        """Use the geometry that a person wants; a new mode begins without what was integrated in the old one."""
        if wanted == self.wanted:
            return
        is_mode = wanted.mode not in ("", HOVER_HERE)
        mode = ServoMode(wanted.mode) if is_mode else self.settings.mode
        if wanted.mode != self.wanted.mode:
            for pid in (self.yaw, self.climb, self.approach, self.aside):
                pid.reset()
        set_m = self.settings.standoff_m
        standoff_m = max(set_m * wanted.standoff_factor, min(set_m, self.nearest_m()))
        self.wanted, self.config = wanted, replace(self.settings, mode=mode, standoff_m=standoff_m)

    def nearest_m(self) -> float:
        """The least stand-off that a person may trim to: nearer, the gate's height drives the feet out of the image."""
        c = self.settings
        below = c.band_rad if c.top_rad is None else FEET * c.top_rad
        return KEPT_M / math.tan(min(max(self.down_rad + below, below), STEEPEST_RAD))

    def accompany(
        self, estimate: Estimate, state: VehicleState, along: float, across: float, dt: float
    ) -> tuple[float, float]:
        """Return the desired velocity along and across the line of sight, given the target's own two."""
        c = self.config
        if c.mode is ServoMode.SPOTLIGHT:
            return 0.0, 0.0
        error = self.range_error(estimate)
        forward, right, _ = state.body_velocity_m_s()
        flown, _ = ned_to_heading(forward, right, estimate.azimuth_rad)
        with_target = c.feed_forward * along
        radial = self.approach.update(error, -estimate.range_m, dt, flown - with_target) + with_target
        radial = self.in_view(radial, max(flown, 0.0), estimate)
        if c.mode is ServoMode.ORBIT:
            return radial, c.orbit_m_s + c.feed_forward * across  # it goes around by itself
        if c.mode is ServoMode.PROFILE and math.hypot(along, across) > c.course_m_s:
            sight = state.yaw_rad + estimate.azimuth_rad
            off = abeam_error(math.atan2(estimate.east_m_s, estimate.north_m_s), sight)
            swing = c.abeam_per_s * estimate.range_m * off
            return radial, min(max(swing, -c.abeam_m_s), c.abeam_m_s) + c.feed_forward * across
        return radial, self.wanted.around_m_s

    def in_view(self, radial: float, flown: float, estimate: Estimate) -> float:
        """Return the speed along the line of sight, reduced if the tilt of acceleration would hide the target."""
        if self.config.top_rad is None or radial <= flown:
            return radial
        above = (self.down_rad - self.lean_rad - estimate.depression_rad) / self.config.top_rad
        room = min(max((EDGE - above) / (EDGE - NEAR_EDGE), 0.0), 1.0)
        return radial if room == 1.0 else min(radial, flown + room * FASTER_M_S)

    def range_error(self, estimate: Estimate) -> float:
        """Return how much farther than desired the target is, metres, by the nearer of the two ranges.

        A vehicle that cannot descend to a target far below keeps it in view from farther away.
        """
        c = self.config
        height = over_target_m(estimate)
        steepest = math.tan(min(max(self.middle_rad() + c.band_rad, c.band_rad), STEEPEST_RAD))
        desired = min(max(c.standoff_m, height / steepest), FARTHEST * c.standoff_m)
        error = estimate.range_m - desired
        self.kept = KeptStandoff(desired, FAR_BELOW if desired > c.standoff_m else "")
        # Of a target that is not seen the nearest possible range falls without end; braking is the gate's part then.
        if estimate.t_s - estimate.seen_t_s > SEEN_S:
            return error
        surely = estimate.range_near_m - c.near_fraction * c.standoff_m
        if not surely < error:  # NaN: nothing says that it may be nearer
            return error
        self.kept = KeptStandoff(estimate.range_m - surely, UNCERTAIN)
        return surely

    def middle_rad(self) -> float:
        """The depression of the image's middle row at the filtered pitch."""
        return self.down_rad - (self.pitch_rad or 0.0)

    def axis_rad(self) -> float:
        """The depression of the row in which the target is wanted: the middle one, or what a person trims it to."""
        return self.middle_rad() + self.wanted.raise_rad

    def descend(self, estimate: Estimate, state: VehicleState, dt: float) -> float:
        """Return the downward speed that brings the target to the image's middle row at the filtered pitch.

        Beyond the stand-off it may appear higher in the image, so that a target that outruns the vehicle does not make
        it climb; inside the stand-off the vehicle does not descend, and it climbs away from a target that comes nearer.
        """
        c = self.config
        axis = min(max(self.axis_rad(), 0.0), STEEPEST_RAD)
        height = over_target_m(estimate)
        stays = c.mode is ServoMode.SPOTLIGHT  # it cannot come nearer, so it keeps the target in the middle row
        beyond = 0.0 if stays else min(max(estimate.range_m / c.standoff_m - 1.0, 0.0), 1.0)
        leaning = min(max(axis, self.down_rad), self.down_rad + c.band_rad)
        leaning += (1.0 - beyond) * max(axis - leaning, 0.0)  # at the stand-off the lean is that of steady flight
        highest = c.height_ratio * c.standoff_m * math.tan(min(max(leaning, c.band_rad), STEEPEST_RAD))
        most = estimate.range_m * math.tan(axis)
        now = axis + beyond * max(self.down_rad - state.pitch_rad - axis, 0.0)
        upper = c.band_rad + min(self.wanted.raise_rad, 0.0)  # the band is the camera's, whatever a person trims
        least = min(estimate.range_m * math.tan(min(max(now - beyond * upper, 0.0), STEEPEST_RAD)), highest)
        too_high_m = max(height - max(most, least), 0.0) - max(least - height, 0.0)
        down = -self.climb.update(-too_high_m, too_high_m, dt, -state.down_m_s)
        inside = 10.0 * (1.0 - estimate.range_m / c.standoff_m)  # 0 at the stand-off, 1 a tenth inside it
        down *= min(max(1.0 - inside, 0.0), 1.0) if down > 0 else 1.0
        return -c.climb.limit if self.closing_in(estimate, state) else down

    def closing_in(self, estimate: Estimate, state: VehicleState) -> bool:
        """Whether the target's head is, or will within `evade_s` be, nearer than the desired least distance."""
        c = self.config
        forward, right, _ = state.body_velocity_m_s()
        along, _ = sight_components(estimate, state.yaw_rad)
        opening = along - ned_to_heading(forward, right, estimate.azimuth_rad)[0]
        soon_m = max(estimate.range_m + min(opening, 0.0) * c.evade_s, 0.0)
        head_m = over_target_m(estimate) - (
            estimate.target_height_m / 2 if math.isfinite(estimate.target_height_m) else 1.0
        )
        return math.hypot(soon_m, max(head_m, 0.0)) < c.evade_fraction * c.standoff_m

    def above(self, estimate: Estimate, state: VehicleState, dt: float) -> Setpoint:
        """Return the velocity that puts the target on the optical axis, keeping heading and height."""
        c = self.config
        height = over_target_m(estimate)
        ahead = height / math.tan(max(self.axis_rad(), 0.2))
        ahead_m, right_m = heading_to_ned(estimate.range_m, 0.0, estimate.azimuth_rad)
        ahead_m -= ahead
        forward, right, _ = state.body_velocity_m_s()
        own = ned_to_heading(estimate.north_m_s, estimate.east_m_s, state.yaw_rad)
        with_forward, with_right = c.feed_forward * own[0], c.feed_forward * own[1]
        return Setpoint(
            self.approach.update(ahead_m, -ahead_m, dt, forward - with_forward) + with_forward,
            self.aside.update(right_m, -right_m, dt, right - with_right) + with_right,
        )


def over_target_m(estimate: Estimate) -> float:
    """Return how far the target's middle is below the vehicle, m, also of one right below."""
    return estimate.range_m * math.tan(min(estimate.depression_rad, math.pi / 2 - 1e-3))


def positions_rate(estimate: Estimate, state: VehicleState) -> VehicleState:
    """The state with the velocity at which its reported position moves, the frame of the target's velocity."""
    return replace(
        state,
        north_m_s=state.north_m_s + estimate.drift_north_m_s,
        east_m_s=state.east_m_s + estimate.drift_east_m_s,
        down_m_s=state.down_m_s + estimate.drift_down_m_s,
    )


def sight_components(estimate: Estimate, yaw_rad: float) -> tuple[float, float]:
    """Return the target's velocity along the line of sight (positive: away) and across it (positive: right), m/s."""
    return ned_to_heading(estimate.north_m_s, estimate.east_m_s, yaw_rad + estimate.azimuth_rad)


def abeam_error(course_rad: float, sight_rad: float) -> float:
    """Return the angle from the line of sight to the nearer abeam direction, radians; flying right reduces it."""
    return min((wrap(sight_rad - course_rad - side * math.pi / 2) for side in (-1, 1)), key=abs)
