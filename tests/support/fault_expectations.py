"""Expectations of a flight with a fault: a text, a bound, a judge and the measured value."""

from collections.abc import Callable
from dataclasses import dataclass

from follow.messages import Autopilot
from tests.support.bounds import Stop
from tests.support.fault_rig import Outcome

HOLD = {Autopilot.PX4: "HOLD", Autopilot.ARDUPILOT: "BRAKE"}
ASK_TIMES = 3  # one request, repeated while there is no answer (MAVLink's command protocol)

Judge = Callable[[Outcome, Autopilot], list[str]]


@dataclass(frozen=True)
class Expectation:
    """What must happen, its bound as text, the judge, which returns the failures, and the measured value as text."""

    must: str
    bound: str
    judge: Judge
    measured: Callable[[Outcome], str]


def stand(o: Outcome) -> str:
    """A stop as text."""
    return f"{o.stop_s:.1f} s, {o.stop_m:.1f} m" if o.stop_s is not None else f"never stood, {o.stop_m:.1f} m"


def silence(o: Outcome) -> str:
    """The end of the stream as text."""
    return f"last setpoint after {max(o.silent_s, 0.0):.2f} s"


def stopped(o: Outcome, bound: Stop) -> list[str]:
    wrong = []
    if o.stop_s is None or o.stop_s > bound.within_s:
        wrong.append(f"stood after {o.stop_s} s")
    if o.stop_m > bound.within_m:
        wrong.append(f"flew {o.stop_m:.1f} m on")
    return wrong


def stops(bound: Stop) -> Expectation:
    """It ramps down, the stream ends, Hold or BRAKE is requested (again only while there is no answer)."""

    def judge(o: Outcome, autopilot: Autopilot) -> list[str]:
        wrong = stopped(o, bound)
        if o.setpoints_at_end or o.gate_mode != "ended":
            wrong.append(f"the gate ended in {o.gate_mode}")
        if o.vehicle_mode != HOLD[autopilot]:
            wrong.append(f"the vehicle ended in {o.vehicle_mode}")
        if o.modes_asked > ASK_TIMES:
            wrong.append(f"{o.modes_asked} modes were requested")
        return wrong

    must = "ramps to zero, ends the stream, requests Hold or BRAKE"
    return Expectation(must, f"stands within {bound.within_s:g} s, {bound.within_m:g} m", judge, stand)


def stands(bound: Stop) -> Expectation:
    """It ramps down and the stream ends; nothing is heard of its mode, so nothing is requested."""

    def judge(o: Outcome, autopilot: Autopilot) -> list[str]:
        wrong = stopped(o, bound)
        if o.setpoints_at_end or o.gate_mode != "ended":
            wrong.append(f"the gate ended in {o.gate_mode}")
        if o.modes_asked:
            wrong.append(f"{o.modes_asked} modes were requested")
        if o.vehicle_mode == "OFFBOARD":
            wrong.append("it is still in OFFBOARD")
        return wrong

    must = "ramps to zero, ends the stream, requests nothing: its mode is not heard"
    return Expectation(must, f"stands within {bound.within_s:g} s, {bound.within_m:g} m", judge, stand)


def hovers(bound: Stop) -> Expectation:
    """It hovers and goes on streaming: the target may come back."""

    def judge(o: Outcome, autopilot: Autopilot) -> list[str]:
        wrong = stopped(o, bound)
        if not o.setpoints_at_end:
            wrong.append("the stream ended")
        return wrong

    must = "coasts, then hovers and searches, in control"
    return Expectation(must, f"stands within {bound.within_s:g} s, {bound.within_m:g} m", judge, stand)


def stands_still(within_m: float) -> Expectation:
    """It hovers when the fault comes: it stays there, or its first movement reveals the fault."""

    def judge(o: Outcome, autopilot: Autopilot) -> list[str]:
        return [] if o.stop_m <= within_m else [f"flew {o.stop_m:.1f} m on"]

    return Expectation("stays where it is", f"flies at most {within_m:g} m", judge, lambda o: f"{o.stop_m:.1f} m")


def goes_on(off_m: float) -> Expectation:
    """It goes on following at the wanted distance."""

    def judge(o: Outcome, autopilot: Autopilot) -> list[str]:
        wrong = [] if o.setpoints_at_end else ["the stream ended"]
        if not o.off_m <= off_m:
            wrong.append(f"{o.off_m:.1f} m off the wanted distance")
        return wrong

    return Expectation(
        "goes on following", f"distance kept within {off_m:g} m", judge, lambda o: f"{o.off_m:.1f} m off"
    )


def falls_silent(within_s: float, modes: tuple[str, ...] = (), asked: int = 0) -> Expectation:
    """Control was lost: no more setpoints, and of mode requests only the `asked` ones for our own mode."""

    def judge(o: Outcome, autopilot: Autopilot) -> list[str]:
        wrong = [] if o.silent_s <= within_s else [f"sent until {o.silent_s:.2f} s"]
        if o.modes_asked != asked:
            wrong.append(f"{o.modes_asked} modes were requested")
        if modes and o.vehicle_mode not in modes:
            wrong.append(f"the vehicle ended in {o.vehicle_mode}")
        return wrong

    must = "ends the stream for good, requests nothing"
    return Expectation(must, f"last setpoint within {within_s:g} s", judge, silence)


