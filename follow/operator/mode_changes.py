"""Reports changes of the gate's mode to a person, the same in a flight, a replay and a simulation."""

import re
from dataclasses import dataclass, field

from follow.messages import NEVER, Cause, Mode, Notify, Order, Reason, Tick
from follow.safety.modes import FLYING
from racf.box import Box, tiny_line

SAME_EVERY_S = 10.0  # least time between two reports of the same hindrance: it and its figures may flicker
LOOSE = (
    "the box was loose, or beside the target: the tracker started again on what moved in it; look whether that is yours"
)
FIGURES = re.compile(r" \([^)]*\)")


@dataclass(slots=True)
class ModeChanges:
    """Reports a new mode, or a new reason for it, once, with the time since the first round; a tiny target once."""

    report: Notify
    mode: Mode = Mode.OBSERVE
    reason: Reason | None = None
    began_t_s: float = NEVER
    followed: bool = False  # whether FOLLOW has begun
    hindrance: Reason | None = None  # the reason before the program left
    refused: Reason | None = None  # why the last order was refused or void
    ended: str = ""  # when following ended last, and why; empty while it follows, or before
    tiny_told: bool = False
    hindered_t_s: dict[str, float] = field(default_factory=dict[str, float])  # when each hindrance was told
    hindered_s: dict[str, float] = field(default_factory=dict[str, float])  # how long each reason lasted before FOLLOW
    seen_t_s: float = NEVER
    doubt: str = ""  # the last report about a rejected candidate

    def see(self, tick: Tick) -> None:
        """Take one round."""
        before = self.mode, self.reason
        self.mode, self.reason = tick.decision.mode, tick.decision.reason
        if self.began_t_s == NEVER:
            self.began_t_s = tick.state.t_s
        at_s = tick.state.t_s - self.began_t_s
        self._note_hindrance(before[1], tick.state.t_s)
        if tick.instruction.order is not Order.LEAVE:
            self.hindrance = self.reason
        if self.reason.cause in (Cause.ORDER_REFUSED, Cause.ORDER_VOID):
            self.refused = self.reason
        if tick.track is not None and tick.track.found:
            self.tell_tiny(tick.track.box, at_s)
        if tick.track is not None and tick.track.restarted:
            self.report(f"{at_s:.1f} s: {LOOSE}")
        doubt, self.doubt = self.doubt, tick.estimate.doubt.split(" (")[0]
        if self.doubt and self.doubt != doubt:
            self.report(f"{at_s:.1f} s: {tick.estimate.doubt}")
        if (self.mode, self.reason) == before:
            return
        waits = Cause.ORDER_WAITS
        if self.reason.cause is waits and (before[1] is None or before[1].cause is not waits):
            self.hindered_t_s.clear()  # a new order: what it waits for is news
        if before[0] is Mode.OBSERVE is self.mode and self.reason.cause in (Cause.NOT_READY, Cause.ORDER_WAITS):
            words = FIGURES.sub("", str(self.reason))
            if at_s - self.hindered_t_s.get(words, NEVER) < SAME_EVERY_S:
                return
            self.hindered_t_s[words] = at_s
        word = "following ended" if before[0] in FLYING and self.mode is Mode.ENDED else self.mode.value
        self.report(f"{at_s:.1f} s: {word} ({self.reason}), vehicle in {tick.state.mode or 'no known mode'}")
        if self.mode in FLYING:
            self.followed, self.ended = True, ""
        elif before[0] in FLYING:
            self.ended = f"{at_s:.1f} s: {self.reason}"

    def tell_tiny(self, box: Box, at_s: float) -> None:
        """Report a box with too few pixels, the first time."""
        if not self.tiny_told and (line := tiny_line(box)):
            self.tiny_told = True
            self.report(f"{at_s:.1f} s: {line}")

    def early_end(self) -> str:
        """Why the vehicle does not follow in the last round, as one line; empty if it does."""
        if self.mode in FLYING or self.began_t_s == NEVER:
            return ""
        if self.followed:
            return f"following ended early, at {self.ended}"
        return f"FOLLOW never began: {self.refused or self._hindrances()}"

    def _note_hindrance(self, reason: Reason | None, t_s: float) -> None:
        """Add the time up to `t_s` to the reason that hindered FOLLOW until now, if one did."""
        if reason is not None and reason.cause is Cause.NOT_READY and not self.followed:
            words = FIGURES.sub("", str(reason))
            self.hindered_s[words] = self.hindered_s.get(words, 0.0) + t_s - self.seen_t_s
        self.seen_t_s = t_s

    def _hindrances(self) -> str:
        """The last hindrance, after the one that lasted longest if that is another."""
        last = str(self.hindrance)
        longest = max(self.hindered_s, key=self.hindered_s.__getitem__, default="")
        if longest in FIGURES.sub("", last) or self.hindered_s[longest] < 1.0:
            return last
        return f"{longest}, for {self.hindered_s[longest]:.0f} s; at the end: {last}"
