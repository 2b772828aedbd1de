"""`follow run`: a real camera or a drawn scene, and a vehicle behind a MAVLink connection."""

import contextlib
import logging
import signal
import time
from collections.abc import Callable, Generator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from follow.camera import Camera
from follow.camera.calibration import described
from follow.camera.live import LiveVideo
from follow.camera.names import is_camera, is_live, parse_camera
from follow.camera.realtime import RealTime
from follow.camera.recent import RecentFrames
from follow.camera.sizes import shrink_for, whole
from follow.camera.video import open_replay
from follow.cli.commands import RunCommand, box_in, box_of, lens_of
from follow.cli.detector import check_detector, open_detector
from follow.cli.ground import carried_by, check_ground, ground_sides, video_address
from follow.cli.height import height_conflict, height_line
from follow.cli.layers import SCENE, from_scene
from follow.cli.named import require_camera, require_device, require_encoder, require_key, require_link
from follow.cli.page import consoles_of, desk_of, open_page, page_options
from follow.cli.settings import as_toml, scene_values
from follow.cli.sim import Referee, believed_camera, scene_camera
from follow.config import CameraConfig, Config, resolve
from follow.control.image_motion import ImageMotionMeter
from follow.control.reach import why_out_of_reach
from follow.control.selector import Selector
from follow.control.servo import Servo
from follow.control.target import Target
from follow.disk import OnceEach
from follow.flight.finding import Finding
from follow.flight.live_flight import LogForwarder, Parts, fly, preflight, unwaived
from follow.flight.parameters import names
from follow.flight.preflight import check_disk
from follow.flight.session import Start, Update, conclude, keep_flight, kept_geometry, require_tracker, tracker_of
from follow.flight.vehicle_checks import CHECKS
from follow.geometry import Intrinsics
from follow.link import Link
from follow.link.connection import MavlinkLink, connect
from follow.link.dry_run import DryRunLink
from follow.link.signing import Signing
from follow.link.tlog import Tlog
from follow.messages import Autopilot, Notify, Tick
from follow.operator.authority import Keys, Operator
from follow.operator.autopilot_texts import AutopilotTexts
from follow.operator.page.exchange import Exchange
from follow.operator.stick_trims import StickTrims, parse_trims
from follow.operator.terminal import Terminal
from follow.recording.exact import Setup
from follow.recording.folder import claimed, require_folder
from follow.recording.recorder import Recorder
from follow.recording.summary import Figures
from follow.safety.gate import Safety
from follow.safety.limits import NEVER_S
from racf.box import Box
from racf.commandline import UsageError
from racf.nearest import hint
from racf.tracker import warm_up
from sim.scenarios import SCENARIOS, build_live

VEHICLE_S = 30.0  # an autopilot boots in less
LONG_S = 1800.0  # length of a scene's path if no end is given: a battery's time


@dataclass(frozen=True, slots=True)
class OpenCamera:
    """An open camera with its lens, mount and target; `config` are the settings resolved for it."""

    camera: Camera
    lens: Intrinsics
    down_rad: float
    target: Box | None
    config: Config
    truth: Callable[[Tick], Box | None] = lambda _tick: None
    score: Callable[[], Figures] = Figures
    scale: int = 1


def open_camera(command: RunCommand, link: Link, report: Notify) -> OpenCamera:
    """The camera that the command names; a scene is drawn from the vehicle's position by the link."""
    if command.camera.startswith(SCENE):
        return open_scene(command, link)
    mount = command.config.camera
    target = box_of(command.target) if command.target is not None else None
    shrink = shrink_for(target) if target is not None else whole
    if is_live(command.camera):
        camera, delay_s = LiveVideo(command.camera, report, mount.delay_s, shrink=shrink), mount.delay_s
    else:
        camera, delay_s = RealTime(open_replay(command.camera, None, report, shrink)), 0.0
    lens = lens_of(mount, *camera.size)
    config = resolve(command.config, lens, mount.down_rad, delay_s)
    zoomed = target.zoomed(1 / camera.scale) if target is not None else None
    return OpenCamera(camera, lens, mount.down_rad, zoomed, config, scale=camera.scale)


