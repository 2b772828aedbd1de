"""Fuzzing of the ground station's side: garbage, and well-formed commands with any number in any field.

Checked after every input: no exception; only whole packets are sent; each command to our camera is acknowledged once;
a selection lies in the image; no message of a ground station orders FOLLOW without `--ground-follows` or changes the
settings of the flight; a valid box is still accepted.
"""

import math
import random
import struct
from collections.abc import Callable
from concurrent.futures import Future
from types import SimpleNamespace

import numpy as np
from pymavlink.dialects.v20 import common as dialect

from follow.control.selector import Selector
from follow.link.packets import Packets
from follow.messages import HOVER, Decision, Estimate, Frame, Mode, Order, Tick, VehicleState
from follow.operator.authority import Operator
from follow.operator.consoles import SELECT_EVERY_S, Consoles
from follow.operator.ground import DirectSide, GroundSide
from follow.operator.ground_camera import CAMERA, GroundCamera, StreamDescription
from follow.operator.told import PilotTexts
from follow.selection import AS_SET, Selection
from racf.box import Box
from racf.track import Track

SIZE = (640, 360)
COMMANDS = (2004, 2005, 2010, 512, 511, 521, 522, 525, 527, 2504, 2505, 2502, 2503, 176, 400, 0, 65535)
NUMBERS = (0.0, 0.25, 0.5, 0.75, 1.0, -0.0, -1.0, 1.0001, 2.0, 259.0, 269.0, 275.0, 1e6, 1e38, -1e38, 1e-45, math.nan,
           math.inf, -math.inf)  # fmt: skip
STATION = ("10.0.0.2", 14550)


class Air:
    """The direct side's datagrams, without a socket."""

    datagrams = True

    def __init__(self) -> None:
        self.waiting: list[tuple[bytes, tuple[str, int]]] = []
        self.sent: list[bytes] = []

    def read(self, _timeout_s: float):
        return self.waiting.pop(0) if self.waiting else (b"", None)

    def write(self, packet: bytes) -> bool:
        self.sent.append(packet)
        return True

    def answer_to(self, _source) -> None: ...

    def close(self) -> None: ...


class AtOnce:
    """Computes the box of a click in the same thread; GrabCut itself has its own tests."""

    def submit(self, look: Callable, *given):
        future: Future = Future()
        future.set_result(Box(300.0, 160.0, 30.0, 40.0) if given[0].is_point else look(*given))
        return future


