"""Is this set-up fit to fly?  Each check returns findings; a finding that is not ok says what mends it."""

import itertools
import shutil
import statistics
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from enum import Enum
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from follow.camera import Camera, CameraError
from follow.flight.parameters import PARAMETERS, Parameter
from follow.link.client import MavlinkClient
from follow.messages import NEVER, Autopilot, Frame

LISTEN_S = 4.0  # enough to count the slowest stream, 1 Hz
ASK_TIMES = 4  # a parameter's request or answer may be lost
ANSWER_S = 0.5
LEAST_HZ = {"ATTITUDE": 20.0, "LOCAL_POSITION_NED": 5.0}  # the gate lets them be 100 and 500 ms old: twice that rate
FRAME_AGE_S = 0.2  # the gate's limit (follow/safety/limits.py)
LEAST_FPS = 10.0  # two pictures within the gate's limit
KEPT_PICTURES = 30  # for timing the tracker: a second of a usual camera
TRACKER_SHARE = 0.7  # of the time between two pictures: the rest is for the loop and the recording
LITTLE_DISK, NO_DISK = 5e9, 5e8  # bytes: an hour of recording takes some 2e9
BATTERY_PERCENT = 30
OLDEST = {Autopilot.PX4: (1, 14), Autopilot.ARDUPILOT: (4, 3)}  # the failsafe parameters have their names since these
SENSIBLE_UNIX_S = 1.7e9  # November 2023: a clock before this was never set


class Health(str, Enum):
    """How bad it is."""

    OK = "ok"
    WARN = "warn"
    RED = "red"


@dataclass(frozen=True, slots=True)
class Finding:
    """One line of the doctor's: what was looked at, how bad it is, what was found, and what mends it."""

    name: str
    verdict: Health
    text: str
    fix: str = ""

    def __str__(self) -> str:
        return f"{self.verdict.value:4} {self.name}: {self.text}" + (f"  ->  {self.fix}" if self.fix else "")


class NotFitError(RuntimeError):
    """Something is red; the message names it."""


def is_fit(findings: Iterable[Finding], waived: Sequence[str] = ()) -> bool:
    """Whether nothing is red but what was waived by name."""
    return all(finding.verdict is not Health.RED or finding.name in waived for finding in findings)


def check_vehicle(client: MavlinkClient, listen: Callable[[float], None], now: Callable[[], float]) -> list[Finding]:
    """The link, the autopilot and its parameters.  `listen(seconds)` keeps the conversation going meanwhile."""
    listen(LISTEN_S)  # to be found, and to ask for rates
    state = client.state(now())
    if state.heartbeat_t_s == NEVER:
        return [_nobody(client)]
    before = dict(client.heard.counts)
    listen(LISTEN_S)
    findings = [_autopilot(client, now()), *_rates(client, before), *_others(client), _clock(client), _battery(client)]
    if state.autopilot is not None:
        findings += check_parameters(client, state.autopilot, listen)
    return findings


def check_parameters(client: MavlinkClient, autopilot: Autopilot, listen: Callable[[float], None]) -> list[Finding]:
    """Read and judge what decides the vehicle's fate when this program dies."""
    wanted = PARAMETERS[autopilot]
    known = client.heard.parameters
    known.clear()
    for _ in range(ASK_TIMES):
        missing = [parameter.name for parameter in wanted if parameter.name not in known]
        if not missing:
            break
        for name in missing:
            client.request_parameter(name)
        listen(ANSWER_S)
    return [judge(parameter, known.get(parameter.name)) for parameter in wanted]


def judge(parameter: Parameter, value: float | None) -> Finding:
    """One parameter's finding; None is a value that the autopilot did not tell."""
    if value is None:
        verdict = Health.WARN if parameter.is_right is None else Health.RED
        return Finding(parameter.name, verdict, "the autopilot does not tell it", "look whether it exists there")
    text = f"{value:g} ({parameter.meaning})"
    if parameter.is_right is None or parameter.is_right(value):
        return Finding(parameter.name, Health.OK, text)
    return Finding(parameter.name, Health.RED, f"{text}, wanted {parameter.wanted}", parameter.fix)


