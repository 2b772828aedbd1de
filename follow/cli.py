"""The `follow` command line: the only file that puts the parts together."""

import logging
import math
import signal
import sys
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated

import tyro

from follow.acquire import Acquire
from follow.camera import Camera, CameraError
from follow.config import Config
from follow.flight import Parts, RealTime, Spoken, preflight, unwaived
from follow.flight import fly as fly_parts
from follow.geometry import Intrinsics
from follow.inspect import show
from follow.link import Link, LinkError
from follow.loop import follow
from follow.messages import Autopilot, Order, Tick
from follow.operator import Operator
from follow.pymavlink_link import connect
from follow.record import Recorder
from follow.safety import Safety
from follow.scoring import Score, Truth
from follow.servo import Servo
from follow.signing import Signing
from follow.summary import Figures
from follow.target import Target
from follow.terminal import Terminal, result
from follow.tlog import Tlog
from follow.video import LiveVideo, is_live, open_replay
from follow.video import Replay as ReplayCamera
from racf.box import Box
from racf.commandline import UsageError, run
from sim.replay import ReplayLink, WindowCamera
from sim.scenarios import SCENARIOS, build_live

REPLAY_HEIGHT_M = 10.0  # of the pretended vehicle: a common follow-me height
PTZ_SHARE = 2  # the virtual camera shows 1 / 2 of the footage's width and height, pixel for pixel
SCENE = "scene:"
VEHICLE_S = 30.0  # an autopilot boots in less

Settings = Annotated[Config, tyro.conf.arg(name="")]


@dataclass(frozen=True, slots=True)
class Replay:
    """A video file or a folder of images through tracker, servo, gate and a link that only pretends to fly."""

    source: tyro.conf.Positional[str]
    """Video file or folder of images."""
    target: str | None = None
    """What to follow: x,y,w,h in 0-based pixels of the first picture."""
    truth: Path | None = None
    """A benchmark's boxes, x,y,w,h in 1-based pixels: the first row starts the tracker, which is then scored."""
    ptz: bool = False
    """Let yaw rate and climb move a window over the footage, so that bad control loses the target."""
    fps: float | None = None
    """Pictures per second; a video says it itself, a folder is taken to have 30."""
    tracker: str = "racf,robust"
    """Tracker by name, with settings: racf, racf-, racf--, bacf, arcf-hc; e.g. racf,robust,cell=4."""
    autopilot: Autopilot = Autopilot.PX4
    """Whose rules the pretended vehicle obeys."""
    out: Path = Path("out/replay")
    """Folder of flight.rrd, ticks.csv and summary.json."""
    json: bool = False
    """Print the summary as JSON on standard output."""
    config: Settings = field(default_factory=Config)

    def start(self) -> tuple[Box, Truth | None]:
        """The first box and, where there is one, the annotation."""
        truth = Truth(self.truth) if self.truth else None
        if self.target is not None:
            return box_of(self.target), truth
        if truth is None:
            raise UsageError("what is to be followed? give --target x,y,w,h or --truth FILE")
        return truth.start, truth


@dataclass(frozen=True, slots=True)
class Run:
    """Fly: follow a target with a vehicle that is already in the air.

    Nothing is sent until FOLLOW is ordered: by --follow, by the key f, by SIGUSR1 or by a switch.  The key o, the
    switch, a moved stick or any change of mode ends it; q, Ctrl-C and SIGTERM leave the vehicle in Hold or BRAKE.
    """

    link: str
    """udpin:HOST:PORT, udpout:HOST:PORT, tcp:HOST:PORT, serial:DEVICE:BAUD; mavsdk+udpin://HOST:PORT for MAVSDK."""
    camera: str = "0"
    """A device (0, /dev/video0), a stream (rtsp://...), a file, or scene:NAME: a drawn scene seen from the vehicle."""
    target: str | None = None
    """What to follow: x,y,w,h in 0-based pixels of the first picture; a scene knows its own."""
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
    tracker: str = "racf,robust"
    """Tracker by name, with settings: racf, racf-, racf--, bacf, arcf-hc; e.g. racf,robust,cell=4."""
    out: Path = Path("out/run")
    """Folder of flight.rrd, flight.tlog, ticks.csv and summary.json."""
    json: bool = False
    """Print the summary as JSON on standard output."""
    config: Settings = field(default_factory=Config)


@dataclass(frozen=True, slots=True)
class Inspect:
    """Open a recording in Rerun's viewer."""

    recording: tyro.conf.Positional[Path]
    """The folder of a flight, or its flight.rrd."""


