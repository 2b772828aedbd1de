"""The camera that a ground station finds, shows and selects targets in: a second MAVLink component, without I/O.

Feed it with `hear` and `step`, and send the packets that `take` returns.  It implements the MAVLink camera protocol as
QGroundControl 4.4 to 5.0 and MAVSDK use it: discovery by REQUEST_MESSAGE and older commands; CAMERA_TRACK_POINT,
CAMERA_TRACK_RECTANGLE and CAMERA_STOP_TRACKING; CAMERA_TRACKING_IMAGE_STATUS ten times a second while a box is tracked.
Every command to this component is acknowledged to its sender, who may be behind the autopilot.
"""

import logging
import math
from collections.abc import Callable
from dataclasses import dataclass

from pymavlink.dialects.v20 import common as dialect

from follow.link.packets import Message, Packets
from follow.link.signing import Signing
from follow.messages import NEVER
from follow.selection import Choose, Cleared, Selection, TrackingState, TrackingStatus

log = logging.getLogger(__name__)

CAMERA = dialect.MAV_COMP_ID_CAMERA  # 100: ground stations look for cameras at 100 to 105
HEARTBEAT_EVERY_S = 1.0  # a ground station drops a camera after 5 s of silence
STATUS_EVERY_S = 0.1  # sent unasked: QGroundControl before August 2025 does not request it
REPEAT_S = 3.0  # a sender repeats a command when its acknowledgement is lost
STALE_S = 1.0  # selections in an image older than this are rejected
SMALLEST = 0.004  # of the image's side: 2.5 pixels of 640
TEXT_EVERY_S = 1.0  # between two texts with the same words
TEXT_LENGTH = 50  # of STATUSTEXT

POINT, RECTANGLE = dialect.MAV_CMD_CAMERA_TRACK_POINT, dialect.MAV_CMD_CAMERA_TRACK_RECTANGLE
STOP = dialect.MAV_CMD_CAMERA_STOP_TRACKING
ACCEPTED, DENIED = dialect.MAV_RESULT_ACCEPTED, dialect.MAV_RESULT_DENIED
UNSUPPORTED, REJECTED = dialect.MAV_RESULT_UNSUPPORTED, dialect.MAV_RESULT_TEMPORARILY_REJECTED

OLD_REQUESTS = {
    dialect.MAV_CMD_REQUEST_CAMERA_INFORMATION: dialect.MAVLINK_MSG_ID_CAMERA_INFORMATION,
    dialect.MAV_CMD_REQUEST_CAMERA_SETTINGS: dialect.MAVLINK_MSG_ID_CAMERA_SETTINGS,
    dialect.MAV_CMD_REQUEST_STORAGE_INFORMATION: dialect.MAVLINK_MSG_ID_STORAGE_INFORMATION,
    dialect.MAV_CMD_REQUEST_CAMERA_CAPTURE_STATUS: dialect.MAVLINK_MSG_ID_CAMERA_CAPTURE_STATUS,
    dialect.MAV_CMD_REQUEST_VIDEO_STREAM_INFORMATION: dialect.MAVLINK_MSG_ID_VIDEO_STREAM_INFORMATION,
    dialect.MAV_CMD_REQUEST_VIDEO_STREAM_STATUS: dialect.MAVLINK_MSG_ID_VIDEO_STREAM_STATUS,
}
"""The older command for each message that REQUEST_MESSAGE asks for today."""


@dataclass(frozen=True, slots=True)
class StreamDescription:
    """The video stream announced to the ground station; `uri` is a bare port for RTP over UDP."""

    uri: str = "5600"
    is_rtp: bool = True
    rate_hz: float = 30.0
    size: tuple[int, int] = (640, 360)
    bit_s: int = 2_000_000
    hfov_deg: float = 0.0  # 0: unknown


@dataclass(frozen=True, slots=True)
class Answer:
    """The result of a command, and the text why it was refused."""

    result: int
    why: str = ""