def open_scene(command: RunCommand, link: Link, drawn: CameraConfig | None = None) -> OpenCamera:
    """A drawn scene, long enough for the flight, with its own target unless the command names another.

    `drawn` is the scene's true camera if it differs from the settings: for tests of a wrong mount.
    """
    scenario = SCENARIOS[command.camera.removeprefix(SCENE)]
    scenario = replace(scenario, duration_s=max(command.seconds or LONG_S, scenario.duration_s))
    autopilot = link.state().autopilot or Autopilot.PX4
    believed = believed_camera(scenario, autopilot, command.config.camera)
    mount = scene_camera(scenario, autopilot, drawn or command.config.camera)
    camera, _ = build_live(scenario, command.seed, autopilot, link, mount)
    target = box_of(command.target) if command.target is not None else camera.first()[1]
    if command.target is None and (command.ground is not None or command.page is not None):
        target = None  # a person will select it
    config = resolve(command.config, believed.intrinsics, believed.down_rad, believed.latency_s)
    referee = Referee(camera)

    def scored() -> Figures:
        return {**referee.figures(referee.flown(), config), "scenario": scenario.name, "seed": command.seed}

    return OpenCamera(camera, believed.intrinsics, believed.down_rad, target, config, referee.box, scored)


def check(command: RunCommand) -> None:
    """Raise UsageError for errors that can be found without a vehicle, CameraError for footage that does not decode."""
    if command.target is not None:
        box_of(command.target)
    elif not command.camera.startswith(SCENE) and command.ground is None and command.page is None:
        raise UsageError("what is to be followed? give --target x,y,w,h, or --page or --ground to point at it later")
    check_ground(command)
    require_link("--link", command.link)
    require_key(command.signing_key)
    require_camera(command.camera)
    for name in command.waive:
        check_waiver(name)
    check_written(command)
    require_tracker(command.tracker)
    check_detector(command.detector)
    if command.camera.startswith(SCENE):
        check_scene(command)
    else:
        require_height(command.config)
    if is_live(command.camera):  # last, so that a command can be judged where its camera is not
        require_device(parse_camera(command.camera))
    elif not command.camera.startswith(SCENE):
        with open_replay(command.camera, None, lambda _line: None) as footage:
            check_image(command, *footage.size)


def check_written(command: RunCommand) -> None:
    """Raise UsageError for a recording or a video that cannot be written here."""
    require_folder(command.out)
    if command.config.record.pictures:
        require_encoder("record.encoder", command.config.record.encoder)
    if video_address(command) is not None:
        require_encoder("video.encoder", command.config.video.encoder)


def check_image(command: RunCommand, width: int, height: int) -> None:
    """Raise UsageError for a lens or a target that does not fit images of that size."""
    lens_of(command.config.camera, width, height)
    if command.target is not None:
        box_in(box_of(command.target), width, height)


def check_scene(command: RunCommand) -> None:
    """Raise UsageError for settings that fit a drawn scene's camera behind no autopilot: each has its own angle."""
    scenario, mount = SCENARIOS[command.camera.removeprefix(SCENE)], command.config.camera
    drawn = [scene_camera(scenario, autopilot, mount) for autopilot in Autopilot]
    check_image(command, drawn[0].intrinsics.width, drawn[0].intrinsics.height)
    resolved = [resolve(command.config, c.intrinsics, c.down_rad, c.latency_s) for c in drawn]
    if all(height_conflict(config) for config in resolved):
        require_height(resolved[0])


def require_height(config: Config) -> None:
    """Raise UsageError for a height outside the altitude band."""
    if conflict := height_conflict(config):
        raise UsageError(conflict)


def check_waiver(name: str) -> None:
    """Raise UsageError for a name that no check has, on either autopilot."""
    known = [*CHECKS, *(parameter for autopilot in Autopilot for parameter in names(autopilot))]
    if name not in known:
        printed = "give a name that follow doctor prints in red, as battery or GF_ACTION"
        raise UsageError(f"--waive {name} is not a check; {hint(name, known, printed)}")


def inspect(command: RunCommand, link: MavlinkLink) -> list[Finding]:
    """The checks before this flight."""
    camera, signs = is_camera(command.camera), command.signing_key is not None
    disk = check_disk(command.out, None, command.config.record, command.seconds)
    return preflight(link, disk, signs=signs, live_camera=camera, simulated=command.simulated)


def fly_live(command: RunCommand, bare: Any) -> None:
    """`follow run`; `bare` are its settings without those that a drawn scene suggests."""
    check(command)
    page = page_options(command.page, command.page_token)
    terminal = Terminal(waits=False)
    name = command.camera.removeprefix(SCENE)
    scene = from_scene(name, command.config, bare) if name != command.camera else frozenset[str]()
    try:
        with claimed(command.out), open_page(page, command.out, terminal, command.page_token) as exchange:
            fly_reported(command, terminal, scene, exchange)
    finally:
        terminal.flush()


