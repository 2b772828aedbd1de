"""Our side of a MAVLink link, without I/O: bytes in, a VehicleState out; setpoints and requests in, packets out.

Rule 1: the vehicle is the PX4 or ArduPilot multirotor whose autopilot (component 1) sends HEARTBEAT; nothing else is
believed (`follow/link/telemetry.py`).
Rule 2: we are component 191 of that vehicle, with a HEARTBEAT of our own each second.
Rule 3: a mode is asked for only by `take_control` and `hold`, and is true only when the autopilot's heartbeat says so.
Rule 4: once the vehicle left the mode that we asked for, we are out of control until `take_control` is called again.
Rule 5: a stream that stops or pauses while we are in control ends it with a request for Hold or BRAKE, because PX4
would fall back and then re-enter OFFBOARD by itself at the next setpoint.
"""

from dataclasses import dataclass, replace

from pymavlink.dialects.v20 import common as dialect

from follow.link import LinkError
from follow.link.clock import VehicleClock
from follow.link.flight_modes import MODES_OF, ModeNames, mode_params
from follow.link.packets import Message, Packets
from follow.link.signing import Signing
from follow.link.telemetry import AUTOPILOT, LinkObservations, TelemetryDecoder
from follow.messages import NEVER, Autopilot, Setpoint, VehicleState

FRAME = dialect.MAV_FRAME_BODY_NED  # 8: the frame that both obey as "forward, right, down from the heading"
VELOCITY_AND_YAW_RATE = 0x05C7  # ignore position, acceleration and yaw; masking one velocity axis drops them all
COMPANION = dialect.MAV_COMP_ID_ONBOARD_COMPUTER  # 191

HEARTBEAT_EVERY_S = 1.0  # the MAVLink heartbeat protocol's rate
TIMESYNC_EVERY_S = 0.2  # five chances a second for an exchange that nothing delayed
RATES_CHECK_EVERY_S = 2.0  # long enough to count a few messages of the slowest stream that we ask for
ASK_AGAIN_S = 0.7  # a command without an answer is repeated after this, as the command protocol does
ASK_TIMES = 3
ASK_PATIENCE_S = 3.0  # a mode acknowledged is waited for this long; PX4's heartbeat shows it up to 1 s late
STREAM_BEFORE_S = 1.2  # PX4 takes OFFBOARD only after more than 1 s of setpoints at more than 2 Hz
STREAM_GAP_S = 0.5  # 2 Hz; also the shortest COM_OF_LOSS_T and GUID_TIMEOUT that we ask for


@dataclass(frozen=True, slots=True)
class TelemetryRates:
    """Messages a second to ask the autopilot for."""

    attitude_hz: float = 50.0  # above the picture rate, so that the pose of a picture is never 20 ms old
    position_hz: float = 25.0  # 0.2 m at 5 m/s between two of them
    landed_hz: float = 2.0
    status_hz: float = 1.0
    rc_hz: float = 5.0  # a switch is a person's: 0.2 s is not felt

    def by_message(self) -> dict[str, tuple[int, float]]:
        """Message name -> (id, rate)."""
        return {
            "ATTITUDE": (dialect.MAVLINK_MSG_ID_ATTITUDE, self.attitude_hz),
            "LOCAL_POSITION_NED": (dialect.MAVLINK_MSG_ID_LOCAL_POSITION_NED, self.position_hz),
            "EXTENDED_SYS_STATE": (dialect.MAVLINK_MSG_ID_EXTENDED_SYS_STATE, self.landed_hz),
            "SYS_STATUS": (dialect.MAVLINK_MSG_ID_SYS_STATUS, self.status_hz),
            "RC_CHANNELS": (dialect.MAVLINK_MSG_ID_RC_CHANNELS, self.rc_hz),
        }


@dataclass(slots=True)
class ModeRequest:
    """A mode asked for: repeated while nobody answers and the vehicle stays in one of `from_modes`.

    Only a heartbeat later than `told_t_s` says anything of it.
    """

    mode: str
    from_modes: tuple[str, ...]
    told_t_s: float
    times: int = 0
    next_t_s: float = NEVER
    first_t_s: float = NEVER


