"""Messages to the pilot over MAVLink: a short text at each change, and three figures twice a second.

A pilot beside a flying vehicle has two seconds to read a text, so it has at most 50 letters, says what happens before
why, and is sent at most once a second; the queue drops its oldest texts.
"""

import math
from collections import deque
from dataclasses import dataclass, field
from typing import Protocol

from pymavlink.dialects.v20 import common as dialect

from follow.messages import NEVER, Cause, Mode, Tick

PREFIX = "Follow: "
TEXT_EVERY_S = 1.0
SAME_EVERY_S = 10.0  # the same text again, if it is true again
WAITING = 3  # length of the queue; older texts are no longer true
VALUES_EVERY_S = 0.5
LOST_AFTER_S = 0.7  # a shorter loss of the target is not reported

SAYS = {
    Mode.READY: "ready, FOLLOW can be ordered",
    Mode.ENGAGE: "taking over",
    Mode.FOLLOW: "following",
    Mode.COAST: "target lost, slowing",
    Mode.SEARCH: "searching",
    Mode.HOLD: "given up, hovers",
    Mode.BRAKE: "braking",
    Mode.ENDED: "ended",
    Mode.OBSERVE: "not ready",
}
"""The text for each mode of the gate."""

WARNINGS = (Mode.COAST, Mode.SEARCH, Mode.HOLD, Mode.BRAKE, Mode.ENDED)
QUIET = (Cause.SEEN, Cause.READY, Cause.BEGAN, Cause.STARTED, Cause.FRESH)
"""Causes that add nothing to the mode's text."""

LOOSE = "box was loose: follows what moved in it"
"""The text for a restarted tracker."""


class TextLink(Protocol):
    """Sends texts and figures; `follow.link.client.MavlinkClient` is one."""

    def tell(self, text: str, severity: int) -> None:
        """Queue one text."""
        ...

    def tell_value(self, name: str, value: float, t_s: float) -> None:
        """Queue one figure."""
        ...


@dataclass(slots=True)
class PilotTexts:
    """Tells the pilot of changes; `see` takes each tick, `say` a line of a console."""

    pilot: TextLink
    shown: str = ""
    sent_t_s: float = NEVER
    values_t_s: float = NEVER
    mode_since_s: float = NEVER
    mode: Mode | None = None
    last: dict[str, float] = field(default_factory=dict[str, float])
    waiting: deque[tuple[str, int]] = field(default_factory=lambda: deque[tuple[str, int]](maxlen=WAITING))

    def say(self, text: str, *, warns: bool = False) -> None:
        """Queue a text for the pilot, unless it is already queued."""
        severity = dialect.MAV_SEVERITY_WARNING if warns else dialect.MAV_SEVERITY_INFO
        if text not in (waiting for waiting, _ in self.waiting):
            self.waiting.append((text, severity))

    def see(self, tick: Tick) -> None:
        """Take one round."""
        decision, t_s = tick.decision, tick.state.t_s
        if decision.mode is not self.mode:
            self.mode, self.mode_since_s = decision.mode, t_s
        text = sentence(tick)
        settled = decision.mode is not Mode.COAST or t_s - self.mode_since_s >= LOST_AFTER_S
        if settled and text != self.shown:
            self.shown = text
            self.say(text, warns=decision.mode in WARNINGS)
        for note in decision.notes:
            if note.startswith(("slower:", "slow:")) and decision.mode is Mode.FOLLOW and self.is_news(note, t_s):
                self.say(note.replace("limits.", ""))
            if note.startswith("not taken:") and self.is_news(text := f"{note.split(' (')[0]}, select again", t_s):
                self.say(text, warns=True)
        if tick.track is not None and tick.track.restarted and self.is_news(LOOSE, t_s):
            self.say(LOOSE, warns=True)
        self.send(t_s)
        if t_s - self.values_t_s >= VALUES_EVERY_S and tick.estimate.seen_t_s > NEVER:
            self.values_t_s = t_s
            for name, value in figures(tick).items():
                self.pilot.tell_value(name, value, t_s)

    def is_news(self, text: str, t_s: float) -> bool:
        """Whether a text was not sent in the last SAME_EVERY_S."""
        if t_s - self.last.get(text, NEVER) < SAME_EVERY_S:
            return False
        self.last[text] = t_s
        return True

    def send(self, t_s: float) -> None:
        """Send the oldest waiting text, if one is due."""
        if self.waiting and t_s - self.sent_t_s >= TEXT_EVERY_S:
            text, severity = self.waiting.popleft()
            self.sent_t_s = t_s
            self.pilot.tell(PREFIX + text, severity)


SHORT = {
    Cause.OBSERVE_ORDERED: "stopped by {what}",
    Cause.STICK: "your stick moved, you fly",
    Cause.JOYSTICK: "your stick moved, you fly",
    Cause.STICK_JUMPED: "a stick jumped to its end",
    Cause.IGNORED: "the autopilot does not obey",
    Cause.MODE_LEFT: "ended, mode is {what}",
    Cause.STREAM_PAUSED: "ended, computer stalled",
    Cause.DISARMED: "ended, disarmed",
    Cause.HOLD_OVER: "ended, nobody took over",
    Cause.LANDED: "ended, on the ground",
    Cause.BATTERY: "battery {what}, stops",
    Cause.REMOTE_LOST: "remote control lost, stops",
    Cause.NOT_OBEYING: "vehicle does not obey, stops",
    Cause.OUT_OF_REACH: "target out of reach",
}
"""Short texts for causes whose own sentence is too long to read in two seconds."""


def sentence(tick: Tick) -> str:
    """The text for a tick: what happens, and why unless the cause adds nothing."""
    decision = tick.decision
    says, cause = SAYS[decision.mode], decision.reason.cause
    if cause in QUIET:
        return says
    if cause is Cause.REFUSED:
        return f"{decision.reason.what.removeprefix('the autopilot ')}"
    if cause in SHORT:
        return SHORT[cause].format(what=decision.reason.what)
    if decision.mode is Mode.OBSERVE and cause in (Cause.ORDER_REFUSED, Cause.ORDER_VOID, Cause.ORDER_WAITS):
        says = {Cause.ORDER_REFUSED: "refused", Cause.ORDER_VOID: "order void", Cause.ORDER_WAITS: "waits"}[cause]
        return f"{says}: {decision.reason.what.rpartition('; waits ')[2]}"  # the text has no room for who ordered
    if cause is Cause.NOT_SEEN or (cause is Cause.FOLLOW_ORDERED and decision.mode is Mode.ENGAGE):
        return says
    return f"{says}: {decision.reason}"


def figures(tick: Tick) -> dict[str, float]:
    """Range along the ground and height over the target in metres, the tracker's confidence 0..1."""
    seen = tick.estimate
    values = {
        "flw_range": seen.range_m,
        "flw_height": seen.range_m * math.tan(min(seen.depression_rad, 1.5)),
        "flw_conf": tick.track.confidence if tick.track is not None else math.nan,
    }
    return {name: value for name, value in values.items() if math.isfinite(value)}
