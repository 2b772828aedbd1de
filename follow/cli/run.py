"""`follow run`: a real camera or a drawn scene, and a vehicle behind a MAVLink connection."""

import logging
import signal
import time
from collections.abc import Callable
from dataclasses import dataclass, replace

from follow.camera import Camera
from follow.camera.realtime import RealTime
from follow.camera.video import LiveVideo, is_live, open_replay
from follow.cli.commands import RunCommand, box_of
from follow.cli.layers import SCENE
from follow.cli.settings import as_toml
from follow.cli.sim import scene_camera
from follow.config import CameraConfig, Config, resolve
from follow.control.servo import Servo
from follow.control.target import Target
from follow.flight.live_flight import LogForwarder, Parts, fly, preflight, unwaived
from follow.flight.session import acquire, conclude
from follow.geometry import Intrinsics
from follow.link import Link
from follow.link.connection import connect
from follow.link.signing import Signing
from follow.link.tlog import Tlog
from follow.messages import Autopilot, Notify, Tick
from follow.operator.authority import Operator
from follow.operator.terminal import Terminal
from follow.recording.recorder import Recorder, set_aside
from follow.recording.summary import Figures
from follow.safety.gate import Safety
from racf.box import Box
from racf.commandline import UsageError
from racf.tracker import warm_up
from sim.scenarios import SCENARIOS, build_live

VEHICLE_S = 30.0  # an autopilot boots in less
LONG_S = 1800.0  # a scene's target has as long a way where no end is given: a battery's time


@dataclass(frozen=True, slots=True)
class OpenCamera:
    """An open camera and what must be known of it to fly by it; `config` are the settings suited to it."""

    camera: Camera
    lens: Intrinsics
    down_rad: float
    target: Box
    config: Config
    truth: Callable[[Tick], Box | None] = lambda _tick: None


def open_camera(command: RunCommand, link: Link, report: Notify) -> OpenCamera:
    """The camera that the command names; a scene is drawn as seen from where the link says that the vehicle is."""
    if command.camera.startswith(SCENE):
        return open_scene(command, link)
    mount = command.config.camera
    if is_live(command.camera):
        camera, delay_s = LiveVideo(command.camera, report, mount.delay_s), mount.delay_s
    else:
        camera, delay_s = RealTime(open_replay(command.camera, None, report)), 0.0
    lens = mount.intrinsics(*camera.size)
    config = resolve(command.config, lens, mount.down_rad, delay_s)
    return OpenCamera(camera, lens, mount.down_rad, box_of(command.target or ""), config)


def open_scene(command: RunCommand, link: Link, drawn: CameraConfig | None = None) -> OpenCamera:
    """A drawn scene of as long a flight as is asked for, with its own target when no other is named.

    `drawn` is the camera that is drawn where it is not the one that is believed: for tests of a wrong mount.
    """
    scenario = SCENARIOS[command.camera.removeprefix(SCENE)]
    scenario = replace(scenario, duration_s=max(command.seconds or LONG_S, scenario.duration_s))
    autopilot = link.state().autopilot or Autopilot.PX4
    believed = scene_camera(scenario, autopilot, command.config.camera)
    mount = scene_camera(scenario, autopilot, drawn) if drawn else believed
    camera, _ = build_live(scenario, command.seed, autopilot, link, mount)
    target = box_of(command.target) if command.target is not None else camera.first()[1]

    def true_box(tick: Tick) -> Box | None:
        return None if tick.frame is None else camera.truth(tick.frame.index).box

    config = resolve(command.config, believed.intrinsics, believed.down_rad, believed.latency_s)
    return OpenCamera(camera, believed.intrinsics, believed.down_rad, target, config, true_box)


def check(command: RunCommand) -> None:
    """Raise UsageError for what no vehicle is needed to refuse."""
    if command.target is not None:
        box_of(command.target)
    elif not command.camera.startswith(SCENE):
        raise UsageError("what is to be followed? give --target x,y,w,h")
    name = command.camera.removeprefix(SCENE)
    if name != command.camera and name not in SCENARIOS:
        raise UsageError(f"there is no scene {name!r}; there are {', '.join(SCENARIOS)}")


def fly_live(command: RunCommand) -> None:
    """`follow run`."""
    check(command)
    terminal = Terminal()
    # Until there is a flight to order, the signal must not do what it does by default: kill.
    signal.signal(signal.SIGUSR1, lambda _number, _frame: terminal.report("not ready yet: SIGUSR1 orders nothing"))
    spoken = LogForwarder(terminal.report)
    log = logging.getLogger("follow")
    log.addHandler(spoken)
    log.setLevel(logging.INFO)
    terminal.report(f"tracker warm after {warm_up():.1f} s")
    about = f"# follow run {command.link} {command.camera}\n\ntracker {command.tracker}"
    if moved := set_aside(command.out):
        terminal.report(f"the flight that was in {command.out} is now in {moved}")
    with Recorder(
        command.out, command.config.record, terminal.report, waits=False, about=about, clock=time.time
    ) as recorder:
        terminal.listeners.append(recorder.message)
        signing = Signing(command.signing_key) if command.signing_key else None
        tlog = Tlog(command.out / "flight.tlog")
        with connect(command.link, command.system_id, signing=signing, tlog=tlog) as link:
            link.wait_for_vehicle(VEHICLE_S)
            findings = preflight(link, command.out, signs=signing is not None)
            red = unwaived(findings, command.waive, terminal.report)
            seen = open_camera(command, link, terminal.report)
            recorder.settings(as_toml(seen.config))
            heard = link.client.heard
            operator = Operator(terminal.report, command.follow, command.rc_channel, heard, red)
            tracker = acquire(command.tracker, seen.target)
            target = Target(seen.lens, seen.down_rad, seen.config.target)
            if command.aim:
                operator.aim = lambda: (tracker.restart(), target.forget())
            with seen.camera as camera:
                parts = Parts(
                    camera,
                    link,
                    tracker,
                    target,
                    Servo(seen.down_rad, seen.config.servo),
                    Safety(seen.config.limits),
                )
                fly(parts, operator, lambda tick: recorder.tick(tick, seen.truth(tick)), command.seconds)
            autopilot = link.state().autopilot
        figures: Figures = {"tracker": command.tracker, "autopilot": autopilot.value if autopilot else ""}
        figures = recorder.close(figures)
    log.removeHandler(spoken)
    conclude(figures, command.out, terminal, as_json=command.json, finished=True)
