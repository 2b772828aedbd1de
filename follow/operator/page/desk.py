"""The loop's side of the page: carries out the windows' acts and publishes each round.  Nothing here waits."""

import math
from collections import deque
from collections.abc import Callable

from follow.geometry import heading_to_ned
from follow.messages import NEVER, Cause, Decision, Estimate, Frame, Mode, Order, Tick, VehicleState
from follow.operator.consoles import CONFIRM_S, SPOTLIGHT, Consoles
from follow.operator.page.exchange import Act, Doing, Exchange, Shown, number
from follow.recording.rows import held_by
from follow.safety.checks import UNSEEN
from follow.safety.modes import FLYING, STREAMING
from follow.selection import HOVER_HERE, Cleared, Detections, Selection, TrackingState, TrackingStatus

ACTS = 4  # carried out in a round, and every STOP: a flood must not delay a setpoint
FRAMES = 256  # frames whose times are kept: more than a selection may name (2 s at 60 frames/s)
SAME_M = 0.5  # a smaller difference of two stand-offs is not shown
PATH_S = 0.5  # between two points of the top view

CALM, GOOD, WARNS, BAD = "calm", "good", "warns", "bad"
"""The tone of a state: nothing moves, it follows, attention, the target or control is lost."""

STATES = {
    Mode.OBSERVE: ("NOT READY", WARNS),
    Mode.READY: ("TRACKING", CALM),
    Mode.ENGAGE: ("TAKING OVER", GOOD),
    Mode.FOLLOW: ("FOLLOWING", GOOD),
    Mode.COAST: ("TARGET LOST", BAD),
    Mode.SEARCH: ("SEARCHING", BAD),
    Mode.HOLD: ("GAVE UP, HOVERS", BAD),
    Mode.BRAKE: ("BRAKING", BAD),
    Mode.ENDED: ("STOPPED", CALM),
}
"""The state in large letters, in each mode of the gate."""


SELECT, HOLDS = "SELECT A TARGET", "HOLDS"
TO_SELECT = "drag a box around it in the image, or tap it; nothing is sent to the vehicle yet"
AGAIN = "stopped before; FOLLOW flies to the target that is drawn now"
NOT_SEEN_YET = "target not seen: wait, or draw the box again"
HOVERS = "hovers until FOLLOW or STOP"


def headline(mode: Mode, wanted: str, tracking: TrackingState, *, is_new: bool) -> tuple[str, str]:
    """The state in large letters and its tone; `wanted` is the mode that a person wants.

    `is_new`: the target was selected after the last flight ended, so the state is no longer STOPPED.
    """
    if mode in (Mode.OBSERVE, Mode.READY, Mode.ENDED) and tracking is TrackingState.IDLE:
        return ("STOPPED" if mode is Mode.ENDED else SELECT), CALM
    if mode is Mode.ENDED and is_new:
        return STATES[Mode.READY]
    if mode is Mode.FOLLOW and wanted == SPOTLIGHT:
        return "SPOTLIGHT", GOOD
    if mode in FLYING and wanted == HOVER_HERE:
        return HOLDS, WARNS
    return STATES[mode]


def explanation(words: str, decision: Decision) -> str:
    """The line below the state `words` (of `headline`): why, or what to do."""
    cause, what = decision.reason.cause, decision.reason.what
    is_unseen = cause is Cause.NOT_READY and what == UNSEEN
    if words == SELECT and (is_unseen or cause in (Cause.STARTED, Cause.NOT_SEEN)):
        return TO_SELECT
    if is_unseen:
        return NOT_SEEN_YET
    if words == STATES[Mode.READY][0] and decision.mode is Mode.ENDED:
        return AGAIN
    if words == HOLDS and cause is Cause.BEGAN:
        return HOVERS
    return f"stopped by {what}" if cause is Cause.OBSERVE_ORDERED else str(decision.reason)


def detected(found: Detections | None, frame: Frame | None, t_s: float) -> dict[str, object] | None:
    """A detector's boxes as the page draws them: fractions of the image, with their frame's index and their age, s."""
    if found is None or frame is None:
        return None
    rows, columns = frame.image.shape[:2]
    boxes = [
        [round(v, 4) for v in (b.x / columns, b.y / rows, b.w / columns, b.h / rows)]
        for b in (detection.box for detection in found.objects)
    ]
    return {"frame": found.index, "age_s": number(t_s - found.t_s), "boxes": boxes}


