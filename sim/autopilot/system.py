"""A simulated autopilot as a MAVLink system, without I/O: `receive` bytes, `step` the time, `take` bytes to send.

It has one or more links (an application's, a ground station's), each with its own message intervals.  Messages for
others are forwarded between the links, as PX4 and ArduPilot do.
"""

import math
import struct
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, ClassVar

from pymavlink.dialects.v20 import common as dialect

from follow.link.signing import UNITS_PER_S
from follow.messages import NEVER, Autopilot
from sim.autopilot.core import NO_PWM, AutopilotCore, Result
from sim.autopilot.parameters import DEFAULT_FIRMWARE
from sim.autopilot.rules import RULES
from sim.autopilot.telemetry import ORIGINS, REPORTS, UNASKED_HZ, Message, autopilot_version
from sim.dynamics import Vehicle

FORCE = 21196  # MAV_CMD_COMPONENT_ARM_DISARM's magic number for disarming in flight
PARAMETER_TYPES = {
    Autopilot.PX4: {int: dialect.MAV_PARAM_TYPE_INT32, float: dialect.MAV_PARAM_TYPE_REAL32},
    Autopilot.ARDUPILOT: {int: dialect.MAV_PARAM_TYPE_INT16, float: dialect.MAV_PARAM_TYPE_REAL32},
}
NO_AXIS = 0x7FFF  # MANUAL_CONTROL: this axis does not exist
KEEP, RELEASE = 0xFFFF, 0  # RC_CHANNELS_OVERRIDE: leave the channel as it is; release it
SILENCE_S = 1.0  # setpoints after a longer pause are a new stream
NOTED = {
    dialect.MAV_CMD_COMPONENT_ARM_DISARM: "arming or disarming",
    dialect.MAV_CMD_DO_SET_MODE: "a mode",
    dialect.MAV_CMD_NAV_TAKEOFF: "take-off",
    dialect.MAV_CMD_NAV_LAND: "landing",
    dialect.MAV_CMD_NAV_RETURN_TO_LAUNCH: "return",
}
"""Commands that are worth a line for the user."""
# The messages of the old REQUEST_DATA_STREAM, all groups together
STREAMED = (
    dialect.MAVLINK_MSG_ID_SYS_STATUS,
    dialect.MAVLINK_MSG_ID_ATTITUDE,
    dialect.MAVLINK_MSG_ID_LOCAL_POSITION_NED,
    dialect.MAVLINK_MSG_ID_GLOBAL_POSITION_INT,
    dialect.MAVLINK_MSG_ID_GPS_RAW_INT,
    dialect.MAVLINK_MSG_ID_EXTENDED_SYS_STATE,
    dialect.MAVLINK_MSG_ID_VFR_HUD,
)


def sender(source: tuple[int, int]) -> str:
    """A sender as text for the user."""
    return f"system {source[0]} component {source[1]}"


@dataclass(slots=True)
class _Link:
    """One link: its codec, its message intervals, and the senders heard on it."""

    mav: dialect.MAVLink
    every_s: dict[int, float]
    due_t_s: dict[int, float] = field(default_factory=dict)
    heard: set[tuple[int, int]] = field(default_factory=set)
    out: list[bytes] = field(default_factory=list)


