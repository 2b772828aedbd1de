"""Our side of a MAVLink link, without I/O: bytes in, a VehicleState out; setpoints and requests in, packets out.

Rule 1: the vehicle is the PX4 or ArduPilot multirotor whose autopilot (component 1) sends HEARTBEAT.  No other sender
changes the state (`follow/link/telemetry.py`), even with the vehicle's id: only its address counts
(`follow/link/identity.py`).
Rule 2: we are component 191 of that vehicle, with a HEARTBEAT each second.
Rule 3: a mode is requested only by `take_control` and `hold`, and counts only when the autopilot's heartbeat shows it.
Rule 4: once the vehicle has left the mode that we requested, we have no control until `take_control` is called again.
If it never left that mode, Hold may still be requested, even after a long silence, because no stick acts in GUIDED.
Rule 5: a stream that stops or pauses while we are in control ends with a request for Hold or BRAKE, because PX4
would fall back and then re-enter OFFBOARD by itself at the next setpoint.
Rule 6: Hold is requested only on a heartbeat that is newer than the reason for it and still shows our mode, so that it
never overrides a mode that somebody else chose meanwhile.
"""

import logging
from dataclasses import replace

from pymavlink.dialects.v20 import common as dialect

from follow.link import LinkError
from follow.link.clock import VehicleClock
from follow.link.flight_modes import MODES_OF, ModeNames, mode_params
from follow.link.identity import PeerAddress, Source
from follow.link.mode_request import ModeRequest
from follow.link.packets import Message, Packets
from follow.link.rates import StreamRates
from follow.link.signing import Signing
from follow.link.telemetry import AUTOPILOT, COMPANION, LinkObservations, TelemetryDecoder
from follow.messages import NEVER, Autopilot, Setpoint, VehicleState

log = logging.getLogger(__name__)

FRAME = dialect.MAV_FRAME_BODY_NED  # 8: the frame that both obey as "forward, right, down from the heading"
VELOCITY_AND_YAW_RATE = 0x05C7  # ignore position, acceleration and yaw; masking one velocity axis drops them all

HEARTBEAT_EVERY_S = 1.0  # the MAVLink heartbeat protocol's rate
TIMESYNC_EVERY_S = 0.2  # five chances a second for an exchange without delay
MODE_EVERY_S = 0.2  # a HEARTBEAT is requested: only it shows the mode, and PX4 keeps the stream at 1 Hz
MODE_SOON_S = 0.05  # the same while a requested mode is awaited
VERSION_EVERY_S = 2.0
STREAM_GAP_S = 0.5  # 2 Hz; also the shortest COM_OF_LOSS_T and GUID_TIMEOUT that we ask for
SILENT_S = 3.0  # without a heartbeat for this long the link is cut, and the vehicle obeys no setpoint
DEAD_STICKS_EVERY_S = 10.0  # the warning about dead sticks is repeated at this interval
TEXT_BYTES = 50  # of STATUSTEXT
REFUSAL_TEXT_S = 2.0  # a STATUSTEXT within this time of a refused request is its reason


