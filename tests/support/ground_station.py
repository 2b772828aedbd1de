"""A ground station's camera panel, as QGroundControl is known to behave: a state machine, bytes in and bytes out.

It stands for QGroundControl, which is no package: discovery, pointing and what it draws, in the variant of
4.4 (OLD) and of 5.0 (NEW).  It decodes with pymavlink's own parser, not with the code under test.
"""

from dataclasses import dataclass, field

from pymavlink.dialects.v20 import common as dialect

OLD, NEW = "old", "new"
WAITS_S = 1.2  # for an acknowledgement; then it shows an error
QUESTIONS = ((259, 521), (260, 522), (269, 2504), (262, 527), (261, 525))
"""Message ids and the older commands that ask for them, in the order in which it asks."""


@dataclass
class GroundStation:
    """The vehicle's system id is 1; a camera is known once its information came."""

    variant: str = NEW
    system_id: int = 255
    camera: int = 0
    heard: dict[str, object] = field(default_factory=dict)
    acks: list[tuple[int, int]] = field(default_factory=list)
    boxes: list[tuple[float, ...]] = field(default_factory=list)
    texts: list[str] = field(default_factory=list)
    errors: list[str] = field(default_factory=list)
    waiting: dict[int, float] = field(default_factory=dict)
    log: list[tuple[float, str]] = field(default_factory=list)

    def __post_init__(self):
        self.mav = dialect.MAVLink(None, srcSystem=self.system_id, srcComponent=190)
        self.parser = dialect.MAVLink(None)
        self.out: list[bytes] = []

    def hear(self, data: bytes, t_s: float) -> None:
        for message in self.parser.parse_buffer(data) or []:
            self.see(message, t_s)

    def see(self, message, t_s: float) -> None:
        kind, component = message.get_type(), message.get_srcComponent()
        if message.get_srcSystem() != 1:
            return
        if kind == "HEARTBEAT" and 100 <= component <= 105 and not self.camera:
            self.camera = component
            self.ask(QUESTIONS[0], t_s)
        if component != self.camera:
            return
        self.log.append((t_s, f"<- {words(message)}"))
        self.heard[kind] = message
        if kind == "CAMERA_INFORMATION":
            for question in QUESTIONS[1:]:
                self.ask(question, t_s)
        elif kind == "COMMAND_ACK" and message.target_system == self.system_id:
            self.acks.append((message.command, message.result))
            self.waiting.pop(message.command, None)
            if message.result != 0 and message.command in (2004, 2005, 2010):
                self.errors.append(f"command {message.command}: result {message.result}")
        elif kind == "STATUSTEXT":
            self.texts.append(message.text)
        elif kind == "CAMERA_TRACKING_IMAGE_STATUS":
            status = message.tracking_status
            is_drawn = status == 1 if self.variant == OLD else bool(status & 1)
            if is_drawn and message.tracking_mode == 2:
                self.boxes.append((message.rec_top_x, message.rec_top_y, message.rec_bottom_x, message.rec_bottom_y))

    def step(self, t_s: float) -> None:
        for command, since_s in list(self.waiting.items()):
            if t_s - since_s > WAITS_S:
                self.errors.append(f"no acknowledgement of command {command}")
                del self.waiting[command]

    def ask(self, question: tuple[int, int], t_s: float) -> None:
        number, command = question
        if self.variant == OLD:
            self.command(command, t_s, 1.0)
        else:
            self.command(512, t_s, float(number))

    def drag(self, t_s: float, left: float, top: float, right: float, bottom: float) -> None:
        self.command(2005, t_s, left, top, right, bottom)
        if self.variant == NEW:
            self.command(511, t_s, 275.0, 500_000.0)

    def click(self, t_s: float, x: float, y: float, radius: float = 0.03) -> None:
        self.command(2004, t_s, x, y, radius)

    def stop(self, t_s: float) -> None:
        self.command(2010, t_s)

    def command(self, command: int, t_s: float, *params: float) -> None:
        numbers = (*params, *(0.0,) * (7 - len(params)))
        message = dialect.MAVLink_command_long_message(1, self.camera, command, 0, *numbers)
        self.out.append(message.pack(self.mav))
        self.waiting[command] = t_s
        shown = " ".join(f"{number:.4g}" for number in params)
        self.log.append((t_s, f"-> {name('MAV_CMD', command)} {shown}"))

    def heartbeat(self) -> bytes:
        return dialect.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3).pack(self.mav)

    def take(self) -> list[bytes]:
        out, self.out = self.out, []
        return out


SHOWN = {
    "CAMERA_INFORMATION": ("flags", "resolution_h", "resolution_v"),
    "CAMERA_SETTINGS": ("mode_id",),
    "VIDEO_STREAM_INFORMATION": ("type", "uri", "encoding", "framerate", "resolution_h", "resolution_v", "bitrate"),
    "CAMERA_CAPTURE_STATUS": ("image_status", "video_status"),
    "STORAGE_INFORMATION": ("storage_count", "status"),
    "STATUSTEXT": ("text",),
}
"""What a transcript shows of each message; of others only the name."""


def name(kind: str, number: int) -> str:
    entry = dialect.enums[kind].get(number)
    return entry.name.removeprefix("MAV_CMD_").removeprefix("MAV_RESULT_") if entry else str(number)


def words(message) -> str:
    kind = message.get_type()
    if kind == "COMMAND_ACK":
        return f"COMMAND_ACK {name('MAV_CMD', message.command)}: {name('MAV_RESULT', message.result)}"
    if kind == "CAMERA_TRACKING_IMAGE_STATUS":
        box = message.rec_top_x, message.rec_top_y, message.rec_bottom_x, message.rec_bottom_y
        corners = " ".join(f"{share:.3f}" for share in box)
        return f"CAMERA_TRACKING_IMAGE_STATUS status {message.tracking_status}, rectangle {corners}"
    return " ".join([kind, *(f"{field} {getattr(message, field)}" for field in SHOWN.get(kind, ()))])
