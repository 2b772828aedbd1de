"""The transition table of the gate: (mode, event) -> mode."""

from enum import Enum

from follow.messages import Mode


class Event(str, Enum):
    """What a round of the gate can find."""

    ORDER_FOLLOW = "FOLLOW ordered"
    ORDER_OBSERVE = "OBSERVE ordered"
    CONTROL_GAINED = "autopilot obeys"
    CONTROL_LOST = "pilot or autopilot took over"
    CHECKS_GREEN = "checks green"
    CHECKS_RED = "checks red"
    STAYED_RED = "checks stayed red, or landed"
    STALE = "data stale"
    FRESH = "data fresh again"
    SEEN = "target seen"
    UNSEEN = "target not seen"
    LONG_UNSEEN = "target not seen for search_after_s"
    GIVEN_UP = "target not seen for give_up_after_s"
    STOPPED = "stopped"
    TIMEOUT = "autopilot does not obey"


FLYING = (Mode.FOLLOW, Mode.COAST, Mode.SEARCH, Mode.HOLD, Mode.BRAKE)
"""Modes in which the autopilot obeys our setpoints."""

STREAMING = (Mode.ENGAGE, *FLYING)
"""Modes in which setpoints are sent."""

TABLE: dict[tuple[Mode, Event], Mode] = {
    (Mode.OBSERVE, Event.CHECKS_GREEN): Mode.READY,
    (Mode.READY, Event.CHECKS_RED): Mode.OBSERVE,
    (Mode.READY, Event.ORDER_FOLLOW): Mode.ENGAGE,
    (Mode.ENGAGE, Event.CONTROL_GAINED): Mode.FOLLOW,
    (Mode.ENGAGE, Event.STAYED_RED): Mode.ENDED,
    (Mode.ENGAGE, Event.TIMEOUT): Mode.ENDED,
    (Mode.FOLLOW, Event.UNSEEN): Mode.COAST,
    (Mode.COAST, Event.SEEN): Mode.FOLLOW,
    (Mode.COAST, Event.LONG_UNSEEN): Mode.SEARCH,
    (Mode.SEARCH, Event.SEEN): Mode.FOLLOW,
    (Mode.SEARCH, Event.GIVEN_UP): Mode.HOLD,
    (Mode.HOLD, Event.ORDER_FOLLOW): Mode.COAST,
    **{(mode, Event.STALE): Mode.BRAKE for mode in FLYING if mode is not Mode.BRAKE},
    (Mode.BRAKE, Event.FRESH): Mode.COAST,
    (Mode.BRAKE, Event.STOPPED): Mode.ENDED,
    **{(mode, Event.CONTROL_LOST): Mode.ENDED for mode in FLYING},
    **{(mode, Event.ORDER_OBSERVE): Mode.ENDED for mode in STREAMING},
    (Mode.ENDED, Event.ORDER_FOLLOW): Mode.OBSERVE,
}
"""(mode, event) -> the next mode.  A pair that is not in the table changes nothing."""


def after(mode: Mode, event: Event) -> Mode:
    """The mode that follows an event."""
    return TABLE.get((mode, event), mode)
