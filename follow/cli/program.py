"""The `follow` command line: parses it and runs the command."""

import os
import sys
import threading
from collections.abc import Sequence
from dataclasses import replace

from follow.camera import CameraError
from follow.cli.commands import (
    CalibrateCommand,
    DoctorCommand,
    InspectCommand,
    ReflyCommand,
    ReplayCommand,
    ReportCommand,
    RunCommand,
    SimCommand,
)
from follow.cli.layers import read, settings_of, with_view, without_scene
from follow.flight.finding import NotFitError
from follow.link import LinkError
from follow.recording.folder import flight_folder
from follow.recording.recorder import RecordingError
from racf.commandline import UsageError, guarded

# Each command's parts are imported when it is run: the help does not wait for the tracker's kernels.
# ruff: noqa: PLC0415


def execute(words: Sequence[str]) -> None:
    """Parse the command line and run its command."""
    words = with_view(words)
    command = read(words)
    if isinstance(command, ReflyCommand | ReportCommand):
        command = replace(command, flight=flight_folder(command.flight))
    if isinstance(command, ReplayCommand | SimCommand | RunCommand) and command.view is not None:
        from follow.recording.viewer import check_view

        try:
            check_view(command.view)
        except ValueError as error:
            raise UsageError(str(error)) from None
    if isinstance(command, SimCommand | ReportCommand | InspectCommand):
        from follow.cli.named import require_named

        require_named(command)
    if isinstance(command, ReplayCommand):
        from follow.cli.replay import replay

        replay(command)
    elif isinstance(command, SimCommand):
        from follow.cli.sim import sim

        sim(command, lambda scenario: settings_of(words, scenario), without_scene(words))
    elif isinstance(command, RunCommand):
        from follow.cli.run import fly_live

        fly_live(command, without_scene(words))
    elif isinstance(command, DoctorCommand):
        from follow.cli.doctor import diagnose

        diagnose(command)
    elif isinstance(command, ReflyCommand):
        from follow.cli.refly import refly

        refly(command)
    elif isinstance(command, ReportCommand):
        from follow.recording.report import write_report

        page = write_report(command.flight, command.out)
        print(f"written: {page}; open it in a browser")
    elif isinstance(command, CalibrateCommand):
        from follow.cli.calibrate import calibrate

        calibrate(command)
    else:
        from follow.recording.viewer import show

        show(command.recording)


def main(argv: Sequence[str] | None = None) -> int:
    """The program; returns the exit status."""
    words = sys.argv[1:] if argv is None else argv
    status = guarded(
        lambda: execute(words), prog="follow", failures=(CameraError, LinkError, NotFitError, RecordingError)
    )
    log = sys.modules.get("follow.recording.rerun_log")
    stuck = any(thread.name in ("the recording", "the view") for thread in threading.enumerate())
    if argv is None and log is not None and (stuck or log.BROKEN):
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(status)  # everything is closed; a normal exit would block in Rerun, waiting for the disk or the viewer
    return status
