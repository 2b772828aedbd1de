"""What a vehicle says of itself: messages in, a VehicleState and a few facts out."""

import math
from collections import Counter, deque
from dataclasses import dataclass, field, replace

from pymavlink.dialects.v20 import common as dialect

from follow.link.clock import VehicleClock
from follow.link.flight_modes import mode_name
from follow.link.packets import Message, as_bytewise_int
from follow.messages import NEVER, Autopilot, VehicleState

AUTOPILOT = dialect.MAV_COMP_ID_AUTOPILOT1
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
SETPOINT_TYPES = {
    "SET_POSITION_TARGET_LOCAL_NED",
    "SET_POSITION_TARGET_GLOBAL_INT",
    "SET_ATTITUDE_TARGET",
    "MANUAL_CONTROL",
    "RC_CHANNELS_OVERRIDE",
}
"""What a second sender would steer the vehicle with."""


@dataclass(slots=True)
class LinkObservations:
    """What a person may want to know about the link, beside the vehicle's state."""

    counts: Counter[str] = field(default_factory=Counter[str])  # the vehicle's messages by type
    steering: dict[tuple[int, int], float] = field(default_factory=dict)  # other senders of setpoints, last heard at
    companions: set[tuple[int, int]] = field(default_factory=set)  # other onboard computers
    vehicles: set[int] = field(default_factory=set)  # system ids of flyable vehicles
    texts: deque[str] = field(default_factory=lambda: deque[str](maxlen=20))  # the autopilot's last STATUSTEXTs
    parameters: dict[str, float] = field(default_factory=dict)
    answers: dict[int, int] = field(default_factory=dict)  # command -> result of its last COMMAND_ACK
    rc_channels: tuple[int, ...] = ()  # PWM microseconds of RC_CHANNELS, empty before the first
    rc_t_s: float = NEVER
    version: dialect.MAVLink_autopilot_version_message | None = None  # AUTOPILOT_VERSION
    status: dialect.MAVLink_sys_status_message | None = None  # SYS_STATUS


class TelemetryDecoder:
    """Listens for one vehicle: the PX4 or ArduPilot multirotor of `system_id`, or the first heard when None.

    Everything else on the link (ground stations, cameras, other companions) is noted and not believed.
    """

    def __init__(self, system_id: int | None = None):
        self.system_id: int | None = None
        self.state = VehicleState(t_s=NEVER)
        self.heard = LinkObservations()
        self.clock = VehicleClock()
        self._wanted_id = system_id

    def hear(self, message: Message, t_s: float) -> None:
        """Take in one message that arrived at `t_s`."""
        kind = message.get_type()
        source = message.get_srcSystem(), message.get_srcComponent()
        if isinstance(message, dialect.MAVLink_heartbeat_message):
            self._meet(message, source)
        elif kind in SETPOINT_TYPES and self._is_for_vehicle(message):
            self.heard.steering[source] = t_s
        if source != (self.system_id, AUTOPILOT):
            return
        self.heard.counts[kind] += 1
        if take := getattr(self, f"_take_{kind.lower()}", None):
            take(message, t_s)

    def _is_for_vehicle(self, message: Message) -> bool:
        target = getattr(message, "target_system", getattr(message, "target", 0))  # MANUAL_CONTROL's is `target`
        return self.system_id is None or target in (0, self.system_id)

    def _meet(self, message: dialect.MAVLink_heartbeat_message, source: tuple[int, int]) -> None:
        if message.type == dialect.MAV_TYPE_ONBOARD_CONTROLLER and source[1] != AUTOPILOT:
            self.heard.companions.add(source)
        if source[1] != AUTOPILOT or message.type not in MULTIROTORS or message.autopilot not in AUTOPILOTS:
            return
        self.heard.vehicles.add(source[0])
        if self.system_id is None and self._wanted_id in (None, source[0]):
            self.system_id = source[0]
            self.state = replace(self.state, autopilot=AUTOPILOTS[message.autopilot])

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

    def _take_extended_sys_state(self, message: dialect.MAVLink_extended_sys_state_message, _t_s: float) -> None:
        self.state = replace(self.state, landed=message.landed_state == dialect.MAV_LANDED_STATE_ON_GROUND)

    def _take_timesync(self, message: dialect.MAVLink_timesync_message, t_s: float) -> None:
        if message.tc1 != 0:  # an answer; a question has 0 there
            self.clock.exchange(message.ts1 / 1e9, message.tc1 / 1e9, t_s)

    def _take_param_value(self, message: dialect.MAVLink_param_value_message, _t_s: float) -> None:
        value = message.param_value
        if self.state.autopilot is Autopilot.PX4 and message.param_type == dialect.MAV_PARAM_TYPE_INT32:
            value = as_bytewise_int(value)
        self.heard.parameters[message.param_id] = value

    def _take_command_ack(self, message: dialect.MAVLink_command_ack_message, _t_s: float) -> None:
        self.heard.answers[message.command] = message.result

    def _take_autopilot_version(self, message: dialect.MAVLink_autopilot_version_message, _t_s: float) -> None:
        self.heard.version = message

    def _take_sys_status(self, message: dialect.MAVLink_sys_status_message, _t_s: float) -> None:
        self.heard.status = message

    def _take_statustext(self, message: dialect.MAVLink_statustext_message, _t_s: float) -> None:
        self.heard.texts.append(message.text)

    def _take_rc_channels(self, message: dialect.MAVLink_rc_channels_message, t_s: float) -> None:
        self.heard.rc_channels = tuple(getattr(message, f"chan{n}_raw") for n in range(1, 19))
        self.heard.rc_t_s = t_s
