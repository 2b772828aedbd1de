"""Is the vehicle behind the link fit to fly?  Each check returns findings; one that is not ok says how to fix it."""

from collections.abc import Callable

from pymavlink.dialects.v20 import common as dialect

from follow.flight.finding import Finding, Health
from follow.flight.parameters import QUESTIONS, SIMULATOR_PARAMETER, WHERE, Firmware, Parameter, answered, names
from follow.link.client import MavlinkClient
from follow.link.transports import Reach
from follow.messages import NEVER, Autopilot, BatteryLevel, Notify

LISTEN_S = 4.0  # long enough to count the slowest stream, 1 Hz
ASK_TIMES = 4  # a parameter's request or reply may be lost
REPLY_S = 0.5
RECENT_S = 3.0  # of remote control and landed state; both are requested at 2 Hz and more
OLDEST_ATTITUDE_S = 0.1  # `limits.attitude_age_s`
LEAST_HZ = {
    "HEARTBEAT": 0.5,
    "ATTITUDE": 20.0,  # twice the rate of OLDEST_ATTITUDE_S
    "LOCAL_POSITION_NED": 5.0,  # ... 500 ms
    "EXTENDED_SYS_STATE": 0.5,  # without it the vehicle counts as landed
}
CHECKS = (
    *("autopilot", "battery", "clock", "companions", "disk", "identity", "joystick", "link", "remote-control"),
    *("second-sender", "sending", "signing", "simulator", "timesync", "vehicles", *map(str.lower, LEAST_HZ)),
)
"""Names of the checks before a flight, beside those of the autopilot's parameters."""

BATTERY_PERCENT = 30
OLDEST: dict[Autopilot, Firmware] = {
    Autopilot.PX4: (1, 14),
    Autopilot.ARDUPILOT: (4, 5),
}  # in the tables of parameters.py


def check_vehicle(
    client: MavlinkClient,
    listen: Callable[[float], None],
    now: Callable[[], float],
    report: Notify = lambda _line: None,
) -> list[Finding]:
    """The link, the autopilot and its parameters.

    `listen(seconds)` runs the link meanwhile; `report` gets a line before each wait.
    """
    report(f"listening for a vehicle, {LISTEN_S:g} s")
    listen(LISTEN_S)  # to meet the vehicle and to request stream rates
    state = client.state(now())
    if state.heartbeat_t_s == NEVER or state.autopilot is None:
        return [_nobody(client)]
    before = dict(client.heard.counts)
    report(f"{state.autopilot.value} found: measuring its message rates, {LISTEN_S:g} s")
    listen(LISTEN_S)
    findings = [_autopilot(client, state.autopilot, now()), *_rates(client, before), *_senders(client, now())]
    findings += [_clock(client), _battery(client, now()), _remote(client, now())]
    return [*findings, *check_parameters(client, state.autopilot, listen, report)]


def check_parameters(
    client: MavlinkClient, autopilot: Autopilot, listen: Callable[[float], None], report: Notify
) -> list[Finding]:
    """Read and judge the parameters that decide what the vehicle does when this program fails."""
    known = client.heard.parameters
    known.clear()
    for _ in range(ASK_TIMES):
        missing = [name for name in names(autopilot) if name not in known]
        if not missing:
            break
        report(f"reading parameters: {len(missing)} of {len(names(autopilot))} to come")
        for name in missing:
            client.request_parameter(name)
        listen(REPLY_S)
    firmware = firmware_of(client)
    parameters = dict.fromkeys(answered(question, known, firmware) for question in QUESTIONS[autopilot])
    seen: set[str] = set()
    findings: list[Finding] = []
    for parameter in parameters:
        if parameter.name not in seen:
            seen.add(parameter.name)
            findings.append(judge(parameter, known.get(parameter.name), WHERE[autopilot]))
    return findings


def judge(parameter: Parameter, value: float | None, where: str = "") -> Finding:
    """One parameter's finding; None is a value that the autopilot did not report."""
    if value is None:
        verdict = Health.WARN if parameter.rule is None else Health.RED
        return Finding(
            parameter.name, verdict, f"the autopilot does not report it ({parameter.meaning})", "check its firmware"
        )
    text = parameter.described(value)
    if parameter.rule is None or parameter.rule.allows(value * parameter.scale):
        return Finding(parameter.name, Health.OK, text)
    return Finding(parameter.name, Health.RED, f"{text}, wanted {parameter.rule.text}", parameter.fix, where)


