"""One line for each error, with an exit status that separates wrong use from failures."""

import contextlib
import os
import pty
import sys
import termios
from dataclasses import dataclass
from typing import Annotated

import pytest
import tyro

from racf.commandline import UsageError, run


@dataclass(frozen=True)
class Fly:
    """Fly to somewhere."""

    place: tyro.conf.Positional[str]
    speed_m_s: float = 1.0


@dataclass(frozen=True)
class Land:
    """Come down."""


Command = Annotated[Fly, tyro.conf.subcommand("fly")] | Annotated[Land, tyro.conf.subcommand("land")]


class BatteryError(RuntimeError):
    pass


def fly(argv: list[str], error: BaseException | None = None) -> int:
    def execute(command: Fly | Land) -> None:
        if error is not None:
            raise error
        print(command)

    return run(Command, execute, argv, prog="drone", description="Fly.", failures=(BatteryError,))


def test_a_command_that_is_understood_runs_and_ends_in_0(capsys):
    assert fly(["fly", "home", "--speed-m-s", "2"]) == 0
    assert capsys.readouterr().out == "Fly(place='home', speed_m_s=2.0)\n"


@pytest.mark.parametrize(
    ("argv", "named"),
    [
        (["fly", "home", "--speeed", "2"], "--speeed"),
        (["fly"], "place"),
        (["fly", "home", "--speed-m-s", "fast"], "fast"),
        (["swim"], "swim"),
        ([], "fly"),
    ],
)
def test_wrong_use_is_one_line_that_names_the_thing_and_status_2(argv, named, capsys):
    assert fly(argv) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith("drone: error: ")
    assert err.count("\n") == 1
    assert named.lower() in err.lower()


@pytest.mark.parametrize(
    ("error", "status"),
    [
        (UsageError("no place\ncalled home"), 2),
        (ValueError("the place has no height"), 1),
        (FileNotFoundError(2, "No such file", "map.txt"), 1),
        (BatteryError("the battery is empty"), 1),
        (KeyboardInterrupt(), 1),
    ],
)
def test_a_failure_is_one_line_with_its_status(error, status, capsys):
    assert fly(["land"], error) == status
    assert capsys.readouterr().err.count("\n") == 1


def test_a_file_that_is_not_there_is_named_without_the_systems_number(capsys):
    fly(["land"], FileNotFoundError(2, "No such file or directory", "map.txt"))
    assert capsys.readouterr().err == "drone: error: 'map.txt': No such file or directory\n"
    fly(["land"], OSError("there is no map: draw one"))
    assert capsys.readouterr().err == "drone: error: there is no map: draw one\n"


def test_a_bug_keeps_its_traceback():
    with pytest.raises(ZeroDivisionError):
        fly(["land"], ZeroDivisionError())


def test_help_goes_to_standard_output_and_ends_in_0(capsys):
    with pytest.raises(SystemExit) as stop:
        fly(["fly", "--help"])
    assert stop.value.code in {0, None}
    out, err = capsys.readouterr()
    assert "Fly to somewhere." in out
    assert err == ""


def fails_while_standard_error_is(descriptor, monkeypatch) -> int:
    with os.fdopen(descriptor, "w") as stream:
        monkeypatch.setattr(sys, "stderr", stream)
        return fly(["fly", "home"], ValueError("the place has no height"))


def test_a_terminal_stopped_by_ctrl_s_does_not_keep_the_program_from_ending(monkeypatch):
    outside, inside = pty.openpty()
    termios.tcflow(inside, termios.TCOOFF)
    assert fails_while_standard_error_is(inside, monkeypatch) == 1
    os.close(outside)


def test_a_full_pipe_that_nobody_reads_does_not_keep_the_program_from_ending(monkeypatch):
    reading, writing = os.pipe()
    os.set_blocking(writing, False)
    with contextlib.suppress(BlockingIOError):
        while True:
            os.write(writing, bytes(4096))
    os.set_blocking(writing, True)
    assert fails_while_standard_error_is(writing, monkeypatch) == 1
    os.close(reading)


def test_a_terminal_that_takes_text_gets_the_error(monkeypatch):
    outside, inside = pty.openpty()
    assert fails_while_standard_error_is(inside, monkeypatch) == 1
    assert b"drone: error: the place has no height" in os.read(outside, 4096)
    os.close(outside)
