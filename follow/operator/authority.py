"""The operator's authority: who may order FOLLOW, and what revokes it.

An order comes from the command line, a key, SIGUSR1, a switch on the remote control or a console.  The same revoke it,
and so do a moved stick and another sender that steers the same vehicle; each of these discards waiting orders.
"""

import contextlib
import os
import re
import select
import signal
import sys
import termios
import tty
from collections.abc import Callable, Generator
from dataclasses import dataclass, field, replace
from types import FrameType
from typing import Protocol

from typing_extensions import Self

from follow.messages import NEVER, Cause, Instruction, Mode, Notify, Order, Reason, Tick, VehicleState
from follow.operator.mode_changes import ModeChanges
from follow.operator.sticks import PWM, StickWatch
from follow.safety.modes import STREAMING
from follow.selection import AS_SET, Wanted

SWITCH_ON_US = 1700  # PWM above which a switch is on; between the two it keeps its state
SWITCH_OFF_US = 1300
RECENT_S = 2.0  # timeout of messages from the remote control and from other senders
EDGE_S = 0.3  # debounce: a switch must keep its new position for this long, because one sample may be wrong

STICKLESS = ("HOLD", "BRAKE", "GUIDED")
"""Modes in which no stick acts, so a moved stick requests the pilot's: they remain after a stream or a lost link."""

KEYS = {"f": Order.FOLLOW, "o": Order.OBSERVE, " ": Order.OBSERVE}
"""Keys in the terminal; `q` ends the flight, `h` and `?` list the keys."""

ESCAPES = re.compile(r"\x1b(?:\[[0-?]*[ -/]*[@-~]|O.|.)?")
"""The escape sequences of keys without a letter: End sends ESC [ F, which must not count as the key f."""

KEYS_HELP = "keys: f follow, o or space observe (give the vehicle back), q leave, h this list"


class RemoteObservations(Protocol):
    """The link's observations that the operator's side reads; `follow.link.telemetry.LinkObservations` has them."""

    rc_channels: tuple[int, ...]
    rc_t_s: float
    steering: dict[tuple[int, int], float]
    joysticks: dict[tuple[int, int], tuple[float, tuple[int, ...]]]


@dataclass(slots=True)
class Remote:
    """The remote control: the state of its switch, and its sticks."""

    channel: int | None = None  # from 1; None: no switch
    was_on: bool | None = None
    turning: tuple[bool, float] | None = None  # a new position of the switch, and since when
    sticks: StickWatch = field(default_factory=StickWatch)

    def forget(self) -> None:
        """Forget the positions after a loss of the remote control: the switch's next position is not an order."""
        self.was_on, self.turning, self.sticks.off_rest = None, None, 0

    def switched(self, channels: tuple[int, ...], t_s: float) -> Order | None:
        """The order that the switch has just given.  The switch's initial position is not an order."""
        if self.channel is None or len(channels) < self.channel or channels[self.channel - 1] not in PWM:
            return None
        pwm = channels[self.channel - 1]
        is_on = pwm >= SWITCH_ON_US
        if SWITCH_OFF_US < pwm < SWITCH_ON_US or is_on is self.was_on:
            self.turning = None
            return None
        if self.turning is None or self.turning[0] is not is_on:
            self.turning = is_on, t_s
        if t_s - self.turning[1] < EDGE_S:
            return None
        before, self.was_on, self.turning = self.was_on, is_on, None
        if before is None:
            return None
        return Order.FOLLOW if is_on else Order.OBSERVE


