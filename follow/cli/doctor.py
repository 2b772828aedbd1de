"""`follow doctor`: is this set-up fit to fly?"""

import json
import sys
import time
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

import cv2

from follow.camera import CameraError
from follow.camera.live import LiveVideo
from follow.camera.names import CameraKind, is_live, parse_camera
from follow.camera.sizes import shrink_for
from follow.camera.video import open_replay
from follow.cli.commands import DoctorCommand
from follow.cli.layers import SCENE
from follow.cli.named import require_camera, require_link
from follow.cli.wave import wave
from follow.config import CameraConfig
from follow.flight import preflight as doctor
from follow.flight.finding import Finding, Health, NotFitError, is_fit, places
from follow.flight.image_checks import check_images
from follow.flight.session import acquire, require_tracker
from follow.flight.vehicle_checks import check_sending, check_signing, check_vehicle
from follow.link import LinkError
from follow.link.connection import connect
from follow.link.signing import Signing
from follow.messages import Frame, Notify
from follow.operator.terminal import Terminal
from follow.recording.folder import require_folder
from racf.box import Box
from racf.commandline import UsageError, plain

PEER_FIX = "look at the address, and what runs there"
CAMERA_S = 3.0  # time over which the gaps between frames are measured
BOX_SHARE = 6  # the timed target is a sixth of the image's height, like a person some 10 m away


def shrink(size: tuple[int, int]) -> int:
    """By how much the loop shrinks images of that (width, height) for the timed target."""
    side = size[1] / BOX_SHARE
    return shrink_for(Box(0.0, 0.0, side, side))(size)


def diagnose(command: DoctorCommand, drawn: CameraConfig | None = None) -> None:
    """Run the checks, report each finding, and raise NotFitError when one of them is red.

    `drawn` is a scene's true camera if it differs from the settings: for tests of --wave.
    """
    if command.camera is not None or command.out.exists():
        require_folder(command.out)
    if command.camera is not None and (is_live(command.camera) or command.camera.startswith(SCENE)):
        require_camera(command.camera)  # footage that is not there is a finding
    if command.camera is not None and not command.camera.startswith(SCENE):
        require_tracker(command.tracker)
    if command.link is not None:
        require_link("--link", command.link)
    terminal = Terminal()
    findings: list[Finding] = []

    def say(found: Sequence[Finding]) -> None:
        findings.extend(found)
        for finding in found:
            terminal.report(str(finding))

    if command.camera is not None:
        say(look(command.camera, command.tracker, command.out, terminal))
    if command.link is not None:
        say(listen(command.link, command.system_id, command.signing_key, terminal.report))
    if command.wave is not None:
        say(wave(command, terminal, drawn))
    if not any(finding.name == "disk" for finding in findings):
        say([doctor.check_disk(command.out)])
    say([doctor.check_time(command.signing_key is not None, time.time())])
    if command.json:
        sys.stdout.write(json.dumps([asdict(finding) for finding in findings], indent=1) + "\n")
    for place in places(findings):
        terminal.report(f"param set: {place}")
    if not is_fit(findings):
        red = ", ".join(finding.name for finding in findings if finding.verdict is Health.RED)
        raise NotFitError(f"not fit to fly: {red}")
    unseen = [f"--{name}" for name in ("camera", "link") if getattr(command, name) is None]
    terminal.report(f"nothing red, but not looked at: {' and '.join(unseen)}" if unseen else "fit to fly")


def look(source: str, tracker: str, out: Path, terminal: Terminal) -> list[Finding]:
    """Check the camera, and the tracker on its frames; save the first in `out`, for reading off a target's box."""
    kept: list[Frame] = []
    if source.startswith(SCENE):
        return [Finding("camera", Health.OK, "a drawn scene: nothing to check")]
    live = is_live(source)
    terminal.report(f"reading frames of {source}, some {CAMERA_S:g} s")
    try:
        report = terminal.report
        with LiveVideo(source, report, shrink=shrink) if live else open_replay(source, None, report, shrink) as camera:
            findings = doctor.check_camera(camera, time.monotonic if live else None, kept, CAMERA_S)
    except CameraError as error:
        return [Finding("camera", Health.RED, str(error), camera_fix(source, str(error)))]
    if len(kept) > 1:
        rows, columns = kept[0].image.shape[:2]
        try:
            out.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise UsageError(f"--out {str(out)!r} must be a folder that can be written: {error.strerror}") from None
        scale = kept[0].scale
        whole = (columns * scale, rows * scale)  # a target's box is given in pixels of the source
        image = kept[0].image if scale == 1 else cv2.resize(kept[0].image, whole, interpolation=cv2.INTER_CUBIC)
        cv2.imwrite(str(out / "camera.png"), image)
        tracked = f", tracked as {columns}x{rows}" if scale > 1 else ""
        terminal.report(f"{whole[0]}x{whole[1]} frames{tracked}, the first is in {out / 'camera.png'}")
        terminal.report(f"timing the tracker on {len(kept) - 1} frames")
        timed = acquire(tracker, Box.around(columns / 2, rows / 2, rows / BOX_SHARE, rows / BOX_SHARE))
        timed.update(kept[0].image)  # its first frame starts it
        fps = (len(kept) - 1) / (kept[-1].t_s - kept[0].t_s)
        findings += [check_images(kept), doctor.check_tracker(timed.update, kept[1:], fps)]
        findings.append(doctor.check_disk(out, (columns, rows)))
    return findings


def listen(uri: str, system_id: int | None, key: Path | None, report: Notify) -> list[Finding]:
    """Check the vehicle behind the link."""
    try:
        signing = Signing(key) if key is not None else None
    except (ValueError, OSError) as error:
        why = plain(error) if isinstance(error, OSError) else str(error)
        return [Finding("signing", Health.RED, f"{why}; the link is not checked", "32 bytes in it, and chmod 600")]
    try:
        with connect(uri, system_id, signing=signing) as link:
            if link.trouble:  # refused: nobody is there to be heard
                return [Finding("link", Health.RED, link.trouble, PEER_FIX)]
            findings = check_vehicle(link.client, link.listen, time.monotonic, report)
            if link.client.vehicle_id is None and link.trouble:
                return [Finding("link", Health.RED, link.trouble, PEER_FIX)]
            signed = check_signing(link.client, signing is not None, link.reach)
            return [*findings, signed, check_sending(link.unsent)]
    except LinkError as error:
        return [Finding("link", Health.RED, str(error))]  # which says what to do


def camera_fix(source: str, error: str) -> str:
    """What to look at if a device or a stream gives nothing; "" if the error itself says what to do."""
    if not is_live(source) or "cannot be opened" not in error:
        return ""
    kind = parse_camera(source).kind
    return {CameraKind.DEVICE: "look at its name and cable", CameraKind.STREAM: "look at its address and network"}.get(
        kind, ""
    )
