"""`follow run`: what a flight needs around the loop.

The loop computes and sends; a flight asks for the mode when the gate engages, lets the operator speak, feeds the
watchdog and, however it ends, ramps down through the gate before the link asks for Hold or BRAKE.
"""

import logging
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from follow.camera import Camera
from follow.camera.realtime import NewPictures
from follow.flight.preflight import Finding, Health, check_disk, check_signing, check_time, check_vehicle
from follow.flight.service import Service
from follow.link import Link
from follow.link.connection import MavlinkLink
from follow.loop import BoxTracker, Controller, SetpointGate, TargetEstimator, follow
from follow.messages import HOVER, NEVER, Estimate, Notify, Order, Tick
from follow.operator.authority import Keys, Operator, signals
from follow.safety.modes import Mode

ROUND_S = 0.05  # 20 setpoints a second while ramping down: the usual rate for either autopilot
LEAVE_S = 10.0  # longer than the ramp from any speed (12 m/s at 2.5 m/s2 and the gate's patience: 6.5 s)


class FlyingLink(Link, Protocol):
    """A Link that can also ask for the mode that obeys us."""

    def take_control(self) -> None:
        """Ask, once, for OFFBOARD or GUIDED."""
        ...


def engaging(ticks: Iterable[Tick], link: FlyingLink) -> Iterator[Tick]:
    """The ticks; where the gate begins to engage, the mode is asked for, once."""
    before = ""
    for tick in ticks:
        if tick.decision.mode == Mode.ENGAGE.value != before:
            link.take_control()
        before = tick.decision.mode
        yield tick


def ramping_down(
    link: Link, safety: SetpointGate, pause: Callable[[], None], rounds: int = int(LEAVE_S / ROUND_S)
) -> Iterator[Tick]:
    """Rounds without a picture, which the gate answers by ramping to zero, until nothing is sent any more."""
    for _ in range(rounds):
        state = link.state()
        unseen = Estimate(state.t_s, 0.0, 0.0, 1.0, 0.0)
        decision = safety.allow(HOVER, unseen, state, NEVER)
        link.send(decision.setpoint)
        yield Tick(None, None, state, unseen, HOVER, decision)
        if decision.setpoint is None:
            return
        pause()


@dataclass(frozen=True, slots=True)
class Parts:
    """What flies: the pieces of the loop, already built, with camera and link open."""

    camera: Camera
    link: FlyingLink
    tracker: BoxTracker
    target: TargetEstimator
    servo: Controller
    safety: SetpointGate


def wait_a_round() -> None:
    """Real time between two rounds of the ramp."""
    time.sleep(ROUND_S)


def fly(
    parts: Parts,
    operator: Operator,
    record: Callable[[Tick], None],
    seconds: float = 0.0,
    pause: Callable[[], None] = wait_a_round,
) -> None:
    """Fly until the camera ends, the operator leaves or `seconds` are over (0: no end), then ramp down.

    An error inside the loop is raised again after the ramp.
    """
    p, service = parts, Service()
    camera = NewPictures(p.camera)
    loop = follow(camera, p.link, p.tracker, p.target, p.servo, p.safety, operator)
    began_t_s: float | None = None
    why = "an error"
    with signals(operator), Keys() as keys:
        service.ready()
        try:
            for tick in engaging(loop, p.link):
                record(tick)
                operator.see(tick)
                service.alive(tick.state.t_s, tick.decision.mode)
                keys.read_into(operator)
                began_t_s = tick.state.t_s if began_t_s is None else began_t_s
                if operator.leaving or 0.0 < seconds <= tick.state.t_s - began_t_s:
                    break
            why = operator.leaving or "the flight is over"
        finally:
            service.stopping()
            operator.report(f"leaving ({why}): ramping down")
            if operator.mode is Mode.ENGAGE:
                p.safety.order(Order.OBSERVE)  # nothing to ramp yet, and nobody is to take the vehicle any more
            for tick in ramping_down(p.link, p.safety, pause):
                record(tick)
                operator.see(tick)
                service.alive(tick.state.t_s, tick.decision.mode)
            service.close()


def preflight(link: MavlinkLink, out: Path, *, signs: bool) -> list[Finding]:
    """What `follow doctor` finds before this flight; the conversation takes some ten seconds."""
    findings = check_vehicle(link.client, link.listen, time.monotonic)
    return [*findings, check_disk(out), check_time(signs, time.time()), check_signing(link.client, signs)]


def unwaived(findings: Sequence[Finding], waived: Sequence[str], report: Notify) -> tuple[str, ...]:
    """Say what is not well, and return what forbids to follow: each red line that `waived` does not name.

    Raises ValueError for a waiver of something that was not looked at.
    """
    names = [finding.name for finding in findings]
    if unknown := [name for name in waived if name not in names]:
        raise ValueError(f"--waive {unknown[0]} names no check; there are {', '.join(names)}")
    for finding in findings:
        if finding.verdict is not Health.OK:
            report(f"{finding}{' (waived)' if finding.name in waived else ''}")
    red = (finding for finding in findings if finding.verdict is Health.RED and finding.name not in waived)
    return tuple(f"{finding.name} is red" for finding in red)


class LogForwarder(logging.Handler):
    """What the parts log, as lines for a person."""

    def __init__(self, report: Notify) -> None:
        super().__init__(logging.INFO)
        self._report = report

    def emit(self, record: logging.LogRecord) -> None:
        """Report one line."""
        self._report(record.getMessage())
