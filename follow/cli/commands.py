"""The commands of `follow` with their options; the docstrings are the help."""

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import tyro

from follow.camera.board import MARKER_FRACTION, Pattern
from follow.camera.lens_fit import LensKind
from follow.config import CameraConfig, Config, TargetKind
from follow.geometry import Intrinsics
from follow.messages import Autopilot
from follow.operator.stick_trims import parse_trims
from racf.box import Box
from racf.commandline import UsageError

Settings = Annotated[Config, tyro.conf.arg(name="")]

ForWhom = Annotated[TargetKind | None, tyro.conf.arg(name="for")]

TRACKER = "racf,robust"

LEAST_WAVE_S, LONGEST_WAVE_S = 8.0, 120.0


def require_system_id(system_id: int | None) -> None:
    """Raise ValueError for an invalid MAVLink system id."""
    if system_id is not None and not 1 <= system_id <= 255:
        raise ValueError(f"--system-id lies in 1..255, not {system_id}")


def require_delay(ground_delay_s: float) -> None:
    """Raise ValueError for the age of an image that is no longer kept."""
    if not 0 <= ground_delay_s <= 1.5:
        raise ValueError(f"--ground-delay-s lies in 0..1.5, not {ground_delay_s:g}: older images are not kept")


def require_standoff(config: Config) -> None:
    """Raise ValueError for a stand-off that the gate does not let the servo reach."""
    standoff_m, least_m = config.servo.standoff_m, config.limits.min_standoff_m
    if standoff_m < least_m:
        raise ValueError(
            f"servo.standoff_m {standoff_m:g} lies below limits.min_standoff_m {least_m:g}, which the gate keeps: "
            "raise the one or lower the other"
        )


@dataclass(frozen=True, slots=True)
class ReplayCommand:
    """Play footage through tracker, servo and gate, to a link that pretends to fly."""

    source: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="SOURCE")]
    """Video file, or folder of images."""
    target: str | None = None
    """Box of the target, x,y,w,h in 0-based pixels of the first frame: 1 less in x and y than in a file of --truth."""
    truth: Path | None = None
    """File of annotated boxes, x,y,w,h in 1-based pixels. The first starts the tracker; all score it."""
    ptz: bool = False
    """Let yaw rate and climb move a window over the footage: bad control loses the target."""
    fps: float | None = None
    """Frame rate, 1/s. Default: what the video says; for a folder what its name says, else 30."""
    tracker: str = TRACKER
    """Tracker: racf, racf-, racf--, bacf, arcf-hc, with ,robust to follow; OpenCV's csrt, kcf, mil, nano, vit; your own
    module:Class. Settings follow after commas: `racf` alone is the paper's, the default of the program racf."""
    autopilot: Autopilot = Autopilot.PX4
    """Autopilot whose rules the pretended vehicle obeys."""
    view: str | None = None
    """Show the flight in Rerun while it flies: here (also without a word), web for a browser, or
    rerun+http://HOST:PORT/proxy for a viewer on another computer. Default: not shown."""
    out: Path = Path("out/replay")
    """Output folder: flight.rrd, ticks.csv, settings.toml and summary.json."""
    json: bool = False
    """Print the summary as JSON on standard output."""
    for_: ForWhom = None
    """Kind of target: sets its size, the stand-off and the speed limit. The settings file and options override each."""
    settings: Path | None = None
    """TOML file of the settings that --help-all lists, as docs/service/settings.toml. Options override it."""
    config: Settings = field(default_factory=Config)

    def __post_init__(self) -> None:
        if self.fps is not None and not 0 < self.fps <= 1000:
            raise ValueError(f"--fps lies above 0, up to 1000, not {self.fps:g}")


