"""The pilot of a simulated autopilot: keys of the terminal that change the mode, arm, and move or lose the sticks."""

import contextlib
import math
import os
import select
import signal
import sys
import termios
import tty
from collections import deque
from dataclasses import dataclass, field
from typing import Any

from typing_extensions import Self

from follow.messages import NEVER, Autopilot, Notify
from sim.autopilot.core import AutopilotCore, Result

MODES: dict[Autopilot, dict[str, str]] = {
    Autopilot.PX4: {"p": "POSCTL", "l": "HOLD", "a": "ALTCTL", "r": "RTL", "d": "LAND", "g": "OFFBOARD"},
    Autopilot.ARDUPILOT: {
        **{"p": "POSHOLD", "l": "LOITER", "a": "ALT_HOLD", "r": "RTL", "d": "LAND", "g": "GUIDED"},
        "b": "BRAKE",
    },
}
"""Key -> the mode that the pilot's switch requests."""

OTHERS = "w arm or disarm, s push the roll stick and let go, x remote control lost or back, q quit, h this list"
NO_REMOTE = "there is no remote control: start without --no-remote"
PUSH_S = 1.0  # a hand's movement out and back
PUSH = 0.9  # of the stick's travel
KEPT_LINES = 200  # for a terminal that Ctrl-S stopped


@dataclass(slots=True)
class Pilot:
    """Acts on keys.  `step` continues the movement of a pushed stick; `report` gets a line about each key's effect."""

    flight: AutopilotCore
    report: Notify
    leaves: bool = False
    pushed_t_s: float = NEVER  # when the stick that is off its rest was pushed

    def help(self) -> str:
        """The keys, as one line."""
        modes = (f"{key} {mode}" for key, mode in MODES[self.flight.autopilot].items())
        return f"keys: {', '.join(modes)}, {OTHERS}"

    def press(self, key: str) -> None:
        """Do what a key stands for; other keys do nothing."""
        flight = self.flight
        if key == "q":
            self.leaves = True
        elif key in "h?":
            self.report(self.help())
        elif mode := MODES[flight.autopilot].get(key):
            numbers = flight.modes[mode]
            self._say(f"the pilot commands mode {mode}: {flight.ask_mode(numbers.number, numbers.sub)[-1].name}")
        elif key == "w":
            self._say(f"the pilot commands {self._arm_or_disarm()}")
        elif key in "sx":
            self._say(self._push() if key == "s" else self._lose_or_find())

    def step(self) -> None:
        """Move a pushed stick as a hand does: out and back, then at rest."""
        flight = self.flight
        if self.pushed_t_s == NEVER:
            return
        after = (flight.t_s - self.pushed_t_s) / PUSH_S
        if flight.sticks is None or after >= 1.0:
            self.pushed_t_s = NEVER
        if flight.sticks is not None:
            out = (0.0, PUSH * math.sin(math.pi * after), 0.0, 0.0)
            flight.sticks = out if after < 1.0 else flight.resting_sticks

    def _say(self, line: str) -> None:
        self.report(f"{self.flight.t_s:.1f} s: {line}")

    def _arm_or_disarm(self) -> str:
        if not self.flight.armed:
            return f"arming: {self.flight.arm().name}"
        result = self.flight.disarm()
        return f"disarming: {result.name}{'' if result is Result.ACCEPTED else ', it is in the air'}"

    def _push(self) -> str:
        if self.flight.resting_sticks is None:
            return NO_REMOTE
        if self.flight.sticks is None:
            return "no stick moves: the remote control is lost, x brings it back"
        self.pushed_t_s = self.flight.t_s
        return f"the pilot pushes the roll stick and lets go within {PUSH_S:g} s"

    def _lose_or_find(self) -> str:
        flight = self.flight
        if flight.resting_sticks is None:
            return NO_REMOTE
        flight.sticks = None if flight.sticks is not None else flight.resting_sticks
        return f"the remote control is {'lost' if flight.sticks is None else 'back'}"


@dataclass(slots=True)
class Console:
    """The terminal: prints lines and reads keys without ever blocking, even while Ctrl-S has stopped the output.

    Keys are read only from a terminal, and only in its foreground: a background process that reads is stopped.
    """

    lines: deque[str] = field(default_factory=lambda: deque[str](maxlen=KEPT_LINES))
    keyboard: int | None = None
    _before: list[Any] | None = None

    def __enter__(self) -> Self:
        if sys.stdin is not None and sys.stdin.isatty():
            self.keyboard = sys.stdin.fileno()
            signal.signal(signal.SIGTERM, signal.default_int_handler)  # ends as Ctrl-C does: the terminal echoes again
        return self

    def __exit__(self, *_error: object) -> None:
        self.flush()
        if self.keyboard is not None and self._before is not None and self._in_front():
            with contextlib.suppress(termios.error):  # the terminal was closed
                termios.tcsetattr(self.keyboard, termios.TCSANOW, self._before)

    def serve(self, pilot: Pilot) -> None:
        """One round: the pilot acts on the keys, and pending lines are written."""
        for key in self.typed():
            pilot.press(key)
        pilot.step()
        self.flush()

    def report(self, line: str) -> None:
        """Print one line for the user as soon as the terminal accepts it; beyond KEPT_LINES the oldest are dropped."""
        self.lines.append(f"sim.autopilot: {line}\n")
        self.flush()

    def flush(self) -> None:
        """Write the lines that standard error accepts without blocking."""
        while self.lines and takes_text():
            sys.stderr.write(self.lines.popleft())
            sys.stderr.flush()

    def typed(self) -> str:
        """The keys typed since the last call, in lower case."""
        keyboard = self.keyboard
        if keyboard is None or not self._in_front():
            return ""
        try:
            before = termios.tcgetattr(keyboard)
            if before[3] & termios.ICANON:  # at the start, and when a shell brings the process back
                self._before = before
                tty.setcbreak(keyboard, termios.TCSANOW)  # TCSADRAIN and TCSAFLUSH would block on a stopped terminal
            ready = select.select([keyboard], [], [], 0)[0]
            return os.read(keyboard, 64).decode(errors="replace").lower() if ready else ""
        except (OSError, termios.error):  # the terminal was closed
            self.keyboard = None
            return ""

    def _in_front(self) -> bool:
        try:
            return self.keyboard is not None and os.tcgetpgrp(self.keyboard) == os.getpgrp()
        except OSError:  # not this session's terminal, or closed: reading then does not stop the process (SIGTTIN)
            return True


def takes_text() -> bool:
    """Whether standard error takes a line without blocking."""
    try:
        return bool(select.select([], [sys.stderr.fileno()], [], 0)[1])
    except (OSError, ValueError):  # replaced within Python: it has no descriptor
        return True
