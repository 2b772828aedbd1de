"""The parameters that `follow doctor` asks a person to set, per autopilot and firmware version."""

from follow.flight.parameters import QUESTIONS, answered
from follow.messages import Autopilot
from sim.autopilot.parameters import DEFAULT_FIRMWARE, Table, defaults


def fixes(autopilot: Autopilot, firmware: str = "") -> dict[str, str]:
    """Name -> value as typed, of each parameter that is wrong by default."""
    known = defaults(autopilot, firmware)
    major, minor = (firmware or DEFAULT_FIRMWARE[autopilot]).split(".")
    out: dict[str, str] = {}
    for question in QUESTIONS[autopilot]:
        parameter = answered(question, known, (int(major), int(minor)))
        value = known.get(parameter.name)
        if parameter.rule is not None and value is not None and not parameter.rule.allows(value * parameter.scale):
            out[parameter.name] = parameter.better
    return out


def fit(autopilot: Autopilot, firmware: str = "") -> Table:
    """The same as numbers of the parameter's own type."""
    known = defaults(autopilot, firmware)
    return {name: type(known[name])(float(text)) for name, text in fixes(autopilot, firmware).items()}
