"""The table of modes and events: what the program may be doing, and what makes it do something else."""

from enum import Enum


class Mode(str, Enum):
    """What the gate lets through."""

    OBSERVE = "observe"  # track and compute, send nothing
    READY = "ready"  # the same, with every check green
    ENGAGE = "engage"  # ordered to follow: stream the present velocity until the autopilot obeys
    FOLLOW = "follow"  # the desired setpoint, within the limits
    COAST = "coast"  # the target is not seen: the desired setpoint, slower and slower
    SEARCH = "search"  # hover and turn towards where it was last
    HOLD = "hold"  # given up: hover until the operator decides
    BRAKE = "brake"  # something is stale: ramp to zero
    ENDED = "ended"  # silent until the operator asks again


class Event(str, Enum):
    """What a round can find."""

    ORDER_FOLLOW = "ordered to follow"
    ORDER_OBSERVE = "ordered to observe"
    CONTROL_GAINED = "autopilot obeys"
    CONTROL_LOST = "pilot or autopilot took over"
    CHECKS_GREEN = "checks green"
    CHECKS_RED = "checks red"
    STAYED_RED = "checks stayed red, or landed"
    STALE = "data stale"
    FRESH = "data fresh again"
    SEEN = "target seen"
    UNSEEN = "target unseen"
    LONG_UNSEEN = "unseen for long"
    GIVEN_UP = "searched in vain"
    STOPPED = "stopped"
    TIMEOUT = "autopilot does not obey"


FLYING = (Mode.FOLLOW, Mode.COAST, Mode.SEARCH, Mode.HOLD, Mode.BRAKE)
STREAMING = (Mode.ENGAGE, *FLYING)

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
    **{(mode, Event.ORDER_OBSERVE): Mode.ENDED for mode in (Mode.ENGAGE, *FLYING)},
    (Mode.ENDED, Event.ORDER_FOLLOW): Mode.OBSERVE,
}
"""(mode, event) -> the next mode.  A pair that is not here changes nothing."""


def after(mode: Mode, event: Event) -> Mode:
    """The mode that follows an event."""
    return TABLE.get((mode, event), mode)