Command = (
    Annotated[Replay, tyro.conf.subcommand("replay")]
    | Annotated[Run, tyro.conf.subcommand("run")]
    | Annotated[Inspect, tyro.conf.subcommand("inspect")]
)  # fmt: skip


def box_of(text: str) -> Box:
    """A box from the command line."""
    try:
        return Box.parse(text)
    except ValueError as error:
        raise UsageError(f"--target: {error}") from None


def acquire(name: str, box: Box, *, uses_prior: bool) -> Acquire:
    """A warm tracker that will start on the box.  Footage does not answer to the vehicle: there is no prior then."""
    from racf import Racf  # noqa: PLC0415 - loads the compiled kernels
    from racf.evaluate.trackers import TrackerSpec  # noqa: PLC0415
    from racf.tracker import warm_up  # noqa: PLC0415

    tracker = TrackerSpec.parse(name).build()
    if isinstance(tracker, Racf):
        warm_up()
        if uses_prior:
            return Acquire(tracker.init, tracker.update, box)
    return Acquire(tracker.init, lambda image, _: tracker.update(image), box)


def once(order: Order) -> Callable[[], Order | None]:
    """An operator who gives one order, in the first round."""
    orders = iter((order,))
    return lambda: next(orders, None)


def fly(
    ticks: Iterable[Tick],
    recorder: Recorder,
    terminal: Terminal,
    total: int | None,
    truth: Callable[[Tick], Box | None],
) -> bool:
    """Record every tick until the frames end; False when a person stopped it."""
    try:
        for tick in terminal.progress(ticks, total, recorder.out.name):
            recorder.tick(tick, truth(tick))
    except KeyboardInterrupt:
        terminal.report("stopped by Ctrl-C: everything up to here is written")
        return False
    return True


def replay(command: Replay) -> None:
    """`follow replay`."""
    if is_live(command.source):
        raise UsageError(f"replay plays files, not the live source {command.source!r}: use follow run")
    box, truth = command.start()
    terminal = Terminal()
    config = command.config
    footage = open_replay(command.source, command.fps, terminal.report)
    link = ReplayLink(footage.fps, REPLAY_HEIGHT_M, command.autopilot, holds_place=command.ptz)
    about = f"# follow replay {command.source}\n\ntracker {command.tracker}, {footage.fps:g} pictures/s"
    with footage, Recorder(command.out, config.record, terminal.report, waits=True, about=about) as recorder:
        terminal.listeners.append(recorder.message)
        width, height = footage.size
        whole = Box(0, 0, width, height)
        camera: Camera = footage
        lens = config.camera.intrinsics(width, height)
        ptz = windowed(footage, link, box, config) if command.ptz else None
        if ptz is not None:
            camera, lens = ptz, ptz.intrinsics
            box = box.moved(-ptz.window.x, -ptz.window.y)
        tracker = acquire(command.tracker, box, uses_prior=False)
        target = Target(lens, config.camera.down_rad, config.target)
        servo = Servo(config.camera.down_rad, config.servo)
        safety = Safety(config.limits)
        score = Score(truth) if truth else None

        def true_box(tick: Tick) -> Box | None:
            return score.add(tick, ptz.window if ptz else whole) if score else None

        with link:
            ticks = follow(camera, link, tracker, target, servo, safety, once(Order.FOLLOW))
            finished = fly(ticks, recorder, terminal, footage.rounds, true_box)
        figures: Figures = {"tracker": command.tracker, "autopilot": command.autopilot.value}
        if score is not None:
            if line := score.shortfall():
                terminal.report(line)
            figures |= score.figures(ptz.window if ptz else whole, closed_loop=command.ptz)
        if any(link.refused.values()):
            terminal.report(f"the vehicle refused setpoints: {link.refused}")
        figures = recorder.close(figures)
    result(figures, as_json=command.json)
    terminal.report(f"recording: {command.out / 'flight.rrd'}")
    if not finished:
        raise KeyboardInterrupt


