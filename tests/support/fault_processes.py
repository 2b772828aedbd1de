"""The rows of the fault matrix that need a process: `follow run` over UDP, in real time."""

import math
import resource
import signal
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

from tests.support.machine import against_the_clock
from tests.support.real_flight import CONTROL, HOLD, Real, real_flight

FLY_S = 4.0  # in FOLLOW before the fault
STILL_M_S = 0.3
BOTH = ("px4", "ardupilot")


@dataclass
class Track:
    """The vehicle's reported motion since the fault, received on the pilot's link."""

    real: Real
    began_s: float = field(default_factory=time.monotonic)
    samples: list[tuple[float, float, float, float]] = field(default_factory=list)  # time, north, east, speed

    def watch(self, seconds: float) -> None:
        """Listen for a while."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            m = self.real.pilot.heard("LOCAL_POSITION_NED")
            now = time.monotonic() - self.began_s
            # A PX4 that stays reports up to 0.5 m/s, and one that is told to stand moves by as much: the lesser counts.
            old = next((s for s in self.samples if s[0] >= now - 1.0), None)
            moved = math.dist(old[1:3], (m.x, m.y)) / (now - old[0]) if old and now > old[0] else math.inf
            self.samples.append((now, m.x, m.y, min(moved, math.hypot(m.vx, m.vy))))

    def stop(self) -> tuple[float | None, float]:
        """Seconds and metres until it stood for good; None when it never did."""
        moving = [i for i, sample in enumerate(self.samples) if sample[3] > STILL_M_S]
        last = moving[-1] + 1 if moving else 0
        way = sum(
            math.dist(a[1:3], b[1:3]) for a, b in zip(self.samples[:last], self.samples[1 : last + 1], strict=False)
        )
        return (self.samples[last][0] if last < len(self.samples) - 5 else None), way

    def last_setpoint_s(self) -> float:
        """When the last setpoint passed on the wire, counted from the fault."""
        return max((p.t_s for p in self.real.relay.setpoints()), default=-math.inf) - self.began_s


Judged = tuple[list[str], str]
"""What is wrong, and what was measured."""


@dataclass(frozen=True)
class ProcessRow:
    """One fault of the process.  `act` does it and judges."""

    name: str
    must: str
    bound: str
    act: Callable[[Real], Judged]
    rules: tuple[str, ...] = BOTH
    options: dict[str, object] = field(default_factory=dict)
    fast: bool = False

    def fly(self, rules: str, out: Path) -> tuple[str, str, tuple[str, ...]]:
        """Fly it: what was measured, the vehicle's mode at the end, what was wrong."""
        with following(rules, out, **self.options) as real:
            wrong, measured = self.act(real)
            time.sleep(1.2)  # PX4 tells its mode once a second
            return measured, real.pilot.flown_mode(), tuple(wrong)


@contextmanager
def following(rules: str, out: Path, **options) -> Iterator[Real]:
    """A flight that is in FOLLOW."""
    with real_flight(rules, out, **options) as real:
        real.order()
        time.sleep(FLY_S)
        with against_the_clock():
            assert real.pilot.flown_mode() == CONTROL[rules], "it fell out of FOLLOW before the fault"
        yield real


def said_stop(stop: tuple[float | None, float]) -> str:
    seconds, way = stop
    return f"never stood, {way:.1f} m" if seconds is None else f"{seconds:.1f} s, {way:.1f} m"


def too_far(stop: tuple[float | None, float], within_s: float, within_m: float) -> list[str]:
    seconds, way = stop
    return [f"stood after {seconds} s, {way:.1f} m"] if seconds is None or seconds > within_s or way > within_m else []


def leave_by(number: int) -> Callable[[Real], Judged]:
    """A signal ends it: it ramps down, requests Hold or BRAKE, reports it and exits with 0."""

    def act(real: Real) -> Judged:
        track = Track(real)
        real.application.process.send_signal(number)
        track.watch(8.0)
        status = real.application.process.wait(20.0)
        wrong = too_far(track.stop(), 6.0, 6.0)
        if status != 0:
            wrong.append(f"exit status {status}")
        if real.pilot.flown_mode() != HOLD[real.rules]:
            wrong.append(f"the vehicle is in {real.pilot.flown_mode()}")
        if not real.application.said(f"leaving: the vehicle is in {HOLD[real.rules]}"):
            wrong.append(f"it did not say so: {real.application.lines[-3:]}")
        return wrong, said_stop(track.stop())

    return act


def killed(real: Real) -> Judged:
    """Nothing of ours is left: the autopilot's failsafe stops the vehicle."""
    track = Track(real)
    real.application.process.kill()
    track.watch(9.0)
    wrong = too_far(track.stop(), 7.0, 8.0)
    if real.pilot.flown_mode() == "OFFBOARD":
        wrong.append("the vehicle is still in OFFBOARD")
    return wrong, said_stop(track.stop())


