"""What can be typed after `follow`: each command and its options, as the help shows them."""

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Union

import tyro

from follow.config import Config, TargetKind
from follow.messages import Autopilot
from racf.box import Box
from racf.commandline import UsageError

Settings = Annotated[Config, tyro.conf.arg(name="")]

ForWhom = Annotated[TargetKind | None, tyro.conf.arg(name="for")]

TRACKER = "racf,robust"
MARKERS = (tyro.conf.EnumChoicesFromValues,)  # px4, not PX4, is what is typed


def require_system_id(system_id: int | None) -> None:
    """Raise ValueError for what is no MAVLink system id."""
    if system_id is not None and not 1 <= system_id <= 255:
        raise ValueError(f"--system-id lies in 1..255, not {system_id}")


@dataclass(frozen=True, slots=True)
class ReplayCommand:
    """A video file or a folder of images through tracker, servo, gate and a link that only pretends to fly."""

    source: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="SOURCE")]
    """Video file or folder of images."""
    target: str | None = None
    """What to follow: x,y,w,h in 0-based pixels of the first picture."""
    truth: Path | None = None
    """A benchmark's boxes, x,y,w,h in 1-based pixels: the first row starts the tracker, which is then scored."""
    ptz: bool = False
    """Let yaw rate and climb move a window over the footage, so that bad control loses the target."""
    fps: float | None = None
    """Pictures per second; a video says it itself, a folder is taken to have 30."""
    tracker: str = TRACKER
    """Tracker by name, with settings: racf, racf-, racf--, bacf, arcf-hc; e.g. racf-,robust."""
    autopilot: Autopilot = Autopilot.PX4
    """Whose rules the pretended vehicle obeys."""
    out: Path = Path("out/replay")
    """Folder of flight.rrd, ticks.csv, settings.toml and summary.json."""
    json: bool = False
    """Print the summary as JSON on standard output."""
    for_: ForWhom = None
    """Size, stand-off and speed limit of this kind of target together. A settings file or an option overrides each."""
    settings: Path | None = None
    """TOML file of the settings below; what is given here stands above it (docs/service/settings.toml has them all)."""
    config: Settings = field(default_factory=Config)


@dataclass(frozen=True, slots=True)
class SimCommand:
    """A closed loop without a drone: a drawn world, a vehicle that answers as PX4's or ArduPilot's did."""

    scenario: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="SCENARIO")] = "walker"
    """Name of the flight."""
    seed: int = 0
    """Of the world, the wind and the camera's noise; 0 or more."""
    autopilot: Autopilot | None = None
    """Whose vehicle flies: px4 where not given, both with --all."""
    all: bool = False
    """Fly every scenario, in parallel, and print a table."""
    seeds: int = 5
    """With --all: fly each scenario with so many seeds, counting from --seed."""
    list: bool = False
    """Print the names of the scenarios."""
    tracker: str = TRACKER
    """Tracker by name, with settings: racf, racf-, racf--, bacf, arcf-hc; e.g. racf-,robust."""
    out: Path | None = None
    """Folder of flight.rrd, ticks.csv, settings.toml, summary.json and flight.png: out/sim/SCENARIO where not given.
    With --all: of a folder for each flight, and of all.txt (out/sim)."""
    json: bool = False
    """Print the summary (with --all: of each flight) as JSON on standard output."""
    for_: ForWhom = None
    """Size, stand-off and speed limit of this kind of target together. A settings file or an option overrides each."""
    settings: Path | None = None
    """TOML file of the settings below; what is given here stands above it (docs/service/settings.toml has them all)."""
    config: Settings = field(default_factory=Config)

    def __post_init__(self) -> None:
        if self.seed < 0:
            raise ValueError(f"--seed is 0 or more, not {self.seed}")
        if self.seeds < 1:
            raise ValueError(f"--seeds is 1 or more, not {self.seeds}")


