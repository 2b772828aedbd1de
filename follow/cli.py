"""The `follow` command line: the only file that puts the parts together."""

import math
import signal
import sys
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import tyro

from follow.acquire import Acquire
from follow.camera import Camera, CameraError
from follow.config import Config
from follow.inspect import show
from follow.link import LinkError
from follow.loop import follow
from follow.messages import Autopilot, Order, Tick
from follow.record import Recorder
from follow.safety import Safety
from follow.scoring import Score, Truth
from follow.servo import Servo
from follow.summary import Figures
from follow.target import Target
from follow.terminal import Terminal, result
from follow.video import Replay as ReplayCamera
from follow.video import is_live, open_replay
from racf.box import Box
from racf.commandline import UsageError, run
from sim.replay import ReplayLink, WindowCamera

REPLAY_HEIGHT_M = 10.0  # of the pretended vehicle: a common follow-me height
PTZ_SHARE = 2  # the virtual camera shows 1 / 2 of the footage's width and height, pixel for pixel

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
class Inspect:
    """Open a recording in Rerun's viewer."""

    recording: tyro.conf.Positional[Path]
    """The folder of a flight, or its flight.rrd."""


Command = (
    Annotated[Replay, tyro.conf.subcommand("replay")]
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


def execute(command: Replay | Inspect) -> None:
    """Run one command."""
    if isinstance(command, Replay):
        replay(command)
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
