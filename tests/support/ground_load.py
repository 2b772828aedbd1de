"""Ground stations beside a flight whose setpoints are timed: one gets the state and the video, another one clicks."""

import contextlib
import socket
import threading
import time

from pymavlink.dialects.v20 import common as dialect

from tests.support.ground_station import NEW
from tests.support.ground_wire import Scripted
from tests.support.real_flight import free_ports

REDRAWN_S = 5.0  # the station that commands draws its box again this often, or the clicks would get the command
COMMANDS_S = 1.0  # from its first box to the first click of the other one: who selects first commands


class GroundLoad:
    """A ground station that commands and gets the video; `clicks_hz` come from another one."""

    def __init__(self, clicks_hz: float) -> None:
        self.ground_port, self.video_port = free_ports(2)
        self.clicks_hz = clicks_hz
        self.received = self.clicked = self.boxes = 0
        self.ending, self.drawn = threading.Event(), threading.Event()

    @property
    def options(self) -> list[str]:
        """For `follow run`."""
        ground = ["--ground", f"udpin:127.0.0.1:{self.ground_port}"]
        return [*ground, "--video-out", f"rtp://127.0.0.1:{self.video_port}"]

    @contextlib.contextmanager
    def beside(self, pilot):
        """Watch and click until the end."""
        with contextlib.ExitStack() as stack:
            station = stack.enter_context(Scripted(NEW, self.ground_port, pilot))
            for run in (self._receive, self._click, lambda: self._redraw(station)):
                thread = threading.Thread(target=run, daemon=True)
                thread.start()
                stack.callback(thread.join)
            stack.callback(self.drawn.set)
            stack.callback(self.ending.set)
            yield

    def _receive(self) -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as ear:
            ear.bind(("127.0.0.1", self.video_port))
            ear.settimeout(0.2)
            while not self.ending.is_set():
                with contextlib.suppress(TimeoutError):
                    self.received += len(ear.recv(2048))

    def _click(self) -> None:
        mav = dialect.MAVLink(None, srcSystem=42, srcComponent=190)
        self.drawn.wait()
        if self.ending.wait(COMMANDS_S):
            return
        began = time.monotonic()
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as mouth:
            while self.clicks_hz and not self.ending.wait(0.01):
                while self.clicked < self.clicks_hz * (time.monotonic() - began):
                    place = 0.2 + 0.0006 * (self.clicked % 1000), 0.5, 0.03
                    click = dialect.MAVLink_command_long_message(1, 100, 2004, 0, *place, 0, 0, 0, 0)
                    mouth.sendto(click.pack(mav), ("127.0.0.1", self.ground_port))
                    self.clicked += 1

    def _redraw(self, station) -> None:
        while not self.ending.wait(REDRAWN_S if self.drawn.is_set() else 0.1):
            self.boxes = station.boxes
            if station.station.boxes:
                station.station.drag(time.monotonic(), *station.station.boxes[-1])
                self.drawn.set()