def fly_reported(
    command: RunCommand, terminal: Terminal, scene: frozenset[str], exchange: Exchange | None = None
) -> None:
    """The flight from the first message to the last; `scene` names the settings that come from a drawn scene."""
    early: list[str] = []  # lines reported before the recording exists
    keep = early.append
    terminal.listeners.append(keep)
    # Before the flight begins SIGUSR1 must not have its default effect, which is to kill the program.
    signal.signal(signal.SIGUSR1, lambda _number, _frame: terminal.report("not ready yet: SIGUSR1 orders nothing"))
    forwarder = LogForwarder(terminal.report)
    log = logging.getLogger("follow")
    log.addHandler(forwarder)
    log.setLevel(logging.INFO)
    if line := unused_line(command):
        terminal.report(line)
    terminal.report(f"tracker warm after {warm_up():.1f} s")
    tracker = tracker_of(command.tracker)
    with contextlib.ExitStack() as recording:  # outlives the link, whose last message is recorded
        keys = recording.enter_context(Keys())  # from now on keys are read, not echoed
        signing = Signing(command.signing_key) if command.signing_key else None
        starting = recording.enter_context(starting_log(command.out))
        report_once = OnceEach(terminal.report)
        tlog = Tlog(starting, report_once)
        kind = DryRunLink if command.dry_run else MavlinkLink
        with connect(command.link, command.system_id, signing=signing, tlog=tlog, kind=kind) as link:
            flight = prepare(command, link, tracker, refusing_early(keys, terminal.report))
            keys.refuse_early(terminal.report)
            recorder = recording.enter_context(
                begin_recording(command, flight.seen, starting, terminal, early, report_once)
            )
            terminal.listeners.remove(keep)
            recorder.settings(as_toml(command.config, flight.seen.config, scene), command.config.camera.calibration)
            finished = fly_prepared(command, flight, link, recorder, terminal.report, exchange)
            autopilot = link.state().autopilot
        figures: Figures = {"tracker": command.tracker, "autopilot": autopilot.value if autopilot else ""}
        if tlog.lost:
            figures["packets_lost"] = tlog.lost
        figures = recorder.close({**figures, **flight.seen.score()})
    log.removeHandler(forwarder)
    conclude(figures, command.out, terminal, as_json=command.json, finished=finished, failure=recorder.failure)


def unused_line(command: RunCommand) -> str:
    """Which settings of the file are not used, because a drawn scene gave them; "" if there are none."""
    if command.settings is None or command.camera.startswith(SCENE):
        return ""
    values = [f"{name} {value:g}" for name, value in scene_values(command.settings).items() if isinstance(value, float)]
    if not values:
        return ""
    given = f"settings {str(command.settings)!r}: not used, because a drawn scene gave them: {', '.join(values)}"
    return f"{given}; give those of your camera (--camera.fov-deg) and target (--for)"


def refusing_early(keys: Keys, report: Notify) -> Notify:
    """A `report` that first refuses the keys typed before the flight begins."""

    def say(line: str) -> None:
        keys.refuse_early(report)
        report(line)

    return say


@dataclass(frozen=True, slots=True)
class PreparedFlight:
    """An open camera, a warm tracker, and the reasons for which FOLLOW would be refused (`red`)."""

    seen: OpenCamera
    tracker: tuple[Start, Update]
    red: tuple[str, ...]


def prepare(command: RunCommand, link: MavlinkLink, tracker: tuple[Start, Update], report: Notify) -> PreparedFlight:
    """Everything that may refuse a flight and needs the vehicle or the camera."""
    report(f"waiting up to {VEHICLE_S:g} s for a vehicle on {command.link}")
    link.wait_for_vehicle(VEHICLE_S, report)
    report("vehicle found: measuring its message rates and reading its parameters, some 10 s")
    red = unwaived(inspect(command, link), command.waive, report)
    seen = open_camera(command, link, report)
    if command.dry_run:
        report("dry run: nothing that could move the vehicle is sent; fly it by hand")
        limits = replace(
            seen.config.limits, disobey_after_s=NEVER_S
        )  # the pilot flies, so the vehicle does not follow setpoints
        seen = replace(seen, config=replace(seen.config, limits=limits))
    scale, box = seen.scale, seen.target  # messages are in pixels of the source
    size = seen.lens.width * scale, seen.lens.height * scale
    if box is not None and (line := box_in(box.zoomed(scale), *size)):
        report(line)
    if path := command.config.camera.calibration:
        report(f"lens by {path}: {described(seen.lens)}")
    require_height(seen.config)
    if line := height_line(seen.config):
        report(line)
    if red:
        report(f"FOLLOW will be refused: {'; '.join(red)}; fix it, or --waive NAME")
    warm_up()  # again, some 10 s later: what the system dropped from memory meanwhile is read now, not in flight
    return PreparedFlight(seen, tracker, red)