def check_signing(client: MavlinkClient, signs: bool, reach: Reach) -> Finding:
    """Whether the link is signed, and if not, who else can command the vehicle on it."""
    refused = client.packets.refused
    if not signs and reach is Reach.NETWORK:
        text = "off: anyone on this network can fly the vehicle"
        return Finding("signing", Health.RED, text, "give both sides a key (--signing-key FILE)")
    if not signs:
        return Finding("signing", Health.OK, f"off, on a {reach.value} link")
    if refused and not client.heard.counts:
        fix = "give the autopilot the same key"
        return Finding("signing", Health.RED, f"all {refused} packets were refused", fix)
    return Finding("signing", Health.OK, f"on, {refused} packets refused")


def check_sending(unsent: int) -> Finding:
    """Whether our packets leave."""
    if unsent:
        text = f"{unsent} {'packet' if unsent == 1 else 'packets'} could not be sent"
        return Finding("sending", Health.WARN, text, "a faster link, or check its cable and address")
    return Finding("sending", Health.OK, "every packet left")


def check_simulator(client: MavlinkClient, reach: Reach, *, said: bool) -> Finding:
    """Whether the vehicle is a simulator, which alone may be flown by a recorded file or a drawn scene.

    It is if the person says so, or on a loopback link by a parameter that only simulators have.
    """
    autopilot = client.state(NEVER).autopilot
    if said:
        return Finding("simulator", Health.OK, "you said that it is one (--simulated)")
    name = SIMULATOR_PARAMETER[autopilot] if autopilot is not None else ""
    if reach is Reach.LOOPBACK and name in client.heard.parameters:
        return Finding("simulator", Health.OK, f"a loopback link, and it has {name}")
    text = "this camera shows a file or a drawn scene, and the vehicle may be a real one"
    return Finding("simulator", Health.RED, text, "a live camera, or --simulated if nothing real flies")


def firmware_of(client: MavlinkClient) -> Firmware | None:
    """The autopilot's major and minor version, if it reported one."""
    version = client.heard.version
    if version is None or not version.flight_sw_version:
        return None
    return version.flight_sw_version >> 24, version.flight_sw_version >> 16 & 0xFF


def _nobody(client: MavlinkClient) -> Finding:
    """No vehicle was found: what was received instead."""
    if client.packets.refused:
        text = f"{client.packets.refused} packets without our signature"
        return Finding("link", Health.RED, text, "give both sides the same key")
    if client.heard.senders:
        heard = "; ".join(described(*pair) for pair in sorted(client.heard.senders.items()))
        if client.wanted_id in client.heard.vehicles or client.wanted_id is None:
            wanted, fix = "no multirotor's autopilot (component 1) of PX4 or ArduPilot", "check what is connected"
        else:
            ids = " or ".join(map(str, sorted(client.heard.vehicles)))
            wanted = f"no system {client.wanted_id}"
            fix = f"--system-id {ids}" if ids else "check what is connected"
        return Finding("link", Health.RED, f"{wanted} is heard, but {heard}", fix)
    if client.packets.unknown:
        text = f"{client.packets.unknown} MAVLink packets, but no heartbeat among them"
        return Finding("link", Health.RED, text, "check what is connected and what it forwards")
    if client.packets.unreadable:
        text = f"{client.packets.unreadable} bytes, but no MAVLink packet in them"
        return Finding("link", Health.RED, text, "a serial line: check the baud rate; else: check what sends there")
    return Finding("link", Health.RED, "nothing is heard", "check address, cable, power, and MAVLink on that port")


def described(source: tuple[int, int], kind: tuple[int, int]) -> str:
    """A sender of HEARTBEAT for a person to read."""
    types, autopilots = dialect.enums["MAV_TYPE"], dialect.enums["MAV_AUTOPILOT"]
    what = types[kind[0]].name.removeprefix("MAV_TYPE_") if kind[0] in types else f"type {kind[0]}"
    whose = autopilots[kind[1]].name.removeprefix("MAV_AUTOPILOT_") if kind[1] in autopilots else f"{kind[1]}"
    flown = "" if kind[1] == dialect.MAV_AUTOPILOT_INVALID else f" with {whose}"
    return f"system {source[0]} component {source[1]} ({what}{flown})"


def _autopilot(client: MavlinkClient, autopilot: Autopilot, now_s: float) -> Finding:
    name = f"{autopilot.value}, system {client.vehicle_id}, mode {client.state(now_s).mode}"
    firmware = firmware_of(client)
    if firmware is None:
        return Finding("autopilot", Health.WARN, f"{name}, version unknown")
    text = f"{name}, version {firmware[0]}.{firmware[1]}"
    if firmware < OLDEST[autopilot]:
        oldest = ".".join(map(str, OLDEST[autopilot]))
        return Finding("autopilot", Health.WARN, f"{text} is older than {oldest}", "update its firmware")
    return Finding("autopilot", Health.OK, text)


