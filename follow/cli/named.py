"""Checks of the cameras, links and keys that a command line names, before anything is opened."""

import shutil
from pathlib import Path

from follow.camera import CameraError
from follow.camera.names import CameraKind, CameraName, is_live, parse_camera
from follow.camera.program import missing_program, words_of
from follow.camera.video import require_footage
from follow.cli.commands import InspectCommand, ReportCommand, SimCommand
from follow.cli.layers import SCENE, no_scenario
from follow.link import LinkError
from follow.link.addresses import parse_address
from follow.link.signing import read_key
from follow.recording.video_encoder import Encoder, opened
from follow.recording.viewer import recording
from racf.commandline import UsageError, plain
from sim.scenarios import SCENARIOS

TRIAL_SIZE = (640, 360)  # of an image for a trial of an encoder


def require_link(option: str, uri: str) -> None:
    """Raise UsageError for a malformed address; MAVSDK judges its own notation."""
    if uri.startswith("mavsdk+"):
        return
    try:
        parse_address(uri)
    except LinkError as error:
        raise UsageError(f"{option}: {error}") from None


def require_key(path: Path | None) -> None:
    """Raise UsageError for a file that holds no signing key of ours."""
    try:
        if path is not None:
            read_key(path)
    except (OSError, ValueError) as error:
        raise UsageError(f"--signing-key: {plain(error) if isinstance(error, OSError) else error}") from None


def require_camera(source: str) -> None:
    """Raise UsageError for a camera's name that cannot be one; whether a device is there is not looked at."""
    if source.startswith(SCENE):
        name = source.removeprefix(SCENE)
        if name not in SCENARIOS:
            raise no_scenario(name, SCENARIOS)
    elif is_live(source):
        try:
            parse_camera(source)
        except CameraError as error:
            raise UsageError(str(error)) from None
    elif Path(source).exists():
        require_source(source)
    else:
        raise UsageError(
            f"camera {source!r} is not a file or folder, a device (0, /dev/video0), "
            "a stream (rtsp://HOST/PATH), a program (exec:PROGRAM), picamera2 or a drawn scene (scene:NAME)"
        )


def require_source(source: str) -> None:
    """Raise UsageError for footage that is neither a file nor a folder of images."""
    try:
        require_footage(source)
    except CameraError as error:
        raise UsageError(str(error)) from None


def require_encoder(setting: str, encoder: Encoder) -> None:
    """Raise UsageError for a setting's H.264 encoder that does not open here; `auto` takes one that does."""
    if encoder in (Encoder.AUTO, Encoder.JPEG):
        return
    try:
        opened(encoder.value, TRIAL_SIZE)
    except OSError:
        raise UsageError(
            f"{setting} {encoder.value} does not open on this computer: auto takes one that does"
        ) from None


def require_device(camera: CameraName) -> None:
    """Raise UsageError for a device or a program that is not there, before the wait for the vehicle."""
    if camera.kind is CameraKind.DEVICE and not Path(camera.address).exists():
        there = ", ".join(sorted(str(path) for path in Path("/dev").glob("video*"))) or "none: is it plugged in?"
        raise UsageError(f"there is no camera {camera.address}; there are {there}")
    if camera.kind is CameraKind.PROGRAM:
        try:
            program = words_of(camera)[0]
        except CameraError as error:
            raise UsageError(str(error)) from None
        if shutil.which(program) is None:
            raise UsageError(missing_program(camera))


def require_named(command: SimCommand | ReportCommand | InspectCommand) -> None:
    """Raise UsageError for a flight, a recording or a ground station's address that cannot be one."""
    if isinstance(command, SimCommand):
        if command.ground is not None:
            require_link("--ground", command.ground)
    elif isinstance(command, ReportCommand):
        if not (command.flight / "ticks.csv").is_file():
            raise UsageError(f"{str(command.flight)!r} holds no ticks.csv: give the folder of a flight")
    else:
        try:
            recording(command.recording)
        except FileNotFoundError as error:
            raise UsageError(str(error)) from None