def never_streams() -> Expectation:
    """Not one setpoint, not one mode request."""

    def judge(o: Outcome, autopilot: Autopilot) -> list[str]:
        wrong = [f"sent until {o.silent_s:.2f} s"] if o.silent_s > -1e9 else []
        return wrong + ([f"{o.modes_asked} modes were requested"] if o.modes_asked else [])

    return Expectation(
        "nothing is sent or requested", "no setpoint", judge, lambda o: "silent" if o.silent_s < 0 else silence(o)
    )


def pilot_has_it(within_s: float) -> Expectation:
    """A stick moved: the stream ends; the vehicle is in a mode in which the pilot's sticks act."""

    def judge(o: Outcome, autopilot: Autopilot) -> list[str]:
        wrong = [] if o.silent_s <= within_s else [f"sent until {o.silent_s:.2f} s"]
        if o.vehicle_mode not in ("POSCTL", "LOITER"):
            wrong.append(f"the vehicle ended in {o.vehicle_mode}")
        return wrong

    must = "ends the stream; the pilot's sticks act"
    return Expectation(must, f"last setpoint within {within_s:g} s", judge, silence)


def gives_sticks(within_s: float) -> Expectation:
    """OBSERVE was ordered and then a stick moved: the stream ended at once, and the pilot's sticks act."""

    def judge(o: Outcome, autopilot: Autopilot) -> list[str]:
        wrong = pilot_has_it(within_s).judge(o, autopilot)
        return wrong if o.modes_asked <= ASK_TIMES else [*wrong, f"{o.modes_asked} modes were requested"]

    must = "hovers in Hold or BRAKE; then the pilot's sticks act"
    return Expectation(must, f"last setpoint within {within_s:g} s", judge, silence)


def lost_link(bound: Stop) -> Expectation:
    """The vehicle hears nothing: its own failsafe stops it, and it is not taken again."""

    def judge(o: Outcome, autopilot: Autopilot) -> list[str]:
        wrong = stopped(o, bound)
        if o.setpoints_at_end or o.gate_mode != "ended":
            wrong.append(f"the gate ended in {o.gate_mode}")
        if o.vehicle_mode == "OFFBOARD":
            wrong.append("it re-entered OFFBOARD")
        return wrong

    must = "the autopilot's failsafe stops it, and it is not taken again"
    return Expectation(must, f"stands within {bound.within_s:g} s, {bound.within_m:g} m", judge, stand)


def within(what: str, bound: str, value: Callable[[Outcome], float], holds: Callable[[float], bool]) -> Expectation:
    """A limit on position is kept while it goes on following."""

    def judge(o: Outcome, autopilot: Autopilot) -> list[str]:
        wrong = [] if o.setpoints_at_end else ["the stream ended"]
        if not holds(value(o)):
            wrong.append(f"{value(o):.2f} is beyond {bound}")
        return wrong

    return Expectation(what, bound, judge, lambda o: f"{value(o):.1f}")


def keeps(distance_m: float) -> Expectation:
    """The true distance to the body, whatever the mode."""

    def judge(o: Outcome, autopilot: Autopilot) -> list[str]:
        return [] if o.nearest_m >= distance_m else [f"{o.nearest_m:.2f} m from the body"]

    return Expectation(
        "keeps its distance", f"never nearer than {distance_m:g} m", judge, lambda o: f"{o.nearest_m:.1f} m"
    )


def keeps_off(distance_m: float, height_m: float) -> Expectation:
    """It goes on following, and keeps the distance to the body and the height above the ground."""

    def judge(o: Outcome, autopilot: Autopilot) -> list[str]:
        wrong = keeps(distance_m).judge(o, autopilot)
        if o.lowest_m < height_m:
            wrong.append(f"{o.lowest_m:.2f} m above the ground")
        return wrong if o.setpoints_at_end else [*wrong, "the stream ended"]

    must = "goes on following, keeps its distance and its height"
    bound = f"never nearer than {distance_m:g} m, nor lower than {height_m:g} m"
    return Expectation(must, bound, judge, lambda o: f"{o.nearest_m:.1f} m, {o.lowest_m:.1f} m high")


def either(one: Expectation, other: Expectation) -> Expectation:
    """Either outcome is safe; the moment of the fault decides which it is."""

    def judge(o: Outcome, autopilot: Autopilot) -> list[str]:
        return one.judge(o, autopilot) and other.judge(o, autopilot)

    def measured(o: Outcome) -> str:
        return one.measured(o) if o.stop_s is not None and not o.setpoints_at_end else other.measured(o)

    return Expectation(f"{one.must}; or {other.must}", f"{one.bound}; or {other.bound}", judge, measured)