@dataclass(frozen=True, slots=True)
class SimCommand:
    """Fly a closed loop without a drone: a drawn world and a simulated vehicle."""

    scenario: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="SCENARIO")] = "walker"
    """Name of the scenario; --list prints them all."""
    seed: int = 0
    """Seed of the world, the wind and the camera's noise, 0 or more."""
    autopilot: Autopilot | None = None
    """Autopilot whose vehicle flies. Default: px4; with --all both."""
    all: bool = False
    """Fly every scenario, in parallel, and print a table."""
    seeds: int | None = None
    """With --all: number of seeds for each scenario, counting from --seed. Default: 5."""
    dask: str | None = None
    """With --all: address of the scheduler of a Dask cluster to fly on (needs the extra `dask`). The files of a flight
    stay on its worker's disk."""
    list: bool = False
    """Print the names of the scenarios and end."""
    tracker: str = TRACKER
    """Tracker: racf, racf-, racf--, bacf, arcf-hc, with ,robust to follow; OpenCV's csrt, kcf, mil, nano, vit; your own
    module:Class. Settings follow after commas: `racf` alone is the paper's, the default of the program racf."""
    detector: Path | None = None
    """ONNX file of a detector, as for `follow run`; what it finds comes 0.3 s of the flight's time later, or with
    --page when it is ready. Default: no detector."""
    view: str | None = None
    """Show the flight in Rerun while it flies: here (also without a word), web for a browser, or
    rerun+http://HOST:PORT/proxy for a viewer on another computer. Default: not shown."""
    page: str | None = None
    """Operator's page in a browser, HOST:PORT, as 127.0.0.1:8080: to see, select, follow and stop, in real time.
    Default: no page."""
    page_token: Path | None = None
    """File of the page's token. Default: a new one, printed, for an address that others reach; none on loopback."""
    ground: str | None = None
    """Ground station, udpin:HOST:PORT: a camera in which it selects the target, in real time. Default: none."""
    video_out: str | None = None
    """Video for the ground: rtp://HOST:5600, or rtsp://SERVER:8554/PATH to push it there; `none`. Default: RTP to port
    5600 of each ground station that is heard at --ground."""
    ground_delay_s: float = 0.3
    """Age of the image that a person at the ground station sees, s."""
    ground_follows: bool = False
    """A box drawn at the ground station orders FOLLOW at once. Default: it is tracked, and FOLLOW is ordered apart."""
    out: Path | None = None
    """Output folder: flight.rrd, ticks.csv, settings.toml, summary.json and flight.png; with --all one folder for each
    flight, and all.txt. Default: out/sim/SCENARIO, with --all out/sim."""
    json: bool = False
    """Print the summary, with --all a list of them, as JSON on standard output."""
    for_: ForWhom = None
    """Kind of target: sets its size, the stand-off and the speed limit. The settings file and options override each."""
    settings: Path | None = None
    """TOML file of the settings that --help-all lists, as docs/service/settings.toml. Options override it."""
    config: Settings = field(default_factory=Config)

    def __post_init__(self) -> None:
        require_standoff(self.config)
        if self.seed < 0:
            raise ValueError(f"--seed is 0 or more, not {self.seed}")
        if self.seeds is not None and self.seeds < 1:
            raise ValueError(f"--seeds is 1 or more, not {self.seeds}")
        if self.seeds is not None and not self.all:
            raise ValueError("--seeds needs --all: a single flight has the one of --seed")
        if self.dask is not None and not self.all:
            raise ValueError("--dask needs --all: a single flight runs here")
        if self.all and (self.page is not None or self.ground is not None):
            raise ValueError("--page and --ground show one flight: leave out --all")
        if self.ground is not None and not self.ground.startswith("udpin:"):
            raise ValueError(f"--ground of a simulated vehicle is udpin:HOST:PORT, not {self.ground!r}")
        if self.ground is None and (self.ground_follows or (self.video_out is not None and self.page is None)):
            raise ValueError("--ground-follows needs --ground, --video-out needs --ground or --page: give one")
        require_delay(self.ground_delay_s)


