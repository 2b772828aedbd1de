"""What the vehicle reports: messages in, a VehicleState and LinkObservations out."""

import math
from collections import Counter, deque
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar

from pymavlink.dialects.v20 import common as dialect

from follow.link.clock import VehicleClock
from follow.link.flight_modes import mode_name
from follow.link.identity import SenderWatch
from follow.link.packets import Message, as_bytewise_int
from follow.link.sticks import STICKS_OF
from follow.messages import NEVER, Autopilot, BatteryLevel, Landed, VehicleState

AUTOPILOT = dialect.MAV_COMP_ID_AUTOPILOT1
COMPANION = dialect.MAV_COMP_ID_ONBOARD_COMPUTER  # 191: our own component
MULTIROTORS = {
    dialect.MAV_TYPE_QUADROTOR,
    dialect.MAV_TYPE_HEXAROTOR,
    dialect.MAV_TYPE_OCTOROTOR,
    dialect.MAV_TYPE_TRICOPTER,
    dialect.MAV_TYPE_COAXIAL,
    dialect.MAV_TYPE_HELICOPTER,
    dialect.MAV_TYPE_DODECAROTOR,
    dialect.MAV_TYPE_DECAROTOR,
}
AUTOPILOTS = {dialect.MAV_AUTOPILOT_PX4: Autopilot.PX4, dialect.MAV_AUTOPILOT_ARDUPILOTMEGA: Autopilot.ARDUPILOT}
SETPOINT_TYPES = {"SET_POSITION_TARGET_LOCAL_NED", "SET_POSITION_TARGET_GLOBAL_INT", "SET_ATTITUDE_TARGET"}
"""Messages with which a second program would steer the vehicle, besides its own sticks."""

LANDED = {
    dialect.MAV_LANDED_STATE_ON_GROUND: Landed.ON_GROUND,
    dialect.MAV_LANDED_STATE_IN_AIR: Landed.IN_AIR,
    dialect.MAV_LANDED_STATE_TAKEOFF: Landed.CHANGING,
    dialect.MAV_LANDED_STATE_LANDING: Landed.CHANGING,
}
CHARGE = {
    dialect.MAV_BATTERY_CHARGE_STATE_OK: BatteryLevel.OK,
    dialect.MAV_BATTERY_CHARGE_STATE_LOW: BatteryLevel.LOW,
    dialect.MAV_BATTERY_CHARGE_STATE_CRITICAL: BatteryLevel.CRITICAL,
    dialect.MAV_BATTERY_CHARGE_STATE_EMERGENCY: BatteryLevel.CRITICAL,
    dialect.MAV_BATTERY_CHARGE_STATE_FAILED: BatteryLevel.CRITICAL,
    dialect.MAV_BATTERY_CHARGE_STATE_UNHEALTHY: BatteryLevel.CRITICAL,
}
LEVELS = list(BatteryLevel)  # from best to worst
BATTERY_AGE_S = 10.0  # a battery that has not been reported for this long is forgotten; PX4 reports it every 2 s
JUMP_M = 0.5  # a position further than this from the one extrapolated by velocity is an estimator reset, not noise
JUMP_GAP_S = 1.0  # over a longer gap the velocity does not predict the position
ACCEL_M_S2 = 10.0  # more than a multirotor accelerates: bounds the extrapolation's error over a gap
METRES_PER_DEGREE = 111_319.5  # of latitude, at the WGS 84 equator: exact enough over the distance to home


@dataclass(slots=True)
class LinkObservations:
    """What else was received on the link, besides the vehicle's state."""

    counts: Counter[str] = field(default_factory=Counter[str])  # the vehicle's messages by type
    steering: dict[tuple[int, int], float] = field(default_factory=dict)  # other senders of setpoints, last heard at
    joysticks: dict[tuple[int, int], tuple[float, tuple[int, ...]]] = field(default_factory=dict)
    companions: set[tuple[int, int]] = field(default_factory=set)  # other onboard computers
    vehicles: set[int] = field(default_factory=set)  # system ids of multirotors with PX4 or ArduPilot
    senders: dict[tuple[int, int], tuple[int, int]] = field(default_factory=dict)  # of HEARTBEAT: (type, autopilot)
    texts: deque[str] = field(default_factory=lambda: deque[str](maxlen=20))  # the autopilot's last STATUSTEXTs
    parameters: dict[str, float] = field(default_factory=dict)
    answers: dict[int, int] = field(default_factory=dict)  # command -> result of its last COMMAND_ACK
    rc_channels: tuple[int, ...] = ()  # PWM microseconds of RC_CHANNELS, empty before the first
    rc_t_s: float = NEVER
    version: dialect.MAVLink_autopilot_version_message | None = None  # AUTOPILOT_VERSION
    status: dialect.MAVLink_sys_status_message | None = None  # SYS_STATUS

    def charge_percent(self) -> int | None:
        """The battery's remaining charge by SYS_STATUS; None if the autopilot does not know it (-1)."""
        left = -1 if self.status is None else self.status.battery_remaining
        return left if 0 <= left <= 100 else None