def frozen(real: Real) -> Judged:
    """It hangs for 5 s: the failsafe acts; when it wakes it sends no velocity and does not take the vehicle again."""
    track = Track(real)
    real.application.process.send_signal(signal.SIGSTOP)
    track.watch(5.0)
    asked = len(real.relay.modes_asked())
    real.application.process.send_signal(signal.SIGCONT)
    track.watch(4.0)
    woke_s = track.began_s + 5.0
    wrong = too_far(track.stop(), 7.0, 8.0)
    after = [p.message for p in real.relay.setpoints() if p.t_s > woke_s]
    if any(math.hypot(m.vx, m.vy) > STILL_M_S for m in after):
        wrong.append("it sent velocities after it woke")
    control = {"px4": 6, "ardupilot": 4}[real.rules]
    if any(p.message.param2 == control for p in real.relay.modes_asked()[asked:]):
        wrong.append("it asked for control again")
    if real.pilot.flown_mode() == "OFFBOARD" or not real.application.said("ended"):
        wrong.append(f"the vehicle is in {real.pilot.flown_mode()}: {real.application.lines[-3:]}")
    return wrong, f"{said_stop(track.stop())}; {len(after)} setpoints after waking"


def still_following(real: Real, seconds: float) -> list[str]:
    """What is wrong if it does not go on following."""
    before = len(real.relay.setpoints())
    time.sleep(seconds)
    rate_hz = (len(real.relay.setpoints()) - before) / seconds
    wrong = [] if rate_hz > 3.0 else [f"{rate_hz:.1f} setpoints a second"]
    if real.pilot.flown_mode() != CONTROL[real.rules]:
        wrong.append(f"the vehicle is in {real.pilot.flown_mode()}")
    if real.application.process.poll() is not None:
        wrong.append(f"it ended: {real.application.lines[-3:]}")
    return wrong


def disk_full(real: Real) -> Judged:
    """Every file of the recording reached its size limit: one line each, and the flight goes on."""
    full = real.application.said("no longer written|ends here|cannot be written|File too large")
    wrong = still_following(real, 3.0)
    if not full:
        wrong.append("it did not say that the recording ended")
    # A flush during which Rerun's file breaks is never answered: it is given up after a minute (FLUSH_TIMEOUT_S).
    status = real.application.end(seconds=75.0)
    return wrong + ([f"exit status {status}"] if status else []), "flew on"


def little_disk() -> None:
    """In the child: limits files to 150 kB, which the recording exceeds within seconds."""
    signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (150_000, 150_000))


def nobody_reads(real: Real) -> Judged:
    """The terminal or viewer that reads its messages is gone: the flight goes on and still ends with 0."""
    process = real.application.process
    assert process.stderr is not None
    real.application.stop_listening()
    real.application.process.send_signal(signal.SIGUSR1)  # makes it say something
    wrong = still_following(real, 3.0)
    process.send_signal(signal.SIGINT)
    status = process.wait(20.0)
    time.sleep(1.2)
    if real.pilot.flown_mode() != HOLD[real.rules]:
        wrong.append(f"the vehicle is in {real.pilot.flown_mode()}")
    return wrong + ([f"exit status {status}"] if status else []), "flew on"


def blocked(real: Real) -> Judged:
    """Its terminal takes no more lines: the flight goes on, and Ctrl-C still ends it with Hold or BRAKE."""
    track = Track(real)
    real.application.block()
    real.application.process.send_signal(signal.SIGUSR1)  # makes it say something
    wrong = still_following(real, 3.0)
    real.application.process.send_signal(signal.SIGINT)
    track.watch(8.0)
    status = real.application.process.wait(20.0)
    if real.pilot.flown_mode() != HOLD[real.rules]:
        wrong.append(f"the vehicle is in {real.pilot.flown_mode()}")
    return wrong + ([f"exit status {status}"] if status else []), "flew on"


LEAVES = "ramps down, requests Hold or BRAKE, reports it, ends with status 0"
PROCESS_ROWS = (
    ProcessRow("Ctrl-C", LEAVES, "stands within 6 s, 6 m", leave_by(signal.SIGINT)),
    ProcessRow("SIGTERM", LEAVES, "stands within 6 s, 6 m", leave_by(signal.SIGTERM), ("ardupilot",), fast=True),
    ProcessRow("terminal closed (SIGHUP)", LEAVES, "stands within 6 s, 6 m", leave_by(signal.SIGHUP), ("px4",)),
    ProcessRow("SIGKILL", "the autopilot's failsafe stops it", "stands within 7 s, 8 m", killed),
    ProcessRow(
        "SIGSTOP for 5 s",
        "the failsafe stops it; after waking it does not retake the vehicle",
        "stands within 7 s, 8 m",
        frozen,
    ),
    ProcessRow(
        "recorder's disk full",
        "reports it, goes on following",
        "more than 3 setpoints/s",
        disk_full,
        ("px4",),
        options={"preexec_fn": little_disk},
    ),
    ProcessRow(
        "terminal blocked (Ctrl-S)",
        "goes on following, still ends with status 0",
        "more than 3 setpoints/s",
        blocked,
    ),
    ProcessRow(
        "viewer gone",
        "goes on following, still ends with status 0",
        "more than 3 setpoints/s",
        nobody_reads,
        ("ardupilot",),
    ),
)
