"""`follow run`: what a flight needs around the loop.

The loop computes and sends.  Around it, a flight requests the mode when the gate engages, reads the operator's keys
and signals and feeds the watchdog.  However it ends, it ramps down through the gate before the link requests Hold or
BRAKE.
"""

import logging
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Protocol

from follow.camera import Camera
from follow.camera.realtime import NewPictures
from follow.flight.finding import Finding, Health
from follow.flight.preflight import check_time
from follow.flight.service import Service
from follow.flight.vehicle_checks import check_sending, check_signing, check_simulator, check_vehicle
from follow.link import Link
from follow.link.connection import MavlinkLink
from follow.loop import BoxTracker, Controller, ImageMeter, ObjectDetector, SetpointGate, TargetEstimator, follow
from follow.messages import (
    HOVER,
    NO_INSTRUCTION,
    PILOTS_STICK,
    Cause,
    Estimate,
    Instruction,
    Mode,
    Notify,
    Order,
    Reason,
    Release,
    Tick,
)
from follow.operator.authority import KEYS_HELP, Keys, Operator, signals

ROUND_S = 0.05  # 20 setpoints a second while ramping down: the usual rate for either autopilot
LEAVE_S = 10.0  # longer than the ramp from any speed (20 m/s at 2.5 m/s2 and the gate's grace period: 9.3 s)


class FlyingLink(Link, Protocol):
    """A Link that can also request the mode in which the autopilot obeys us."""

    def take_control(self) -> None:
        """Request OFFBOARD or GUIDED, once."""
        ...

    def hold(self, *, for_sticks: bool = False) -> object:
        """Request Hold or BRAKE, or the mode in which the sticks act, if the vehicle obeys us or holds for us."""
        ...


def taking_and_giving(ticks: Iterable[Tick], link: FlyingLink) -> Iterator[Tick]:
    """Pass the ticks on; request our mode as the gate begins to engage, the pilot's when a stick ends the stream.

    A stick that moves after the stream has ended requests the pilot's mode again.
    """
    before, was_released = Mode.OBSERVE, False
    for tick in ticks:
        mode = tick.decision.mode
        released = tick.decision.setpoint is None and tick.decision.release is Release.STICKS
        again = tick.instruction.reason.cause in PILOTS_STICK  # the first request may have been lost
        if mode is Mode.ENGAGE is not before:
            link.take_control()
        elif released and (again or not was_released):
            link.hold(for_sticks=True)
        before, was_released = mode, released
        yield tick


def ramping_down(
    link: Link,
    safety: SetpointGate,
    why: Reason,
    pause: Callable[[], None] = lambda: None,
    rounds: int = int(LEAVE_S / ROUND_S),
) -> Iterator[Tick]:
    """Rounds without the camera, from the order LEAVE on: the gate ramps to zero and ends the stream."""
    instruction = Instruction(Order.LEAVE, why)
    for _ in range(rounds):
        state = link.state()
        unseen = Estimate(state.t_s, 0.0, 0.0, 1.0, 0.0)
        decision = safety.allow(HOVER, unseen, state, state.t_s, instruction)
        link.send(decision.setpoint)
        yield Tick(None, None, state, unseen, HOVER, decision, instruction=instruction)
        instruction = NO_INSTRUCTION
        if decision.setpoint is None:
            return
        pause()


@dataclass(frozen=True, slots=True)
class Parts:
    """The parts of the loop, already built, with camera and link open."""

    camera: Camera
    link: FlyingLink
    tracker: BoxTracker
    target: TargetEstimator
    servo: Controller
    safety: SetpointGate
    meter: ImageMeter | None = None
    detector: ObjectDetector | None = None


def wait_a_round() -> None:
    """Wait in real time between two rounds of the ramp."""
    time.sleep(ROUND_S)


def fly(
    parts: Parts,
    operator: Operator,
    record: Callable[[Tick], None],
    seconds: float = 0.0,
    pause: Callable[[], None] = wait_a_round,
    frames_over: str = "the flight is over",
) -> None:
    """Fly until the camera ends, the operator leaves or `seconds` are over (0: no limit), then ramp down.

    `frames_over` is the reason to leave when the camera ends.  An error inside the loop is raised again after the ramp.
    """
    p, service = parts, Service()
    camera = NewPictures(p.camera)
    loop = follow(camera, p.link, p.tracker, p.target, p.servo, p.safety, operator, p.meter, p.detector)
    began_t_s: float | None = None
    why = "an error"
    with signals(operator), Keys() as keys:
        service.ready()
        if keys.are_there:
            operator.report(KEYS_HELP)
        try:
            for tick in taking_and_giving(loop, p.link):
                record(tick)
                operator.see(tick)
                service.alive(tick.state.t_s, tick.decision.mode.value)
                keys.read_into(operator)
                began_t_s = tick.state.t_s if began_t_s is None else began_t_s
                if operator.leaving or 0.0 < seconds <= tick.state.t_s - began_t_s:
                    why = operator.leaving or "the flight is over"
                    break
            else:
                why = operator.leaving or frames_over
        finally:
            service.stopping()
            operator.report(f"leaving: {why}")
            for tick in ramping_down(p.link, p.safety, Reason(Cause.LEAVING, why), pause):
                record(tick)
                operator.see(tick)
                service.alive(tick.state.t_s, tick.decision.mode.value)
            service.close()


def preflight(link: MavlinkLink, disk: Finding, *, signs: bool, live_camera: bool, simulated: bool) -> list[Finding]:
    """The checks of `follow doctor` before this flight, with that of the disk; they take some ten seconds.

    Without a live camera only a simulator may be flown.
    """
    findings = check_vehicle(link.client, link.listen, time.monotonic)
    findings += [disk, check_time(signs, time.time()), check_signing(link.client, signs, link.reach)]
    findings.append(check_sending(link.unsent))
    return findings if live_camera else [*findings, check_simulator(link.client, link.reach, said=simulated)]


def unwaived(findings: Sequence[Finding], waived: Sequence[str], report: Notify) -> tuple[str, ...]:
    """Report every finding that is not OK; returns the ones that forbid FOLLOW: red and not named by `waived`.

    Raises ValueError for a waiver that names no check.
    """
    names = [finding.name for finding in findings]
    if unknown := [name for name in waived if name not in names]:
        raise ValueError(f"--waive {unknown[0]} is not a check; the checks are {', '.join(names)}")
    for finding in findings:
        if finding.verdict is not Health.OK:
            report(f"{finding}{' (waived)' if finding.name in waived else ''}")
    red = (finding for finding in findings if finding.verdict is Health.RED and finding.name not in waived)
    return tuple(f"{finding.name} is red" for finding in red)


class LogForwarder(logging.Handler):
    """Forwards the log records of the parts as lines for a person."""

    def __init__(self, report: Notify) -> None:
        super().__init__(logging.INFO)
        self._report = report

    def emit(self, record: logging.LogRecord) -> None:
        """Report one record."""
        self._report(record.getMessage())