def check_camera(
    camera: Camera, now: Callable[[], float] | None, kept: list[Frame], seconds: float = 3.0
) -> list[Finding]:
    """Look through an open camera for a while, and put its first pictures into `kept`.

    `now` is the clock of a live one's pictures, None for a file.
    """
    times: list[float] = []
    ages: list[float] = []
    began_s = time.monotonic()
    try:
        for frame in camera.frames():
            if frame is not None:
                times.append(frame.t_s)
                if len(kept) < KEPT_PICTURES:
                    kept.append(frame)
                ages.append(now() - frame.t_s if now else 0.0)
            if time.monotonic() - began_s > seconds:
                break
    except CameraError as error:
        return [Finding("camera", Health.RED, str(error), "look whether the source delivers")]
    if len(times) < 3 or times[-1] <= times[0]:
        return [Finding("camera", Health.RED, f"{len(times)} pictures in {seconds:g} s", "look at cable and power")]
    rate = (len(times) - 1) / (times[-1] - times[0])
    gap_ms = 1e3 * max(after - before for before, after in itertools.pairwise(times))
    text = f"{rate:.1f} pictures/s, longest gap {gap_ms:.0f} ms"
    slow = rate < LEAST_FPS
    findings = [Finding("camera", Health.RED if slow else Health.OK, text, "choose a faster mode" if slow else "")]
    if now:
        age_s = statistics.median(ages)
        old = age_s > FRAME_AGE_S
        fix = "a shorter buffer, or a lower resolution" if old else ""
        text = f"pictures are {1e3 * age_s:.0f} ms old when they arrive"
        findings.append(Finding("latency", Health.RED if old else Health.OK, text, fix))
    return findings


def check_tracker(update: Callable[[NDArray[np.uint8]], object], frames: Sequence[Frame], fps: float) -> Finding:
    """Time the tracker on this machine, on real pictures, against the time between two of them."""
    took_ms: list[float] = []
    for frame in frames:
        began_s = time.perf_counter()
        update(frame.image)
        took_ms.append(1e3 * (time.perf_counter() - began_s))
    took_ms.sort()
    usual, worst = statistics.median(took_ms), took_ms[min(len(took_ms) - 1, int(0.99 * len(took_ms)))]
    period_ms = 1e3 / fps
    text = f"{usual:.1f} ms a picture, 99 % within {worst:.1f} ms, of {period_ms:.1f} ms"
    if usual > period_ms:
        return Finding("tracker", Health.RED, text, "a smaller picture, a lower rate, or --tracker racf--")
    if worst > TRACKER_SHARE * period_ms:
        return Finding("tracker", Health.WARN, f"{text}: little head-room", "a lower rate, or --tracker racf--")
    return Finding("tracker", Health.OK, text)


def check_disk(folder: Path) -> Finding:
    """Room for the recording."""
    existing = next(path for path in (folder.absolute(), *folder.absolute().parents) if path.exists())
    free = shutil.disk_usage(existing).free
    text = f"{free / 1e9:.1f} GB free for {folder}"
    if free < NO_DISK:
        return Finding("disk", Health.RED, text, "make room, or another --out")
    return Finding("disk", Health.WARN if free < LITTLE_DISK else Health.OK, text)


def check_time(signs: bool, unix_s: float) -> Finding:
    """The machine's calendar: recordings bear it, and signatures are refused without it."""
    if unix_s > SENSIBLE_UNIX_S:
        return Finding("clock", Health.OK, time.strftime("%Y-%m-%d %H:%M:%S UTC", time.gmtime(unix_s)))
    verdict = Health.RED if signs else Health.WARN
    return Finding("clock", verdict, "the machine's clock was never set", "timedatectl set-ntp true")