@dataclass(frozen=True, slots=True)
class RunCommand:
    """Fly: follow a target with a vehicle that is already in the air.

    No setpoint is sent until FOLLOW is ordered: by --follow, by the key f, by SIGUSR1 or by a switch.  The key o, the
    switch, a moved stick or any change of mode ends it; q, Ctrl-C and SIGTERM leave the vehicle in Hold or BRAKE.
    """

    link: str
    """udpin:HOST:PORT, udpout:HOST:PORT, tcp:HOST:PORT, serial:DEVICE:BAUD; mavsdk+udpin://HOST:PORT for MAVSDK."""
    camera: str = "0"
    """A device (0, /dev/video0), a stream (rtsp://...), a file, or scene:NAME: a drawn scene seen from the vehicle."""
    target: str | None = None
    """What to follow: x,y,w,h in 0-based pixels of the first picture; a scene knows its own."""
    aim: bool = False
    """The box is a sight: start on what is in it, anew, when FOLLOW is ordered."""
    follow: bool = False
    """Order FOLLOW as soon as every check is green, once."""
    rc_channel: Annotated[int | None, tyro.conf.arg(metavar="1-18")] = None
    """Channel of the remote control whose switch orders FOLLOW (up) and OBSERVE (down)."""
    waive: Annotated[tuple[str, ...], tyro.conf.UseAppendAction] = ()
    """Follow although this check of `follow doctor` is red, repeatable."""
    system_id: int | None = None
    """The vehicle's MAVLink system id; the first vehicle heard when not given."""
    signing_key: Path | None = None
    """File of the MAVLink 2 signing key: 32 bytes, readable by its owner only."""
    seconds: float = 0.0
    """End after this time; 0 flies until stopped."""
    seed: int = 0
    """Of a drawn scene."""
    tracker: str = TRACKER
    """Tracker by name, with settings: racf, racf-, racf--, bacf, arcf-hc; e.g. racf,robust,cell_px=4."""
    out: Path = Path("out/run")
    """Folder of flight.rrd, flight.tlog, ticks.csv, settings.toml and summary.json."""
    json: bool = False
    """Print the summary as JSON on standard output."""
    for_: ForWhom = None
    """Size, stand-off and speed limit of this kind of target together. A settings file or an option overrides each."""
    settings: Path | None = None
    """TOML file of the settings below; what is given here stands above it (docs/service/settings.toml has them all)."""
    config: Settings = field(default_factory=Config)

    def __post_init__(self) -> None:
        require_system_id(self.system_id)
        if self.rc_channel is not None and not 1 <= self.rc_channel <= 18:
            raise ValueError(f"--rc-channel lies in 1..18, not {self.rc_channel}")
        if not 0 <= self.seconds < math.inf:
            raise ValueError(f"--seconds is 0 or more, not {self.seconds:g}")
        if self.seed < 0:
            raise ValueError(f"--seed is 0 or more, not {self.seed}")


@dataclass(frozen=True, slots=True)
class DoctorCommand:
    """Look at camera, tracker, link, autopilot, disk, clock and signing, and say what mends them.

    Exit status 0: fit to fly.  1: something is red.  Nothing on the vehicle is changed.
    """

    camera: str | None = None
    """A device (0, /dev/video0), a stream (rtsp://...) or a file; not looked at when not given."""
    link: str | None = None
    """As for `follow run`; not looked at when not given."""
    system_id: int | None = None
    """The vehicle's MAVLink system id; the first vehicle heard when not given."""
    signing_key: Path | None = None
    """File of the MAVLink 2 signing key: 32 bytes, readable by its owner only."""
    tracker: str = TRACKER
    """The tracker that is timed on the camera's pictures."""
    out: Path = Path("out/run")
    """Where recordings would go; the camera's first picture is left there."""
    json: bool = False
    """Print the findings as JSON on standard output."""

    def __post_init__(self) -> None:
        require_system_id(self.system_id)


@dataclass(frozen=True, slots=True)
class InspectCommand:
    """Open a recording in Rerun's viewer."""

    recording: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="DIR_OR_RRD")]
    """The folder of a flight, or its flight.rrd."""


def commands(config: Config) -> Any:
    """The commands as the parser takes them; a setting that the command line does not give is that of `config`."""
    return union(ReplayCommand, SimCommand, RunCommand, config)


def union(replay: Any, sim: Any, run: Any, config: Any) -> Any:
    """The commands by name, with these classes for the three that fly."""
    replay = Annotated[replay, tyro.conf.subcommand("replay", default=replay(tyro.MISSING, config=config))]
    sim = Annotated[sim, tyro.conf.subcommand("sim", default=sim(config=config))]
    run = Annotated[run, tyro.conf.subcommand("run", default=run(tyro.MISSING, config=config))]
    doctor = Annotated[DoctorCommand, tyro.conf.subcommand("doctor")]
    inspect = Annotated[InspectCommand, tyro.conf.subcommand("inspect")]
    return Union[replay, sim, run, doctor, inspect]  # noqa: UP007 - made of values, not of types that `|` knows


Command = commands(Config())


def box_of(text: str) -> Box:
    """A box from the command line; raises UsageError."""
    try:
        return Box.parse(text)
    except ValueError as error:
        raise UsageError(f"--target: {error}") from None
