"""An option with which sticks trim the flight while it follows: to the side, nearer and farther, higher and lower.

Only the first part of a stick's travel trims.  Beyond it the pilot takes over, as without the option, and also with any
other stick.  PX4 itself hands the vehicle over to a stick that moves fast, however little: trim slowly there.
"""

from dataclasses import dataclass, replace

from follow.messages import NEVER, Mode, Tick
from follow.operator.authority import RECENT_S, RemoteObservations
from follow.operator.consoles import AROUND_M_S, RAISE_RANGE, ConsoleCommand, Consoles
from follow.operator.sticks import PWM, STICK_US, STICKS
from follow.safety.modes import STREAMING

REST_US = 40  # dead band, 8 % of a stick's travel: no hand holds it stiller
NEARER_PER_S, RAISE_RAD_S = 0.2, 0.05  # at the end of the part that trims: 2.4 m/s at 12 m, 3 degrees/s
HOLDS_S = 0.3  # a move to the side ends this long after the last sample of the stick
LONGEST_S = 0.2  # a longer pause between two rounds counts as this


@dataclass(frozen=True, slots=True)
class TrimSticks:
    """The channels (from 1) of right, forward and up, negative for one whose pulses are reversed."""

    right: int
    forward: int
    up: int


def parse_trims(text: str) -> TrimSticks:
    """The channels that `text` names, e.g. 1,-2,3.  Raises ValueError."""
    words = text.split(",")
    if len(words) == 3 and all(word.strip().removeprefix("-").isdecimal() for word in words):
        right, forward, up = (int(word) for word in words)
        channels = [abs(channel) for channel in (right, forward, up)]
        if all(1 <= channel <= STICKS for channel in channels) and len(set(channels)) == 3:
            return TrimSticks(right, forward, up)
    raise ValueError(
        f"--stick-trims names three different channels of 1 to {STICKS}, for right, forward and up, with a minus for a "
        f"reversed one, as 1,-2,3; not {text!r}"
    )


@dataclass(slots=True)
class StickTrims:
    """`see` takes each tick, after the consoles did; `heard` has the remote control's channels."""

    sticks: TrimSticks
    consoles: Consoles
    heard: RemoteObservations
    rest: tuple[int, ...] = ()  # the sticks' position when the stream began, as in StickWatch; kept over a short loss
    t_s: float = NEVER
    is_trimming: bool = False

    def see(self, tick: Tick) -> None:
        """Trim by the sticks' deflections in this round."""
        t_s, wanted = tick.state.t_s, self.consoles.wanted
        dt_s, self.t_s = min(max(t_s - self.t_s, 0.0), LONGEST_S), t_s
        channels = self.heard.rc_channels[:STICKS]
        valid = len(channels) == STICKS and all(pwm in PWM for pwm in channels)
        is_heard = valid and t_s - self.heard.rc_t_s <= RECENT_S and tick.state.rc_healthy is not False
        if tick.decision.mode not in STREAMING:
            self.rest = ()
            return
        if not is_heard:
            return
        self.rest = self.rest or channels
        if tick.decision.mode is not Mode.FOLLOW or self.consoles.why_untrimmed(ConsoleCommand.NEARER):
            return
        right, forward, up = (self._deflection(channels, stick) for stick in self._order)
        if right and not self.consoles.why_untrimmed(ConsoleCommand.RIGHT):
            self.consoles.around_until_s = t_s + HOLDS_S
            wanted = replace(wanted, around_m_s=AROUND_M_S * right)
        if forward:
            factor = wanted.standoff_factor * (1.0 - NEARER_PER_S * forward * dt_s)
            wanted = replace(wanted, standoff_factor=self.consoles.possible(factor))
        if up:
            raised = wanted.raise_rad + RAISE_RAD_S * up * dt_s
            wanted = replace(wanted, raise_rad=min(max(raised, RAISE_RANGE[0]), RAISE_RANGE[1]))
        self.consoles.wanted = wanted
        self._tell(bool(forward or up))

    @property
    def _order(self) -> tuple[int, int, int]:
        return self.sticks.right, self.sticks.forward, self.sticks.up

    def _deflection(self, channels: tuple[int, ...], stick: int) -> float:
        """From -1 to 1 over the part that trims; 0 at rest, and beyond that part, where the stick takes over."""
        off = channels[abs(stick) - 1] - self.rest[abs(stick) - 1]
        if not REST_US < abs(off) <= STICK_US:
            return 0.0
        fraction = (abs(off) - REST_US) / (STICK_US - REST_US)
        return fraction if (off > 0) is (stick > 0) else -fraction

    def _tell(self, is_trimming: bool) -> None:
        """Report the trimmed geometry once, when the stick is back at rest."""
        if self.is_trimming and not is_trimming:
            self.consoles.report(f"sticks: {self.consoles.trimmed()}")
        self.is_trimming = is_trimming
