"""A stopped terminal does not block the program: reports return, and the later output is in order and complete."""

import contextlib
import os
import pty
import re
import signal
import termios
import threading
from collections.abc import Iterator
from itertools import pairwise

import pytest

from follow.operator.authority import Keys
from follow.operator.background import LINES
from follow.operator.terminal import Terminal, result
from tests.follow.test_operator import desk

ENOUGH = 20000  # lines: many times what a terminal or a pipe takes before it blocks
GUARD_S = 20  # a test that waits for a terminal is ended by this; no test needs more than a fraction of it


class WaitedError(Exception):
    """The program waited for the terminal."""


@pytest.fixture(autouse=True)
def guard() -> Iterator[None]:
    """End a test that hangs."""

    def end(_number: int, _frame: object) -> None:
        raise WaitedError

    before = signal.signal(signal.SIGALRM, end)
    signal.setitimer(signal.ITIMER_REAL, GUARD_S, 0.5)  # again, because closing the file waits as well
    yield
    signal.setitimer(signal.ITIMER_REAL, 0)
    signal.signal(signal.SIGALRM, before)


@pytest.fixture(params=["stopped terminal", "unread terminal", "unread pipe"])
def ends(request) -> Iterator[tuple[int, int]]:
    """A terminal or pipe that takes nothing until somebody reads: the reader's end and ours."""
    ours, theirs = os.pipe() if request.param == "unread pipe" else pty.openpty()
    if request.param == "stopped terminal":
        termios.tcflow(theirs, termios.TCOOFF)
    yield ours, theirs
    with contextlib.suppress(OSError):
        os.close(ours)  # ends what the writer waits for
    os.close(theirs)


@contextlib.contextmanager
def shown_on(theirs: int) -> Iterator[Terminal]:
    """A live flight's terminal whose standard error and output are `theirs`."""
    with open(theirs, "w", closefd=False) as file, contextlib.redirect_stderr(file), contextlib.redirect_stdout(file):
        yield Terminal(waits=False)


def read_until(descriptor: int, last: str) -> list[str]:
    """Everything written up to the line `last`."""
    text = b""
    while last.encode() not in text:
        text += os.read(descriptor, 65536)
    return text.decode().split()


def resume(theirs: int) -> None:
    """Resume the output, as Ctrl-Q does."""
    if os.isatty(theirs):
        termios.tcflow(theirs, termios.TCOON)


def test_reports_return_while_nobody_reads_and_reach_the_recording(ends):
    recorded: list[str] = []
    with shown_on(ends[1]) as terminal:
        terminal.listeners.append(recorded.append)
        for i in range(ENOUGH):
            terminal.report(f"line {i}")
        terminal.flush()
    assert recorded == [f"line {i}" for i in range(ENOUGH)]


def test_what_is_shown_later_is_in_order_ends_with_the_newest_and_counts_what_is_missing(ends):
    ours, theirs = ends
    with shown_on(theirs) as terminal:
        for i in range(ENOUGH):
            terminal.report(f"#{i}#")
    resume(theirs)
    words = read_until(ours, f"#{ENOUGH - 1}#")
    shown = [int(word.strip("#")) for word in words if re.fullmatch(r"#\d+#", word)]
    missing = [int(count) for count, older in pairwise(words) if older == "older"]
    assert missing
    assert shown == sorted(set(shown))
    assert shown[-LINES:] == list(range(ENOUGH - LINES, ENOUGH))
    assert len(shown) + sum(missing) == ENOUGH


def test_a_signal_handler_may_report_in_the_middle_of_a_report(ends):
    seen: list[str] = []

    def heard(line: str) -> None:
        seen.append(line)
        if line == "outer":
            signal.raise_signal(signal.SIGUSR1)

    with shown_on(ends[1]) as terminal:
        before = signal.signal(signal.SIGUSR1, lambda _number, _frame: terminal.report("inner"))
        try:
            terminal.listeners.append(heard)
            terminal.report("outer")
        finally:
            signal.signal(signal.SIGUSR1, before)
    assert seen == ["outer", "inner"]


def test_a_reader_that_goes_away_is_no_error(ends):
    ours, theirs = ends
    with shown_on(theirs) as terminal:
        os.close(ours)
        for i in range(ENOUGH):
            terminal.report(f"line {i}")
        terminal.flush()


@pytest.mark.parametrize("ends", ["stopped terminal"], indirect=True)
def test_a_stopped_terminal_gets_no_result_and_gives_its_keyboard_back(ends, monkeypatch):
    _ours, theirs = ends
    with shown_on(theirs):
        result({"in_view": 1.0}, as_json=False)
    with open(theirs, closefd=False) as keyboard:
        monkeypatch.setattr("sys.stdin", keyboard)
        with Keys() as keys:
            keys.read_into(desk().operator)


def test_a_terminal_that_reads_has_every_line_when_flushed():
    ours, theirs = pty.openpty()
    with shown_on(theirs) as terminal:
        for i in range(5):
            terminal.report(f"line  {i} [bold] :smile:")
        terminal.flush()
    assert os.read(ours, 65536).decode() == "".join(f"line {i} [bold] :smile:\r\n" for i in range(5))
    os.close(ours)
    os.close(theirs)


def test_lines_of_several_threads_arrive_whole():
    ours, theirs = os.pipe()
    with shown_on(theirs) as terminal:
        speak = lambda name: [terminal.report(f"{name} {i}") for i in range(LINES // 4)]  # noqa: E731
        threads = [threading.Thread(target=speak, args=(name,)) for name in ("link", "loop")]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        terminal.flush()
    os.close(theirs)
    with open(ours) as reader:
        lines = [line.split() for line in reader]
    for name in ("link", "loop"):
        assert [int(number) for who, number in lines if who == name] == list(range(LINES // 4))