def _rates(client: MavlinkClient, before: dict[str, int]) -> list[Finding]:
    findings: list[Finding] = []
    for name, least_hz in LEAST_HZ.items():
        rate_hz = (client.heard.counts[name] - before.get(name, 0)) / LISTEN_S
        text = f"{rate_hz:.1f} Hz, at least {least_hz:g}"
        if rate_hz >= least_hz:
            findings.append(Finding(name.lower(), Health.OK, text))
            continue
        fix = "a faster link, or fewer other streams on it" if rate_hz else "check what filters it on the way"
        if name == "LOCAL_POSITION_NED" and not rate_hz:
            fix = "wait until the autopilot has a position (GPS); an ArduCopter needs some 40 s"
        findings.append(Finding(name.lower(), Health.RED, text, fix))
    return findings


def _senders(client: MavlinkClient, now_s: float) -> list[Finding]:
    heard = client.heard
    findings: list[Finding] = []
    if heard.steering:
        text = listed(sorted(heard.steering))
        findings.append(Finding("second-sender", Health.RED, f"{text} also steers this vehicle", "stop that program"))
    else:
        findings.append(Finding("second-sender", Health.OK, "nobody else is heard steering"))
    if heard.joysticks:
        text = f"{listed(sorted(heard.joysticks))} sends sticks: moving one ends FOLLOW"
        findings.append(Finding("joystick", Health.OK, text))
    if heard.companions:
        text = f"{listed(sorted(heard.companions))} is another onboard computer"
        findings.append(Finding("companions", Health.WARN, text, "stop it, unless it only reads"))
    if len(heard.vehicles) > 1:
        ids = ", ".join(map(str, sorted(heard.vehicles)))
        verdict = Health.RED if client.wanted_id is None else Health.OK
        fix = "" if verdict is Health.OK else "--system-id N of the one to fly"
        findings.append(Finding("vehicles", verdict, f"systems {ids} are heard, {client.vehicle_id} is flown", fix))
    if client.state(now_s).contested_t_s > NEVER:
        addresses = ", ".join(f"{a[0]}:{a[1]}" for a in client.peer.strangers if a is not None)
        text = f"two senders use system {client.vehicle_id}{f' (also from {addresses})' if addresses else ''}"
        fix = "give each vehicle an id of its own (MAV_SYS_ID, SYSID_THISMAV or MAV_SYSID), or stop the copy"
        findings.append(Finding("identity", Health.RED, text, fix))
    else:
        findings.append(Finding("identity", Health.OK, f"one sender uses system {client.vehicle_id}"))
    return findings


def listed(senders: list[tuple[int, int]]) -> str:
    """Senders for a person to read."""
    return ", ".join(f"system {system} component {component}" for system, component in senders)


def _clock(client: MavlinkClient) -> Finding:
    """Without the vehicle's clock nobody knows the telemetry's age; late telemetry counts as half a round trip old."""
    clock = client.clock
    if clock.offset_s is None:
        text = "no reply to TIMESYNC, which both autopilots answer: how old the telemetry is cannot be known"
        fix = "let TIMESYNC pass both ways on every router, and sign all of them or none"
        return Finding("timesync", Health.RED, text, fix)
    if clock.round_trip_s / 2 > OLDEST_ATTITUDE_S:
        text = f"a round trip takes {clock.round_trip_s:.1f} s: telemetry counts as {clock.round_trip_s / 2:.1f} s old"
        return Finding("timesync", Health.RED, text, "a faster link, or fewer other streams on it")
    return Finding("timesync", Health.OK, f"the vehicle's clock is known within {500 * clock.round_trip_s:.1f} ms")


def _battery(client: MavlinkClient, now_s: float) -> Finding:
    status, level = client.heard.status, client.state(now_s).battery
    percent = f"{status.battery_remaining} %" if status is not None and status.battery_remaining >= 0 else "unknown"
    if level in (BatteryLevel.LOW, BatteryLevel.CRITICAL):
        return Finding("battery", Health.RED, f"{percent}, {level.value} by the autopilot's levels", "charge it")
    if percent == "unknown":
        return Finding("battery", Health.WARN, "the autopilot does not report it", "set up its battery monitor")
    low = status is not None and status.battery_remaining < BATTERY_PERCENT
    return Finding("battery", Health.WARN if low else Health.OK, percent, "charge it" if low else "")


def _remote(client: MavlinkClient, now_s: float) -> Finding:
    """A pilot must be able to take over: the autopilot reports a healthy remote control, or its channels arrive."""
    state = client.state(now_s)
    recent = now_s - state.rc_t_s <= RECENT_S
    if state.rc_healthy is False or (state.rc_healthy is None and not recent):
        text = "lost" if state.rc_healthy is False else "the autopilot has none: no pilot can take over"
        return Finding("remote-control", Health.RED, text, "switch it on, and check that it is bound")
    return Finding("remote-control", Health.OK, "on")