class GroundCamera:
    """One camera component, for all ground stations.

    `choose` gets each valid selection or stop, and returns why it refuses it, or "".  `delay_s` is the age of the image
    that a person sees when the command arrives.
    """

    def __init__(
        self,
        size: tuple[int, int],
        choose: Choose,
        stream: StreamDescription | None = None,
        delay_s: float = 0.0,
        signing: Signing | None = None,
    ):
        self._size = size
        self._choose = choose
        self._stream = stream
        self._delay_s = delay_s
        self._packets = Packets(1, CAMERA, signing)
        self._is_on_line = False  # nothing is sent before the vehicle's id is known
        self._status = TrackingStatus(TrackingState.IDLE, None, NEVER)
        self._status_every_s = STATUS_EVERY_S
        self._told_state = TrackingState.IDLE
        self._done_t_s: dict[str, float] = {}
        # By sender, its last selection or stop: command, numbers, time and answer.
        self._recent: dict[tuple[int, int], tuple[int, tuple[float, ...], float, Answer]] = {}
        self._out: list[bytes] = []

    def address(self, system_id: int) -> None:
        """Use the vehicle's system id: a ground station ignores a camera with another id."""
        self._packets.address = system_id, CAMERA
        self._is_on_line = True

    def take(self) -> list[bytes]:
        """The packets to be sent now, in order; each is returned once."""
        out, self._out = self._out, []
        return out

    def step(self, t_s: float, status: TrackingStatus) -> None:
        """Do what is due: our heartbeat, and the tracking status while a box is tracked and once after."""
        self._status = status
        if not self._is_on_line:
            return
        if self._is_due("heartbeat", t_s, HEARTBEAT_EVERY_S):
            kind, autopilot = dialect.MAV_TYPE_CAMERA, dialect.MAV_AUTOPILOT_INVALID
            self._send(dialect.MAVLink_heartbeat_message(kind, autopilot, 0, 0, dialect.MAV_STATE_ACTIVE, 3))
        ended = status.state is TrackingState.IDLE and self._told_state is not TrackingState.IDLE
        tracked = status.state is not TrackingState.IDLE and self._is_due("status", t_s, self._status_every_s)
        if ended or tracked:
            self._told_state = status.state
            self._send(tracking_message(status))

    def hear(self, message: Message, t_s: float) -> None:
        """Answer a command to this component."""
        if not self._is_on_line or not isinstance(
            message, dialect.MAVLink_command_long_message | dialect.MAVLink_command_int_message
        ):
            return
        if (message.target_system, message.target_component) != self._packets.address:
            return
        sender = message.get_srcSystem(), message.get_srcComponent()
        numbers = params_of(message)
        answer = self._answer_once((*sender, message.command), numbers, t_s)
        self._send(dialect.MAVLink_command_ack_message(message.command, answer.result, 0, 0, *sender))
        if answer.result == ACCEPTED:
            self._send_requested(message.command, numbers, t_s)
        elif answer.why:
            self.tell(answer.why, t_s)

    def tell(self, text: str, t_s: float) -> None:
        """Queue a text for the pilot; the same text at most once in TEXT_EVERY_S."""
        if self._is_on_line and self._is_due(f"text {text}", t_s, TEXT_EVERY_S):
            words = text.encode("ascii", "replace")[:TEXT_LENGTH]
            self._send(dialect.MAVLink_statustext_message(dialect.MAV_SEVERITY_WARNING, words))

    def _answer_once(self, command: tuple[int, int, int], numbers: tuple[float, ...], t_s: float) -> Answer:
        """The answer; a retried selection gets the same answer again and is not carried out twice.

        A repeated stop stops again, because another console may have ordered FOLLOW meanwhile.
        """
        if command[2] not in (POINT, RECTANGLE, STOP):
            return self._answer(command[2], numbers, t_s, name_of(command))
        if command[2] == POINT:
            numbers = numbers[:2]  # the others are unused and may be NaN, which never compares equal
        last = self._recent.get(command[:2])  # the same box again after a stop is not a retry
        is_same = last is not None and command[2] != STOP and last[:2] == (command[2], numbers)
        if last is not None and is_same and t_s - last[2] <= REPEAT_S and last[3].result == ACCEPTED:
            return last[3]
        answer = self._answer(command[2], numbers, t_s, name_of(command))
        self._recent[command[:2]] = command[2], numbers, t_s, answer
        return answer

    def _answer(self, command: int, numbers: tuple[float, ...], t_s: float, by: str) -> Answer:
        if command in (POINT, RECTANGLE):
            return self._select(command, numbers, t_s, by)
        if command == STOP:
            return refused_or_not(self._choose(Cleared(by)))
        if command in OLD_REQUESTS or command == dialect.MAV_CMD_REQUEST_MESSAGE:
            wanted = wanted_message(command, numbers)
            return Answer(ACCEPTED if wanted is not None and self._message(wanted, t_s) else UNSUPPORTED)
        if command == dialect.MAV_CMD_SET_MESSAGE_INTERVAL:
            return self._set_interval(numbers)
        if command in (dialect.MAV_CMD_VIDEO_START_STREAMING, dialect.MAV_CMD_VIDEO_STOP_STREAMING):
            return Answer(ACCEPTED if self._stream is not None else UNSUPPORTED)
        return Answer(UNSUPPORTED)

    def _select(self, command: int, numbers: tuple[float, ...], t_s: float, by: str) -> Answer:
        if not all(math.isfinite(share) and 0.0 <= share <= 1.0 for share in numbers):
            return Answer(DENIED, "box not in the image: draw it again")
        if t_s - self._status.frame_t_s > STALE_S:
            return Answer(REJECTED, "no fresh image: nothing selected")
        left, top, right, bottom = numbers if command == RECTANGLE else (*numbers, *numbers)
        width, height = right - left, bottom - top
        if command == RECTANGLE and (width < SMALLEST or height < SMALLEST):
            return Answer(DENIED, "box too small: draw it round the target")
        frame_t_s = min(t_s - self._delay_s, self._status.frame_t_s)
        return refused_or_not(self._choose(Selection(left, top, width, height, frame_t_s, by)))

    def _set_interval(self, numbers: tuple[float, ...]) -> Answer:
        """Switch the tracking status on or off.  Its rate stays: at a slower one the box would lag behind."""
        if numbers[0] != dialect.MAVLINK_MSG_ID_CAMERA_TRACKING_IMAGE_STATUS or not math.isfinite(numbers[1]):
            return Answer(UNSUPPORTED)
        self._status_every_s = math.inf if numbers[1] < 0.0 else STATUS_EVERY_S
        return Answer(ACCEPTED)

    def _send_requested(self, command: int, numbers: tuple[float, ...], t_s: float) -> None:
        wanted = wanted_message(command, numbers)
        message = self._message(wanted, t_s) if wanted is not None else None
        if message is not None:
            self._send(message)

    def _message(self, number: int, t_s: float) -> Message | None:
        """The present content of a message, None if this camera does not have that message."""
        boot_ms = round(t_s * 1e3) & 0xFFFFFFFF
        nan, size, stream = math.nan, self._size, self._stream
        none_stored = dialect.STORAGE_STATUS_NOT_SUPPORTED, 0.0, 0.0, 0.0, nan, nan
        makers: dict[int, Callable[[], Message]] = {
            dialect.MAVLINK_MSG_ID_CAMERA_INFORMATION: lambda: camera_information(boot_ms, size, stream),
            dialect.MAVLINK_MSG_ID_CAMERA_SETTINGS: lambda: dialect.MAVLink_camera_settings_message(
                boot_ms, dialect.CAMERA_MODE_VIDEO, nan, nan
            ),
            dialect.MAVLINK_MSG_ID_CAMERA_CAPTURE_STATUS: lambda: dialect.MAVLink_camera_capture_status_message(
                boot_ms, 0, 0, 0.0, 0, 0.0
            ),
            dialect.MAVLINK_MSG_ID_STORAGE_INFORMATION: lambda: dialect.MAVLink_storage_information_message(
                boot_ms, 1, 1, *none_stored
            ),
            dialect.MAVLINK_MSG_ID_CAMERA_TRACKING_IMAGE_STATUS: lambda: tracking_message(self._status),
        }
        if stream is not None:
            makers[dialect.MAVLINK_MSG_ID_VIDEO_STREAM_INFORMATION] = lambda: stream_information(stream)
            makers[dialect.MAVLINK_MSG_ID_VIDEO_STREAM_STATUS] = lambda: stream_status(stream)
        return makers[number]() if number in makers else None

    def _send(self, message: Message) -> None:
        self._out.append(self._packets.write(message))

    def _is_due(self, what: str, t_s: float, every_s: float) -> bool:
        last_t_s = self._done_t_s.get(what, NEVER)
        if t_s - last_t_s < every_s - 1e-6:
            return False
        self._done_t_s = {old: at for old, at in self._done_t_s.items() if t_s - at < REPEAT_S}
        on_time = t_s - last_t_s < 2.0 * every_s  # then keep the mean rate, whatever the length of the rounds
        self._done_t_s[what] = last_t_s + every_s if on_time else t_s
        return True


