"""The operator's authority: who may order FOLLOW, and what takes it back.

An order comes only from the command line, a key, SIGUSR1 or a switch on the remote control.  It is taken back by the
same, by a stick that moves, or by another sender that steers the same vehicle.
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

from follow.messages import NEVER, Mode, Notify, Order, Tick, VehicleState
from follow.safety.modes import STREAMING

SWITCH_ON_US = 1700  # PWM above which a switch is on; between the two it keeps its state
SWITCH_OFF_US = 1300
STICK_US = 150  # 30 % of a stick's travel from the centre: the default of PX4's COM_RC_STICK_OV
STICKS = 4  # channels 1 to 4, in any order
PWM = range(800, 2201)  # valid pulses; 0 and 65535 mean that the channel does not exist
RECENT_S = 2.0  # timeout of messages from the remote control and from other senders

KEYS = {"f": Order.FOLLOW, "o": Order.OBSERVE, " ": Order.OBSERVE}
"""Keys in the terminal; `q` ends the flight."""


class RemoteObservations(Protocol):
    """What the operator's side reads from the link; `follow.link.telemetry.LinkObservations` has it."""

    rc_channels: tuple[int, ...]
    rc_t_s: float
    steering: dict[tuple[int, int], float]


@dataclass(slots=True)
class Remote:
    """The remote control: the state of its switch, and the positions of the sticks when FOLLOW began."""

    channel: int | None = None  # from 1; None: no switch
    was_on: bool | None = None
    sticks: tuple[int, ...] | None = None

    def switched(self, channels: tuple[int, ...]) -> Order | None:
        """The order that the switch has just given.  The switch's initial position is not an order."""
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
        """Whether a stick has left its position at the start of FOLLOW (a throttle rests at its lower end)."""
        sticks = channels[:STICKS]
        if not flying:
            self.sticks = None
        if not flying or len(sticks) < STICKS or any(pwm not in PWM for pwm in sticks):
            return False  # no valid pulses: keep the positions from before the gap
        if self.sticks is None:
            self.sticks = sticks
        return any(abs(now - before) > STICK_US for now, before in zip(sticks, self.sticks, strict=True))


@dataclass(slots=True)
class Operator:
    """Called by the loop once a round for an order.  `see` takes each tick.

    `at_once` orders FOLLOW when the checks are first green, once.  `red` lists the failed checks that forbid FOLLOW.
    """

    report: Notify
    at_once: bool = False
    channel: int | None = None
    heard: RemoteObservations | None = None
    red: tuple[str, ...] = ()
    aim: Callable[[], object] = lambda: None  # called when FOLLOW is ordered
    leaving: str = ""  # why the program must end; empty: it must not
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
        """Take one round, and report a change of mode."""
        mode, before = tick.decision.mode, self.mode
        self.mode, self.state = mode, tick.state
        if mode is not before:
            why = f" ({'; '.join(tick.decision.notes)})" if tick.decision.notes else ""
            self.report(f"{tick.state.t_s:.1f} s: {mode.value}{why}, vehicle in {tick.state.mode or 'no mode'}")

    def order(self, order: Order) -> None:
        """Queue an order; the next round gives it."""
        self.waiting.append(order)

    def leave(self, why: str) -> None:
        """End the flight; the second call ends it without the ramp."""
        if self.leaving:
            raise KeyboardInterrupt
        self.leaving = why

    def asked(self) -> Order | None:
        """The order from the switch, the command line, a key or a signal."""
        if self.heard is not None and self.is_recent(self.heard.rc_t_s):
            order = self.remote.switched(self.heard.rc_channels)
            if order is not None:
                return order
        if self.at_once and self.mode is Mode.READY:
            self.at_once = False
            return Order.FOLLOW
        return self.waiting.pop(0) if self.waiting else None

    def taken_back(self) -> Order | None:
        """OBSERVE when a stick moved or another sender steers while we stream."""
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
        """One line for each other sender that steers the vehicle now."""
        steering = self.heard.steering if self.heard is not None else {}
        return tuple(
            f"system {system} component {component} also sends setpoints"
            for (system, component), t_s in sorted(steering.items())
            if self.is_recent(t_s)
        )

    def is_recent(self, t_s: float) -> bool:
        """Whether a message of `t_s` is younger than its timeout."""
        return self.state.t_s - t_s <= RECENT_S


@contextlib.contextmanager
def signals(operator: Operator) -> Generator[None, None, None]:
    """SIGUSR1 orders FOLLOW; Ctrl-C, SIGTERM and SIGHUP (the terminal was closed) end the flight.

    Restores the previous handlers.
    """

    def usr1(_number: int, _frame: FrameType | None) -> None:
        operator.order(Order.FOLLOW)

    def end(number: int, _frame: FrameType | None) -> None:
        if number == signal.SIGHUP and operator.leaving:
            return  # the shell repeats the SIGHUP that the terminal has sent already
        operator.leave("Ctrl-C" if number == signal.SIGINT else signal.Signals(number).name)

    new = {signal.SIGUSR1: usr1, signal.SIGINT: end, signal.SIGTERM: end, signal.SIGHUP: end}
    old = {number: signal.signal(number, take) for number, take in new.items()}
    try:
        yield
    finally:
        for number, take in old.items():
            signal.signal(number, take)


class Keys:
    """Reads the keyboard without blocking if standard input is a terminal; otherwise does nothing."""

    def __init__(self) -> None:
        self._file = sys.stdin.fileno() if sys.stdin is not None and sys.stdin.isatty() else None
        self._before = termios.tcgetattr(self._file) if self._file is not None else None

    def __enter__(self) -> Self:
        if self._file is not None:
            tty.setcbreak(self._file)
        return self

    def __exit__(self, *_error: object) -> None:
        if self._file is not None and self._before is not None:
            with contextlib.suppress(termios.error):  # the terminal was closed
                termios.tcsetattr(self._file, termios.TCSADRAIN, self._before)

    def read_into(self, operator: Operator) -> None:
        """Pass the keys typed since the last call to the operator."""
        if self._file is None or not select.select([self._file], [], [], 0)[0]:
            return
        try:
            typed = os.read(self._file, 64)
        except OSError:  # the terminal was closed; SIGHUP reports it
            typed, self._file = b"", None
        for key in typed.decode(errors="replace").lower():
            if key == "q":
                operator.leave("key q")
            elif key in KEYS:
                operator.order(KEYS[key])
