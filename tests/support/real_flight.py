"""What it takes to fly `follow run` as a process: the autopilot's process, a pilot on a second link, a relay between.

The relay keeps every packet that passes with its time, so that what was sent is judged by what was on the wire, and it
may spoil or withhold what passes.
"""

import contextlib
import os
import random
import re
import select
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path

from pymavlink.dialects.v20 import common as dialect

from follow.messages import Autopilot
from tests.support.fit import fixes
from tests.support.machine import LateError

CONTROL = {"px4": "OFFBOARD", "ardupilot": "GUIDED"}
HOLD = {"px4": "HOLD", "ardupilot": "BRAKE"}
NUMBERS = {  # parameters 2 and 3 of DO_SET_MODE
    "px4": {"HOLD": (4, 3), "OFFBOARD": (6, 0), "POSCTL": (3, 0), "LAND": (4, 6)},
    "ardupilot": {"GUIDED": (4, 0), "LOITER": (5, 0), "BRAKE": (17, 0), "LAND": (9, 0)},
}
PILOTS_CHOICE = {"px4": "HOLD", "ardupilot": "LOITER"}
FIT = {  # the parameters that `follow doctor` asks for
    autopilot.value: tuple(f"{name}={value}" for name, value in fixes(autopilot).items()) for autopilot in Autopilot
}
READY_S = 120.0  # a loaded machine compiles the tracker's kernels that long
PORTS = range(12000, 32000)  # below those that systems hand out: no other socket gets one between the probe and its use
TURN_S = 0.02


def is_free(port: int) -> bool:
    """Whether a port can be had on this machine, for datagrams and for connections."""
    for kind in (socket.SOCK_DGRAM, socket.SOCK_STREAM):
        with socket.socket(socket.AF_INET, kind) as probe:
            try:
                probe.bind(("127.0.0.1", port))
            except OSError:
                return False
    return True


def free_ports(count: int) -> list[int]:
    """As many ports as asked for, none of them twice; drawn afresh, as other tests run beside this one."""
    drawn = random.SystemRandom().sample(PORTS, len(PORTS))
    return list(islice(filter(is_free, drawn), count))


def until(what: str, done: Callable[[], bool], seconds: float = 20.0) -> None:
    """Wait for something that happens in another process; a machine that was stopped meanwhile has not waited."""
    for _turn in range(round(seconds / TURN_S)):
        if done():
            return
        time.sleep(TURN_S)
    raise LateError(f"not {what} within {seconds} s")


@dataclass
class Packet:
    t_s: float
    message: dialect.MAVLink_message


class Relay:
    """Passes datagrams between the application (at `port`, which it binds first) and the autopilot, and keeps them.

    `to_autopilot` and `to_application` turn one datagram into those that are passed on, at once.
    """

    def __init__(self, application_port: int) -> None:
        self.to_autopilot: Callable[[bytes], list[bytes]] = lambda data: [data]
        self.to_application: Callable[[bytes], list[bytes]] = lambda data: [data]
        self.sent: list[Packet] = []  # by the application
        self._mav = dialect.MAVLink(None)
        self._mav.robust_parsing = True
        self._application = ("127.0.0.1", application_port)
        self._near = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._far = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._far.bind(("127.0.0.1", 0))
        self._near.bind(("127.0.0.1", 0))
        self._autopilot: tuple[str, int] | None = None
        self.port: int = self._far.getsockname()[1]
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)

    def __enter__(self) -> "Relay":
        self._thread.start()
        return self

    def __exit__(self, *_error: object) -> None:
        self._ending.set()
        self._thread.join()
        self._near.close()
        self._far.close()

    def setpoints(self) -> list[Packet]:
        return [p for p in list(self.sent) if p.message.get_type() == "SET_POSITION_TARGET_LOCAL_NED"]

    def modes_asked(self) -> list[Packet]:
        set_mode = dialect.MAV_CMD_DO_SET_MODE
        long = [p for p in list(self.sent) if p.message.get_type() == "COMMAND_LONG"]
        return [p for p in long if p.message.command == set_mode]

    def inject(self, data: bytes) -> None:
        """Send something to the application as if the autopilot's address had."""
        self._near.sendto(data, self._application)

    def _run(self) -> None:
        while not self._ending.is_set():
            for ready in select.select([self._near, self._far], [], [], 0.05)[0]:
                with contextlib.suppress(ConnectionError):
                    if ready is self._far:
                        data, self._autopilot = self._far.recvfrom(65536)
                        for packet in self.to_application(data):
                            self._near.sendto(packet, self._application)
                    else:
                        data = self._near.recv(65536)
                        now = time.monotonic()
                        self.sent += [Packet(now, m) for m in self._mav.parse_buffer(data) or ()]
                        if self._autopilot is not None:
                            for packet in self.to_autopilot(data):
                                self._far.sendto(packet, self._autopilot)


