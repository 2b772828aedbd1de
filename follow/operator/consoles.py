"""Many consoles, one commander: who may order, what an order means now, and what each console shows.

A console is anything through which a person orders: the page, a ground station.  The pilot's keys, switch and signals
go to `Operator` directly and need no command.  One console commands at a time: the first that orders, until it hands
over (`release`) or falls silent; STOP works from all.

Track, confirm and follow are separate.  A selected box is tracked and nothing is sent.  FOLLOW flies to a target that
a person drew a moment ago; any other target is proposed first (`Consoles.proposal`) and flown to after CONFIRM.  After
a change of target in flight the vehicle only turns to the new one (spotlight) until FOLLOW is ordered again.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from enum import Enum

from follow.messages import NEVER, Mode, Notify, Order, Tick
from follow.operator.authority import Operator
from follow.safety.modes import FLYING, STREAMING
from follow.selection import (
    ANY_STANDOFF,
    AS_SET,
    HOVER_HERE,
    NOT_KEPT,
    Choice,
    Choose,
    KeptStandoff,
    Selection,
    TrackingState,
    TrackingStatus,
    Wanted,
)

SPOTLIGHT = "spotlight"
DRAWN_S = 10.0  # FOLLOW needs no CONFIRM for a box drawn within this time
CONFIRM_S = 15.0  # timeout of a proposal
SELECT_EVERY_S = 0.3  # rate limit: a flood of selections must not keep the tracker from its work
UNSEEN_S = 1.0  # the proposal mentions that a target was not seen for longer than this
SILENT_S = 10.0  # timeout of a silent commander
STANDOFF_STEP, STANDOFF_RANGE = 1.15, (0.5, 2.5)  # factor of one press, and the range of all of them together
RAISE_STEP_RAD = math.radians(3.0)
RAISE_RANGE = (-math.radians(9.0), math.radians(9.0))  # a third of half a wide view
AROUND_M_S, AROUND_STEP_S = 1.5, 2.0  # one press moves the vehicle 3 m to the side


class ConsoleCommand(str, Enum):
    """What a person may order from a console."""

    FOLLOW = "follow"
    CONFIRM = "confirm"
    SPOTLIGHT = "spotlight"
    HOLD = "hold"
    STOP = "stop"
    NEARER = "nearer"
    FARTHER = "farther"
    HIGHER = "higher"
    LOWER = "lower"
    LEFT = "left"
    RIGHT = "right"
    CHASE = "chase"
    ORBIT = "orbit"
    PROFILE = "profile"
    TOP_DOWN = "top-down"


MODES = (ConsoleCommand.CHASE, ConsoleCommand.ORBIT, ConsoleCommand.PROFILE, ConsoleCommand.TOP_DOWN)
TRIMS = (
    ConsoleCommand.NEARER,
    ConsoleCommand.FARTHER,
    ConsoleCommand.HIGHER,
    ConsoleCommand.LOWER,
    ConsoleCommand.LEFT,
    ConsoleCommand.RIGHT,
)
ASIDE = (ConsoleCommand.LEFT, ConsoleCommand.RIGHT)


PILOTS = (ConsoleCommand.FOLLOW, ConsoleCommand.CONFIRM, ConsoleCommand.SPOTLIGHT, ConsoleCommand.HOLD)
"""Orders whose refusal is also sent to the pilot, whichever console gave them."""

NOTHING = TrackingStatus(TrackingState.IDLE, None, NEVER)


@dataclass(frozen=True, slots=True)
class Reply:
    """The result of an order: done or not, and why, or what to do next."""

    done: bool
    words: str


@dataclass(slots=True)
class Consoles:
    """The consoles' side of the operator, called in the loop's thread only.

    `select` passes a choice to the tracker; while `is_looking` the search for a tap's box is running.  `decided` gets
    its result, and `answer` replies to the console.  `standoff_m` is the configured stand-off, `nearest` the least to
    which it can be trimmed, `kept` the one that the servo keeps.
    """

    operator: Operator
    select: Choose
    report: Notify
    standoff_m: float = 12.0
    nearest: KeptStandoff = ANY_STANDOFF
    kept: Callable[[], KeptStandoff] = lambda: NOT_KEPT
    tell: Notify = lambda _text: None  # a short text for the pilot
    is_looking: Callable[[], bool] = lambda: False
    answer: Callable[[str, Reply], object] = lambda _console, _reply: None
    tapped_by: str = ""
    tap_flies: bool = False  # whether the box of the present tap orders FOLLOW by itself
    asked: bool = False  # whether FOLLOW was ordered, by anybody, and neither revoked nor flown to its end
    commander: str = ""
    wanted: Wanted = AS_SET
    heard_t_s: dict[str, float] = field(default_factory=dict[str, float])
    selected_t_s: float = NEVER
    drawn_t_s: float = NEVER
    proposed_t_s: float = NEVER
    around_until_s: float = NEVER
    flown_mode: str = ""  # the servo mode that FOLLOW flies; empty: the configured one
    set_mode: str = ConsoleCommand.CHASE.value
    status: TrackingStatus = NOTHING  # what every console shows of the tracker
    tick: Tick | None = None

    @property
    def t_s(self) -> float:
        """The loop's time."""
        return NEVER if self.tick is None else self.tick.state.t_s

    @property
    def mode(self) -> Mode:
        """The gate's mode."""
        return Mode.OBSERVE if self.tick is None else self.tick.decision.mode

    def see(self, tick: Tick) -> None:
        """Take one round; the end of a flight resets the trims, and a stop voids earlier orders."""
        was_streaming, vehicle = self.mode in STREAMING, self.tick.state.mode if self.tick is not None else ""
        self.tick, self.status = tick, shown(tick, self.status)
        is_streaming, ordered = self.mode in STREAMING, tick.instruction.order
        if ordered is Order.FOLLOW:
            self.asked = True
        if ordered is Order.OBSERVE or (was_streaming and not is_streaming):
            self._voids()
        elif vehicle and tick.state.mode != vehicle and not is_streaming:
            self.tap_flies = False
        if self.around_until_s <= self.t_s and self.wanted.around_m_s != 0.0:
            self.wanted = replace(self.wanted, around_m_s=0.0)
        if was_streaming and not is_streaming:
            self.wanted = AS_SET

    def _voids(self) -> None:
        """Void all pending orders after a stop or a take-over: they must not act later."""
        self.asked = self.tap_flies = False
        self.proposed_t_s = NEVER

    def hears(self, console: str) -> None:
        """Note a sign of life of a console."""
        self.heard_t_s[console] = self.t_s

    def leaves(self, console: str) -> None:
        """Forget a console that has gone."""
        self.heard_t_s.pop(console, None)
        self.release(console)

    def release(self, console: str) -> Reply:
        """Hand over the command: the next console that orders takes it."""
        if self.commander != console:
            return Reply(False, "you do not command")
        self.commander = ""
        self.report(f"{console} hands over the command")
        return Reply(True, "handed over")

    @property
    def present_commander(self) -> str:
        """The console that commands; empty if nobody does, or if it has fallen silent."""
        is_there = self.t_s - self.heard_t_s.get(self.commander, NEVER) <= SILENT_S
        return self.commander if is_there else ""

    def why_not(self, console: str) -> str:
        """Why this console may not order, empty if it may; it takes the command if nobody has it."""
        self.hears(console)
        holder = self.commander
        if self.present_commander not in ("", console):
            return f"{holder} commands: hand over there first"
        if holder != console:
            self.commander = console
            self.report(f"{console} commands")
        return ""

    def choose(self, choice: Choice, *, flies: bool = False) -> str:
        """Take a selection or a stop from a console; returns why it is refused, or "" if it is accepted.

        `flies`: the selection also orders FOLLOW.
        """
        if not isinstance(choice, Selection):
            self.order(ConsoleCommand.STOP, choice.by)
            return self.select(choice)
        why = self.why_not(choice.by)
        if not why and self.t_s - self.selected_t_s < SELECT_EVERY_S:
            why = "one selection at a time"
        if why:
            return why
        self.selected_t_s = self.t_s
        if why := self.select(choice):
            self.report(f"selection by {choice.by} refused: {why}")
            return why
        self.drawn_t_s, self.proposed_t_s = NEVER, NEVER  # they belong to the previous target
        if self.is_looking():
            self.tapped_by, self.tap_flies = choice.by, flies
        else:
            self._has_selected(choice.by, flies=flies)
        return ""

    def decided(self, why: str) -> None:
        """Take the result of a tap: `why` it selects nothing, so that the old target stays; empty for a new target."""
        by, self.tapped_by = self.tapped_by, ""
        if why:
            self.report(f"selection by {by} refused: {why}")
            self.tell(f"not selected: {why}")
        else:
            self._has_selected(by, flies=self.tap_flies)
        self.answer(by, Reply(not why, f"not selected: {why}" if why else "target selected"))

    def _has_selected(self, by: str, *, flies: bool) -> None:
        """Note that a person's box is the tracker's new target; `flies`: it orders FOLLOW by itself.

        A pending FOLLOW for the previous target is void: it must not fly to the new one.
        """
        self.drawn_t_s, self.proposed_t_s = self.t_s, NEVER
        self.report(f"target selected by {by}")
        self.tell("target selected")
        if flies:
            self.operator.order(Order.FOLLOW, by)
            self.wanted = AS_SET
        elif self.mode in STREAMING:
            self.wanted = Wanted(mode=SPOTLIGHT)
        elif self.asked or any(order is Order.FOLLOW for order, _by in self.operator.waiting):
            self.operator.order(Order.OBSERVE, by)
            self.report("FOLLOW was ordered for the target before: order it again")
            self.tell("new target: order FOLLOW again")

    def order(self, command: ConsoleCommand, by: str) -> Reply:
        """Give an order of a console; returns its result."""
        reply = self._order(command, by)
        self.report(f"{by}: {command.value}: {reply.words}")
        if command is ConsoleCommand.CONFIRM and reply.done:
            self.tell("confirmed")
        elif not reply.done and command in PILOTS:
            self.tell(f"{command.value}: {reply.words}")
        return reply

    def _order(self, command: ConsoleCommand, by: str) -> Reply:
        if command is ConsoleCommand.STOP:
            self.hears(by)
            self.wanted = AS_SET
            self._voids()
            self.operator.order(Order.OBSERVE, by)
            return Reply(True, "stopped")
        if why := self.why_not(by):
            return Reply(False, why)
        if command in (ConsoleCommand.FOLLOW, ConsoleCommand.SPOTLIGHT, ConsoleCommand.CONFIRM):
            return self._fly(command, by)
        return self._trim(command) if command in TRIMS else self._change_mode(command)

    def _change_mode(self, command: ConsoleCommand) -> Reply:
        """Hover, or another servo mode."""
        if command is not ConsoleCommand.HOLD:
            self.flown_mode = command.value
            if self.wanted.mode not in (SPOTLIGHT, HOVER_HERE):
                self.wanted = replace(self.wanted, mode=self.flown_mode)
            return Reply(True, f"will fly {command.value}")
        if self.mode not in FLYING:
            return Reply(False, "nothing is flown")
        self.wanted = Wanted(mode=HOVER_HERE)
        return Reply(True, "hovers; FOLLOW goes on")

    def _fly(self, command: ConsoleCommand, by: str) -> Reply:
        """FOLLOW, SPOTLIGHT, or CONFIRM of what was proposed."""
        if self.status.state is TrackingState.IDLE:
            return Reply(False, "select a target first")
        mode = SPOTLIGHT if command is ConsoleCommand.SPOTLIGHT else self.flown_mode
        is_proposed = self.t_s - self.proposed_t_s <= CONFIRM_S
        is_drawn = self.t_s - self.drawn_t_s <= DRAWN_S
        if command is ConsoleCommand.CONFIRM and not is_proposed:
            return Reply(False, "nothing to confirm: order FOLLOW")
        if command is ConsoleCommand.FOLLOW and not is_drawn:
            self.proposed_t_s = self.t_s
            return Reply(False, f"CONFIRM: {self.proposal()}")
        self.proposed_t_s = NEVER
        self.wanted = Wanted(mode=mode)
        if self.mode not in FLYING or self.mode is Mode.HOLD:
            self.operator.order(Order.FOLLOW, by)
        return Reply(True, "ordered" if self.mode not in FLYING else mode or "follows")

    def _trim(self, command: ConsoleCommand) -> Reply:
        """Change the wanted geometry, not the authority."""
        w = self.wanted
        if why := self.why_untrimmed(command):
            return Reply(False, why)
        if command in (ConsoleCommand.NEARER, ConsoleCommand.FARTHER):
            factor = w.standoff_factor * (STANDOFF_STEP if command is ConsoleCommand.FARTHER else 1 / STANDOFF_STEP)
            w = replace(w, standoff_factor=self.possible(factor))
        elif command in (ConsoleCommand.HIGHER, ConsoleCommand.LOWER):
            raised = w.raise_rad + (RAISE_STEP_RAD if command is ConsoleCommand.HIGHER else -RAISE_STEP_RAD)
            w = replace(w, raise_rad=min(max(raised, RAISE_RANGE[0]), RAISE_RANGE[1]))
        else:
            w = replace(w, around_m_s=AROUND_M_S if command is ConsoleCommand.RIGHT else -AROUND_M_S)
            self.around_until_s = self.t_s + AROUND_STEP_S
        self.wanted = w
        return Reply(True, self.trimmed())

    def why_untrimmed(self, command: ConsoleCommand) -> str:
        """Why a trim would have no effect now, or another one than its name says; empty if it acts."""
        mode = self.wanted.mode or self.set_mode
        if self.mode not in FLYING or mode in (SPOTLIGHT, HOVER_HERE):
            return "trims act while it follows"
        if mode == ConsoleCommand.TOP_DOWN.value:
            return "top-down keeps its height and stays above: nothing to trim"
        if command in ASIDE and mode != ConsoleCommand.CHASE.value:
            return f"{mode} chooses its side itself: left and right act in chase"
        return ""

    @property
    def least_factor(self) -> float:
        """The least factor of the stand-off: by STANDOFF_RANGE, or by `nearest`."""
        return max(STANDOFF_RANGE[0], min(1.0, self.nearest.standoff_m / self.standoff_m))

    def possible(self, factor: float) -> float:
        """The factor of the stand-off, clipped to the range of trims."""
        return min(max(factor, self.least_factor), STANDOFF_RANGE[1])

    def trimmed(self) -> str:
        """The geometry after the trims, and why the vehicle comes no nearer."""
        w = self.wanted
        least = (
            f" (the least: {self.nearest.why})" if STANDOFF_RANGE[0] < self.least_factor == w.standoff_factor else ""
        )
        return f"stand-off {self.standoff_m * w.standoff_factor:.0f} m{least}, {math.degrees(w.raise_rad):+.0f}°"

    def proposal(self) -> str:
        """What would be flown: range, height, stand-off and mode."""
        if self.tick is None:
            return "no estimate yet"
        seen = self.tick.estimate
        height_m, unseen_s = seen.range_m * math.tan(seen.depression_rad), self.tick.state.t_s - seen.seen_t_s
        unseen = f"not seen for {unseen_s:.0f} s; " if unseen_s > UNSEEN_S else ""
        mode = self.flown_mode or self.set_mode
        kept = self.kept()
        at = f"{kept.standoff_m:.0f} m, as {kept.why}" if kept.why else f"{self.standoff_m:.0f} m"
        return f"{unseen}{mode} at {at} (now {seen.range_m:.0f} m away, {height_m:.0f} m above it)"


def shown(tick: Tick, before: TrackingStatus) -> TrackingStatus:
    """The status to show after one round; `before` is the previous one."""
    if tick.frame is None:
        return before
    track = tick.track
    if track is None:
        return TrackingStatus(TrackingState.IDLE, None, tick.frame.t_s)
    rows, columns = tick.frame.image.shape[:2]
    box = track.box.x / columns, track.box.y / rows, track.box.w / columns, track.box.h / rows
    state = TrackingState.ACTIVE if track.found else TrackingState.COASTING
    return TrackingStatus(state, box, tick.frame.t_s)