@dataclass(frozen=True, slots=True)
class RunCommand:
    """Fly: follow a target with a vehicle that is already in the air.

    - No setpoint is sent until you order FOLLOW: --follow, key f, SIGUSR1, switch.
    - The key o, the switch, a moved stick or any change of mode ends following.
    - The key q, Ctrl-C and SIGTERM end the flight and leave it in Hold or BRAKE.
    """

    link: str
    """Address of the autopilot: udpin:HOST:PORT, udpout:HOST:PORT, tcp:HOST:PORT, serial:DEVICE:BAUD, or
    mavsdk+udpin://HOST:PORT for MAVSDK's connection."""
    camera: str = "0"
    """Camera: a device (0, /dev/video0?size=1280x720&fps=30&format=mjpeg), a stream (rtsp://, udp://, http://), an .sdp
    file, a program's output (exec:PROGRAM), picamera2, a file, or a drawn scene (scene:NAME); see docs/cameras.md."""
    target: str | None = None
    """Box of the target, x,y,w,h in 0-based pixels of the first frame. Default: a drawn scene's own target."""
    dry_run: bool = False
    """Send nothing that could move the vehicle; FOLLOW is pretended, and what would be sent is recorded."""
    detector: Path | None = None
    """ONNX file of a detector of your own (YOLOX, YOLOv8 or later, SSD). Its boxes are shown to tap on and recorded, a
    tap becomes the box of the object there, and a lost target is looked for in them. Default: no detector."""
    aim: bool = False
    """Use the box as a sight: the tracker starts again on what is in it when FOLLOW is ordered."""
    follow: bool = False
    """Order FOLLOW once, as soon as every check is green."""
    rc_channel: Annotated[int | None, tyro.conf.arg(metavar="1-18")] = None
    """Channel of the remote control whose switch orders FOLLOW (up) and OBSERVE (down). Default: no switch."""
    stick_trims: Annotated[str | None, tyro.conf.arg(metavar="RIGHT,FORWARD,UP")] = None
    """Channels of the remote control that trim while it follows: aside, nearer, higher; as 1,-2,3 (minus: reversed).
    Up to 30 % of a stick's travel; beyond it the stick takes the vehicle over, as every stick does by default, and on
    PX4 a stick that moves fast."""
    waive: Annotated[tuple[str, ...], tyro.conf.UseAppendAction] = ()
    """Name of a check of `follow doctor` that may be red. Repeat it for several."""
    simulated: bool = False
    """The vehicle is a simulator: a file or a drawn scene may fly it. Not needed on loopback with a known simulator."""
    system_id: int | None = None
    """MAVLink system id of the vehicle, 1 to 255. Default: the first vehicle heard."""
    signing_key: Path | None = None
    """File of the MAVLink 2 signing key, 32 bytes, readable by its owner only. Default: packets are not signed."""
    ground: str | None = None
    """Ground station: a camera that it can point in. `link`: behind the autopilot; udpin:HOST:PORT also directly."""
    video_out: str | None = None
    """Video for the ground: rtp://HOST:5600, or rtsp://SERVER:8554/PATH to push it there; `none`. Default: RTP to port
    5600 of each ground station that is heard at --ground udpin:HOST:PORT."""
    ground_delay_s: float = 0.3
    """Age of the image that a person at the ground station sees, s."""
    ground_follows: bool = False
    """A box drawn at the ground station orders FOLLOW at once. Default: it is tracked, and FOLLOW is ordered apart."""
    ground_unsigned: bool = False
    """Let everybody on the network choose the target at --ground udpin:HOST:PORT. Default: only with --signing-key."""
    page: str | None = None
    """Operator's page in a browser, HOST:PORT, as 127.0.0.1:8080: to see, select, follow and stop. Default: no page."""
    page_token: Path | None = None
    """File of the page's token. Default: a new one, printed, for an address that others reach; none on loopback."""
    seconds: float = 0.0
    """End after this time, s. 0: fly until stopped."""
    seed: int = 0
    """Seed of a drawn scene, 0 or more."""
    tracker: str = TRACKER
    """Tracker: racf, racf-, racf--, bacf, arcf-hc, with ,robust to follow; OpenCV's csrt, kcf, mil, nano, vit; your own
    module:Class. Settings follow after commas: `racf` alone is the paper's, the default of the program racf."""
    view: str | None = None
    """Show the flight in Rerun while it flies: here (also without a word), web for a browser, or
    rerun+http://HOST:PORT/proxy for a viewer on another computer. Default: not shown."""
    out: Path = Path("out/run")
    """Output folder: flight.rrd, flight.tlog, ticks.csv, settings.toml and summary.json."""
    json: bool = False
    """Print the summary as JSON on standard output."""
    for_: ForWhom = None
    """Kind of target: sets its size, the stand-off and the speed limit. The settings file and options override each."""
    settings: Path | None = None
    """TOML file of the settings that --help-all lists, as docs/service/settings.toml. Options override it."""
    config: Settings = field(default_factory=Config)

    def __post_init__(self) -> None:
        require_standoff(self.config)
        require_system_id(self.system_id)
        if self.rc_channel is not None and not 1 <= self.rc_channel <= 18:
            raise ValueError(f"--rc-channel lies in 1..18, not {self.rc_channel}")
        if self.stick_trims is not None:
            parse_trims(self.stick_trims)
        if not 0 <= self.seconds < math.inf:
            raise ValueError(f"--seconds is 0 or more, not {self.seconds:g}")
        require_delay(self.ground_delay_s)
        if self.seed < 0:
            raise ValueError(f"--seed is 0 or more, not {self.seed}")