class Pilot:
    """A person with a ground station on the autopilot's second link.  A thread listens, so that nothing grows old."""

    def __init__(self, rules: str, port: int) -> None:
        from pymavlink import mavutil  # noqa: PLC0415 (it reads the environment when it is imported)

        self.rules = rules
        self.hears: Callable[[bytes], object] = lambda _packet: None
        self.known: dict[str, tuple[int, dialect.MAVLink_message]] = {}  # the autopilot's messages: how many, the last
        self.link = mavutil.mavlink_connection(f"udpout:127.0.0.1:{port}", source_system=255)
        self._ending = threading.Event()
        self._listener = threading.Thread(target=self._listen, daemon=True)

    def close(self) -> None:
        self._ending.set()
        self._listener.join()
        self.link.close()

    def _listen(self) -> None:
        while not self._ending.is_set():
            message = self.link.recv_match(blocking=True, timeout=0.1)
            if message is not None:
                self.hears(bytes(message.get_msgbuf()))
            if message is not None and message.get_srcComponent() == 1:
                kind = message.get_type()
                self.known[kind] = self.known.get(kind, (0, message))[0] + 1, message

    def meet(self) -> None:
        """Speak first until the autopilot answers, and ask for its position ten times a second."""
        self.link.mav.heartbeat_send(6, 8, 0, 0, 4)
        self._listener.start()

        def answered() -> bool:
            self.link.mav.heartbeat_send(6, 8, 0, 0, 4)
            return "HEARTBEAT" in self.known

        until("heard", answered, 30.0)
        for number in (32, 245):  # LOCAL_POSITION_NED, EXTENDED_SYS_STATE
            self.command(511, number, 1e5)

    def command(self, number: int, *params: float) -> None:
        self.link.mav.command_long_send(1, 1, number, 0, *params, *(0,) * (7 - len(params)))

    def mode(self, name: str) -> None:
        self.command(176, 1, *NUMBERS[self.rules][name])

    def take_off(self, height_m: float) -> None:
        """Arm, climb, and hover in HOLD or LOITER."""
        if self.rules == "ardupilot":
            self.mode("GUIDED")
            until("in GUIDED", lambda: self.heard("HEARTBEAT").custom_mode == 4)
        self.command(400, 1)
        until("armed", lambda: bool(self.heard("HEARTBEAT").base_mode & 128))
        self.command(22, 0, 0, 0, 0, 0, 0, height_m if self.rules == "ardupilot" else 488.0 + height_m)
        until("up", lambda: -self.heard("LOCAL_POSITION_NED").z > height_m - 0.6, 30.0)
        if self.rules == "ardupilot":
            self.mode("LOITER")

    def heard(self, kind: str):
        """The autopilot's next message of a kind."""
        count = self.known.get(kind, (0, None))[0]
        until(f"a {kind} came", lambda: self.known.get(kind, (0, None))[0] > count, 5.0)
        return self.known[kind][1]

    def flown_mode(self) -> str:
        """The name of the autopilot's own mode; `sim.autopilot` tells it at 1 Hz."""
        number = self.known["HEARTBEAT"][1].custom_mode
        numbers = (number >> 16 & 0xFF, number >> 24 & 0xFF) if self.rules == "px4" else (number, 0)
        return next((name for name, known in NUMBERS[self.rules].items() if known == numbers), str(number))