class MavlinkClient:
    """One companion's MAVLink connection with one vehicle.

    Feed it with `receive` and `step`, and send the packets that `take` returns.  `system_id` selects the vehicle; None
    takes the first one heard.
    """

    def __init__(self, system_id: int | None = None, signing: Signing | None = None):
        self.packets = Packets(system_id or 1, COMPANION, signing)
        self.peer = PeerAddress()
        self._signed = signing is not None
        self._vehicle = TelemetryDecoder(system_id)
        self._rates = StreamRates()
        self._in_control = False
        self._is_in_ours = False  # it has stayed in the control mode that we requested; also after we gave control back
        self._request: ModeRequest | None = None
        self._refusal = ""
        self._is_held = False  # in the Hold or BRAKE that we requested
        self._stream_since_t_s = NEVER
        self._stream_t_s = NEVER
        self._is_barred = False  # after a pause while in control no setpoint is sent until control is taken again
        self._t_s = NEVER  # the latest time that we were given
        self._done_t_s: dict[str, float] = {}
        self._out: list[bytes] = []

    @property
    def vehicle_id(self) -> int | None:
        """The vehicle's system id, None before its first heartbeat."""
        return self._vehicle.system_id

    @property
    def wanted_id(self) -> int | None:
        """The system id that was chosen, None for the first vehicle heard."""
        return self._vehicle.wanted_id

    @property
    def heard(self) -> LinkObservations:
        """What else was heard on the link."""
        return self._vehicle.heard

    @property
    def clock(self) -> VehicleClock:
        """How the vehicle's clock relates to ours."""
        return self._vehicle.clock

    @property
    def requested_mode(self) -> str:
        """The mode that is requested and not yet confirmed or given up; empty if there is no request."""
        return "" if self._request is None else self._request.mode

    @property
    def requested_times(self) -> int:
        """How often the request was sent: 0 until a heartbeat shows that the vehicle is still in our mode."""
        return 0 if self._request is None else self._request.times

    def state(self, t_s: float) -> VehicleState:
        """What is known of the vehicle at `t_s`."""
        known = self._vehicle.state
        return replace(
            known,
            t_s=t_s,
            in_control=self._in_control and known.armed,
            refusal=self._refusal,
            contested_t_s=max(known.contested_t_s, self.peer.stranger_t_s),
        )

    def receive(self, data: bytes, t_s: float, datagram: bool = False, source: Source = None) -> list[Message]:
        """Use bytes that arrived at `t_s` from `source`; returns the messages in them, accepted or not."""
        self._t_s = max(self._t_s, t_s)
        messages = self.packets.read_datagram(data) if datagram else self.packets.read(data)
        for message in messages:
            if self._is_forged(message, source, t_s):
                continue
            was_unknown = self.vehicle_id is None
            self._vehicle.hear(message, t_s)
            if self.vehicle_id is not None:
                self.packets.address = self.vehicle_id, COMPANION
                if was_unknown:
                    self.peer.admits(source, t_s, signed=self._signed)
            if self._vehicle.watch.is_contested(t_s) and self._is_due("contested", t_s, 10.0):
                log.warning("two senders use system %s: its remote control is ignored", self.vehicle_id)
            if isinstance(message, dialect.MAVLink_command_ack_message):
                self._hear_answer(message)
            elif isinstance(message, dialect.MAVLink_statustext_message):
                self._hear_text(message, t_s)
            self._judge_control()
        return messages

    def is_from_vehicle(self, message: Message) -> bool:
        """Whether a message has the vehicle's id and its autopilot's component."""
        return (message.get_srcSystem(), message.get_srcComponent()) == (self.vehicle_id, AUTOPILOT)

    def take(self) -> list[bytes]:
        """The packets to be sent now, in order; each is returned once."""
        out, self._out = self._out, []
        return out

    def step(self, t_s: float) -> None:
        """Do what is due: our heartbeat, clock exchange, stream rates, a requested mode."""
        self._t_s = max(self._t_s, t_s)
        if self._is_due("heartbeat", t_s, HEARTBEAT_EVERY_S):
            kind, autopilot = dialect.MAV_TYPE_ONBOARD_CONTROLLER, dialect.MAV_AUTOPILOT_INVALID
            self._send(dialect.MAVLink_heartbeat_message(kind, autopilot, 0, 0, dialect.MAV_STATE_ACTIVE, 3))
        autopilot = self._vehicle.state.autopilot
        if self.vehicle_id is None or autopilot is None:
            return
        if self._is_due("timesync", t_s, TIMESYNC_EVERY_S):
            self.clock.ask(t_s)
            self._send(dialect.MAVLink_timesync_message(0, round(t_s * 1e9)))
        if self._is_due("mode", t_s, MODE_EVERY_S if self._request is None else MODE_SOON_S):
            self.command(dialect.MAV_CMD_REQUEST_MESSAGE, dialect.MAVLINK_MSG_ID_HEARTBEAT)
        for number, rate_hz in self._rates.missing(self.heard.counts, autopilot, t_s):
            self.command(dialect.MAV_CMD_SET_MESSAGE_INTERVAL, number, 1e6 / rate_hz)
        if self.heard.version is None and self._is_due("version", t_s, VERSION_EVERY_S):
            self.command(dialect.MAV_CMD_REQUEST_MESSAGE, dialect.MAVLINK_MSG_ID_AUTOPILOT_VERSION)
        if self._request is not None:
            self._pursue(self._request, autopilot, t_s)
        silent_s = t_s - self._vehicle.state.heartbeat_t_s
        if self._is_in_ours and silent_s > SILENT_S and self._is_due("silence", t_s, DEAD_STICKS_EVERY_S):
            mode, sticks = self._vehicle.state.mode, self._names().sticks
            log.warning("nothing heard from the vehicle for %.0f s: it was in %s, switch to %s", silent_s, mode, sticks)

    def send_setpoint(self, setpoint: Setpoint | None, t_s: float) -> None:
        """Queue one setpoint, or end the stream if None.

        Raises ValueError for a number that is not finite: one NaN makes ArduPilot refuse to arm until a restart.
        """
        if setpoint is not None:
            setpoint.require_finite()
        self._t_s = max(self._t_s, t_s)
        streamed = self._stream_t_s > NEVER
        paused = streamed and t_s - self._stream_t_s > STREAM_GAP_S
        if streamed and (setpoint is None or (paused and self._in_control)):
            if paused and self._in_control:
                log.warning(
                    "no setpoint was sent for %.1f s: this program or its camera stalled", t_s - self._stream_t_s
                )
                self._is_barred = True
            self.hold()
            self._stream_t_s = NEVER
            return
        if setpoint is None or self.vehicle_id is None or self._is_barred:
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
        """Request, once, the mode that obeys setpoints, as soon as they are streaming.

        Call this only on an operator's explicit order.  Raises LinkError if no vehicle is known.
        """
        now = self._vehicle.state
        self._refusal, self._is_barred = "", False
        self._request = ModeRequest(self._names().control, (now.mode,), now.heartbeat_t_s)

    def hold(self, *, for_sticks: bool = False) -> bool:
        """Give the vehicle back if it obeys us or may soon; returns whether a request may follow.

        Requests Hold or BRAKE, or with `for_sticks` the mode in which the pilot's sticks act, as soon as a heartbeat
        newer than this call shows that the vehicle is still in our mode, whatever the result of an earlier request.
        With `for_sticks` it may also be in the Hold or BRAKE that we requested.  In any other mode somebody else flies.
        """
        if self._vehicle.state.autopilot is None:
            return False
        names, request = self._names(), self._request
        if for_sticks and self._is_held and request is None:
            self._request = ModeRequest(names.sticks, (names.hold,), self._t_s, since_t_s=self._t_s)
            return True
        mode = names.sticks if for_sticks else names.hold
        if request is not None and request.mode != names.control:
            if for_sticks and not request.times:
                request.mode = mode
            return True
        if not (self._is_in_ours or (request is not None and request.times)):
            self._request = None
            return False
        before = (names.control,) if request is None else (*request.from_modes, names.control)
        self._in_control = False
        self._done_t_s.pop("mode", None)  # request a HEARTBEAT at once
        self._request = ModeRequest(mode, before, self._t_s, since_t_s=self._t_s)
        return True

    def is_asking(self) -> bool:
        """Whether a requested mode is still awaited."""
        return self._request is not None

    def command(self, command: int, *params: float) -> None:
        """Queue a COMMAND_LONG to the autopilot."""
        numbers = (*params, *(0.0,) * (7 - len(params)))
        target = self.vehicle_id or 0, AUTOPILOT
        self._send(dialect.MAVLink_command_long_message(*target, command, 0, *numbers))

    def tell(self, text: str, severity: int = dialect.MAV_SEVERITY_INFO) -> None:
        """Queue a STATUSTEXT for the pilot; the autopilot forwards it.  Longer texts are cut at 50 bytes."""
        self._send(dialect.MAVLink_statustext_message(severity, text.encode("ascii", "replace")[:TEXT_BYTES]))

    def tell_value(self, name: str, value: float, t_s: float) -> None:
        """Queue a NAMED_VALUE_FLOAT: a figure that a ground station shows or plots; `name` has at most 10 letters."""
        boot_ms = round(t_s * 1e3) & 0xFFFFFFFF
        self._send(dialect.MAVLink_named_value_float_message(boot_ms, name.encode("ascii")[:10], value))

    def request_parameter(self, name: str) -> None:
        """Request one parameter; the answer appears in `heard.parameters`."""
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

    def _is_forged(self, message: Message, source: Source, t_s: float) -> bool:
        """Whether a packet has the vehicle's id but does not come from the vehicle's address."""
        if self.vehicle_id is None or not self.is_from_vehicle(message):
            return False
        known = self.peer.address
        if self.peer.admits(source, t_s, signed=self._signed):
            if known not in (None, self.peer.address):
                log.warning("the vehicle is now heard at %s, no longer at %s", self.peer.address, known)
            return False
        if self._is_due("stranger", t_s, 10.0):
            log.warning("%s also claims to be system %s: its packets are ignored", source, self.vehicle_id)
        return True

    # Modes

    def _hear_answer(self, message: dialect.MAVLink_command_ack_message) -> None:
        """End a mode request that the autopilot refused, with the result as the reason."""
        request = self._request
        if request is None or not request.times or message.command != dialect.MAV_CMD_DO_SET_MODE:
            return
        if not self.is_from_vehicle(message) or not self._vehicle.is_answer(message):
            return
        if message.result not in (
            dialect.MAV_RESULT_ACCEPTED,
            dialect.MAV_RESULT_IN_PROGRESS,
        ):
            results = dialect.enums["MAV_RESULT"]
            name = results[message.result].name if message.result in results else f"result {message.result}"
            self._give_up(f"the autopilot refused {request.mode} ({name.removeprefix('MAV_RESULT_')})")

    def _hear_text(self, message: dialect.MAVLink_statustext_message, t_s: float) -> None:
        """Append the autopilot's text about a refused request to the reason."""
        recent = t_s - self._done_t_s.get("request", NEVER) <= REFUSAL_TEXT_S
        if self._refusal and recent and self.is_from_vehicle(message) and message.text not in self._refusal:
            self._refusal += f": {message.text}"

    def _give_up(self, reason: str) -> None:
        log.warning("%s", reason)
        self._refusal, self._request = reason, None

    def _pursue(self, request: ModeRequest, autopilot: Autopilot, t_s: float) -> None:
        """Send the request when it is due; drop it after its timeout."""
        now = self._vehicle.state
        control = self._names().control
        streaming_s = self._stream_t_s - self._stream_since_t_s if self._stream_t_s > NEVER else None
        if request.overdue(t_s):
            if request.times:
                self._give_up(f"the autopilot stayed in {now.mode} after {request.times} requests for {request.mode}")
            self._request = None
            return
        if request.may_send(now, t_s, control, streaming_s, dialect.MAV_CMD_DO_SET_MODE in self.heard.answers):
            self.heard.answers.pop(dialect.MAV_CMD_DO_SET_MODE, None)
            log.info("requesting %s", request.mode)
            custom = dialect.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
            self.command(dialect.MAV_CMD_DO_SET_MODE, custom, *mode_params(autopilot, request.mode))
            request.sent(now.heartbeat_t_s, t_s)
            self._done_t_s["request"] = t_s

    def _judge_control(self) -> None:
        """Compare the vehicle's mode with the one that we requested."""
        mode, request = self._vehicle.state.mode, self._request
        if request is not None and self._vehicle.state.heartbeat_t_s > request.cause_t_s:
            # PX4 returns to OFFBOARD by itself when our stream begins, if it had fallen back from it.
            by_itself = request.mode == self._names().control and self._stream_t_s > NEVER
            if mode == request.mode and (request.times or by_itself):
                self._in_control = self._is_in_ours = mode == self._names().control
                self._is_held = mode == self._names().hold
                self._request = None
            elif mode not in request.from_modes and request.mode != mode:
                self._request = None  # somebody else chose another mode meanwhile: leave it
            elif mode == request.mode != self._names().control:
                self._request = None  # the vehicle is already in it, by somebody else's choice or a failsafe
        if self._is_held and mode != self._names().hold:
            self._is_held = False
        if self._is_in_ours and (mode != self._names().control or not self._vehicle.state.armed):
            self._in_control = self._is_in_ours = False  # also after a disarm, until a new order
        self._warn_of_dead_sticks()

    def _warn_of_dead_sticks(self) -> None:
        """Warn repeatedly while the vehicle stays in our mode although nothing is sent or requested."""
        left_alone = self._is_in_ours and not self._in_control and self._request is None
        is_heard = self._t_s - self._vehicle.state.heartbeat_t_s <= HEARTBEAT_EVERY_S
        if left_alone and is_heard and self._is_due("dead sticks", self._t_s, DEAD_STICKS_EVERY_S):
            mode, sticks = self._vehicle.state.mode, self._names().sticks
            log.warning("the vehicle is still in %s, and nothing is sent to it: switch to %s", mode, sticks)
            self.tell(f"Still in {mode}, nothing sent: switch to {sticks}", dialect.MAV_SEVERITY_WARNING)