class TelemetryDecoder:
    """Decodes one vehicle's messages: the PX4 or ArduPilot multirotor of `system_id`, or the first one heard if None.

    Other senders on the link (ground stations, cameras, other companions) are noted, but do not change the state.
    """

    def __init__(self, system_id: int | None = None):
        self.system_id: int | None = None
        self.state = VehicleState(t_s=NEVER)
        self.heard = LinkObservations()
        self.clock = VehicleClock()
        self.watch = SenderWatch()
        self.wanted_id = system_id
        self._origin: tuple[int, int, int] | None = None  # GPS_GLOBAL_ORIGIN: 1e-7 degrees and millimetres
        self._batteries: dict[int, tuple[float, BatteryLevel]] = {}
        self._reset_counter: int | None = None

    def hear(self, message: Message, t_s: float) -> None:
        """Use one message that arrived at `t_s`."""
        kind = message.get_type()
        source = message.get_srcSystem(), message.get_srcComponent()
        if isinstance(message, dialect.MAVLink_heartbeat_message):
            self._meet(message, source)
        elif self._is_for_vehicle(message) and kind in SETPOINT_TYPES:
            self.heard.steering[source] = t_s
        elif self._is_for_vehicle(message) and kind in STICKS_OF:
            self.heard.joysticks[source] = t_s, STICKS_OF[kind](message)
        if source != (self.system_id, AUTOPILOT):
            return
        self.watch.hear(message.get_seq(), t_s, self.clock.restarts)
        if self.watch.contested_t_s > self.state.contested_t_s:
            self.state = replace(self.state, contested_t_s=self.watch.contested_t_s)
        self.heard.counts[kind] += 1
        if take := self.TAKES.get(kind):
            take(self, message, t_s)

    def _is_for_vehicle(self, message: Any) -> bool:
        target = getattr(message, "target_system", getattr(message, "target", 0))  # MANUAL_CONTROL's is `target`
        return self.system_id is None or target in (0, self.system_id)

    def _meet(self, message: dialect.MAVLink_heartbeat_message, source: tuple[int, int]) -> None:
        self.heard.senders[source] = message.type, message.autopilot
        if message.type == dialect.MAV_TYPE_ONBOARD_CONTROLLER and source[1] != AUTOPILOT:
            self.heard.companions.add(source)
        if source[1] != AUTOPILOT or message.type not in MULTIROTORS or message.autopilot not in AUTOPILOTS:
            return
        self.heard.vehicles.add(source[0])
        if self.system_id is None and self.wanted_id in (None, source[0]):
            self.system_id = source[0]
            self.state = replace(self.state, autopilot=AUTOPILOTS[message.autopilot])

    # Motion

    def _take_heartbeat(self, message: dialect.MAVLink_heartbeat_message, t_s: float) -> None:
        autopilot = AUTOPILOTS.get(message.autopilot)
        if autopilot is None:
            return
        self.state = replace(
            self.state,
            heartbeat_t_s=t_s,
            autopilot=autopilot,
            mode=mode_name(autopilot, message.custom_mode),
            armed=bool(message.base_mode & dialect.MAV_MODE_FLAG_SAFETY_ARMED),
        )

    def _take_attitude(self, message: dialect.MAVLink_attitude_message, t_s: float) -> None:
        numbers = message.roll, message.pitch, message.yaw, message.yawspeed
        measured_t_s = self.clock.measured_at("attitude", message.time_boot_ms / 1e3, t_s)
        if measured_t_s is None or not all(map(math.isfinite, numbers)):
            return
        roll, pitch, yaw, yaw_rate = numbers
        self.state = replace(
            self.state,
            attitude_t_s=measured_t_s,
            roll_rad=roll,
            pitch_rad=pitch,
            yaw_rad=yaw,
            yaw_rate_rad_s=yaw_rate,
        )

    def _take_local_position_ned(self, message: dialect.MAVLink_local_position_ned_message, t_s: float) -> None:
        numbers = message.x, message.y, message.z, message.vx, message.vy, message.vz
        measured_t_s = self.clock.measured_at("position", message.time_boot_ms / 1e3, t_s)
        if measured_t_s is None or not all(map(math.isfinite, numbers)):
            return
        north, east, down, north_speed, east_speed, down_speed = numbers
        jump = jumped(self.state, numbers, measured_t_s)
        self.state = replace(
            self.state,
            position_t_s=measured_t_s,
            north_m=north,
            east_m=east,
            down_m=down,
            north_m_s=north_speed,
            east_m_s=east_speed,
            down_m_s=down_speed,
        )
        if jump is not None:
            self._note_reset(measured_t_s, jump)

    def _take_odometry(self, message: dialect.MAVLink_odometry_message, t_s: float) -> None:
        """PX4 counts its estimator's resets of any kind here; a reset already seen as a jump is not counted twice."""
        before, self._reset_counter = self._reset_counter, message.reset_counter
        if before not in (None, message.reset_counter) and t_s - self.state.reset_t_s > JUMP_GAP_S:
            self._note_reset(t_s, (0.0, 0.0, 0.0))

    def _note_reset(self, t_s: float, jump: tuple[float, float, float]) -> None:
        north, east, down = jump
        self.state = replace(
            self.state,
            resets=self.state.resets + 1,
            reset_t_s=t_s,
            reset_north_m=north,
            reset_east_m=east,
            reset_down_m=down,
        )

    # Heights

    def _take_gps_global_origin(self, message: dialect.MAVLink_gps_global_origin_message, _t_s: float) -> None:
        self._origin = message.latitude, message.longitude, message.altitude

    def _take_home_position(self, message: dialect.MAVLink_home_position_message, t_s: float) -> None:
        """PX4 fills x, y, z; ArduPilot before 4.6 leaves them 0, so its home is taken from the global coordinates."""
        home = message.x, message.y, message.z
        if self.state.autopilot is Autopilot.ARDUPILOT:
            if self._origin is None:
                return
            lat, lon, alt = self._origin
            east_scale = math.cos(math.radians(lat / 1e7))
            home = (
                (message.latitude - lat) * 1e-7 * METRES_PER_DEGREE,
                math.remainder((message.longitude - lon) * 1e-7, 360.0) * METRES_PER_DEGREE * east_scale,
                (alt - message.altitude) / 1e3,
            )
        if all(map(math.isfinite, home)):
            north, east, down = home
            self.state = replace(self.state, home_t_s=t_s, home_north_m=north, home_east_m=east, home_down_m=down)

    def _take_global_position_int(self, message: dialect.MAVLink_global_position_int_message, t_s: float) -> None:
        measured_t_s = self.clock.measured_at("height", message.time_boot_ms / 1e3, t_s)
        if measured_t_s is not None:
            height_m = message.relative_alt / 1e3
            self.state = replace(self.state, above_home_t_s=measured_t_s, above_home_m=height_m)

    def _take_distance_sensor(self, message: dialect.MAVLink_distance_sensor_message, t_s: float) -> None:
        """A rangefinder that looks down; a reading at its limits or of quality 1 is invalid."""
        inside = message.min_distance < message.current_distance < message.max_distance
        if message.orientation == dialect.MAV_SENSOR_ROTATION_PITCH_270 and inside and message.signal_quality != 1:
            upright = math.cos(self.state.roll_rad) * math.cos(self.state.pitch_rad)
            height_m = message.current_distance / 100 * upright
            self.state = replace(self.state, above_ground_t_s=t_s, above_ground_m=height_m)

    def _take_altitude(self, message: dialect.MAVLink_altitude_message, t_s: float) -> None:
        """`bottom_clearance` is PX4's estimate from its rangefinder; NaN or negative: none."""
        if math.isfinite(message.bottom_clearance) and message.bottom_clearance > 0.0:
            self.state = replace(self.state, above_ground_t_s=t_s, above_ground_m=message.bottom_clearance)

    def _take_terrain_report(self, message: dialect.MAVLink_terrain_report_message, t_s: float) -> None:
        """`spacing` is 0 where the autopilot has no map."""
        if message.spacing > 0 and math.isfinite(message.current_height):
            self.state = replace(self.state, above_terrain_t_s=t_s, above_terrain_m=message.current_height)

    # Condition

    def _take_extended_sys_state(self, message: dialect.MAVLink_extended_sys_state_message, t_s: float) -> None:
        landed = LANDED.get(message.landed_state, Landed.UNKNOWN)
        self.state = replace(self.state, landed_t_s=t_s, landed=landed)

    def _take_battery_status(self, message: dialect.MAVLink_battery_status_message, t_s: float) -> None:
        """The worst of the batteries counts."""
        self._batteries[message.id] = t_s, CHARGE.get(message.charge_state, BatteryLevel.UNKNOWN)
        levels = [level for told_t_s, level in self._batteries.values() if t_s - told_t_s <= BATTERY_AGE_S]
        self.state = replace(self.state, battery_t_s=t_s, battery=max(levels, key=LEVELS.index))

    def _take_sys_status(self, message: dialect.MAVLink_sys_status_message, _t_s: float) -> None:
        self.heard.status = message
        rc = dialect.MAV_SYS_STATUS_SENSOR_RC_RECEIVER
        known = bool(message.onboard_control_sensors_present & message.onboard_control_sensors_enabled & rc)
        healthy = bool(message.onboard_control_sensors_health & rc) if known else None
        self.state = replace(self.state, rc_healthy=healthy)

    def _take_rc_channels(self, message: dialect.MAVLink_rc_channels_message, t_s: float) -> None:
        """Ignored while a second sender uses the vehicle's id, because a switch is an order."""
        if message.chancount and not self.watch.is_contested(t_s):
            self.heard.rc_channels = tuple(getattr(message, f"chan{n}_raw") for n in range(1, 19))
            self.heard.rc_t_s = t_s
            self.state = replace(self.state, rc_t_s=t_s)

    # Conversation

    def _take_timesync(self, message: dialect.MAVLink_timesync_message, t_s: float) -> None:
        if message.tc1 != 0:  # a reply; a request has 0 there
            self.clock.exchange(message.ts1 / 1e9, message.tc1 / 1e9, t_s)

    def _take_param_value(self, message: dialect.MAVLink_param_value_message, _t_s: float) -> None:
        value = message.param_value
        if self.state.autopilot is Autopilot.PX4 and message.param_type == dialect.MAV_PARAM_TYPE_INT32:
            value = as_bytewise_int(value)
        self.heard.parameters[message.param_id] = value

    def is_answer(self, message: dialect.MAVLink_command_ack_message) -> bool:
        """Whether this answers a command of ours.  Old autopilots leave the target 0, which means everybody."""
        ours = self.system_id, COMPANION
        return all(
            to in (0, own) for to, own in zip((message.target_system, message.target_component), ours, strict=True)
        )

    def _take_command_ack(self, message: dialect.MAVLink_command_ack_message, _t_s: float) -> None:
        if self.is_answer(message):
            self.heard.answers[message.command] = message.result

    def _take_autopilot_version(self, message: dialect.MAVLink_autopilot_version_message, _t_s: float) -> None:
        self.heard.version = message

    def _take_statustext(self, message: dialect.MAVLink_statustext_message, t_s: float) -> None:
        self.heard.texts.append(message.text)
        self.state = replace(self.state, said_t_s=t_s, said=message.text)

    TAKES: ClassVar[dict[str, Callable[["TelemetryDecoder", Any, float], None]]] = {
        "HEARTBEAT": _take_heartbeat,
        "ATTITUDE": _take_attitude,
        "LOCAL_POSITION_NED": _take_local_position_ned,
        "ODOMETRY": _take_odometry,
        "GPS_GLOBAL_ORIGIN": _take_gps_global_origin,
        "HOME_POSITION": _take_home_position,
        "GLOBAL_POSITION_INT": _take_global_position_int,
        "DISTANCE_SENSOR": _take_distance_sensor,
        "ALTITUDE": _take_altitude,
        "TERRAIN_REPORT": _take_terrain_report,
        "EXTENDED_SYS_STATE": _take_extended_sys_state,
        "BATTERY_STATUS": _take_battery_status,
        "SYS_STATUS": _take_sys_status,
        "RC_CHANNELS": _take_rc_channels,
        "TIMESYNC": _take_timesync,
        "PARAM_VALUE": _take_param_value,
        "COMMAND_ACK": _take_command_ack,
        "AUTOPILOT_VERSION": _take_autopilot_version,
        "STATUSTEXT": _take_statustext,
    }
    """Message type -> the method that uses it."""


def jumped(state: VehicleState, position: tuple[float, ...], measured_t_s: float) -> tuple[float, float, float] | None:
    """A new position minus the one extrapolated from the last, NED, metres; None if it is small enough for noise."""
    dt_s = measured_t_s - state.position_t_s
    if not 0.0 <= dt_s <= JUMP_GAP_S:
        return None
    old = state.north_m, state.east_m, state.down_m
    old_speed = state.north_m_s, state.east_m_s, state.down_m_s
    north, east, down = (
        now - before - dt_s * (was + speed) / 2
        for now, before, was, speed in zip(position[:3], old, old_speed, position[3:], strict=True)
    )
    if math.hypot(north, east, down) <= JUMP_M + ACCEL_M_S2 * dt_s * dt_s / 2:
        return None
    return north, east, down