@dataclass
class Program:
    """`follow run` as a process; `lines` grows with what it says."""

    process: subprocess.Popen
    lines: list[str] = field(default_factory=list)
    deaf: threading.Event = field(default_factory=threading.Event)
    asleep: threading.Event = field(default_factory=threading.Event)  # nobody reads, and the pipe stays open
    all_read: threading.Event = field(default_factory=threading.Event)  # `lines` grows no more

    def said(self, pattern: str) -> bool:
        """Whether a line like this was said; of a program that has ended, the last line counts too."""
        if self.process.poll() is not None:
            self.all_read.wait(5.0)
        return any(re.search(pattern, line) for line in list(self.lines))

    def wait_until_said(self, pattern: str, seconds: float = 20.0) -> None:
        def done() -> bool:
            ended = self.process.poll() is not None
            said = self.said(pattern)
            assert said or not ended, f"it ended: {self.lines}"
            return said

        until(f"said {pattern!r}", done, seconds)

    def end(self, number: int = signal.SIGINT, seconds: float = 30.0) -> int:
        """Send a signal and wait for the end; the exit status."""
        self.process.send_signal(number)
        return self.process.wait(seconds)

    def listen(self) -> None:
        """Keep what it says until it ends or nobody is to listen any more."""
        try:
            self._listen()
        finally:
            self.all_read.set()

    def _listen(self) -> None:
        assert self.process.stderr is not None
        file = self.process.stderr.fileno()
        rest = b""
        while not self.deaf.is_set():
            if self.asleep.is_set():
                self.deaf.wait(0.05)
            elif select.select([file], [], [], 0.05)[0]:
                data = os.read(file, 65536)
                if not data:
                    return
                *lines, rest = (rest + data).split(b"\n")
                self.lines += [line.decode(errors="replace").rstrip() for line in lines]
        self.process.stderr.close()

    def block(self) -> None:
        """Read no more, and fill the pipe, as a terminal that was stopped by Ctrl-S: its next line must wait."""
        self.asleep.set()
        time.sleep(0.2)  # the reader's last turn
        file = os.open(f"/proc/{self.process.pid}/fd/2", os.O_WRONLY | os.O_NONBLOCK)
        with contextlib.suppress(BlockingIOError):
            while True:
                os.write(file, b" " * 512)
        os.close(file)

    def stop_listening(self) -> None:
        """Close our end of the pipe: what it says now meets nobody."""
        self.deaf.set()
        assert self.process.stderr is not None
        until("closed", lambda: self.process.stderr is not None and self.process.stderr.closed)


@contextlib.contextmanager
def program(call: list[str], **options) -> Iterator[Program]:
    """A program of ours on one thread's worth of processor, ended at the end whatever happens.

    What is late while it runs tells what it said, and whether it still ran.
    """
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "COLUMNS": "200", **options.pop("env", {})}
    process = subprocess.Popen(
        call, stdin=subprocess.DEVNULL, stderr=subprocess.PIPE, bufsize=0, env=environment, **options
    )
    running = Program(process)
    listener = threading.Thread(target=running.listen, daemon=True)
    listener.start()
    try:
        yield running
    except LateError as error:
        ended = process.poll()
        state = "runs" if ended is None else f"ended with {ended}"
        raise LateError(f"{error}; {' '.join(call[1:4])} {state} and said {running.lines[-20:]}") from error
    finally:
        running.asleep.clear()
        if process.poll() is None:
            process.send_signal(signal.SIGCONT)
            process.kill()
        process.wait(10.0)
        listener.join(10.0)
        for pipe in (process.stderr, process.stdout):
            if pipe is not None:
                pipe.close()


@dataclass
class Real:
    """Everything that flies."""

    rules: str
    out: Path
    relay: Relay
    pilot: Pilot
    application: Program
    autopilot: Program

    def order(self) -> None:
        """Order FOLLOW by SIGUSR1, once, and wait until it flies."""
        self.application.process.send_signal(signal.SIGUSR1)
        self.application.wait_until_said(r": follow", 8.0)  # the gate gives up after 5 s (Limits.engage_timeout_s)


@contextlib.contextmanager
def real_flight(
    rules: str,
    out: Path,
    *,
    mavsdk: bool = False,
    height_m: float = 6.0,
    options=(),
    settings=(),
    begins: str = "ready",
    **process,
):
    """`follow run` on the scene's walker beside a hovering autopilot, in OBSERVE or READY; yields a Real.

    The pilot takes the vehicle off when it does not start in the air.
    """
    application_port, pilot_port = free_ports(2)
    with contextlib.ExitStack() as stack:
        relay = stack.enter_context(Relay(application_port))
        ways = ["--link", f"udpout:127.0.0.1:{relay.port}", "--gcs", f"udpin:127.0.0.1:{pilot_port}"]
        vehicle = [sys.executable, "-m", "sim.autopilot", "--autopilot", rules, *ways]
        vehicle += [word for setting in (*FIT[rules], *settings) for word in ("--set", setting)]
        autopilot = stack.enter_context(program(vehicle))
        pilot = Pilot(rules, pilot_port)
        stack.callback(pilot.close)
        pilot.meet()
        pilot.take_off(height_m)
        address = f"127.0.0.1:{application_port}"
        link = f"mavsdk+udpin://{address}" if mavsdk else f"udpin:{address}"
        call = [sys.executable, "-m", "follow.cli", "run", "--link", link, "--camera", "scene:walker"]
        call += ["--out", str(out), *options]
        application = stack.enter_context(program(call, **process))
        application.wait_until_said(begins, READY_S)
        yield Real(rules, out, relay, pilot, application, autopilot)
