"""The messages that flow through the loop, one way: Frame, Track, VehicleState, Estimate, Setpoint, Tick.

Body axes are FRD (forward, right, down), the local frame is NED, units are SI and radians.  All times are seconds on
one clock, the one of the link that flies (in a simulation: simulated time).
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from follow.geometry import ned_to_heading
from follow.selection import AS_SET, Detections, Wanted
from racf.track import Track

Notify = Callable[[str], None]
"""Takes one line for a person to read."""

NEVER = -math.inf
"""The time of something that has not happened."""


class Autopilot(str, Enum):
    """Whose rules the vehicle obeys."""

    PX4 = "px4"
    ARDUPILOT = "ardupilot"


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """One image and its time: uint8, (rows, columns, 3) in BGR or (rows, columns) in grey, taken at `t_s`.

    One pixel of the image is `scale` pixels of the source, which was shrunk; boxes inside the loop are in pixels of
    this image.
    """

    image: NDArray[np.uint8]
    t_s: float
    index: int
    scale: int = 1


class Landed(str, Enum):
    """The autopilot's landed state (EXTENDED_SYS_STATE).  Only IN_AIR means flying."""

    UNKNOWN = "unknown"
    ON_GROUND = "on the ground"
    IN_AIR = "in the air"
    CHANGING = "taking off or landing"


class BatteryLevel(str, Enum):
    """The battery by the autopilot's own failsafe levels (BATTERY_STATUS.charge_state)."""

    UNKNOWN = "unknown"
    OK = "ok"
    LOW = "low"
    CRITICAL = "critical"


LANDED_AGE_S = 3.0
"""`Landed` counts as unknown after this; the link requests it twice a second."""


@dataclass(frozen=True, slots=True)
class VehicleState:
    """What is known of the vehicle at `t_s`; each group carries the time it was measured, NEVER if it was not.

    Attitude: roll, pitch, yaw (radians, aerospace order) and the yaw rate.  Position and velocity are local NED.
    `resets` counts the jumps of the autopilot's own position estimate; `reset_*` is the last jump, new minus old, zero
    if only the autopilot's counter shows it.  Home is the position of arming, local NED.  Heights are positive upward:
    above home; above the ground below, by a rangefinder (vertical); above the ground, by a terrain map.
    `mode` is the autopilot's own name for its flight mode as of `heartbeat_t_s`; `in_control` says that the autopilot
    obeys our setpoints; `refusal` is its reason for refusing our last mode request, empty if it did not.
    `rc_healthy` is the autopilot's own report on its remote control (None: unknown), `rc_t_s` the time of the last
    channels.  `said` is the autopilot's last STATUSTEXT.  `contested_t_s` is the last time that a second sender used
    the vehicle's id.
    """

    t_s: float
    attitude_t_s: float = NEVER
    roll_rad: float = 0.0
    pitch_rad: float = 0.0
    yaw_rad: float = 0.0
    yaw_rate_rad_s: float = 0.0
    position_t_s: float = NEVER
    north_m: float = 0.0
    east_m: float = 0.0
    down_m: float = 0.0
    north_m_s: float = 0.0
    east_m_s: float = 0.0
    down_m_s: float = 0.0
    resets: int = 0
    reset_t_s: float = NEVER
    reset_north_m: float = 0.0
    reset_east_m: float = 0.0
    reset_down_m: float = 0.0
    home_t_s: float = NEVER
    home_north_m: float = 0.0
    home_east_m: float = 0.0
    home_down_m: float = 0.0
    above_home_t_s: float = NEVER
    above_home_m: float = 0.0
    above_ground_t_s: float = NEVER
    above_ground_m: float = 0.0
    above_terrain_t_s: float = NEVER
    above_terrain_m: float = 0.0
    heartbeat_t_s: float = NEVER
    autopilot: Autopilot | None = None
    mode: str = ""
    in_control: bool = False
    refusal: str = ""
    armed: bool = False
    landed_t_s: float = NEVER
    landed: Landed = Landed.UNKNOWN
    battery_t_s: float = NEVER
    battery: BatteryLevel = BatteryLevel.UNKNOWN
    rc_t_s: float = NEVER
    rc_healthy: bool | None = None
    said_t_s: float = NEVER
    said: str = ""
    contested_t_s: float = NEVER

    @property
    def in_air(self) -> bool:
        """Whether the autopilot said within LANDED_AGE_S that the vehicle flies; unknown counts as landed."""
        return self.landed is Landed.IN_AIR and self.t_s - self.landed_t_s <= LANDED_AGE_S

    def body_velocity_m_s(self) -> tuple[float, float, float]:
        """Velocity forward, right, down in the heading frame (yaw only: the setpoint's frame)."""
        return *ned_to_heading(self.north_m_s, self.east_m_s, self.yaw_rad), self.down_m_s