@dataclass(frozen=True, slots=True)
class DoctorCommand:
    """Check camera, tracker, link, autopilot and machine, and say how to fix them.

    - Give --camera, --link or both.
    - Exit status 0: nothing checked is red; 1: a check is red; 2: wrong use.
    - Nothing on the vehicle is changed.
    """

    camera: str | None = None
    """Camera, as for `follow run`, or a file. Default: not checked."""
    link: str | None = None
    """Address of the autopilot, as for `follow run`. Default: not checked."""
    system_id: int | None = None
    """MAVLink system id of the vehicle, 1 to 255. Default: the first vehicle heard."""
    signing_key: Path | None = None
    """File of the MAVLink 2 signing key, 32 bytes, readable by its owner only. Default: packets are not signed."""
    tracker: str = TRACKER
    """Tracker that is timed on the camera's frames."""
    out: Path = Path("out/run")
    """Folder where recordings would go; the camera's first image is written there."""
    wave: Annotated[float | None, tyro.conf.arg(metavar="SECONDS")] = None
    """Measure the camera's mount, field of view and delay while you turn the vehicle in your hands for this long, s,
    propellers off, and compare them with the settings. Default: not measured; 20 is enough."""
    json: bool = False
    """Print the findings as JSON on standard output."""
    settings: Path | None = None
    """TOML file of the settings that --help-all lists, as docs/service/settings.toml. Options override it."""
    config: Settings = field(default_factory=Config)

    def __post_init__(self) -> None:
        require_system_id(self.system_id)
        if self.camera is None and self.link is None:
            raise ValueError("nothing to check: give --camera SOURCE, --link ADDRESS or both")
        if self.wave is not None and (self.camera is None or self.link is None):
            raise ValueError("--wave compares the image with the attitude: give --camera SOURCE and --link ADDRESS")
        if self.wave is not None and not LEAST_WAVE_S <= self.wave <= LONGEST_WAVE_S:
            raise ValueError(f"--wave lies in {LEAST_WAVE_S:g}..{LONGEST_WAVE_S:g} s, not {self.wave:g}")


@dataclass(frozen=True, slots=True)
class InspectCommand:
    """Open a recording in Rerun's viewer."""

    recording: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="DIR_OR_RRD")]
    """Folder of a flight, or its flight.rrd."""


