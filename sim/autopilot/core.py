"""A simulated autopilot without MAVLink: modes, arming, guidance, failsafes.

`AutopilotCore` is the behaviour that PX4 and ArduCopter share; `sim/autopilot/rules.py` has their differences.
"""

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum, IntEnum, auto
from typing import ClassVar

from follow.geometry import ned_to_heading
from follow.messages import NEVER, Autopilot, Setpoint
from sim.autopilot.parameters import defaults, flown
from sim.dynamics import Vehicle
from sim.measured import PX4_SINK_M_S

STEP_S = 0.02  # guidance runs at 50 Hz, like the position controllers of both
POSITION_GAIN_PER_S = 0.95  # PX4 MPC_XY_P
CLIMB_M_S = 1.5  # PX4 MPC_TKO_SPEED
DESCEND_M_S = {Autopilot.PX4: 0.7, Autopilot.ARDUPILOT: 0.5}  # MPC_LAND_SPEED, LAND_SPEED
STICK_M_S = 5.0  # at full deflection
ARRIVED_M = 0.3
AT_HOME_M = 1.0  # well above the 0.3 m by which PX4 drifts while it holds a position
NO_PWM = 0xFFFF  # PWM of an RC channel that does not exist


Sticks = tuple[float, float, float, float]
"""Pitch, roll, down, yaw in -1..1."""


class Result(IntEnum):
    """MAV_RESULT."""

    ACCEPTED = 0
    TEMPORARILY_REJECTED = 1
    DENIED = 2
    UNSUPPORTED = 3
    FAILED = 4


@dataclass(frozen=True, slots=True)
class Command:
    """A velocity setpoint as the autopilot understood it, in body axes or NED; yaw_rate None: turn to the course."""

    t_s: float
    x_m_s: float
    y_m_s: float
    down_m_s: float
    yaw_rate_rad_s: float | None
    body: bool


class Guidance(Enum):
    """The source of the setpoint in a flight mode."""

    STAY = auto()
    CLIMB = auto()
    LAND = auto()
    RETURN = auto()
    STICKS = auto()
    VELOCITY = auto()


@dataclass(frozen=True, slots=True)
class AutopilotMode:
    """A flight mode: its numbers in DO_SET_MODE (main and sub, or ArduPilot's one) and its source of setpoints."""

    number: int
    sub: int
    guidance: Guidance


