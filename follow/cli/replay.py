"""`follow replay`: footage, the virtual camera over it, and the link to a simulated vehicle."""

import math
import os
from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import partial

from follow.camera import Camera
from follow.camera.names import is_live
from follow.camera.sizes import shrink_for, whole
from follow.camera.video import ReplayCamera, open_replay
from follow.camera.window import WindowCamera
from follow.cli.commands import ReplayCommand, box_in, box_of, lens_of
from follow.cli.named import require_encoder, require_source
from follow.cli.settings import as_toml
from follow.config import Config, resolve
from follow.control.footage import FootageTarget
from follow.control.servo import Servo, ServoMode
from follow.control.target import Target
from follow.flight.session import acquire, conclude, fly, keep_flight, kept_geometry, once, require_tracker
from follow.link.replay import ReplayLink
from follow.loop import follow
from follow.messages import Order
from follow.operator.terminal import Terminal
from follow.recording.exact import Setup
from follow.recording.folder import claimed, require_folder
from follow.recording.recorder import Recorder
from follow.recording.scoring import Annotations, FootageScore
from follow.recording.summary import Figures
from follow.safety.gate import Safety
from follow.safety.limits import NEVER_S
from racf.box import Box
from racf.commandline import UsageError

REPLAY_HEIGHT_M = 10.0  # of the simulated vehicle: a common follow-me height
PTZ_SHARE = 3  # the virtual camera shows 1 / 3 of the footage's width and height, pixel for pixel


def replay(command: ReplayCommand) -> None:
    """`follow replay`."""
    if is_live(command.source):
        raise UsageError(f"replay plays files, not the live source {command.source!r}: use follow run")
    if command.truth is not None and not command.truth.is_file():
        raise UsageError(
            f"--truth must be a file of annotations, x,y,w,h in 1-based pixels; {command.truth} is not a file"
        )
    truth = Annotations(command.truth) if command.truth else None
    box = box_of(command.target) if command.target else truth.start if truth else None
    if box is None:
        raise UsageError(
            "what is to be followed? give --target x,y,w,h (0-based pixels) or --truth FILE (1-based pixels)"
        )
    require_source(command.source)
    require_folder(command.out)
    if command.config.record.pictures:
        require_encoder("record.encoder", command.config.record.encoder)
    require_tracker(command.tracker)
    with claimed(command.out):
        replay_into(command, box, truth)


def replay_into(command: ReplayCommand, box: Box, truth: Annotations | None) -> None:
    """Fly in the folder that is now claimed, from the target's box in the first frame."""
    terminal = Terminal()
    config = command.config
    footage = open_replay(command.source, command.fps, terminal.report, whole if command.ptz else shrink_for(box))
    source = os.fsencode(command.source).decode(errors="replace")  # a name need not be UTF-8, a recording must
    about = f"# follow replay {source}\n\ntracker {command.tracker}, {footage.fps:g} frames/s"
    with footage:
        source_size = footage.size[0] * footage.scale, footage.size[1] * footage.scale
        if line := box_in(box, *source_size):
            terminal.report(line)
        now = partial(getattr, footage, "t_s")
        link = ReplayLink(footage.fps, REPLAY_HEIGHT_M, command.autopilot, holds_place=command.ptz, now=now)
        camera: Camera = footage
        lens = lens_of(config.camera, *footage.size)
        ptz = windowed(footage, link, box, config) if command.ptz else None
        score = FootageScore(truth, Box(0, 0, *source_size), (lambda: ptz.window) if ptz else None)
        if ptz is not None:
            camera, lens = ptz, ptz.intrinsics
            box = box.moved(-ptz.window.x, -ptz.window.y)
        box = box.zoomed(1 / footage.scale)
        config = resolve(config, lens, config.camera.down_rad, 0.0)  # a file's frames have no delay
        target = FootageTarget(Target(lens, config.camera.down_rad, config.target), moves_view=command.ptz)
        # The window can turn and climb, but not come nearer, so only SPOTLIGHT works.
        geometry = replace(config.servo, mode=ServoMode.SPOTLIGHT) if command.ptz else config.servo
        servo = Servo(config.camera.down_rad, geometry)
        # The window's vehicle has a fixed position, which must not count as disobeying.
        limits = replace(config.limits, disobey_after_s=NEVER_S) if command.ptz else config.limits
        tracker, safety = acquire(command.tracker, box), Safety(limits)
        keep_flight(command.out, terminal)
        kept, down_rad = kept_geometry(geometry, config.camera.down_rad), config.camera.down_rad
        flown_with = as_toml(replace(config, servo=geometry, limits=limits))
        setup = Setup(lens, down_rad, flown_with, command.ptz, about)
        record = partial(Recorder, waits=True, about=about, desired=kept, setup=setup, view=command.view)
        with link, record(command.out, config.record, terminal.report) as recorder:
            terminal.listeners.append(recorder.message)
            recorder.settings(as_toml(command.config, config), command.config.camera.calibration)
            # No meter: the motion of the camera that filmed the footage is unknown, so there is nothing to compare.
            ticks = follow(camera, link, tracker, target, servo, safety, once(Order.FOLLOW))
            ticks = terminal.progress(ticks, footage.rounds, "replay")
            finished = fly(ticks, recorder, terminal.report, score.add, start=box)
            for line in filter(None, (score.shortfall(), score.left_window(), *refusals(link.refused, finished))):
                terminal.report(line)
            flown: Figures = {"tracker": command.tracker, "autopilot": command.autopilot.value}
            figures = recorder.close({**flown, **score.figures()})
    conclude(figures, command.out, terminal, as_json=command.json, finished=finished, failure=recorder.failure)


def refusals(refused: Mapping[str, int], followed: bool) -> Iterator[str]:
    """What the pretended vehicle did not fly, as sentences; the end of the stream only if there was one."""
    if count := refused["too fast"]:
        yield f"the pretended vehicle refused {count} of the setpoints, because they were faster than any vehicle flies"
    if refused["stream timeout"] and followed:
        yield "no setpoint came for longer than the autopilot waits: the pretended vehicle hovered, as a real one does"


def windowed(footage: ReplayCamera, link: ReplayLink, target: Box, config: Config) -> WindowCamera:
    """The virtual camera on the footage, at first centred on the target.  Raises UsageError for a bent lens."""
    width, height = footage.size
    lens = lens_of(config.camera, width, height)
    if lens.is_bent:
        raise UsageError(
            f"--ptz moves a window over images without distortion, and {config.camera.calibration} describes some: "
            "undistort the footage first, or replay it without --ptz"
        )
    window = (width // PTZ_SHARE, height // PTZ_SHARE)
    # The distance of flat ground in the middle of the image: it sets how far a climb moves the view.
    range_m = REPLAY_HEIGHT_M / max(math.sin(config.camera.down_rad), 0.1)
    return WindowCamera(footage, link.state, lens, window, (target.centre_x, target.centre_y), range_m)
