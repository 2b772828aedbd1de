"""Simulate a PX4 or ArduCopter with its vehicle, as a MAVLink system on UDP.

    python -m sim.autopilot --autopilot px4 --link udpout:127.0.0.1:14540 --gcs udpout:127.0.0.1:14550

The application listens at the first address, a ground station at the second.  Mode changes and the autopilot's messages
are printed on standard error; in a terminal, keys are the pilot's (h lists them).
"""

import contextlib
import math
import select
import socket
import sys
import time
from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Annotated, cast

import tyro

from follow.link.signing import EPOCH_S, UNITS_PER_S, read_key
from follow.messages import Autopilot, Notify
from racf.commandline import parse
from sim.autopilot.keys import Console, Pilot
from sim.autopilot.system import AutopilotSystem
from sim.dynamics import Vehicle, VehicleTruth, Wind
from sim.waving import WavedVehicle

LAST_PORT = 65535
STEP_S = 0.005  # twice as often as the fastest telemetry in practice


@dataclass(frozen=True, slots=True)
class Options:
    """The options of `python -m sim.autopilot`."""

    autopilot: Autopilot = Autopilot.PX4
    """The autopilot whose rules the vehicle obeys."""
    firmware: str = ""
    """Firmware whose parameters it has: PX4 1.14, 1.16 or 1.18; ArduCopter 4.5 or 4.7. Empty: 1.16 or 4.7."""
    remote: bool = True
    """A remote control is on, with its sticks at rest."""
    link: str = "udpout:127.0.0.1:14540"
    """Address of the application: udpout:HOST:PORT sends to it first, udpin:HOST:PORT waits for its first packet."""
    gcs: str = ""
    """Address of a ground station, written as for --link. Empty: no ground station."""
    height_m: float = 0.0
    """Height at the start, m. Above 0 the vehicle is armed and hovers there; at 0 it stands on the ground, disarmed."""
    heading_deg: float = 0.0
    """Heading at the start, degrees clockwise from north."""
    wave: bool = False
    """It is not flown: somebody turns it in their hands, disarmed, as for `follow doctor --wave`."""
    wind_m_s: float = 0.0
    """Steady wind toward the east, m/s."""
    seed: int = 0
    """Seed of the gusts and of the drift in hover."""
    speedup: float = 1.0
    """Simulated seconds in each second of the machine."""
    seconds: float = 0.0
    """End after this many simulated seconds. 0: run until Ctrl-C."""
    signing_key: Path | None = None
    """File of the MAVLink 2 signing key, 32 bytes or 64 hexadecimal digits, readable by its owner only. Packets are
    then signed, and unsigned ones ignored."""
    set: Annotated[tuple[str, ...], tyro.conf.UseAppendAction] = ()
    """Value of an autopilot parameter at the start, as NAME=VALUE. Repeat it for several."""