@contextlib.contextmanager
def starting_log(out: Path) -> Generator[Path, None, None]:
    """The file for packets before the flight starts, next to the last flight's; removed if no flight starts."""
    path = out / "starting.tlog"
    try:
        yield path
    finally:
        path.unlink(missing_ok=True)


@contextlib.contextmanager
def begin_recording(
    command: RunCommand, seen: OpenCamera, starting: Path, terminal: Terminal, early: Sequence[str], report_once: Notify
) -> Generator[Recorder, None, None]:
    """The recording of a flight that starts now; moves the last one aside, and includes the `early` messages."""
    keep_flight(command.out, terminal)
    starting.rename(command.out / "flight.tlog")
    about = f"# follow run {command.link} {command.camera}\n\ntracker {command.tracker}"
    kept = kept_geometry(seen.config.servo, seen.down_rad)
    setup = Setup(seen.lens, seen.down_rad, as_toml(seen.config), about=about)
    record = partial(Recorder, waits=False, about=about, clock=time.time, desired=kept, setup=setup, view=command.view)
    with record(command.out, command.config.record, report_once) as recorder:
        for line in early:
            recorder.message(line)
        terminal.listeners.append(recorder.message)
        yield recorder


def fly_prepared(
    command: RunCommand,
    flight: PreparedFlight,
    link: MavlinkLink,
    recorder: Recorder,
    report: Notify,
    exchange: Exchange | None = None,
) -> bool:
    """Build the parts and fly until the end; False if --follow ordered FOLLOW, which never began: that is reported."""
    seen = flight.seen
    operator = Operator(report, command.follow, command.rc_channel, link.client.heard, flight.red)
    operator.watches_sticks = not command.dry_run
    link.listeners.append(AutopilotTexts(report).hear)
    target = Target(seen.lens, seen.down_rad, seen.config.target)
    recent = RecentFrames(seen.camera)
    servo, safety = Servo(seen.down_rad, seen.config.servo), Safety(seen.config.limits)
    meter = ImageMotionMeter(seen.lens, seen.down_rad)
    with recent as camera, ThreadPoolExecutor(1, "click") as looks, contextlib.ExitStack() as open_sides:
        detector, snap = open_detector(command.detector, open_sides)
        tracker = Selector(*flight.tracker, recent, operator.retarget, seen.target, looks, snap)
        operator.forget = target.forget
        tracker.out_of_reach = partial(why_out_of_reach, target)
        if command.aim:
            operator.aim = tracker.restart
        sees: list[Callable[[Tick], object]] = [lambda tick: recorder.tick(tick, seen.truth(tick))]
        consoles = consoles_of(operator, tracker, report, servo, seen.config.limits)
        if command.ground is not None or exchange is not None or command.stick_trims is not None:
            operator.wanted = lambda: consoles.wanted
            sees.append(consoles.see)
        if command.stick_trims is not None:
            sees.append(StickTrims(parse_trims(command.stick_trims), consoles, link.client.heard).see)
        sees += open_sides.enter_context(ground_sides(command, carried_by(link), seen.lens, consoles, report))
        if exchange is not None:
            charge = link.client.heard.charge_percent
            desk = desk_of(exchange, consoles, command.out, is_dry=command.dry_run, charge=charge)
            sees.append(open_sides.enter_context(desk).see)

        def see(tick: Tick) -> None:
            for take in sees:
                take(tick)

        parts = Parts(camera, link, tracker, target, servo, safety, meter, detector)
        is_footage = not is_live(command.camera) and not command.camera.startswith(SCENE)
        over = "the footage is over" if is_footage else "the flight is over"
        fly(parts, operator, see, command.seconds, frames_over=over)
    began = operator.changes.followed or not command.follow
    if not began and (line := operator.changes.early_end()):
        report(line)
    return began
