"""The `follow` command line.  `cli_replay`, `cli_sim` and `cli_run` put the parts of their command together."""

import sys
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, cast

from follow.camera import CameraError
from follow.cli.commands import MARKERS, DoctorCommand, InspectCommand, ReplayCommand, RunCommand, SimCommand, commands
from follow.cli.settings import named, settings_of
from follow.flight.preflight import NotFitError
from follow.link import LinkError
from racf.commandline import guarded, parse

# Each command's parts are imported when it is run: the help does not wait for the tracker's kernels.
# ruff: noqa: PLC0415

ABOUT = "Keep a target in view: PX4 and ArduPilot, replayed footage, or a simulated flight."


def execute(command: ReplayCommand | SimCommand | RunCommand | DoctorCommand | InspectCommand) -> None:
    """Run one command."""
    if isinstance(command, ReplayCommand):
        from follow.cli.replay import replay

        replay(command)
    elif isinstance(command, SimCommand):
        from follow.cli.sim import sim

        sim(command)
    elif isinstance(command, RunCommand):
        from follow.cli.run import fly_live

        fly_live(command)
    elif isinstance(command, DoctorCommand):
        from follow.cli.doctor import diagnose

        diagnose(command)
    else:
        from follow.recording.viewer import show

        show(command.recording)


def main(argv: Sequence[str] | None = None) -> int:
    """The program; returns the exit status."""
    words = sys.argv[1:] if argv is None else argv

    def work() -> None:
        known = commands(settings_of(words))
        command = cast(Any, parse(known, words, prog="follow", description=ABOUT, config=MARKERS))
        flies = isinstance(command, ReplayCommand | SimCommand | RunCommand)
        execute(replace(command, named=named(words)) if flies else command)

    return guarded(work, prog="follow", failures=(CameraError, LinkError, NotFitError))