class UdpPort:
    """One UDP path: `udpout:` sends first to an address, `udpin:` waits at one and answers the latest sender.

    Raises ValueError for an invalid `uri`, OSError for an address that cannot be bound.
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
        """Release the port."""
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
    if options.wave and options.height_m > 0.0:
        raise ValueError("--wave is a vehicle in the hands: without --height-m")
    if not math.isfinite(options.heading_deg):
        raise ValueError(f"--heading-deg must be a finite number, not {options.heading_deg:g}")


def finite(text: str) -> float:
    """The number that `text` spells; raises ValueError for anything else and for a number that is not finite."""
    value = float(text)
    if not math.isfinite(value):
        raise ValueError(f"{text} is not finite")
    return value


def set_parameter(known: dict[str, float | int], setting: str) -> None:
    """Set one NAME=VALUE; raises ValueError for a name that is not in `known` or a value that is not finite."""
    name, _, text = setting.partition("=")
    if name not in known:
        raise ValueError(f"--set must name a parameter that this autopilot has, not {name!r}")
    try:
        known[name] = type(known[name])(finite(text))
    except ValueError as error:
        raise ValueError(f"--set must be NAME=VALUE with a finite number, not {setting!r}") from error


@contextlib.contextmanager
def open_port(option: str, uri: str) -> Generator[UdpPort, None, None]:
    """The port of an option, released at the end; raises ValueError when it cannot be opened."""
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
    if options.wave:
        vehicle: Vehicle = WavedVehicle(options.autopilot, start)
    else:
        vehicle = Vehicle(options.autopilot, start, wind, options.seed)
    key = read_key(options.signing_key) if options.signing_key else None
    links = 2 if options.gcs else 1
    signing_time = round((time.time() - EPOCH_S) * UNITS_PER_S)
    system = AutopilotSystem(
        options.autopilot, vehicle, links, key=key, signing_time=signing_time, firmware=options.firmware
    )
    if options.remote:
        system.flight.resting_sticks = system.flight.sticks = (0.0, 0.0, 0.0, 0.0)
    for setting in options.set:
        set_parameter(system.flight.parameters, setting)
    return system


def run(
    system: AutopilotSystem,
    ports: list[UdpPort],
    is_over: Callable[[], bool],
    speedup: float = 1.0,
    report: Notify = lambda _line: None,
) -> None:
    """Serve the ports until `is_over()`; `report` gets mode changes, commands and texts."""
    began = time.monotonic()
    mode = system.flight.mode
    while not is_over():
        ready, _, _ = select.select([port.socket for port in ports], [], [], STEP_S)
        system.step((time.monotonic() - began) * speedup)
        lines = list(system.told)
        if system.flight.mode != mode:
            lines.append(f"mode {mode} -> {system.flight.mode}")
            mode = system.flight.mode
        for text in lines:
            report(f"{system.t_s:.1f} s: {text}")
        for link, port in enumerate(ports):
            if port.socket in ready:
                for data in port.receive():
                    system.receive(data, link)
        for link, port in enumerate(ports):
            for packet in system.take(link):
                port.send(packet)


def read(words: Sequence[str]) -> Options:
    """The options of a command line; raises SystemExit for help, ValueError for unknown words."""
    for option, value in pairwise(words):
        if option == "--set" and "=" not in value:
            raise ValueError(f"--set must be NAME=VALUE with a finite number, not {value!r}")
    markers = (tyro.conf.EnumChoicesFromValues,)
    return cast(
        Options, parse(Options, words, prog="python -m sim.autopilot", description=__doc__ or "", config=markers)
    )


def report(line: str) -> None:
    """Print one line for the user."""
    sys.stderr.write(f"sim.autopilot: {line}\n")


def main() -> None:
    """Run until interrupted; a wrong option is reported in one sentence with exit status 2."""
    try:
        options = read(sys.argv[1:])
    except ValueError as error:
        report(str(error))
        sys.exit(2)
    addresses = {"--link": options.link} | ({"--gcs": options.gcs} if options.gcs else {})
    with contextlib.ExitStack() as stack:
        try:
            system = build(options)
            ports = [stack.enter_context(open_port(option, uri)) for option, uri in addresses.items()]
        except (ValueError, OSError) as error:
            report(str(error))
            sys.exit(2)
        with contextlib.suppress(KeyboardInterrupt), Console() as console:
            pilot = Pilot(system.flight, console.report)

            def is_over() -> bool:
                console.serve(pilot)
                return pilot.leaves or 0.0 < options.seconds <= system.t_s

            remote = "on" if options.remote else "off"
            console.report(
                f"{options.autopilot.value} {system.firmware} in {system.flight.mode} at {options.height_m:g} m, "
                f"remote control {remote}; {', '.join(f'{name} {uri}' for name, uri in addresses.items())}"
            )
            if console.keyboard is not None:
                console.report(pilot.help())
            run(system, ports, is_over, options.speedup, console.report)