@dataclass(frozen=True, slots=True)
class Setpoint:
    """Body-frame velocity command, FRD axes (levelled: heading only): the servo's output, or the gate's."""

    forward_m_s: float = 0.0
    right_m_s: float = 0.0
    down_m_s: float = 0.0  # positive descends
    yaw_rate_rad_s: float = 0.0  # positive turns right (clockwise seen from above)

    def is_finite(self) -> bool:
        """Whether all four numbers are finite."""
        numbers = (self.forward_m_s, self.right_m_s, self.down_m_s, self.yaw_rate_rad_s)
        return all(math.isfinite(v) for v in numbers)

    def require_finite(self) -> None:
        """Raise ValueError unless all four numbers are finite."""
        if not self.is_finite():
            raise ValueError(f"a setpoint needs four finite numbers, not {self}")


HOVER = Setpoint()


@dataclass(frozen=True, slots=True)
class OtherSighting:
    """A person found after a loss who is not, or not yet, accepted as the target.

    `azimuth_rad` is clockwise from the vehicle's heading, `range_m` along the ground, two standard deviations nearer
    than measured; `below_m` is how far its middle lies below the vehicle.
    """

    azimuth_rad: float
    range_m: float
    below_m: float


@dataclass(frozen=True, slots=True)
class Estimate:
    """The estimated position of the target at `t_s`, relative to the vehicle.

    `azimuth_rad` is measured clockwise from the vehicle's heading, `depression_rad` downward from the horizon; both
    are free of the vehicle's roll and pitch.  `range_m` is the distance along the ground with its standard deviation;
    `range_near_m` is the shortest distance that the measurements leave possible (inf: not known).  The velocity is the
    target's own over the ground, local NED, m/s, with its covariance (north², north·east, east²), m²/s².

    `ground_below_m` is how far the ground under the target lies below the vehicle, with its standard deviation, and
    `target_height_m` how far the target's top is above that ground.  `size_m` is its sqrt(width x height) with the
    standard deviation.  Each is inf where it is not known.

    `seen_t_s` is the time of the last frame in which the target was found; `seen_range_m` and `seen_azimuth_rad` lead
    from the vehicle's present position and heading to the target's position then.  `contradiction` is a text about
    measurements that disagree beyond their uncertainty; it is empty while they agree.  `doubt` is a text about a
    candidate that was found after a loss and rejected; it is empty if there is none.  `other` is where a candidate was
    found within the last second while the target is lost.

    `drift_*` is how much faster the vehicle's reported position moves than its reported velocity says, local NED.  The
    target moves in the frame of the positions, setpoints are flown by the reported velocity.
    """

    t_s: float
    azimuth_rad: float
    depression_rad: float
    range_m: float
    range_std_m: float
    north_m_s: float = 0.0
    east_m_s: float = 0.0
    seen_t_s: float = NEVER
    range_near_m: float = math.inf
    velocity_covariance: tuple[float, float, float] = (0.0, 0.0, 0.0)
    ground_below_m: float = math.inf
    ground_std_m: float = math.inf
    target_height_m: float = math.inf
    size_m: float = math.inf
    size_std_m: float = math.inf
    seen_range_m: float = math.inf
    seen_azimuth_rad: float = 0.0
    contradiction: str = ""
    doubt: str = ""
    other: OtherSighting | None = None
    drift_north_m_s: float = 0.0
    drift_east_m_s: float = 0.0
    drift_down_m_s: float = 0.0


@dataclass(frozen=True, slots=True)
class ImageMotion:
    """How corners of the background moved between two frames, and the motion predicted from the vehicle's poses.

    With m the measured motion of a corner, r the one predicted from rotation alone and t what translation over flat
    ground adds, all in pixels, the fields are weighted means over the corners of their dot products, px²; `mm_px2` is
    the median of m·m.  `box_seen_px` is the motion of the target's box, `box_expected_px` that by rotation alone,
    (right, down).  `height_m` is the camera's height above the ground around the target's feet, from the parallax of
    corners there, with its standard deviation; both are inf when the vehicle moved too little to measure it.
    `height_shared_std_m` is the part of that deviation that successive measurements share: the vehicle's velocity.
    """

    from_t_s: float
    t_s: float
    corners: int
    rr_px2: float
    rt_px2: float
    tt_px2: float
    mr_px2: float
    mt_px2: float
    mm_px2: float
    box_seen_px: tuple[float, float] = (0.0, 0.0)
    box_expected_px: tuple[float, float] = (0.0, 0.0)
    height_m: float = math.inf
    height_std_m: float = math.inf
    height_shared_std_m: float = 0.0


class Order(str, Enum):
    """What the operator orders."""

    FOLLOW = "follow"
    OBSERVE = "observe"  # end the stream at once
    LEAVE = "leave"  # ramp to zero, then end the stream


