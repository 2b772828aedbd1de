"""The doctor at a simulated autopilot, and a person who types what it prints."""

import struct

from pymavlink.dialects.v20 import common as dialect

from follow.flight.finding import Finding, Health
from follow.flight.vehicle_checks import check_vehicle
from follow.messages import Autopilot
from tests.support.autopilot_pair import Pair


def examined(pair: Pair) -> list[Finding]:
    return check_vehicle(pair.client, pair.run, lambda: pair.t_s)


def red(findings: list[Finding]) -> dict[str, str]:
    return {finding.name: finding.fix for finding in findings if finding.verdict is Health.RED}


def obey(pair: Pair, command: str) -> None:
    """What a person types into MAVProxy, as it goes over the wire."""
    verb, noun, name, value = command.split()
    assert (verb, noun) == ("param", "set")
    old = pair.system.flight.parameters[name]
    number = type(old)(float(value))
    station = dialect.MAVLink(None, 255, 190)
    if pair.system.flight.autopilot is Autopilot.PX4 and isinstance(old, int):
        packed = dialect.MAVLink_param_set_message(1, 1, name.encode(), 0.0, 6)
        packed.param_value = int_as_float(number)
    else:
        packed = dialect.MAVLink_param_set_message(1, 1, name.encode(), number, 9)
    pair.system.receive(packed.pack(station))


def int_as_float(number: int) -> float:
    return struct.unpack("<f", struct.pack("<i", number))[0]
