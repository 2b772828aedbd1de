"""The transition table of the gate: (our mode, whose mode the vehicle is in, event) -> our next mode.

A triple that is not in the table changes nothing.  Times are in `follow.safety.limits`.
"""

from collections.abc import Iterator
from enum import Enum

from follow.messages import Autopilot, Mode, VehicleState


class Standing(str, Enum):
    """Whose mode the vehicle is in."""

    OURS = "ours"  # the autopilot obeys our setpoints
    OPEN = "open"  # a mode out of which FOLLOW may be ordered
    CLOSED = "closed"  # any other: a return, a landing, a take-off, a mission, BRAKE, an unknown mode


OPEN_MODES: dict[Autopilot, tuple[str, ...]] = {
    Autopilot.PX4: ("POSCTL", "ALTCTL", "HOLD", "OFFBOARD"),
    Autopilot.ARDUPILOT: ("LOITER", "POSHOLD", "ALT_HOLD", "GUIDED"),
}
"""The vehicle's modes out of which FOLLOW may be ordered: a person flies, or the vehicle stays where it is."""


class Event(str, Enum):
    """What a round of the gate can find."""

    ASKED = "FOLLOW ordered"
    ORDER_FOLLOW = "FOLLOW ordered, and nothing forbids it"
    ORDER_OBSERVE = "OBSERVE ordered, or a stick moved, or another sender"
    ORDER_LEAVE = "leaving"
    CONTROL_GAINED = "the autopilot obeys"
    CONTROL_LOST = "the vehicle left our mode, or disarmed"
    REFUSED = "the autopilot refused our mode"
    CLEARED = "nothing forbids FOLLOW"
    HINDERED = "something forbids FOLLOW"
    STAYED_HINDERED = "something forbids FOLLOW for longer than stale_grace_s"
    STALE = "data stale or contradictory"
    FRESH = "data fresh again, and nothing else stopped it"
    MUST_STOP = "battery low, remote lost, landed, or the vehicle does not obey"
    SEEN = "target seen"
    UNSEEN = "target not seen for coast_after_s"
    LONG_UNSEEN = "target not seen for search_after_s"
    GIVEN_UP = "target not seen for give_up_after_s"
    OUT_OF_REACH = "target out of reach for out_of_reach_s"
    HOLD_OVER = "hovered for hold_timeout_s"
    STOPPED = "stopped"
    TIMEOUT = "not obeyed for engage_timeout_s"


FLYING = (Mode.FOLLOW, Mode.COAST, Mode.SEARCH, Mode.HOLD, Mode.BRAKE)
"""Modes in which the autopilot obeys our setpoints."""

STREAMING = (Mode.ENGAGE, *FLYING)
"""Modes in which setpoints are sent."""

ANY = tuple(Standing)
NOT_CLOSED = (Standing.OURS, Standing.OPEN)

Row = tuple[tuple[Mode, ...], tuple[Standing, ...], Event, Mode]

ROWS: tuple[Row, ...] = (
    ((Mode.ENDED,), ANY, Event.ASKED, Mode.OBSERVE),
    ((Mode.OBSERVE,), NOT_CLOSED, Event.CLEARED, Mode.READY),
    ((Mode.READY,), ANY, Event.HINDERED, Mode.OBSERVE),
    ((Mode.READY,), NOT_CLOSED, Event.ORDER_FOLLOW, Mode.ENGAGE),
    ((Mode.ENGAGE,), (Standing.OURS,), Event.CONTROL_GAINED, Mode.FOLLOW),
    ((Mode.ENGAGE,), ANY, Event.REFUSED, Mode.ENDED),
    ((Mode.ENGAGE,), ANY, Event.CONTROL_LOST, Mode.ENDED),
    ((Mode.ENGAGE,), ANY, Event.STAYED_HINDERED, Mode.ENDED),
    ((Mode.ENGAGE,), ANY, Event.TIMEOUT, Mode.ENDED),
    ((Mode.FOLLOW,), (Standing.OURS,), Event.UNSEEN, Mode.COAST),
    ((Mode.FOLLOW,), (Standing.OURS,), Event.OUT_OF_REACH, Mode.HOLD),
    ((Mode.COAST,), (Standing.OURS,), Event.SEEN, Mode.FOLLOW),
    ((Mode.COAST,), (Standing.OURS,), Event.LONG_UNSEEN, Mode.SEARCH),
    ((Mode.SEARCH,), (Standing.OURS,), Event.SEEN, Mode.FOLLOW),
    ((Mode.SEARCH,), (Standing.OURS,), Event.GIVEN_UP, Mode.HOLD),
    ((Mode.HOLD,), (Standing.OURS,), Event.ORDER_FOLLOW, Mode.COAST),
    ((Mode.HOLD,), ANY, Event.HOLD_OVER, Mode.ENDED),
    ((Mode.FOLLOW, Mode.COAST, Mode.SEARCH, Mode.HOLD), ANY, Event.STALE, Mode.BRAKE),
    ((Mode.FOLLOW, Mode.COAST, Mode.SEARCH, Mode.HOLD), ANY, Event.MUST_STOP, Mode.BRAKE),
    ((Mode.FOLLOW, Mode.COAST, Mode.SEARCH, Mode.HOLD), ANY, Event.ORDER_LEAVE, Mode.BRAKE),
    ((Mode.BRAKE,), (Standing.OURS,), Event.FRESH, Mode.COAST),
    ((Mode.BRAKE,), ANY, Event.STOPPED, Mode.ENDED),
    (FLYING, ANY, Event.CONTROL_LOST, Mode.ENDED),
    (STREAMING, ANY, Event.ORDER_OBSERVE, Mode.ENDED),
    ((Mode.ENGAGE,), ANY, Event.ORDER_LEAVE, Mode.ENDED),
)
"""The table as data: (our modes, whose mode the vehicle is in, event, our next mode)."""


def expanded() -> Iterator[tuple[tuple[Mode, Standing, Event], Mode]]:
    """The table with one entry for each triple."""
    for modes, standings, event, then in ROWS:
        for mode in modes:
            for standing in standings:
                yield (mode, standing, event), then


TABLE: dict[tuple[Mode, Standing, Event], Mode] = dict(expanded())


def open_modes(state: VehicleState) -> tuple[str, ...]:
    """The modes out of which FOLLOW may be ordered on this autopilot; none on an unknown one."""
    return OPEN_MODES[state.autopilot] if state.autopilot is not None else ()


def standing(state: VehicleState) -> Standing:
    """Whose mode the vehicle is in."""
    if state.in_control:
        return Standing.OURS
    return Standing.OPEN if state.mode in open_modes(state) else Standing.CLOSED


def after(mode: Mode, where: Standing, event: Event) -> Mode:
    """The mode that follows an event."""
    return TABLE.get((mode, where, event), mode)
