"""The operator's authority: who may order FOLLOW, and what takes it back.

An order comes from the command line, a key, SIGUSR1 or a switch on the remote control, and from nothing else.  It is
taken back by the same ways, by a stick that moves, and by another sender that steers the same vehicle.
"""

import contextlib
import os
import select
import signal
import sys
import termios
import tty
from collections.abc import Callable, Generator
from dataclasses import dataclass, field
from types import FrameType
from typing import Protocol

from typing_extensions import Self

from follow.messages import NEVER, Notify, Order, Tick, VehicleState
from follow.safety.modes import STREAMING, Mode

SWITCH_ON_US = 1700  # PWM of a switch: the usual thirds of 1000..2000
SWITCH_OFF_US = 1300
STICK_US = 150  # 30 % of a stick's way from the middle: the default of PX4's COM_RC_STICK_OV
STICKS = 4  # channels 1-4, in whichever order
PWM = range(800, 2201)  # what a remote control sends; 0 and 65535 say that there is no such channel
RECENT_S = 2.0  # a message of the remote control or of another sender older than this says nothing of now

KEYS = {"f": Order.FOLLOW, "o": Order.OBSERVE, " ": Order.OBSERVE}
"""Keys in the terminal; `q` leaves."""


class RemoteObservations(Protocol):
    """What the operator's side needs of the link, as `follow.link.telemetry.Heard` has it."""

    rc_channels: tuple[int, ...]
    rc_t_s: float
    steering: dict[tuple[int, int], float]


@dataclass(slots=True)
class Remote:
    """The remote control: the order of its switch's last change, and whether a stick was moved since FOLLOW began."""

    channel: int | None = None  # from 1; None: no switch
    was_on: bool | None = None
    sticks: tuple[int, ...] | None = None

    def switched(self, channels: tuple[int, ...]) -> Order | None:
        """The order that the switch has just given.  Where it stands at the start is none."""
        if self.channel is None or len(channels) < self.channel or channels[self.channel - 1] not in PWM:
            return None
        pwm = channels[self.channel - 1]
        if SWITCH_OFF_US < pwm < SWITCH_ON_US:
            return None
        before, self.was_on = self.was_on, pwm >= SWITCH_ON_US
        if before in (None, self.was_on):
            return None
        return Order.FOLLOW if self.was_on else Order.OBSERVE

    def stick_moved(self, channels: tuple[int, ...], flying: bool) -> bool:
        """Whether a stick has left the place where it was when FOLLOW began (a throttle rests at its lower end)."""
        sticks = channels[:STICKS]
        if not flying:
            self.sticks = None
        if not flying or len(sticks) < STICKS or any(pwm not in PWM for pwm in sticks):
            return False  # a remote that is not heard for a while has rested where it did before
        if self.sticks is None:
            self.sticks = sticks
        return any(abs(now - before) > STICK_US for now, before in zip(sticks, self.sticks, strict=True))


