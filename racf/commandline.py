"""The command line of every program of this project: one-line errors and exit statuses.

Exit status: 0 done, 1 the run failed, 2 wrong use.  An error is one line on standard error.
"""

import contextlib
import io
import re
import signal
import sys
from collections.abc import Callable, Sequence
from typing import Any, TypeVar, cast

import tyro

from racf.errors import UsageError
from racf.threads import one_core

__all__ = ["UsageError", "guarded", "parse", "run"]

CommandT = TypeVar("CommandT")

_PARSING = re.compile(r"^Error parsing \S+: ")  # before what a dataclass of ours says itself
_FRAME = re.compile(r"[─-╿]+")  # the block of box-drawing characters


def run(
    commands: Any,
    execute: Callable[[CommandT], None],
    argv: Sequence[str] | None = None,
    *,
    prog: str,
    description: str,
    failures: tuple[type[Exception], ...] = (),
    config: Sequence[Any] = (),
) -> int:
    """Parse `argv` into one of `commands` (a dataclass or a union of them), execute it, return the exit status.

    `config` holds tyro's own markers, applied to the whole tree.
    """
    return guarded(
        lambda: execute(cast(CommandT, parse(commands, argv, prog=prog, description=description, config=config))),
        prog=prog,
        failures=failures,
    )


def guarded(work: Callable[[], None], *, prog: str, failures: tuple[type[Exception], ...] = ()) -> int:
    """Do the work of a program and return its exit status, with its error on one line.

    UsageError gives 2; OSError, ValueError and the `failures` that a program's own parts raise give 1.  Anything else
    is a bug and keeps its traceback.
    """
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # a service manager's stop ends as cleanly as Ctrl-C
    one_core()
    try:
        work()
    except UsageError as error:
        return _complain(prog, error, 2)
    except KeyboardInterrupt:
        return _complain(prog, "interrupted", 1)
    except BrokenPipeError:
        return 1  # the reader of our output closed it: nobody reads a message
    except (OSError, ValueError, *failures) as error:
        return _complain(prog, error, 1)
    return 0


def parse(
    commands: Any, argv: Sequence[str] | None, *, prog: str, description: str, config: Sequence[Any] = ()
) -> object:
    """The command in `argv`; raises UsageError if it cannot be parsed, SystemExit(0) after `--help`."""
    complaint = io.StringIO()
    try:
        with contextlib.redirect_stderr(complaint):
            return tyro.cli(commands, args=argv, prog=prog, description=description, config=config)
    except SystemExit as stop:
        if not stop.code:
            raise
        raise UsageError(one_line(complaint.getvalue()) or f"cannot read the command line; see {prog} --help") from None


def one_line(framed: str) -> str:
    """The sentence inside the frame that tyro draws around an error, without its title and footer."""
    said: list[str] = []
    for line in framed.splitlines():
        if "╭" in line:  # ╭: the frame's top edge, which carries the title
            continue
        if "├" in line or (not _FRAME.sub("", line).strip() and said):  # a rule: what follows is the footer
            break
        said.append(_FRAME.sub(" ", line).strip())
    return _PARSING.sub("", " ".join(" ".join(said).split()))


def _complain(prog: str, error: object, status: int) -> int:
    text = " ".join(str(error).split()) or type(error).__name__
    print(f"{prog}: error: {text}", file=sys.stderr)  # noqa: T201 - the one place where a program speaks of failure
    return status