class Cause(str, Enum):
    """Why the gate is in its mode: the closed list.  `{what}` and `{seconds}` are filled in by a Reason."""

    STARTED = "the program started"
    READY = "FOLLOW can be ordered"
    NOT_READY = "{what}"
    ORDER_WAITS = "FOLLOW ordered by {what}"
    ORDER_REFUSED = "FOLLOW refused: {what}"
    ORDER_VOID = "the order is void: {what}"
    FOLLOW_ORDERED = "FOLLOW ordered by {what}"
    OBSERVE_ORDERED = "OBSERVE ordered by {what}"
    LEAVING = "leaving: {what}"
    STICK = "the pilot moved a stick"
    JOYSTICK = "the pilot moved a stick of {what}"
    STICK_JUMPED = "a stick jumped to its end, as when a receiver loses its transmitter"
    OTHER_SENDER = "{what}"
    BEGAN = "FOLLOW began"
    REFUSED = "the autopilot refused: {what}"
    IGNORED = "the autopilot did not obey within {seconds:g} s"
    MODE_LEFT = "the vehicle went to {what}"
    STREAM_PAUSED = "no setpoint was sent in time: this program or its camera stalled"
    DISARMED = "the vehicle is disarmed"
    NOT_SEEN = "target not seen for {seconds:.2f} s"  # COAST begins at 0.25 s, which one decimal would call 0.3
    SEEN = "target seen"
    OUT_OF_REACH = "the target is out of reach: {what}"
    IN_REACH = "the target is in reach again"
    STALE = "{what}"
    FRESH = "the data are fresh again"
    STOPPED = "stopped: {what}"
    HOLD_OVER = "nobody took over within {seconds:g} s of hovering"
    LANDED = "the vehicle is on the ground"
    BATTERY = "the autopilot reports battery {what}"
    REMOTE_LOST = "the remote control is lost"
    NOT_OBEYING = "the vehicle does not fly what is sent: {what}"
    CONTRADICTION = "{what}"
    NO_HEADING = "the heading is invalid"


PILOTS_STICK = (Cause.STICK, Cause.JOYSTICK)
"""A person moved a stick, so the vehicle goes to a mode in which sticks act."""


@dataclass(frozen=True, slots=True)
class Reason:
    """A cause with its parameters; `str()` gives the sentence for a person."""

    cause: Cause
    what: str = ""
    seconds: float = 0.0

    def __str__(self) -> str:
        return self.cause.value.format(what=self.what, seconds=self.seconds)


STARTED = Reason(Cause.STARTED)


@dataclass(frozen=True, slots=True)
class Instruction:
    """The operator's input in one round: an order with its reason, what forbids FOLLOW now, how to fly.

    `aimed` says that a new target was chosen: the tracker starts again and the estimate has forgotten the old one.
    """

    order: Order | None = None
    reason: Reason = STARTED
    forbids: str = ""
    wanted: Wanted = AS_SET
    aimed: bool = False


NO_INSTRUCTION = Instruction()


class Release(str, Enum):
    """What the link requests of the autopilot when the stream ends, if the vehicle is still in our mode."""

    HOLD = "Hold or BRAKE"
    STICKS = "the mode in which the pilot's sticks act"


class Mode(str, Enum):
    """What the gate is doing."""

    OBSERVE = "observe"  # track and compute, send nothing
    READY = "ready"  # observe, with every check green
    ENGAGE = "engage"  # FOLLOW is ordered: stream the present velocity until the autopilot obeys
    FOLLOW = "follow"  # send the desired setpoint, within the limits
    COAST = "coast"  # the target is not seen: send the desired setpoint, scaled down with time
    SEARCH = "search"  # hover and turn towards the target's predicted direction
    HOLD = "hold"  # the search has ended, or the target is out of reach: hover until the operator decides
    BRAKE = "brake"  # data are stale, or FOLLOW must end: ramp to zero
    ENDED = "ended"  # silent until the operator orders FOLLOW again


@dataclass(frozen=True, slots=True)
class Decision:
    """The gate's answer: the setpoint to send (None: send nothing), the gate's mode and the reason for it.

    `notes` name the limits and stale data of this round.  `release` says what to request as the stream ends.
    """

    setpoint: Setpoint | None
    mode: Mode
    notes: tuple[str, ...] = ()
    reason: Reason = STARTED
    release: Release = Release.HOLD


@dataclass(frozen=True, slots=True, eq=False)
class Tick:
    """One round of the loop.  `frame` and `track` are None in a round without a new frame.

    `instruction` and `motion` (of the image, None: no new measurement) are further inputs of the gate.  `found` are the
    last detections, None without a detector or if they are too old.

    `stage_ms` maps each stage's name to its wall-clock duration in ms.  It is only recorded; the loop never reads it.
    """

    frame: Frame | None
    track: Track | None
    state: VehicleState
    estimate: Estimate
    desired: Setpoint
    decision: Decision
    stage_ms: dict[str, float] = field(default_factory=dict)
    motion: ImageMotion | None = None
    instruction: Instruction = NO_INSTRUCTION
    found: Detections | None = None