@dataclass(slots=True)
class Operator:
    """Called by the loop once a round for an order.  `see` tells it of each tick.

    `at_once` orders FOLLOW when the checks are first green, once.  `red` says what forbids to follow.
    """

    report: Notify
    at_once: bool = False
    channel: int | None = None
    heard: RemoteObservations | None = None
    red: tuple[str, ...] = ()
    aim: Callable[[], object] = lambda: None  # called as FOLLOW is ordered
    leaving: str = ""  # why the program is to end, empty while it is not
    mode: Mode = Mode.OBSERVE
    state: VehicleState = field(default_factory=lambda: VehicleState(NEVER))
    remote: Remote = field(init=False)
    waiting: list[Order] = field(default_factory=list[Order])

    def __post_init__(self) -> None:
        self.remote = Remote(self.channel)

    def __call__(self) -> Order | None:
        """The order of this round."""
        order = self.taken_back() or self.asked()
        if order is Order.FOLLOW and self.mode not in STREAMING:
            if red := (*self.red, *self.other_senders()):
                self.report(f"will not follow: {'; '.join(red)}")
                return None
            self.report("ordered to follow")
            self.aim()
        return order

    def see(self, tick: Tick) -> None:
        """Take in one round, and say what changed."""
        mode, before = Mode(tick.decision.mode), self.mode
        self.mode, self.state = mode, tick.state
        if mode is not before:
            why = f" ({'; '.join(tick.decision.notes)})" if tick.decision.notes else ""
            self.report(f"{tick.state.t_s:.1f} s: {mode.value}{why}, vehicle in {tick.state.mode or 'no mode'}")

    def order(self, order: Order) -> None:
        """Take an order from elsewhere; it is given in the next round."""
        self.waiting.append(order)

    def leave(self, why: str) -> None:
        """End the flight; asked twice, end it without the ramp."""
        if self.leaving:
            raise KeyboardInterrupt
        self.leaving = why

    def asked(self) -> Order | None:
        """What a person asks for by any of the ways."""
        if self.heard is not None and self.is_recent(self.heard.rc_t_s):
            order = self.remote.switched(self.heard.rc_channels)
            if order is not None:
                return order
        if self.at_once and self.mode is Mode.READY:
            self.at_once = False
            return Order.FOLLOW
        return self.waiting.pop(0) if self.waiting else None

    def taken_back(self) -> Order | None:
        """OBSERVE when a stick moved or another sender steers while we do."""
        flying = self.mode in STREAMING
        if self.heard is None:
            return None
        moved = self.remote.stick_moved(self.heard.rc_channels, flying)
        if not flying:
            return None
        if moved:
            self.report("a stick was moved: the pilot has control")
            return Order.OBSERVE
        if others := self.other_senders():
            self.report(f"stopping: {'; '.join(others)}")
            return Order.OBSERVE
        return None

    def other_senders(self) -> tuple[str, ...]:
        """Who else steers the vehicle now."""
        steering = self.heard.steering if self.heard is not None else {}
        return tuple(
            f"system {system} component {component} sends setpoints, too"
            for (system, component), t_s in sorted(steering.items())
            if self.is_recent(t_s)
        )

    def is_recent(self, t_s: float) -> bool:
        """Whether something happened so lately that it says something of now."""
        return self.state.t_s - t_s <= RECENT_S


@contextlib.contextmanager
def signals(operator: Operator) -> Generator[None, None, None]:
    """SIGUSR1 orders FOLLOW; Ctrl-C, SIGTERM and SIGHUP (the terminal is gone) leave.

    Restores what they did before.
    """

    def usr1(_number: int, _frame: FrameType | None) -> None:
        operator.order(Order.FOLLOW)

    def end(number: int, _frame: FrameType | None) -> None:
        if number == signal.SIGHUP and operator.leaving:
            return  # a shell passes on what the terminal has told already
        operator.leave("Ctrl-C" if number == signal.SIGINT else signal.Signals(number).name)

    new = {signal.SIGUSR1: usr1, signal.SIGINT: end, signal.SIGTERM: end, signal.SIGHUP: end}
    old = {number: signal.signal(number, take) for number, take in new.items()}
    try:
        yield
    finally:
        for number, take in old.items():
            signal.signal(number, take)


class Keys:
    """The keyboard, read without waiting, when standard input is a terminal; nothing otherwise."""

    def __init__(self) -> None:
        self._file = sys.stdin.fileno() if sys.stdin is not None and sys.stdin.isatty() else None
        self._before = termios.tcgetattr(self._file) if self._file is not None else None

    def __enter__(self) -> Self:
        if self._file is not None:
            tty.setcbreak(self._file)
        return self

    def __exit__(self, *_error: object) -> None:
        if self._file is not None and self._before is not None:
            with contextlib.suppress(termios.error):  # the terminal is gone
                termios.tcsetattr(self._file, termios.TCSADRAIN, self._before)

    def read_into(self, operator: Operator) -> None:
        """Give the operator's side what was typed since the last call."""
        if self._file is None or not select.select([self._file], [], [], 0)[0]:
            return
        try:
            typed = os.read(self._file, 64)
        except OSError:  # the terminal is gone; SIGHUP says so, too
            typed, self._file = b"", None
        for key in typed.decode(errors="replace").lower():
            if key == "q":
                operator.leave("key q")
            elif key in KEYS:
                operator.order(KEYS[key])