class GroundTarget:
    """The ground station's side of a flight that tracks but is not flown; its images are coloured blocks."""

    def __init__(self) -> None:
        self.air, self.linked, self.lines = Air(), [], []
        self.t_s, self.chosen = 100.0, []
        blocks = np.random.default_rng(1).integers(0, 256, (SIZE[1] // 8, SIZE[0] // 8, 3), np.uint8)
        self.image = blocks.repeat(8, 0).repeat(8, 1)
        self.recent = SimpleNamespace(kept=())
        self.operator = Operator(self.lines.append)
        self.selector = Selector(self._init, self._track, self.recent, lambda: None, looks=AtOnce())
        self.consoles = Consoles(self.operator, self._select, self.lines.append)
        camera = GroundCamera(SIZE, self.consoles.choose, StreamDescription(), 0.1)
        camera.address(1)
        link = SimpleNamespace(write=self.linked.extend)
        texts = PilotTexts(SimpleNamespace(tell=lambda *_a: None, tell_value=lambda *_a: None))
        self.ground = GroundSide(link, camera, self.consoles, texts, DirectSide(self.air))
        self.packets, self.reader, self.other = Packets(255, 190), Packets(255, 190), Packets(255, 190)
        self.box = Box(0.0, 0.0, 1.0, 1.0)

    def _init(self, _image, box: Box) -> Track:
        self.box = box
        return Track(box, box, 20.0, 50.0, 0.9)

    def _track(self, _image, _prior) -> Track:
        return Track(self.box, self.box, 20.0, 50.0, 0.9)

    def _select(self, choice) -> str:
        self.chosen.append(choice)
        return self.selector.choose(choice)

    def round(self) -> None:
        """A round of the loop."""
        self.t_s += 0.05
        frame = Frame(self.image, self.t_s, round(self.t_s / 0.05))
        self.recent.kept = (*self.recent.kept[-20:], frame)
        track = self.selector.update(frame.image)
        seen = Estimate(self.t_s, 0.0, 0.4, 20.0, 0.5)
        tick = Tick(frame, track, VehicleState(self.t_s), seen, HOVER, Decision(None, Mode.READY))
        self.consoles.see(tick)
        self.ground.see(tick)

    def hear(self, data: bytes) -> None:
        """One input: as a datagram, and as the seed of a well-formed command, directly or through the autopilot."""
        dice = random.Random(data)
        command = self.command(dice)
        packet = self.packets.write(command)
        self.air.waiting.append((data, ("10.0.0.3", 1)))
        if dice.random() < 0.5:
            self.air.waiting.append((packet, STATION))
        else:
            (message,) = self.reader.read_datagram(packet)
            self.ground.hear(message, self.t_s)
        self.chosen.clear()
        self.round()
        also = [message.command for message in self.other.read_datagram(data) if is_for_us(message)]
        self.judge(command, 1 + also.count(command.command))
        if dice.random() < 0.02:
            self.drawn_properly()

    def command(self, dice: random.Random):
        """A command to our camera with any numbers."""

        def number() -> float:
            if dice.random() < 0.7:
                return dice.choice(NUMBERS)
            return struct.unpack("<f", dice.randbytes(4))[0]

        numbers = [number() for _ in range(7)]
        name = dice.choice(COMMANDS) if dice.random() < 0.9 else dice.randrange(65536)
        if dice.random() < 0.2:
            whole = dice.randrange(-(2**31), 2**31), dice.randrange(-(2**31), 2**31)
            return dialect.MAVLink_command_int_message(1, CAMERA, 0, name, 0, 0, *numbers[:4], *whole, numbers[6])
        return dialect.MAVLink_command_long_message(1, CAMERA, name, dice.randrange(256), *numbers)

    def judge(self, command, count: int) -> None:
        """The checks of the module's docstring; the command was sent `count` times."""
        sent = [message for packet in self.linked for message in self.reader.read_datagram(packet)]
        assert len(sent) == len(self.linked), "a packet that is not whole went out"
        acks = [m for m in sent if m.get_type() == "COMMAND_ACK" and m.command == command.command]
        assert len(acks) == count, f"{len(acks)} acknowledgements of {command}"
        for choice in self.chosen:
            if isinstance(choice, Selection):
                shares = choice.left, choice.top, choice.left + choice.width, choice.top + choice.height
                assert all(0.0 <= share <= 1.0 for share in shares), f"selected {choice}"
                assert math.isfinite(choice.frame_t_s)
        orders = [order for order, _by in self.operator.waiting]
        assert Order.FOLLOW not in orders, "a ground station ordered FOLLOW"
        assert self.consoles.wanted == AS_SET
        self.operator.waiting.clear()
        self.linked.clear()
        self.air.sent.clear()

    def drawn_properly(self) -> None:
        """A valid box is accepted, whatever was sent before."""
        for _ in range(math.ceil(SELECT_EVERY_S / 0.05) + 1):
            self.round()
        box = 0.3, 0.3, 0.3 + random.uniform(0.1, 0.2), 0.5
        drag = dialect.MAVLink_command_long_message(1, CAMERA, 2005, 0, *box, 0, 0, 0)
        self.air.waiting.append((self.packets.write(drag), STATION))
        self.chosen.clear()
        self.round()
        assert len(self.chosen) == 1, "a box that was drawn properly was not taken"
        self.linked.clear()


def is_for_us(message) -> bool:
    """Whether a message is a command to our camera."""
    is_command = message.get_type() in ("COMMAND_LONG", "COMMAND_INT")
    return is_command and (message.target_system, message.target_component) == (1, CAMERA)


def ground_target() -> tuple[list[bytes], Callable[[bytes], None]]:
    """Seeds, and the function that receives the inputs."""
    target = GroundTarget()
    station = Packets(255, 190)
    drag = dialect.MAVLink_command_long_message(1, CAMERA, 2005, 0, 0.25, 0.5, 0.375, 0.75, 0, 0, 0)
    beat = dialect.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3)
    return [station.write(drag), station.write(beat), bytes(range(40))], target.hear