class AutopilotCore(ABC):
    """One autopilot flying one vehicle: on the ground in its first mode, or hovering if it starts in the air.

    `firmware` selects the names, units and defaults of its parameters.
    """

    autopilot: ClassVar[Autopilot]
    modes: ClassVar[Mapping[str, AutopilotMode]]
    ground_mode: ClassVar[str]
    stay_mode: ClassVar[str]
    land_mode: ClassVar[str] = "LAND"
    return_mode: ClassVar[str] = "RTL"

    def __init__(self, vehicle: Vehicle, firmware: str = ""):
        motion = vehicle.motion
        self.vehicle = vehicle
        self._response = vehicle.response
        self.parameters = defaults(self.autopilot, firmware)
        self.armed = not motion.landed
        self.mode = self.ground_mode if motion.landed else self.stay_mode
        self.home = (motion.north_m, motion.east_m)
        self.battery = 1.0  # of full
        self.texts: list[str] = []  # STATUSTEXTs to be sent, oldest first; the sender empties it
        self.resting_sticks: Sticks | None = None  # of a remote control that nobody moves; None: it has none
        self.sticks: Sticks | None = None  # None: no remote control
        self.switches: tuple[int, ...] = ()  # PWM of RC channels 5 and up, microseconds, NO_PWM for none
        self._sticks_end_s = math.inf  # MAVLink sticks are dropped then, unless repeated
        self.command: Command | None = None  # the setpoint that is obeyed in OFFBOARD or GUIDED
        self.datum_down_m = 0.0  # offset of the estimator's z = 0 from the ground where it booted
        self.jump_ned_m = (0.0, 0.0, 0.0)  # sum of all position resets so far
        self.resets = 0
        self.rangefinder_m = 0.0  # range of a rangefinder that looks down; 0: it has none
        self._guides: dict[Guidance, Callable[[], Setpoint]] = {
            Guidance.STAY: self._guide_stay,
            Guidance.CLIMB: self._guide_climb,
            Guidance.LAND: self._guide_land,
            Guidance.RETURN: self._guide_return,
            Guidance.STICKS: self._guide_sticks,
            Guidance.VELOCITY: self._guide_velocity,
        }
        self.ground_station_t_s = NEVER
        self.t_s = motion.t_s
        self._armed_t_s = motion.t_s
        self._landed_t_s = motion.t_s
        self._point = (motion.north_m, motion.east_m, motion.down_m)
        self._climb_to_m = 0.0
        self.beyond_fence = False
        self._battery_warned = False

    @property
    def has_remote(self) -> bool:
        """Whether it has a remote control, lost or not."""
        return self.resting_sticks is not None or self.sticks is not None

    def believed_ned_m(self) -> tuple[float, float, float]:
        """The estimated position, local NED."""
        motion, (north, east, down) = self.vehicle.motion, self.jump_ned_m
        return motion.north_m + north, motion.east_m + east, motion.down_m + self.datum_down_m + down

    def reset_estimate(self, north_m: float, east_m: float, down_m: float) -> None:
        """Shift the estimated position in one step, as an estimator does after a GPS or barometer glitch."""
        north, east, down = self.jump_ned_m
        self.jump_ned_m = north + north_m, east + east_m, down + down_m
        self.resets += 1

    def advance(self, t_s: float) -> None:
        """Fly until `t_s`, within the limits that the parameters set now."""
        self.vehicle.response = flown(self._response, self.parameters)
        while self.t_s < t_s - 1e-9:
            dt_s = min(STEP_S, t_s - self.t_s)
            self.t_s += dt_s
            self._watch()
            was_landed = self.vehicle.motion.landed
            motion = self.vehicle.step(self._guide() if self.armed else None, dt_s)
            if motion.landed and not was_landed:
                self._landed_t_s = self.t_s

    def enter(self, mode: str) -> None:
        """Change the mode now."""
        if mode != self.mode:
            self.mode = mode
            motion = self.vehicle.motion
            self._point = (motion.north_m, motion.east_m, motion.down_m)

    def ask_mode(self, number: int, sub: int) -> list[Result]:
        """A mode is requested by its numbers; returns the results to acknowledge with, in order."""
        name = next((name for name, mode in self.modes.items() if (mode.number, mode.sub) == (number, sub)), None)
        return [Result.DENIED] if name is None else self._change(name)

    def arm(self) -> Result:
        """Start the motors, unless a check forbids it."""
        if not self.armed:
            if reason := self._refusal_to_arm():
                self.texts.append(reason)
                return Result.TEMPORARILY_REJECTED if self.autopilot is Autopilot.PX4 else Result.FAILED
            self.armed = True
            self._armed_t_s = self._landed_t_s = self.t_s
            self.home = (self.vehicle.motion.north_m, self.vehicle.motion.east_m)
        return Result.ACCEPTED

    def disarm(self, force: bool = False) -> Result:
        """Stop the motors; in flight only with `force`."""
        if not self.vehicle.motion.landed and not force:
            return Result.FAILED if self.autopilot is Autopilot.ARDUPILOT else Result.TEMPORARILY_REJECTED
        self.armed = False
        return Result.ACCEPTED

    def take_sticks(self, axes: Sequence[float | None], switches: tuple[int, ...]) -> None:
        """Sticks over MAVLink: pitch, roll, down, yaw, clipped to -1..1; a missing axis (None) is at rest."""
        pitch, roll, down, yaw = (0.0 if axis is None else max(-1.0, min(1.0, axis)) for axis in axes)
        self.sticks = self.resting_sticks if all(axis is None for axis in axes) else (pitch, roll, down, yaw)
        self.switches = switches
        self._sticks_end_s = self.t_s + self._sticks_last_s()

    @property
    def is_taking_off(self) -> bool:
        """Whether it climbs to its take-off height."""
        return self.mode == "TAKEOFF"

    @property
    def is_landing(self) -> bool:
        """Whether it is in the air and descending to the ground."""
        mode = self.mode
        down = mode == self.land_mode or (mode == self.return_mode and self._is_above_home())
        return down and not self.vehicle.motion.landed

    def land(self) -> Result:
        """Descend here."""
        self.enter(self.land_mode)
        return Result.ACCEPTED

    @abstractmethod
    def take_setpoint(self, frame: int, mask: int, velocity: tuple[float, float, float], yaw_rate: float) -> None:
        """Use a velocity setpoint."""
        ...

    @abstractmethod
    def take_off(self, height_m: float) -> Result:
        """Climb to `height_m` above home."""
        ...

    @property
    @abstractmethod
    def charge_state(self) -> int:
        """MAV_BATTERY_CHARGE_STATE by the failsafe levels: 1 OK, 2 low, 3 critical, 4 emergency."""
        ...

    @abstractmethod
    def _change(self, name: str) -> list[Result]: ...

    @abstractmethod
    def _refusal_to_arm(self) -> str: ...

    def _watch(self) -> None:
        """React to sticks, landing, fence and battery; the rules add theirs."""
        motion = self.vehicle.motion
        if self.t_s > self._sticks_end_s:
            self.sticks, self.switches, self._sticks_end_s = self.resting_sticks, (), math.inf
        if self.armed and motion.landed and self._idle_s() > self._idle_limit_s():
            self.armed = False
        outside = self.armed and self._outside_fence(self._from_home_m(), -motion.down_m)
        if outside and not self.beyond_fence and (mode := self._fence_mode()):
            self.texts.append("Geofence exceeded" if self.autopilot is Autopilot.PX4 else "Fence Breached")
            self.enter(mode)
        self.beyond_fence = outside
        if self.armed and not self._battery_warned and self._battery_low():
            self._battery_warned = True
            self.texts.append("Low battery")
            if mode := self._battery_mode():
                self.enter(mode)

    def _from_home_m(self) -> float:
        motion = self.vehicle.motion
        return math.hypot(motion.north_m - self.home[0], motion.east_m - self.home[1])

    def _is_above_home(self) -> bool:
        return self._from_home_m() < AT_HOME_M

    def _idle_s(self) -> float:
        return self.t_s - max(self._armed_t_s, self._landed_t_s)

    @abstractmethod
    def _sticks_last_s(self) -> float:
        """Timeout of sticks that come over MAVLink."""
        ...

    @abstractmethod
    def _idle_limit_s(self) -> float: ...

    @abstractmethod
    def _outside_fence(self, distance_m: float, height_m: float) -> bool: ...

    @abstractmethod
    def _fence_mode(self) -> str | None: ...

    @abstractmethod
    def _battery_low(self) -> bool: ...

    @abstractmethod
    def _battery_mode(self) -> str | None: ...

    # Guidance: the setpoint of this moment

    def _guide(self) -> Setpoint:
        return self._guides[self.modes[self.mode].guidance]()

    def _guide_stay(self) -> Setpoint:
        return self._toward(self._point, 5.0)

    def _guide_climb(self) -> Setpoint:
        north, east, _ = self._point
        if abs(-self.vehicle.motion.down_m - self._climb_to_m) < ARRIVED_M:
            self._climbed()
        return self._toward((north, east, -self._climb_to_m), CLIMB_M_S)

    def _climbed(self) -> None:
        """The take-off height is reached."""
        self.enter(self.stay_mode)

    def _guide_land(self) -> Setpoint:
        north, east, _ = self._point
        down = self.vehicle.motion.down_m + DESCEND_M_S[self.autopilot] / POSITION_GAIN_PER_S
        return self._toward((north, east, down), 5.0)

    def _guide_return(self) -> Setpoint:
        if self._is_above_home():
            self._point = (*self.home, self.vehicle.motion.down_m)  # a gust sideways interrupts the descent
            return self._guide_land()
        return self._toward((*self.home, self._point[2]), 5.0)

    def _guide_sticks(self) -> Setpoint:
        if self.sticks is None:
            return Setpoint(down_m_s=PX4_SINK_M_S)
        pitch, roll, down, yaw = self.sticks
        if max(abs(pitch), abs(roll), abs(down), abs(yaw)) < 0.1:
            return self._toward(self._point, 5.0)
        motion = self.vehicle.motion
        self._point = (motion.north_m, motion.east_m, motion.down_m)
        return Setpoint(STICK_M_S * pitch, STICK_M_S * roll, down, yaw)

    def _guide_velocity(self) -> Setpoint:
        command = self.command
        if command is None:
            return self._toward(self._point, 5.0)
        motion = self.vehicle.motion
        forward, right = command.x_m_s, command.y_m_s
        if not command.body:
            forward, right = ned_to_heading(forward, right, motion.yaw_rad)
        yaw_rate = command.yaw_rate_rad_s
        if yaw_rate is None:
            moving = math.hypot(forward, right) > 0.5
            yaw_rate = max(-1.0, min(1.0, 1.5 * math.atan2(right, forward))) if moving else 0.0
        return Setpoint(forward, right, command.down_m_s, yaw_rate)

    def _toward(self, point: tuple[float, float, float], speed_m_s: float) -> Setpoint:
        """The velocity that brings the vehicle to a point, local NED."""
        motion = self.vehicle.motion
        offset = (point[0] - motion.north_m, point[1] - motion.east_m, point[2] - motion.down_m)
        north, east, down = (POSITION_GAIN_PER_S * part for part in offset)
        level = math.hypot(north, east)
        if level > speed_m_s:
            north, east = north * speed_m_s / level, east * speed_m_s / level
        return Setpoint(*ned_to_heading(north, east, motion.yaw_rad), max(-speed_m_s, min(speed_m_s, down)))