def windowed(footage: ReplayCamera, link: ReplayLink, target: Box, config: Config) -> WindowCamera:
    """The virtual camera on the footage, at first centred on the target."""
    width, height = footage.size
    lens = config.camera.intrinsics(width, height)
    window = (width // PTZ_SHARE, height // PTZ_SHARE)
    # The climb that a person would expect: as far away as flat ground is in the middle of the picture.
    range_m = REPLAY_HEIGHT_M / max(math.sin(config.camera.down_rad), 0.1)
    return WindowCamera(footage, link, lens, window, (target.centre_x, target.centre_y), range_m)


@dataclass(frozen=True, slots=True)
class Eye:
    """An open camera and what must be known of it to fly by it."""

    camera: Camera
    lens: Intrinsics
    down_rad: float
    target: Box
    truth: Callable[[Tick], Box | None] = lambda _tick: None


def eye(command: Run, link: Link, report: Callable[[str], None]) -> Eye:
    """The camera that the command names; a scene is drawn as seen from where the link says that the vehicle is."""
    if command.camera.startswith(SCENE):
        return scene_eye(command, link)
    if command.target is None:
        raise UsageError("what is to be followed? give --target x,y,w,h")
    if is_live(command.camera):
        camera = LiveVideo(command.camera, report)
    else:
        camera = RealTime(open_replay(command.camera, None, report))
    mount = command.config.camera
    return Eye(camera, mount.intrinsics(*camera.size), mount.down_rad, box_of(command.target))


def scene_eye(command: Run, link: Link) -> Eye:
    """A drawn scene of as long a flight as is asked for, with its own target when no other is named."""
    name = command.camera.removeprefix(SCENE)
    scenario = SCENARIOS.get(name)
    if scenario is None:
        raise UsageError(f"there is no scene {name!r}; there are {', '.join(SCENARIOS)}")
    scenario = replace(scenario, duration_s=max(command.seconds, scenario.duration_s))
    camera, _ = build_live(scenario, command.seed, link.state().autopilot or Autopilot.PX4, link)
    target = box_of(command.target) if command.target is not None else camera.first()[1]

    def true_box(tick: Tick) -> Box | None:
        return None if tick.frame is None else camera.truth(tick.frame.index).box

    return Eye(camera, camera.settings.intrinsics, camera.settings.down_rad, target, true_box)


def fly_live(command: Run) -> None:
    """`follow run`."""
    from racf.tracker import warm_up  # noqa: PLC0415 - loads the compiled kernels

    terminal = Terminal()
    spoken = Spoken(terminal.report)
    log = logging.getLogger("follow")
    log.addHandler(spoken)
    log.setLevel(logging.INFO)
    config = command.config
    terminal.report(f"tracker warm after {warm_up():.1f} s")
    about = f"# follow run {command.link} {command.camera}\n\ntracker {command.tracker}"
    with Recorder(command.out, config.record, terminal.report, waits=False, about=about) as recorder:
        terminal.listeners.append(recorder.message)
        signing = Signing(command.signing_key) if command.signing_key else None
        tlog = Tlog(command.out / "flight.tlog")
        with connect(command.link, command.system_id, signing=signing, tlog=tlog) as link:
            link.wait_for_vehicle(VEHICLE_S)
            findings = preflight(link, command.out, signs=signing is not None)
            red = unwaived(findings, command.waive, terminal.report)
            seen = eye(command, link, terminal.report)
            heard = link.client.heard
            operator = Operator(terminal.report, command.follow, command.rc_channel, heard, red)
            with seen.camera as camera:
                parts = Parts(
                    camera,
                    link,
                    acquire(command.tracker, seen.target, uses_prior=True),
                    Target(seen.lens, seen.down_rad, config.target),
                    Servo(seen.down_rad, config.servo),
                    Safety(config.limits),
                )
                fly_parts(parts, operator, recorder, seen.truth, command.seconds)
            autopilot = link.state().autopilot
        figures: Figures = {"tracker": command.tracker, "autopilot": autopilot.value if autopilot else ""}
        figures = recorder.close(figures)
    log.removeHandler(spoken)
    result(figures, as_json=command.json)
    terminal.report(f"recording: {command.out / 'flight.rrd'}")


def execute(command: Replay | Run | Inspect) -> None:
    """Run one command."""
    if isinstance(command, Replay):
        replay(command)
    elif isinstance(command, Run):
        fly_live(command)
    else:
        show(command.recording)


def main(argv: Sequence[str] | None = None) -> int:
    """The program; returns the exit status."""
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # a service manager's stop ends as cleanly as Ctrl-C
    return run(
        Command,
        execute,
        argv,
        prog="follow",
        description="Keep a target in view: PX4 and ArduPilot, replayed footage, or a simulated flight.",
        failures=(CameraError, LinkError),
    )


if __name__ == "__main__":
    sys.exit(main())
