"""`python -m sim.autopilot`: the simulated vehicle as a PX4 or ArduCopter on UDP.

    python -m sim.autopilot --rules px4 --connect udpout:127.0.0.1:14540 --gcs udpout:127.0.0.1:14550

The application listens at the first address, a ground station at the second.  The time is the machine's, or
`--speedup` times as fast.
"""

import contextlib
import math
import select
import socket
import sys
import time
from collections.abc import Callable, Generator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from follow.link.signing import EPOCH_S, UNITS_PER_S, read_key
from follow.messages import Autopilot
from sim.autopilot.system import AutopilotSystem
from sim.dynamics import Vehicle, VehicleTruth, Wind

LAST_PORT = 65535
STEP_S = 0.005  # twice as often as the fastest telemetry that is asked for in practice


@dataclass(frozen=True, slots=True)
class Options:
    """A simulated autopilot over UDP."""

    rules: Literal["px4", "ardupilot"] = "px4"
    """Whose rules it follows."""
    connect: str = "udpout:127.0.0.1:14540"
    """Where the application listens (udpout:HOST:PORT), or where to wait for it (udpin:HOST:PORT)."""
    gcs: str = ""
    """The same for a ground station; empty for none."""
    height_m: float = 0.0
    """Start hovering this high; 0 on the ground."""
    heading_deg: float = 0.0
    """Start looking this way, clockwise from north."""
    wind_m_s: float = 0.0
    """Steady wind toward the east."""
    seed: int = 0
    """Of the gusts and of the wandering of a vehicle that should stand still."""
    speedup: float = 1.0
    """Simulated seconds in one of the machine's."""
    seconds: float = 0.0
    """End after this many simulated seconds; 0 never."""
    signing_key: Path | None = None
    """A file with 32 bytes, raw or hexadecimal, its owner's alone: sign packets and accept only signed ones."""
    set: Annotated[tuple[str, ...], tyro.conf.UseAppendAction] = ()
    """NAME=VALUE of a parameter, repeatable."""


class UdpPort:
    """One UDP way: `udpout:` speaks first to an address, `udpin:` waits at one and answers whoever spoke last.

    Raises ValueError for a `uri` that is none, OSError for an address that cannot be had.
    """

    def __init__(self, uri: str):
        kind, _, address = uri.partition(":")
        host, _, port = address.rpartition(":")
        if kind not in ("udpout", "udpin") or not port.isdecimal() or int(port) > LAST_PORT:
            raise ValueError(f"must be udpout:HOST:PORT or udpin:HOST:PORT with a port up to {LAST_PORT}, not {uri!r}")
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.setblocking(False)
        self._peer: tuple[str, int] | None = None
        try:
            if kind == "udpin":
                self.socket.bind((host, int(port)))
            else:
                self._peer = (socket.gethostbyname(host), int(port))
                self.socket.bind(("", 0))
        except OSError:
            self.close()
            raise

    def receive(self) -> list[bytes]:
        """Every datagram that waits."""
        datagrams = []
        with contextlib.suppress(BlockingIOError):
            while True:
                data, self._peer = self.socket.recvfrom(65536)
                datagrams.append(data)
        return datagrams

    def send(self, packet: bytes) -> None:
        """Send one packet; nobody listening is not an error."""
        if self._peer is not None:
            with contextlib.suppress(BlockingIOError, ConnectionRefusedError):
                self.socket.sendto(packet, self._peer)

    def close(self) -> None:
        """Give the port back."""
        self.socket.close()


def check(options: Options) -> None:
    """Raises ValueError for the first number that is out of its range."""
    from_0 = {
        "--height-m": options.height_m,
        "--wind-m-s": options.wind_m_s,
        "--seed": options.seed,
        "--seconds": options.seconds,
    }
    for option, value in from_0.items():
        if not 0.0 <= value < math.inf:
            raise ValueError(f"{option} must be a finite number of at least 0, not {value:g}")
    if not 0.0 < options.speedup < math.inf:
        raise ValueError(f"--speedup must be a finite number above 0, not {options.speedup:g}")
    if not math.isfinite(options.heading_deg):
        raise ValueError(f"--heading-deg must be a finite number, not {options.heading_deg:g}")


def finite(text: str) -> float:
    """The number that `text` is; raises ValueError when it is none or not finite."""
    value = float(text)
    if not math.isfinite(value):
        raise ValueError(f"{text} is not finite")
    return value


def set_parameter(known: dict[str, float | int], setting: str) -> None:
    """Obey one NAME=VALUE; raises ValueError for a name that is not in `known` or a value that is no finite number."""
    name, _, text = setting.partition("=")
    if name not in known:
        raise ValueError(f"--set must name a parameter of these rules, not {name!r}")
    try:
        known[name] = type(known[name])(finite(text))
    except ValueError as error:
        raise ValueError(f"--set must be NAME=VALUE with a finite number, not {setting!r}") from error


@contextlib.contextmanager
def open_port(option: str, uri: str) -> Generator[UdpPort, None, None]:
    """The port that an option asks for, given back at the end; raises ValueError when it cannot be had."""
    try:
        port = UdpPort(uri)
    except ValueError as error:
        raise ValueError(f"{option} {error}") from error
    except OSError as error:
        raise ValueError(f"{option} must be an address that can be had, not {uri!r}: {error}") from error
    with contextlib.closing(port):
        yield port


def build(options: Options) -> AutopilotSystem:
    """The system that the options describe; raises ValueError for options that break a rule, OSError without a key."""
    check(options)
    start = VehicleTruth(down_m=-options.height_m, yaw_rad=math.radians(options.heading_deg))
    wind = Wind(options.wind_m_s, toward_rad=math.pi / 2)
    vehicle = Vehicle(Autopilot(options.rules), start, wind, options.seed)
    key = read_key(options.signing_key) if options.signing_key else None
    links = 2 if options.gcs else 1
    signing_time = round((time.time() - EPOCH_S) * UNITS_PER_S)
    system = AutopilotSystem(Autopilot(options.rules), vehicle, links, key=key, signing_time=signing_time)
    for setting in options.set:
        set_parameter(system.flight.parameters, setting)
    return system


def run(system: AutopilotSystem, ports: list[UdpPort], is_over: Callable[[], bool], speedup: float = 1.0) -> None:
    """Serve the ports until `is_over` says so."""
    began = time.monotonic()
    while not is_over():
        ready, _, _ = select.select([port.socket for port in ports], [], [], STEP_S)
        system.step((time.monotonic() - began) * speedup)
        for link, port in enumerate(ports):
            if port.socket in ready:
                for data in port.receive():
                    system.receive(data, link)
        for link, port in enumerate(ports):
            for packet in system.take(link):
                port.send(packet)


def main() -> None:
    """Run until interrupted; bad options are one sentence and exit status 2."""
    options = tyro.cli(Options, description=__doc__)
    addresses = {"--connect": options.connect} | ({"--gcs": options.gcs} if options.gcs else {})
    with contextlib.ExitStack() as stack:
        try:
            system = build(options)
            ports = [stack.enter_context(open_port(option, uri)) for option, uri in addresses.items()]
        except (ValueError, OSError) as error:
            sys.stderr.write(f"sim.autopilot: {error}\n")
            sys.exit(2)
        with contextlib.suppress(KeyboardInterrupt):
            run(system, ports, lambda: 0.0 < options.seconds <= system.t_s, options.speedup)