def refused_or_not(why: str) -> Answer:
    """ACCEPTED, or DENIED with the reason."""
    return Answer(DENIED, why) if why else Answer(ACCEPTED)


def name_of(command: tuple[int, int, int]) -> str:
    """The console that sent a command."""
    return f"the ground station {command[0]}/{command[1]}"


def params_of(message: dialect.MAVLink_command_long_message | dialect.MAVLink_command_int_message) -> tuple[float, ...]:
    """The numbers of a command, at least four."""
    return message.param1, message.param2, message.param3, message.param4


def wanted_message(command: int, numbers: tuple[float, ...]) -> int | None:
    """The number of the message that a command requests, None for any other command."""
    if command in OLD_REQUESTS:
        return OLD_REQUESTS[command]
    if command == dialect.MAV_CMD_REQUEST_MESSAGE and math.isfinite(numbers[0]):
        return round(numbers[0])
    return None


def tracking_message(status: TrackingStatus) -> Message:
    """CAMERA_TRACKING_IMAGE_STATUS: always a rectangle, because old ground stations draw a point wrongly.

    Ground stations before March 2026 draw the box only if the status is 1 exactly, so coasting has no flag of its own.
    """
    nan = math.nan
    if status.box is None or status.state is TrackingState.IDLE:
        is_idle = status.state is TrackingState.IDLE
        flags = dialect.CAMERA_TRACKING_STATUS_FLAGS_IDLE if is_idle else dialect.CAMERA_TRACKING_STATUS_FLAGS_ERROR
        none = dialect.CAMERA_TRACKING_MODE_NONE
        return dialect.MAVLink_camera_tracking_image_status_message(flags, none, 0, nan, nan, nan, nan, nan, nan, nan)
    left, top, width, height = status.box
    flags, mode = dialect.CAMERA_TRACKING_STATUS_FLAGS_ACTIVE, dialect.CAMERA_TRACKING_MODE_RECTANGLE
    shown = dialect.CAMERA_TRACKING_TARGET_DATA_IN_STATUS
    corners = left, top, left + width, top + height
    return dialect.MAVLink_camera_tracking_image_status_message(flags, mode, shown, nan, nan, nan, *corners)


