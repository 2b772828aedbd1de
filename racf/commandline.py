"""The command line of every program of this project: one-line errors and exit statuses.

Exit status: 0 done, 1 the run failed, 2 wrong use.  An error is one line on standard error.
"""

import contextlib
import io
import re
import select
import signal
import sys
from collections.abc import Callable, Sequence
from typing import Any, TextIO, TypeVar, cast

import tyro

import racf
from racf.errors import UsageError
from racf.threads import one_core

__all__ = ["StopReported", "UsageError", "guarded", "parse", "run"]

CommandT = TypeVar("CommandT")

_PARSING = re.compile(r"^Error parsing (?!-)\S+: ")  # the prefix before an error from a dataclass of ours
_VALUE = re.compile(
    r"^Error parsing (-\S+): (?:could not convert string to (float)|invalid literal for int\(\).*): (.*)$"
)
_OPTIONAL = re.compile(
    r"^Error parsing (-\S+): no type matching \S+\|(INT|FLOAT) could be instantiated from \[(.*)\]\.?$"
)
_OPTION = re.compile(r"^Error parsing (-\S+): (.*)$")
_CHOICE = re.compile(r"^invalid choice (.+) for argument '(\S+)'\. Expected one of \((.*)\)\.$")
_UNKNOWN = re.compile(r"^Unrecognized options: (.*)$")
STOPPED_S = 0.5
"""Maximum wait for a terminal that Ctrl-S stopped: the program must end, and its exit status shows the failure."""

_FRAME = re.compile(r"[─-╿]+|-{5,}")  # the block of box-drawing characters; dashes if the output is not UTF-8


class StopReported(KeyboardInterrupt):
    """The program ended before its work was done, and has already reported that."""


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
    except StopReported:
        return 1
    except KeyboardInterrupt:
        return _complain(prog, "stopped before it was done (Ctrl-C or SIGTERM)", 1)
    except BrokenPipeError:
        return 1  # the reader of our output has closed it, so there is no message
    except (OSError, ValueError, *failures) as error:
        return _complain(prog, plain(error) if isinstance(error, OSError) else error, 1)
    return 0


def plain(error: OSError) -> str:
    """The error without its number: the file and the system's text, or the sentence that it was raised with."""
    if error.filename is None or not error.strerror:
        return str(error)
    return f"{str(error.filename)!r}: {error.strerror}"


def parse(
    commands: Any, argv: Sequence[str] | None, *, prog: str, description: str, config: Sequence[Any] = ()
) -> object:
    """The command in `argv`; raises UsageError if it cannot be parsed, SystemExit(0) after `--help` or `--version`."""
    if list(sys.argv[1:] if argv is None else argv) == ["--version"]:
        print(f"{prog} {racf.__version__}")  # noqa: T201 - the requested output
        raise SystemExit(0)
    complaint = io.StringIO()
    try:
        with contextlib.redirect_stderr(complaint):
            return tyro.cli(commands, args=argv, prog=prog, description=description, config=config)
    except SystemExit as stop:
        if not stop.code:
            raise
        raise UsageError(one_line(complaint.getvalue()) or f"cannot read the command line; see {prog} --help") from None


def one_line(framed: str) -> str:
    """The sentence in the frame that tyro draws around an error: option, rule, value, and the nearest known option."""
    sentence: list[str] = []
    lines = framed.splitlines()
    if len(lines) > 1 and set(lines[1].strip()) == {"-"}:  # without box characters: a title over a rule
        lines = lines[2:]
    for line in lines:
        if "╭" in line:  # ╭: the frame's top edge, which carries the title
            continue
        if "├" in line or (not _FRAME.sub("", line).strip() and sentence):  # a rule: what follows is the footer
            break
        sentence.append(_FRAME.sub(" ", line).strip())
    text = " ".join(" ".join(sentence).split())
    if found := _VALUE.match(text):
        return f"{found[1]} must be a {'' if found[2] else 'whole '}number, not {found[3]}"
    if found := _OPTIONAL.match(text):
        return f"{found[1]} must be a {'' if found[2] == 'FLOAT' else 'whole '}number, not {found[3]}"
    if found := _OPTION.match(text):
        return f"{found[1]}: {found[2]}"
    if found := _CHOICE.match(text):
        choices = sorted(choice for choice in re.findall(r"'([^']*)'", found[3]) if choice != "None")
        return f"{found[2]} must be one of {', '.join(choices)}, not {found[1]}"
    if found := _UNKNOWN.match(text):
        return _unknown(found[1].split(", "), framed)
    return _PARSING.sub("", text)


def _unknown(words: Sequence[str], framed: str) -> str:
    """The error message for words that tyro does not know; `framed` also holds its suggestions."""
    footer = " ".join(_FRAME.sub(" ", framed).split())
    options = [word for word in words if word.startswith("-")]
    if options:
        near = re.search(r"Perhaps you meant: (--\S+)", footer)
        also = f"; the nearest is {near[1].rstrip(',')}" if near else "; --help lists the options"
        return f"there is no option {' or '.join(options)}{also}"
    commands = re.search(r"Available subcommands: (.*?) For full helptext", footer)
    if commands:
        return f"there is no command {words[0]!r}; the commands are {commands[1]}"
    return f"{' '.join(words)!r} is one word too many; --help shows what is expected"


def _complain(prog: str, error: object, status: int) -> int:
    text = " ".join(str(error).split()) or type(error).__name__
    if _takes_text(sys.stderr):
        print(f"{prog}: error: {text}", file=sys.stderr)  # noqa: T201 - the one place where a program speaks of failure
    return status


def _takes_text(stream: TextIO | None) -> bool:
    """Whether a line can be written without blocking: not to a stopped terminal nor to a full pipe."""
    try:
        return stream is not None and bool(select.select([], [stream.fileno()], [], STOPPED_S)[1])
    except (OSError, ValueError):  # replaced within Python: it has no descriptor
        return True