class AutopilotSystem:
    """An autopilot on `links` links.  `boot_s` is its time since boot when the caller's clock shows 0.

    With `key` (32 bytes) it signs its packets and ignores packets that are not signed with it; their timestamp is
    `signing_time` (10 us since 2015) when the caller's clock shows 0.
    """

    def __init__(
        self,
        autopilot: Autopilot,
        vehicle: Vehicle,
        links: int = 1,
        boot_s: float = 100.0,
        key: bytes | None = None,
        signing_time: int = 0,
        firmware: str = "",
    ):
        self.flight: AutopilotCore = RULES[autopilot](vehicle, firmware)
        self.firmware = firmware or DEFAULT_FIRMWARE[autopilot]
        self.t_s = self.flight.t_s
        self._boot_s = boot_s
        self._signing_time = signing_time
        self._reported_mode = self.flight.mode
        self.told: list[str] = []  # lines for the user from the last step: commands with their senders, texts sent
        self._commanded: list[str] = []
        self._steered: dict[tuple[int, int], float] = {}  # sender of setpoints -> time of its last one
        self._links = [_Link(self._codec(n, key), self._unasked()) for n in range(links)]

    def receive(self, data: bytes, link: int = 0) -> None:
        """Use bytes that arrived on one link."""
        channel = self._links[link]
        for message in channel.mav.parse_buffer(data) or ():
            if message.get_type() == "BAD_DATA" or message.get_type().startswith("UNKNOWN"):
                continue
            source = message.get_srcSystem(), message.get_srcComponent()
            channel.heard.add(source)
            if self._is_for_us(message) and (act := self.HANDLERS.get(message.get_type())):
                act(self, message, channel)
            self._pass_on(message, channel)

    def step(self, t_s: float) -> None:
        """Fly until `t_s` and queue the telemetry that is due."""
        self.flight.advance(t_s)
        self.t_s = t_s
        ardupilot = self.flight.autopilot is Autopilot.ARDUPILOT
        for channel in self._links:
            signing = channel.mav.signing
            signing.timestamp = max(signing.timestamp, self._signing_time + round(t_s * UNITS_PER_S))
            if ardupilot and self.flight.mode != self._reported_mode:
                channel.due_t_s[dialect.MAVLINK_MSG_ID_HEARTBEAT] = t_s  # it sends a new mode at once
            for number, every_s in channel.every_s.items():
                if t_s >= channel.due_t_s.get(number, t_s) - 1e-9:
                    self._report(number, channel)
                    channel.due_t_s[number] = max(channel.due_t_s.get(number, t_s) + every_s, t_s)
            for text in self.flight.texts:
                severity = dialect.MAV_SEVERITY_CRITICAL
                self._send(channel, dialect.MAVLink_statustext_message(severity, text.encode()[:50]))
        self._reported_mode = self.flight.mode
        self.told = [*self._commanded, *self.flight.texts]
        self._commanded.clear()
        self.flight.texts.clear()

    def take(self, link: int = 0) -> list[bytes]:
        """The packets to be sent now on one link; each is returned once."""
        channel = self._links[link]
        out, channel.out = channel.out, []
        return out

    def _codec(self, link: int, key: bytes | None) -> dialect.MAVLink:
        mav = dialect.MAVLink(None, srcSystem=1, srcComponent=dialect.MAV_COMP_ID_AUTOPILOT1)
        mav.robust_parsing = True
        if key is not None:
            mav.signing.secret_key = key
            mav.signing.link_id = link
            mav.signing.timestamp = self._signing_time
            mav.signing.sign_outgoing = True
        return mav

    def _unasked(self) -> dict[int, float]:
        return {number: 1.0 / rate for number, rate in UNASKED_HZ[self.flight.autopilot].items()}

    def _boot_time_s(self) -> float:
        return self.t_s + self._boot_s

    def _report(self, number: int, channel: _Link) -> None:
        """Send one message of telemetry; nothing where the flight has no such sensor."""
        if message := REPORTS[number](self.flight, self._boot_time_s()):
            self._send(channel, message)

    def _send(self, channel: _Link, message: Message) -> None:
        channel.out.append(message.pack(channel.mav))
        channel.mav.seq = (channel.mav.seq + 1) % 256

    def _is_for_us(self, message: Message) -> bool:
        system = getattr(message, "target_system", 0)
        component = getattr(message, "target_component", 0)
        return system in (0, 1) and component in (0, dialect.MAV_COMP_ID_AUTOPILOT1)

    def _pass_on(self, message: Message, origin: _Link) -> None:
        """Forward broadcasts to every other link, other messages to the link where their target was heard."""
        target = getattr(message, "target_system", 0), getattr(message, "target_component", 0)
        if target[0] and self._is_for_us(message):
            return
        for channel in self._links:
            known = any(target[0] in (0, s) and target[1] in (0, c) for s, c in channel.heard)
            if channel is not origin and known:
                channel.out.append(bytes(message.get_msgbuf()))

    # Messages

    def _on_heartbeat(self, message: dialect.MAVLink_heartbeat_message, _channel: _Link) -> None:
        if message.type == dialect.MAV_TYPE_GCS:
            self.flight.ground_station_t_s = self.t_s

    def _on_timesync(self, message: dialect.MAVLink_timesync_message, channel: _Link) -> None:
        if message.tc1 == 0:
            self._send(channel, dialect.MAVLink_timesync_message(round(self._boot_time_s() * 1e9), message.ts1))

    def _on_set_position_target_local_ned(
        self, message: dialect.MAVLink_set_position_target_local_ned_message, _channel: _Link
    ) -> None:
        source = message.get_srcSystem(), message.get_srcComponent()
        if self.t_s - self._steered.get(source, NEVER) > SILENCE_S:
            self._commanded.append(f"{sender(source)} starts sending setpoints")
        self._steered[source] = self.t_s
        velocity = message.vx, message.vy, message.vz
        self.flight.take_setpoint(message.coordinate_frame, message.type_mask, velocity, message.yaw_rate)

    def _on_manual_control(self, message: dialect.MAVLink_manual_control_message, _channel: _Link) -> None:
        axes = message.x, message.y, message.z, message.r
        pitch, roll, throttle, yaw = (None if axis == NO_AXIS else axis / 1e3 for axis in axes)
        down = None if throttle is None else 1.0 - 2.0 * throttle  # the throttle's middle is at 0.5
        self.flight.take_sticks((pitch, roll, down, yaw), self.flight.switches)

    def _on_rc_channels_override(self, message: dialect.MAVLink_rc_channels_override_message, _channel: _Link) -> None:
        roll, pitch, throttle, yaw, *rest = (getattr(message, f"chan{n}_raw") for n in range(1, 9))
        before = self.flight.sticks or (None,) * 4
        moved = zip(before, (pitch, roll, throttle, yaw), (-1, 1, -1, 1), strict=True)
        axes = [{KEEP: old, RELEASE: None}.get(pwm, sign * (pwm - 1500) / 500) for old, pwm, sign in moved]
        switches = self.flight.switches or (NO_PWM,) * 4
        switched = zip(switches, rest, strict=True)
        switches = tuple(old if pwm == KEEP else pwm or NO_PWM for old, pwm in switched)  # 0 is RELEASE
        self.flight.take_sticks(axes, switches)

    def _on_set_mode(self, message: dialect.MAVLink_set_mode_message, _channel: _Link) -> None:
        custom = message.custom_mode
        px4 = self.flight.autopilot is Autopilot.PX4
        self.flight.ask_mode(*((custom >> 16 & 0xFF, custom >> 24 & 0xFF) if px4 else (custom, 0)))

    def _on_request_data_stream(self, message: dialect.MAVLink_request_data_stream_message, channel: _Link) -> None:
        for number in STREAMED:
            channel.every_s.pop(number, None)
            if message.start_stop and message.req_message_rate:
                channel.every_s[number] = 1.0 / message.req_message_rate

    def _on_mission_request_list(self, message: dialect.MAVLink_mission_request_list_message, channel: _Link) -> None:
        source = message.get_srcSystem(), message.get_srcComponent()
        self._send(channel, dialect.MAVLink_mission_count_message(*source, 0, message.mission_type))

    # Parameters

    def _on_param_request_list(self, _message: dialect.MAVLink_param_request_list_message, channel: _Link) -> None:
        for name in self.flight.parameters:
            self._send_parameter(name, channel)

    def _on_param_request_read(self, message: dialect.MAVLink_param_request_read_message, channel: _Link) -> None:
        names = list(self.flight.parameters)
        index = message.param_index
        name = names[index] if 0 <= index < len(names) else message.param_id
        if name in self.flight.parameters:
            self._send_parameter(name, channel)

    def _on_param_set(self, message: dialect.MAVLink_param_set_message, _channel: _Link) -> None:
        name = message.param_id
        if name not in self.flight.parameters:
            return
        kind = type(self.flight.parameters[name])
        value = message.param_value
        if kind is int and self.flight.autopilot is Autopilot.PX4:  # PX4: an integer's four bytes as a float
            value = struct.unpack("<i", struct.pack("<f", value))[0]
        if not math.isfinite(value):
            return
        self.flight.parameters[name] = kind(value)
        for channel in self._links:
            self._send_parameter(name, channel)

    def _send_parameter(self, name: str, channel: _Link) -> None:
        value = self.flight.parameters[name]
        kind = PARAMETER_TYPES[self.flight.autopilot][type(value)]
        if isinstance(value, int) and self.flight.autopilot is Autopilot.PX4:
            value = struct.unpack("<f", struct.pack("<i", value))[0]
        names = list(self.flight.parameters)
        message = dialect.MAVLink_param_value_message(name.encode(), value, kind, len(names), names.index(name))
        self._send(channel, message)

    # Commands

    def _on_command_int(self, message: dialect.MAVLink_command_int_message, channel: _Link) -> None:
        numbers = message.param1, message.param2, message.param3, message.param4, message.x, message.y, message.z
        self._obey(message, message.command, numbers, channel)

    def _on_command_long(self, message: dialect.MAVLink_command_long_message, channel: _Link) -> None:
        self._obey(message, message.command, tuple(getattr(message, f"param{n}") for n in range(1, 8)), channel)

    def _obey(self, message: Message, command: int, p: tuple[float, ...], channel: _Link) -> None:
        """Execute one command and acknowledge it to its sender."""
        source = message.get_srcSystem(), message.get_srcComponent()
        if command in WHOLE and not math.isfinite(p[WHOLE[command]]):
            results = [Result.DENIED]
        else:
            results = self.COMMANDS.get(command, AutopilotSystem._unsupported)(self, p, channel)
        if command in NOTED:
            outcome = ", ".join(result.name for result in results[-1:])  # PX4 acknowledges twice: the second counts
            self._commanded.append(f"{sender(source)} commands {self._described(command, p)}: {outcome}")
        for result in results:
            self._send(channel, dialect.MAVLink_command_ack_message(command, int(result), 0, 0, *source))

    def _described(self, command: int, p: tuple[float, ...]) -> str:
        """A command as text for the user, with the mode that it requests."""
        if command != dialect.MAV_CMD_DO_SET_MODE or not math.isfinite(p[1]):
            return NOTED[command]
        px4 = self.flight.autopilot is Autopilot.PX4
        numbers = int(p[1]), int(p[2]) if px4 and math.isfinite(p[2]) else 0
        modes = self.flight.modes.items()
        return next((f"mode {name}" for name, mode in modes if (mode.number, mode.sub) == numbers), f"mode {numbers}")

    def _unsupported(self, _p: tuple[float, ...], _channel: _Link) -> list[Result]:
        return [Result.UNSUPPORTED]

    def _arm_disarm(self, p: tuple[float, ...], _channel: _Link) -> list[Result]:
        return [self.flight.arm() if p[0] == 1.0 else self.flight.disarm(force=p[1] == FORCE)]

    def _do_set_mode(self, p: tuple[float, ...], _channel: _Link) -> list[Result]:
        has_sub = self.flight.autopilot is Autopilot.PX4 and math.isfinite(p[2])  # NaN: not used
        sub = int(p[2]) if has_sub else 0
        return self.flight.ask_mode(int(p[1]), sub)

    def _take_off(self, p: tuple[float, ...], _channel: _Link) -> list[Result]:
        height = p[6] if math.isfinite(p[6]) else 0.0
        if height and self.flight.autopilot is Autopilot.PX4:
            height -= ORIGINS[Autopilot.PX4][2]  # PX4: above sea level; ArduPilot: above home
        return [self.flight.take_off(height)]

    def _land(self, _p: tuple[float, ...], _channel: _Link) -> list[Result]:
        return [self.flight.land()]

    def _return(self, _p: tuple[float, ...], _channel: _Link) -> list[Result]:
        self.flight.enter(self.flight.return_mode)
        return [Result.ACCEPTED]

    def _set_message_interval(self, p: tuple[float, ...], channel: _Link) -> list[Result]:
        number, interval_us = int(p[0]), p[1]
        if number == dialect.MAVLINK_MSG_ID_HEARTBEAT and self.flight.autopilot is Autopilot.PX4:
            return [Result.ACCEPTED]  # it stays at 1 Hz
        if number not in REPORTS:
            return [Result.UNSUPPORTED if self.flight.autopilot is Autopilot.PX4 else Result.DENIED]
        channel.every_s.pop(number, None)
        channel.due_t_s.pop(number, None)
        unasked = self._unasked().get(number)
        if interval_us > 0.0:
            channel.every_s[number] = interval_us / 1e6
        elif interval_us == 0.0 and unasked:
            channel.every_s[number] = unasked
        return [Result.ACCEPTED]

    def _request_message(self, p: tuple[float, ...], channel: _Link) -> list[Result]:
        number = int(p[0])
        if number not in REPORTS:
            return [Result.UNSUPPORTED]
        if number == dialect.MAVLINK_MSG_ID_AUTOPILOT_VERSION:
            self._send(channel, autopilot_version(self.flight.autopilot, self.firmware))
        else:
            self._report(number, channel)
        return [Result.ACCEPTED]

    def _request_version(self, _p: tuple[float, ...], channel: _Link) -> list[Result]:
        return self._request_message((dialect.MAVLINK_MSG_ID_AUTOPILOT_VERSION,), channel)

    HANDLERS: ClassVar[dict[str, Callable[["AutopilotSystem", Any, _Link], None]]] = {
        "HEARTBEAT": _on_heartbeat,
        "TIMESYNC": _on_timesync,
        "SET_POSITION_TARGET_LOCAL_NED": _on_set_position_target_local_ned,
        "MANUAL_CONTROL": _on_manual_control,
        "RC_CHANNELS_OVERRIDE": _on_rc_channels_override,
        "SET_MODE": _on_set_mode,
        "REQUEST_DATA_STREAM": _on_request_data_stream,
        "MISSION_REQUEST_LIST": _on_mission_request_list,
        "PARAM_REQUEST_LIST": _on_param_request_list,
        "PARAM_REQUEST_READ": _on_param_request_read,
        "PARAM_SET": _on_param_set,
        "COMMAND_INT": _on_command_int,
        "COMMAND_LONG": _on_command_long,
    }
    """Message type -> the method that uses it."""

    COMMANDS: ClassVar[dict[int, Callable[["AutopilotSystem", tuple[float, ...], _Link], list[Result]]]] = {
        dialect.MAV_CMD_COMPONENT_ARM_DISARM: _arm_disarm,
        dialect.MAV_CMD_DO_SET_MODE: _do_set_mode,
        dialect.MAV_CMD_NAV_TAKEOFF: _take_off,
        dialect.MAV_CMD_NAV_LAND: _land,
        dialect.MAV_CMD_NAV_RETURN_TO_LAUNCH: _return,
        dialect.MAV_CMD_SET_MESSAGE_INTERVAL: _set_message_interval,
        dialect.MAV_CMD_REQUEST_MESSAGE: _request_message,
        dialect.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES: _request_version,
    }
    """Command -> the method that executes it."""


WHOLE = {
    dialect.MAV_CMD_DO_SET_MODE: 1,
    dialect.MAV_CMD_SET_MESSAGE_INTERVAL: 0,
    dialect.MAV_CMD_REQUEST_MESSAGE: 0,
}
"""Command -> the index of the parameter that is an integer and so must be finite."""
