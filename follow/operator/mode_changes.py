"""Reports changes of the gate's mode to a person, the same in a flight, a replay and a simulation."""

import re
from dataclasses import dataclass, field

from follow.messages import NEVER, Cause, Mode, Notify, Order, Reason, Tick
from follow.safety.modes import FLYING
from racf.box import tiny_line

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
    doubt: str = ""  # the last report about a rejected candidate

    def see(self, tick: Tick) -> None:
        """Take one round."""
        before = self.mode, self.reason
        self.mode, self.reason = tick.decision.mode, tick.decision.reason
        if self.began_t_s == NEVER:
            self.began_t_s = tick.state.t_s
        at_s = tick.state.t_s - self.began_t_s
        if tick.instruction.order is not Order.LEAVE:
            self.hindrance = self.reason
        if self.reason.cause in (Cause.ORDER_REFUSED, Cause.ORDER_VOID):
            self.refused = self.reason
        if not self.tiny_told and tick.track is not None and tick.track.found and (line := tiny_line(tick.track.box)):
            self.tiny_told = True
            self.report(f"{at_s:.1f} s: {line}")
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
        self.report(f"{at_s:.1f} s: {self.mode.value} ({self.reason}), vehicle in {tick.state.mode or 'no known mode'}")
        if self.mode in FLYING:
            self.followed, self.ended = True, ""
        elif before[0] in FLYING:
            self.ended = f"{at_s:.1f} s: {self.reason}"

    def early_end(self) -> str:
        """Why the vehicle does not follow in the last round, as one line; empty if it does."""
        if self.mode in FLYING or self.began_t_s == NEVER:
            return ""
        if self.followed:
            return f"following ended early, at {self.ended}"
        return f"FOLLOW never began: {self.refused or self.hindrance}"