@dataclass(slots=True)
class Operator:
    """Called by the loop once a round for an instruction.  `see` takes each tick.

    `at_once` orders FOLLOW when the gate is first READY, once.  `red` lists the failed checks that forbid FOLLOW.
    Without `watches_sticks`, in a dry run, moved sticks revoke nothing, because the pilot flies with them.
    """

    report: Notify
    at_once: bool = False
    channel: int | None = None
    heard: RemoteObservations | None = None
    red: tuple[str, ...] = ()
    aim: Callable[[], object] | None = None  # called when FOLLOW is ordered
    forget: Callable[[], object] = lambda: None  # called when the tracker has another target
    retargeted: bool = False
    wanted: Callable[[], Wanted] = lambda: AS_SET  # how a person wants the vehicle to fly now
    watches_sticks: bool = True
    leaving: str = ""  # why the program must end; empty: it goes on
    mode: Mode = Mode.OBSERVE
    reason: Reason | None = None
    ordered: bool = False  # whether FOLLOW was ordered in this round
    state: VehicleState = field(default_factory=lambda: VehicleState(NEVER))
    remote: Remote = field(init=False)
    changes: ModeChanges = field(init=False)
    waiting: list[tuple[Order, str]] = field(default_factory=list[tuple[Order, str]])
    joysticks: dict[tuple[int, int], StickWatch] = field(default_factory=dict[tuple[int, int], StickWatch])

    def __post_init__(self) -> None:
        self.remote = Remote(self.channel)
        self.changes = ModeChanges(self.report)

    def __call__(self) -> Instruction:
        """The instruction of this round."""
        instruction = replace(self.instruction(), wanted=self.wanted())
        if not self.retargeted:
            return instruction
        self.retargeted = False
        self.forget()
        return replace(instruction, aimed=True)

    def retarget(self) -> None:
        """Note that the tracker has another target: in this round the estimate forgets the old one."""
        self.retargeted = True

    def instruction(self) -> Instruction:
        """The order of this round, and what forbids FOLLOW."""
        forbids = "; ".join((*self.red, *self.other_senders()))
        if reason := self.taken_back():
            self.waiting.clear()
            return Instruction(Order.OBSERVE, reason, forbids)
        asked = self.asked()
        if asked is None:
            return Instruction(forbids=forbids)
        order, by = asked
        if order is Order.OBSERVE:
            self.waiting.clear()
            return Instruction(order, Reason(Cause.OBSERVE_ORDERED, by), forbids)
        self.ordered = True
        if self.aim is not None and self.mode not in STREAMING and not forbids:
            self.aim()
        return Instruction(order, Reason(Cause.FOLLOW_ORDERED, by), forbids)

    def see(self, tick: Tick) -> None:
        """Take one round, and report a new mode or a new reason for it once."""
        decision = tick.decision
        if decision.mode is not self.mode and self.mode in STREAMING and decision.mode not in STREAMING:
            self.waiting.clear()
        if self.state.mode and tick.state.mode != self.state.mode:
            self.waiting.clear()
        if self.ordered and decision.reason == self.reason and decision.reason.cause is Cause.ORDER_REFUSED:
            self.report(f"again: {self.reason}")  # `changes` does not repeat the same reason, but the order is new
        self.ordered = False
        self.mode, self.state, self.reason = decision.mode, tick.state, decision.reason
        self.changes.see(tick)

    def order(self, order: Order, by: str = "the program") -> None:
        """Queue an order for the next round.  OBSERVE voids the orders that wait."""
        if order is Order.OBSERVE:
            self.waiting.clear()
        self.waiting.append((order, by))

    def leave(self, why: str) -> None:
        """End the flight; the second call ends it without the ramp."""
        if self.leaving:
            raise KeyboardInterrupt
        self.leaving = why

    def asked(self) -> tuple[Order, str] | None:
        """The order from the switch, the command line, a key, a signal or a console, and its source."""
        if self.hears_remote() and self.heard is not None:
            order = self.remote.switched(self.heard.rc_channels, self.heard.rc_t_s)
            if order is not None:
                return order, f"the switch on channel {self.channel}"
        if self.at_once and self.mode is Mode.READY:
            self.at_once = False
            return Order.FOLLOW, "--follow"
        return self.waiting.pop(0) if self.waiting else None

    def hears_remote(self) -> bool:
        """Whether the remote control is heard now and healthy; forgets its switch's position if it is not."""
        if self.heard is None or not self.is_recent(self.heard.rc_t_s) or self.state.rc_healthy is False:
            self.remote.forget()
            return False
        return True

    def taken_back(self) -> Reason | None:
        """Why control must be revoked: a stick moved, or another sender steers while we stream.

        Sticks also count after the stream has ended, while the vehicle is in a mode in which they do not act.
        """
        streaming = self.mode in STREAMING
        if self.heard is None:
            return None
        healthy = self.hears_remote()
        waiting = self.reason is not None and self.reason.cause is Cause.ORDER_WAITS
        held = self.mode in (Mode.ENDED, Mode.OBSERVE) and self.state.mode in STICKLESS
        reason = self.stick(self.heard, self.watches_sticks and (streaming or waiting or held), healthy)
        if reason is not None and not (held and reason.cause is Cause.STICK_JUMPED):
            return reason
        others = self.other_senders()
        return Reason(Cause.OTHER_SENDER, "; ".join(others)) if streaming and others else None

    def stick(self, heard: RemoteObservations, watching: bool, healthy: bool) -> Reason | None:
        """The reason for a moved stick, of the remote control or of a ground station; None if none moved."""
        remote = self.remote.sticks
        if remote.moved(heard.rc_channels if healthy else (), watching, heard.rc_t_s):
            return Reason(Cause.STICK_JUMPED if remote.has_jumped else Cause.STICK)
        for (system, component), (t_s, channels) in sorted(heard.joysticks.items()):
            watch = self.joysticks.setdefault((system, component), StickWatch())
            recent = self.is_recent(t_s)
            if watch.moved(channels if recent else (), watching, t_s):
                return Reason(Cause.JOYSTICK, f"system {system} component {component}")
        return None

    def other_senders(self) -> tuple[str, ...]:
        """One line for each other sender that steers the vehicle now."""
        steering = self.heard.steering if self.heard is not None else {}
        return tuple(
            f"system {system} component {component} also steers, by setpoints"
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
        operator.order(Order.FOLLOW, "SIGUSR1")

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
            tty.setcbreak(self._file, termios.TCSANOW)  # other options block on a terminal stopped by Ctrl-S
        return self

    def __exit__(self, *_error: object) -> None:
        if self._file is not None and self._before is not None:
            with contextlib.suppress(termios.error):  # the terminal was closed
                termios.tcsetattr(self._file, termios.TCSANOW, self._before)

    def read_into(self, operator: Operator) -> None:
        """Pass the keys typed since the last call to the operator."""
        unknown: set[str] = set()
        for key in self.typed():
            if key == "q":
                operator.leave("key q")
            elif key in KEYS:
                operator.order(KEYS[key], name_of(key))
            elif key in "h?":
                operator.report(KEYS_HELP)
            elif key not in unknown:
                unknown.add(key)
                operator.report(f"{name_of(key)} orders nothing; {KEYS_HELP}")

    def refuse_early(self, report: Notify) -> None:
        """Refuse the keys typed before the flight begins, with a message.  Raises KeyboardInterrupt for `q`."""
        for key in dict.fromkeys(self.typed()):
            if key == "q":
                report(f"leaving: {name_of(key)}")
                raise KeyboardInterrupt
            if key in KEYS:
                report(f"not ready yet: {name_of(key)} orders nothing")
            elif key in "h?":
                report(KEYS_HELP)

    def typed(self) -> str:
        """The keys typed since the last call, in lower case."""
        if self._file is None or not select.select([self._file], [], [], 0)[0]:
            return ""
        try:
            text = os.read(self._file, 64).decode(errors="replace")
            return "".join(c for c in ESCAPES.sub("", text).lower() if c.isprintable())
        except OSError:  # the terminal was closed; SIGHUP reports it
            self._file = None
            return ""

    @property
    def are_there(self) -> bool:
        """Whether standard input is a terminal."""
        return self._file is not None


def name_of(key: str) -> str:
    """A key as messages name it."""
    return "the space bar" if key == " " else f"key {key}"