def camera_information(boot_ms: int, size: tuple[int, int], stream: StreamDescription | None) -> Message:
    """CAMERA_INFORMATION: a resolution of 0 would misplace every box."""
    flags = dialect.CAMERA_CAP_FLAGS_HAS_TRACKING_POINT | dialect.CAMERA_CAP_FLAGS_HAS_TRACKING_RECTANGLE
    if stream is not None:
        flags |= dialect.CAMERA_CAP_FLAGS_HAS_VIDEO_STREAM
    vendor, model = (list(name.ljust(32, b"\0")) for name in (b"follow-me", b"RACF"))
    unknown = math.nan, math.nan, math.nan
    return dialect.MAVLink_camera_information_message(boot_ms, vendor, model, 0, *unknown, *size, 0, flags, 0, b"")


def stream_information(stream: StreamDescription) -> Message:
    """VIDEO_STREAM_INFORMATION: the first of one stream."""
    kind = dialect.VIDEO_STREAM_TYPE_RTPUDP if stream.is_rtp else dialect.VIDEO_STREAM_TYPE_RTSP
    how = stream.rate_hz, *stream.size, stream.bit_s, 0, round(stream.hfov_deg)
    running, name = dialect.VIDEO_STREAM_STATUS_FLAGS_RUNNING, b"follow"
    h264 = dialect.VIDEO_STREAM_ENCODING_H264
    return dialect.MAVLink_video_stream_information_message(1, 1, kind, running, *how, name, stream.uri.encode(), h264)


def stream_status(stream: StreamDescription) -> Message:
    """VIDEO_STREAM_STATUS of the one stream."""
    how = stream.rate_hz, *stream.size, stream.bit_s, 0, round(stream.hfov_deg)
    return dialect.MAVLink_video_stream_status_message(1, dialect.VIDEO_STREAM_STATUS_FLAGS_RUNNING, *how)