class MavlinkClient:
    """One companion's conversation with one vehicle.

    Feed it with `receive` and `step`, and send what `take` returns.  `system_id` picks the vehicle; None takes the
    first one heard.
    """

    def __init__(
        self, system_id: int | None = None, rates: TelemetryRates | None = None, signing: Signing | None = None
    ):
        self.packets = Packets(system_id or 1, COMPANION, signing)
        self._vehicle = TelemetryDecoder(system_id)
        self._rates = rates or TelemetryRates()
        self._in_control = False
        self._commanded_mode = ""
        self._ask: ModeRequest | None = None
        self._stream_since_t_s = NEVER
        self._stream_t_s = NEVER
        self._done_t_s: dict[str, float] = {}
        self._counted: dict[str, int] = {}
        self._out: list[bytes] = []

    @property
    def vehicle_id(self) -> int | None:
        """The vehicle's system id, None before its first heartbeat."""
        return self._vehicle.system_id

    @property
    def heard(self) -> LinkObservations:
        """What else was heard on the link."""
        return self._vehicle.heard

    @property
    def clock(self) -> VehicleClock:
        """How the vehicle's clock relates to ours."""
        return self._vehicle.clock

    def state(self, t_s: float) -> VehicleState:
        """What is known of the vehicle at `t_s`."""
        known = self._vehicle.state
        in_control = self._in_control and known.armed
        return replace(known, t_s=t_s, commanded_mode=self._commanded_mode, in_control=in_control)

    def receive(self, data: bytes, t_s: float, datagram: bool = False) -> list[Message]:
        """Take in bytes that arrived at `t_s`; returns the messages in them, believed or not."""
        messages = self.packets.read_datagram(data) if datagram else self.packets.read(data)
        for message in messages:
            self._vehicle.hear(message, t_s)
            if self.vehicle_id is not None:
                self.packets.address = self.vehicle_id, COMPANION
            self._judge_control()
        return messages

    def is_from_vehicle(self, message: Message) -> bool:
        """Whether the vehicle's autopilot sent it; its other components may live elsewhere."""
        return (message.get_srcSystem(), message.get_srcComponent()) == (self.vehicle_id, AUTOPILOT)

    def take(self) -> list[bytes]:
        """The packets to be sent now, in order; each is handed out once."""
        out, self._out = self._out, []
        return out

    def step(self, t_s: float) -> None:
        """Do what is due: our heartbeat, the clocks, the telemetry rates, a mode asked for."""
        if self._is_due("heartbeat", t_s, HEARTBEAT_EVERY_S):
            kind, autopilot = dialect.MAV_TYPE_ONBOARD_CONTROLLER, dialect.MAV_AUTOPILOT_INVALID
            self._send(dialect.MAVLink_heartbeat_message(kind, autopilot, 0, 0, dialect.MAV_STATE_ACTIVE, 3))
        if self.vehicle_id is None:
            return
        if self._is_due("timesync", t_s, TIMESYNC_EVERY_S):
            self._send(dialect.MAVLink_timesync_message(0, round(t_s * 1e9)))
        if self._is_due("rates", t_s, RATES_CHECK_EVERY_S):
            self._ask_for_missing_rates()
        if self.heard.version is None and self._is_due("version", t_s, RATES_CHECK_EVERY_S):
            self.command(dialect.MAV_CMD_REQUEST_MESSAGE, dialect.MAVLINK_MSG_ID_AUTOPILOT_VERSION)
        if self._ask is not None:
            self._pursue(self._ask, t_s)

    def send_setpoint(self, setpoint: Setpoint | None, t_s: float) -> None:
        """Queue one setpoint, or end the stream when None.

        Raises ValueError for a number that is not finite: one NaN makes ArduPilot refuse to arm until a restart.
        """
        if setpoint is not None:
            setpoint.require_finite()
        streamed = self._stream_t_s > NEVER
        paused = streamed and t_s - self._stream_t_s > STREAM_GAP_S
        if streamed and (setpoint is None or (paused and self._in_control)):
            self.hold()
            self._stream_t_s = NEVER
            return
        if setpoint is None or self.vehicle_id is None:
            return
        if paused or not streamed:
            self._stream_since_t_s = t_s
        self._stream_t_s = t_s
        target = self.vehicle_id, AUTOPILOT, FRAME, VELOCITY_AND_YAW_RATE
        velocity = setpoint.forward_m_s, setpoint.right_m_s, setpoint.down_m_s
        numbers = 0.0, 0.0, 0.0, *velocity, 0.0, 0.0, 0.0, 0.0, setpoint.yaw_rate_rad_s
        boot_ms = round(t_s * 1e3) & 0xFFFFFFFF
        self._send(dialect.MAVLink_set_position_target_local_ned_message(boot_ms, *target, *numbers))

    def take_control(self) -> None:
        """Ask, once, for the mode that obeys setpoints, as soon as they are streaming.

        Only an operator's explicit order may lead here.  Raises LinkError when no vehicle is known.
        """
        self._begin(self._names().control)

    def hold(self) -> bool:
        """Ask, once, for Hold or BRAKE if the vehicle obeys us or may soon; returns whether it was asked.

        In any other mode somebody else flies, and is left alone.
        """
        asked = self._ask
        if asked is not None and asked.mode == self._names().hold:
            return True
        may_obey = self._in_control or (asked is not None and asked.times > 0)
        self._in_control = False
        self._ask = None
        if may_obey:
            self._begin(self._names().hold)
        return may_obey

    def is_asking(self) -> bool:
        """Whether a mode asked for is still awaited."""
        return self._ask is not None

    def command(self, command: int, *params: float) -> None:
        """Queue a COMMAND_LONG to the autopilot."""
        numbers = (*params, *(0.0,) * (7 - len(params)))
        target = self.vehicle_id or 0, AUTOPILOT
        self._send(dialect.MAVLink_command_long_message(*target, command, 0, *numbers))

    def request_parameter(self, name: str) -> None:
        """Ask for one parameter; the answer appears in `heard.parameters`."""
        target = self.vehicle_id or 0, AUTOPILOT
        self._send(dialect.MAVLink_param_request_read_message(*target, name.encode(), -1))

    def _names(self) -> ModeNames:
        if self._vehicle.state.autopilot is None:
            raise LinkError("no PX4 or ArduPilot multirotor has been heard on the link yet")
        return MODES_OF[self._vehicle.state.autopilot]

    def _send(self, message: Message) -> None:
        self._out.append(self.packets.write(message))

    def _is_due(self, what: str, t_s: float, every_s: float) -> bool:
        if t_s - self._done_t_s.get(what, NEVER) < every_s:
            return False
        self._done_t_s[what] = t_s
        return True

    def _ask_for_missing_rates(self) -> None:
        """Ask for each stream that brought less than half of what is wanted since the last look.

        So a restarted autopilot, which forgot what it was asked, is asked again.
        """
        for name, (number, rate_hz) in self._rates.by_message().items():
            came = self.heard.counts[name] - self._counted.get(name, 0)
            self._counted[name] = self.heard.counts[name]
            if came < 0.5 * rate_hz * RATES_CHECK_EVERY_S:
                self.command(dialect.MAV_CMD_SET_MESSAGE_INTERVAL, number, 1e6 / rate_hz)

    def _begin(self, mode: str) -> None:
        self._commanded_mode = mode
        now = self._vehicle.state
        # PX4 tells a mode up to 1 s late: when Hold is asked for, the mode that obeys us may be yet to be told.
        from_modes = (now.mode,) if mode == self._names().control else (now.mode, self._names().control)
        self._ask = ModeRequest(mode, from_modes, told_t_s=now.heartbeat_t_s)

    def _pursue(self, ask: ModeRequest, t_s: float) -> None:
        """Send the request when it may be sent; drop it when it was answered in vain or the vehicle moved on."""
        autopilot = self._vehicle.state.autopilot
        if t_s < ask.next_t_s or autopilot is None:
            return
        if ask.mode == self._names().control:
            before_s = STREAM_BEFORE_S if autopilot is Autopilot.PX4 else 0.0
            if self._stream_t_s == NEVER or self._stream_t_s - self._stream_since_t_s < before_s:
                return
        if ask.times == ASK_TIMES or (ask.times and dialect.MAV_CMD_DO_SET_MODE in self.heard.answers):
            if t_s >= ask.first_t_s + ASK_PATIENCE_S:
                self._ask = None
            return
        self.heard.answers.pop(dialect.MAV_CMD_DO_SET_MODE, None)
        custom = dialect.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
        self.command(dialect.MAV_CMD_DO_SET_MODE, custom, *mode_params(autopilot, ask.mode))
        if ask.times == 0:
            ask.first_t_s, ask.told_t_s = t_s, self._vehicle.state.heartbeat_t_s
        ask.times += 1
        ask.next_t_s = t_s + ASK_AGAIN_S

    def _judge_control(self) -> None:
        """Compare the vehicle's mode with the one that we asked for."""
        mode, ask = self._vehicle.state.mode, self._ask
        if ask is not None and self._vehicle.state.heartbeat_t_s > ask.told_t_s:
            if mode == ask.mode and ask.times:
                self._in_control = mode == self._names().control
                self._ask = None
            elif mode not in ask.from_modes:
                self._ask = None  # somebody chose another mode meanwhile: theirs counts
        if self._in_control and (mode != self._names().control or not self._vehicle.state.armed):
            self._in_control = False  # after a disarm, too, it is not ours again without an order