@dataclass(frozen=True, slots=True)
class ReflyCommand:
    """Fly a recorded flight's tracks and states through estimate, servo and gate.

    - With the recorded settings the outcome must be equal to the last bit.
    - Exit status 1 if it is not.
    - With others it shows what they would have sent.
    - The vehicle goes where it went.
    """

    flight: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="DIR")]
    """Folder of the recorded flight, or a file in it."""
    out: Path | None = None
    """Output folder: flight.rrd, ticks.csv, settings.toml, summary.json and refly.html. Default: DIR/refly."""
    json: bool = False
    """Print the summary as JSON on standard output."""
    for_: ForWhom = None
    """Kind of target: sets its size, the stand-off and the speed limit. The settings file and options override each."""
    settings: Path | None = None
    """TOML file of settings that differ from the recorded ones. Options override it."""
    config: Settings = field(default_factory=Config)


@dataclass(frozen=True, slots=True)
class ReportCommand:
    """Write one self-contained HTML page about a flight.

    It shows modes and why, losses, limits, timing, link and messages.
    """

    flight: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="DIR")]
    """Folder of the flight, or a file in it."""
    out: Path | None = None
    """File of the page. Default: DIR/report.html."""


@dataclass(frozen=True, slots=True)
class CalibrateCommand:
    """Write a camera file from a video or a folder of images of a calibration board.

    - Show the board in the whole image, also in its corners, near and far.
    - Tilt it by 20 to 40 degrees to all sides.
    - Move it slowly, in good light: blurred images are left out.
    """

    source: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="SOURCE")]
    """Video file, or folder of images, in the mode of the camera that is flown."""
    board: Annotated[str, tyro.conf.arg(metavar="COLUMNSxROWS")] = "9x6"
    """Inner corners of a checkerboard (where four squares meet), or squares of a ChArUco board."""
    pattern: Pattern = Pattern.CHECKERBOARD
    """What is printed on the board."""
    square_m: float = 0.025
    """Side of a square, m. The lens does not depend on it."""
    dictionary: str = "DICT_4X4_50"
    """OpenCV's dictionary of the markers of a ChArUco board."""
    marker_fraction: float = MARKER_FRACTION
    """Side of a marker of a ChArUco board over that of a square."""
    lens: LensKind = LensKind.PINHOLE
    """Model that is fitted: pinhole (5 coefficients) or fisheye (4, for wide lenses)."""
    out: Path = Path("camera.yaml")
    """File to write, OpenCV's YAML; a plot goes beside it, with the ending .png."""

    def __post_init__(self) -> None:
        if not 0 < self.marker_fraction < 1:
            raise ValueError(f"--marker-fraction lies between 0 and 1, not {self.marker_fraction:g}")
        if self.out.is_dir() or self.out.suffix.lower() == ".png":
            raise ValueError(f"--out must be a file to write, not ending in .png; {str(self.out)!r} is not one")


Command = (
    ReplayCommand
    | SimCommand
    | RunCommand
    | DoctorCommand
    | InspectCommand
    | ReflyCommand
    | ReportCommand
    | CalibrateCommand
)


def lens_of(camera: CameraConfig, width: int, height: int) -> Intrinsics:
    """The lens that the settings describe, for frames of that size; raises UsageError."""
    try:
        return camera.intrinsics(width, height)
    except ValueError as error:
        raise UsageError(f"camera.calibration {camera.calibration!r}: {error}") from None


def box_in(box: Box, width: int, height: int) -> str:
    """A warning about the target's box in frames of that size, or "".  Raises UsageError for an invalid box."""
    try:
        return box.as_start(width, height)
    except ValueError as error:
        raise UsageError(f"--target (x,y,w,h in 0-based pixels): {error}") from None


def box_of(text: str) -> Box:
    """A box from the command line; raises UsageError."""
    try:
        return Box.parse(text)
    except ValueError as error:
        raise UsageError(f"--target (x,y,w,h in 0-based pixels): {error}") from None
