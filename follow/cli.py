"""The `follow` command line.  `cli_replay`, `cli_sim` and `cli_run` put the parts of their command together."""

import signal
import sys
from collections.abc import Sequence

from follow.camera import CameraError
from follow.commands import MARKERS, Command, Doctor, Inspect, Replay, Run, Sim
from follow.doctor import NotFitError
from follow.link import LinkError
from racf.commandline import run

# Each command's parts are imported when it is run: the help does not wait for the tracker's kernels.
# ruff: noqa: PLC0415


def execute(command: Replay | Sim | Run | Doctor | Inspect) -> None:
    """Run one command."""
    if isinstance(command, Replay):
        from follow.cli_replay import replay

        replay(command)
    elif isinstance(command, Sim):
        from follow.cli_sim import sim

        sim(command)
    elif isinstance(command, Run):
        from follow.cli_run import fly_live

        fly_live(command)
    elif isinstance(command, Doctor):
        from follow.cli_doctor import diagnose

        diagnose(command)
    else:
        from follow.inspect import show

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
        config=MARKERS,
        failures=(CameraError, LinkError, NotFitError),
    )


if __name__ == "__main__":
    sys.exit(main())