class PageDesk:
    """`see` takes each tick, after the consoles did.

    `recording` names the flight that is being recorded; `suffix` follows each state in large letters.  `charge` gives
    the battery's remaining charge, percent, None if the autopilot does not know it.
    """

    def __init__(
        self,
        consoles: Consoles,
        exchange: Exchange,
        recording: str = "",
        suffix: str = "",
        charge: Callable[[], int | None] = lambda: None,
    ) -> None:
        self._consoles, self._exchange, self._recording, self._suffix = consoles, exchange, recording, suffix
        self._charge = charge
        self._times: deque[tuple[int, float]] = deque(maxlen=FRAMES)
        self._frame: Frame | None = None
        self._status: TrackingStatus | None = None
        self._path_t_s = NEVER
        self._ended_t_s = NEVER  # the last round in which setpoints were sent, or STOP was ordered
        exchange.is_flying = True
        consoles.answer = lambda by, reply: exchange.reply(by, reply.words, done=reply.done)

    def see(self, tick: Tick) -> None:
        """Take one round."""
        if tick.frame is not None:
            self._frame, self._status = tick.frame, self._consoles.status
            self._times.append((tick.frame.index, tick.frame.t_s))
        for window in self._exchange.heard():
            self._consoles.hears(window)
        for act in self._exchange.taken(ACTS):
            self._heed(act)
        status = self._status
        self._exchange.put(
            Shown(
                self._frame,
                status.box if status is not None else None,
                (status.state if status is not None else TrackingState.IDLE).value,
                self._describe(tick),
                detected(tick.found, self._frame, tick.state.t_s),
            )
        )

    def close(self) -> None:
        """End the flight: no more acts are carried out."""
        self._exchange.is_flying = False
        last = self._exchange.shown
        ended = {**last.status, "state": "THE FLIGHT IS OVER", "tone": CALM, "why": "the program has ended"}
        self._exchange.put(Shown(last.frame, None, "idle", ended))

    def _heed(self, act: Act) -> None:
        """Carry out one act and answer its window."""
        consoles = self._consoles
        if act.doing is Doing.SELECT:
            why = self._select(act)
            if why or not consoles.is_looking():
                self._exchange.reply(act.by, f"not selected: {why}" if why else "target selected", done=not why)
        elif act.doing is Doing.CLEAR:
            consoles.choose(Cleared(act.by))
            self._exchange.reply(act.by, "target cleared, stopped", done=True)
        elif act.doing is Doing.HAND_OVER:
            reply = consoles.release(act.by)
            self._exchange.reply(act.by, reply.words, done=reply.done)
        elif act.order is not None:
            reply = consoles.order(act.order, act.by)
            self._exchange.reply(act.by, f"{act.order.value}: {reply.words}", done=reply.done)

    def _select(self, act: Act) -> str:
        """Why a selection is refused; empty if it is taken."""
        frame_t_s = next((t_s for index, t_s in reversed(self._times) if index == act.frame), None)
        if frame_t_s is None:
            return "that image is too old: select again"
        return self._consoles.choose(Selection(*act.box, frame_t_s, act.by))

    def _describe(self, tick: Tick) -> dict[str, object]:
        """The status of one round as JSON has it."""
        consoles, decision, state, seen = self._consoles, tick.decision, tick.state, tick.estimate
        wanted = consoles.wanted
        if decision.mode in STREAMING or tick.instruction.order is Order.OBSERVE:
            self._ended_t_s = state.t_s
        is_new = consoles.drawn_t_s > self._ended_t_s
        words, tone = headline(decision.mode, wanted.mode, consoles.status.state, is_new=is_new)
        held = [note.replace("limits.", "") for note in held_by(decision.notes)]
        confidence = tick.track.confidence if tick.track is not None else math.nan
        is_known = seen.seen_t_s > NEVER
        return {
            "t": number(state.t_s),
            "state": f"{words} {self._suffix}".rstrip(),
            "tone": tone,
            "mode": decision.mode.value,
            "why": explanation(words, decision),
            "streams": decision.mode in STREAMING,
            "vehicle": state.mode or "no known mode",
            "armed": state.armed,
            "landed": state.landed.value,
            "battery": state.battery.value,
            "charge": self._charge(),
            "link_s": number(state.t_s - state.heartbeat_t_s, 1),
            "image_s": number(state.t_s - self._frame.t_s) if self._frame is not None else None,
            "confidence": number(confidence),
            "range_m": number(seen.range_m, 1) if is_known else None,
            "range_std_m": number(seen.range_std_m, 1) if is_known else None,
            "height_m": number(seen.range_m * math.tan(min(seen.depression_rad, 1.5)), 1) if is_known else None,
            "speed_m_s": number(math.hypot(state.north_m_s, state.east_m_s), 1),
            "held": held,
            "proposal": consoles.proposal() if self._is_proposed() else "",
            "would_fly": consoles.proposal() if is_known else "",
            "standoff_m": number(consoles.standoff_m * wanted.standoff_factor, 1),
            "kept": self._kept(consoles.standoff_m * wanted.standoff_factor),
            "raise_deg": number(math.degrees(wanted.raise_rad), 0),
            "flown_mode": consoles.flown_mode or consoles.set_mode,
            "wanted": wanted.mode,
            "commander": consoles.present_commander,
            "recording": self._recording,
            "map": self._map(state, seen if is_known else None),
        }

    def _kept(self, desired_m: float) -> str:
        """The stand-off that the servo keeps and why, if it differs from the desired one; else empty."""
        kept = self._consoles.kept()
        if not abs(kept.standoff_m - desired_m) > SAME_M:  # NaN: none is kept
            return ""
        return f"keeps {kept.standoff_m:.0f} m" + (f": {kept.why}" if kept.why else "")

    def _is_proposed(self) -> bool:
        return self._consoles.t_s - self._consoles.proposed_t_s <= CONFIRM_S

    def _map(self, state: VehicleState, seen: Estimate | None) -> list[float | None]:
        """Vehicle (north, east, yaw) and target (north, east), m and rad, local NED; None where it is not known."""
        points: list[float | None] = [number(state.north_m, 1), number(state.east_m, 1), number(state.yaw_rad)]
        if seen is None or not math.isfinite(seen.range_m):
            points += [None, None]
        else:
            ahead, aside = seen.range_m * math.cos(seen.azimuth_rad), seen.range_m * math.sin(seen.azimuth_rad)
            north, east = heading_to_ned(ahead, aside, state.yaw_rad)
            points += [number(state.north_m + north, 1), number(state.east_m + east, 1)]
        known = [value for value in points if value is not None]
        if state.t_s - self._path_t_s >= PATH_S and len(known) == len(points):
            self._path_t_s = state.t_s
            self._exchange.path.append(tuple(known))
        return points
