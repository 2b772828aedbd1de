"""The operator's page on a free port, with the loop's side driven by hand, and windows that speak its protocol."""

import json
import struct
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from websockets.sync.client import connect

from follow.messages import HOVER, STARTED, Decision, Estimate, Frame, Instruction, Mode, Tick, VehicleState
from follow.operator.authority import Operator
from follow.operator.consoles import Consoles
from follow.operator.page.desk import PageDesk
from follow.operator.page.door import PageAddress
from follow.operator.page.exchange import Exchange
from follow.operator.page.server import PageServer
from follow.selection import Selection
from racf.box import Box
from racf.track import Track

BOX = Box(320, 180, 16, 36)
ROUND_S = 0.05
ROUNDS = 400


class PageRig:
    """A page; `round` is one round of the loop."""

    def __init__(self, out: Path, token: str = "", host: str = "127.0.0.1", suffix: str = "") -> None:
        self.lines, self.chosen, self.refusal = [], [], ""
        self.mode, self.n, self.has_target = Mode.READY, 0, False
        self.found, self.reason, self.heeds = None, STARTED, None
        self.operator = Operator(self.lines.append)
        self.consoles = Consoles(self.operator, self.select, self.report)
        self.exchange = Exchange()
        self.server = PageServer(PageAddress(host, 0), token, self.exchange, out, self.report)
        self.desk = PageDesk(self.consoles, self.exchange, "now", suffix)
        self.token, self.port = token, self.server.address.port
        self.host = f"127.0.0.1:{self.port}"

    def report(self, line: str) -> None:
        self.lines.append(line)
        self.exchange.say(line)

    def select(self, choice) -> str:
        self.chosen.append(choice)
        self.has_target = isinstance(choice, Selection) and not self.refusal
        return self.refusal

    def round(self) -> None:
        self.n += 1
        t_s = 100.0 + ROUND_S * self.n
        image = np.full((360, 640, 3), self.n % 256, np.uint8)
        track = Track(BOX, BOX, 30.0, 100.0, 0.9) if self.has_target else None
        seen = Estimate(t_s, 0.0, 0.4, 20.0, 0.5, seen_t_s=t_s)
        state = VehicleState(t_s, heartbeat_t_s=t_s)
        decision = Decision(None, self.mode, (), self.reason)
        heeded = Instruction(self.heeds)
        tick = Tick(
            Frame(image, t_s, self.n), track, state, seen, HOVER, decision, instruction=heeded, found=self.found
        )
        self.consoles.see(tick)
        self.desk.see(tick)

    def ordered(self):
        waiting, self.operator.waiting[:] = list(self.operator.waiting), []
        return [order for order, _by in waiting]

    @contextmanager
    def window(self, key="0123456789abcdef", **options):
        headers = {"Cookie": f"follow_{self.port}={options.pop('cookie')}"} if "cookie" in options else None
        options = {"origin": f"http://{self.host}", "additional_headers": headers, **options}
        with connect(f"ws://{self.host}/window", compression=None, **options) as socket:
            socket.send(key)
            yield Window(self, socket)

    def __enter__(self) -> "PageRig":
        return self

    def __exit__(self, *_error: object) -> None:
        self.desk.close()
        self.server.close()


@dataclass
class Window:
    """A browser's window as the server sees it.  `acks` says whether it shows its images."""

    rig: PageRig
    socket: object
    acks: bool = True
    name: str = ""
    status: dict = field(default_factory=dict)
    lines: list = field(default_factory=list)
    replies: list = field(default_factory=list)
    images: list = field(default_factory=list)

    def send(self, **message) -> None:
        self.socket.send(json.dumps(message))

    def order(self, order: str) -> None:
        self.send(do="order", order=order)

    def take(self, timeout_s: float = 0.0) -> bool:
        """Read one message; False if none came."""
        try:
            message = self.socket.recv(timeout_s)
        except TimeoutError:
            return False
        if isinstance(message, bytes):
            (length,) = struct.unpack(">H", message[:2])
            header = json.loads(message[2 : 2 + length])
            self.images.append((header, message[2 + length :]))
            if self.acks:
                self.send(do="shown", frame=header["frame"])
        else:
            read = json.loads(message)
            if "own" in read:
                self.status, self.name = read["status"], read["own"]["you"]
                self.lines += read["own"]["lines"]
                self.replies += read["own"]["replies"]
        return True

    def until(self, is_so, others=()) -> None:
        """Let the loop go on until something is so in this window."""
        for _ in range(ROUNDS):
            if is_so(self):
                return
            self.rig.round()
            for window in (self, *others):
                while window.take(0.01):
                    pass
        raise AssertionError(f"not within {ROUNDS} rounds: {self.status}, {self.replies}, {self.lines}")

    def replied(self) -> list:
        """The next reply."""
        before = len(self.replies)
        self.until(lambda window: len(window.replies) > before)
        return self.replies[before]