def check_signing(client: MavlinkClient, signs: bool) -> Finding:
    """Whether the link is signed and whether the vehicle's packets are accepted."""
    refused = client.packets.refused
    if not signs:
        return Finding("signing", Health.WARN, "off: anyone on this link can fly the vehicle", "--signing-key FILE")
    if refused and not client.heard.counts:
        fix = "give the autopilot the same key"
        return Finding("signing", Health.RED, f"all {refused} packets were refused", fix)
    return Finding("signing", Health.OK, f"on, {refused} packets refused")


def _nobody(client: MavlinkClient) -> Finding:
    if client.packets.refused:
        text = f"{client.packets.refused} packets with a wrong signature or none"
        return Finding("link", Health.RED, text, "give both sides the same key")
    if client.packets.unreadable:
        text = f"{client.packets.unreadable} bytes, but no packet in them"
        return Finding("link", Health.RED, text, "look at the baud rate")
    return Finding("link", Health.RED, "no PX4 or ArduPilot multirotor is heard", "look at address, cable and power")


def _autopilot(client: MavlinkClient, now_s: float) -> Finding:
    state = client.state(now_s)
    assert state.autopilot is not None
    name = f"{state.autopilot.value}, system {client.vehicle_id}, mode {state.mode}"
    version = client.heard.version
    if version is None:
        return Finding("autopilot", Health.WARN, f"{name}, version not told")
    number = version.flight_sw_version >> 24, version.flight_sw_version >> 16 & 0xFF
    text = f"{name}, version {number[0]}.{number[1]}.{version.flight_sw_version >> 8 & 0xFF}"
    if number < OLDEST[state.autopilot]:
        oldest = ".".join(map(str, OLDEST[state.autopilot]))
        return Finding("autopilot", Health.WARN, f"{text} is older than {oldest}", "update its firmware")
    return Finding("autopilot", Health.OK, text)


def _rates(client: MavlinkClient, before: dict[str, int]) -> list[Finding]:
    findings: list[Finding] = []
    for name, least_hz in LEAST_HZ.items():
        rate_hz = (client.heard.counts[name] - before.get(name, 0)) / LISTEN_S
        verdict = Health.OK if rate_hz >= least_hz else Health.RED
        fix = "" if verdict is Health.OK else "a faster link, or fewer other streams on it"
        findings.append(Finding(name.lower(), verdict, f"{rate_hz:.1f} a second, at least {least_hz:g}", fix))
    return findings


def _others(client: MavlinkClient) -> list[Finding]:
    findings: list[Finding] = []
    steering = sorted(client.heard.steering)
    if steering:
        text = ", ".join(f"system {system} component {component}" for system, component in steering)
        findings.append(Finding("second-sender", Health.RED, f"{text} steers this vehicle, too", "stop that program"))
    else:
        findings.append(Finding("second-sender", Health.OK, "nobody else is heard steering"))
    twins = sorted(client.heard.companions)
    if twins:
        text = ", ".join(f"system {system} component {component}" for system, component in twins)
        findings.append(Finding("companions", Health.WARN, f"{text} is another onboard computer"))
    if len(client.heard.vehicles) > 1:
        ids = ", ".join(map(str, sorted(client.heard.vehicles)))
        findings.append(Finding("vehicles", Health.WARN, f"systems {ids} are heard", "--system-id N to be sure"))
    return findings


def _clock(client: MavlinkClient) -> Finding:
    clock = client.clock
    if clock.offset_s is None:
        return Finding("timesync", Health.WARN, "no answer: measurements count from their arrival")
    return Finding("timesync", Health.OK, f"the vehicle's clock is known within {500 * clock.round_trip_s:.1f} ms")


def _battery(client: MavlinkClient) -> Finding:
    status = client.heard.status
    if status is None or status.battery_remaining < 0:
        return Finding("battery", Health.WARN, "the autopilot does not tell it")
    low = status.battery_remaining < BATTERY_PERCENT
    fix = "charge it" if low else ""
    return Finding("battery", Health.WARN if low else Health.OK, f"{status.battery_remaining} %", fix)
