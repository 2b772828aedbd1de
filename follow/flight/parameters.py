"""The autopilot's parameters that decide what happens when this program, the link or the remote control fails.

Each question has one parameter, or several names of it in different firmware versions; the name that the autopilot has
is judged.  Defaults and values are those of PX4 1.14 to 1.18 and ArduCopter 4.5 to 4.7.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from follow.messages import Autopilot

Firmware = tuple[int, int]
"""Major and minor version."""

FENCE_M = 1000.0  # a small drone is out of sight beyond it; our own fence is 300 m (follow/safety/limits.py)
FENCE_HEIGHT_M = 150.0  # 120 m is the open category's limit in Europe, with room for braking

WHERE: dict[Autopilot, str] = {
    Autopilot.PX4: "type it into QGroundControl's MAVLink Console (Analyze Tools) or MAVProxy; "
    "for `python -m sim.autopilot`, start it with --set NAME=VALUE",
    Autopilot.ARDUPILOT: "type it into MAVProxy, or set it in Mission Planner's or QGroundControl's parameter list; "
    "for `python -m sim.autopilot`, start it with --set NAME=VALUE",
}
"""Where a person types `param set NAME VALUE`."""


@dataclass(frozen=True, slots=True)
class Rule:
    """The condition on a value: a test, and the same in words."""

    allows: Callable[[float], bool]
    text: str


@dataclass(frozen=True, slots=True)
class Parameter:
    """One parameter: its meaning, its rule (None: it is only reported), and the value that fixes it.

    `scale` times the value is its SI value, which the rule judges and `unit` names; `better` is in the parameter's own
    unit.  It exists from firmware `since` on and before `before`.
    """

    name: str
    meaning: str
    rule: Rule | None = None
    better: str = ""
    unit: str = ""
    scale: float = 1.0
    since: Firmware = (0, 0)
    before: Firmware = (99, 0)

    @property
    def fix(self) -> str:
        """The command for PX4's shell and for MAVProxy."""
        return f"param set {self.name} {self.better}"

    def exists_in(self, firmware: Firmware | None) -> bool:
        """Whether this firmware has it; any may, if the version is unknown."""
        return firmware is None or self.since <= firmware < self.before

    def described(self, value: float) -> str:
        """The value in SI units with its meaning."""
        return f"{value * self.scale:g}{' ' * bool(self.unit)}{self.unit} ({self.meaning})"


def between(low: float, high: float) -> Rule:
    """A number within two bounds."""
    return Rule(lambda value: low - 1e-6 <= value <= high + 1e-6, f"{low:g} to {high:g}")


def up_to(high: float) -> Rule:
    """A positive number up to a bound; 0 is off."""
    return Rule(lambda value: 0.0 < value <= high + 1e-6, f"more than 0 and at most {high:g}")


def one_of(values: Mapping[int, str]) -> Rule:
    """One of these values, each with its meaning."""
    return Rule(lambda value: value in values, " or ".join(f"{value} {what}" for value, what in values.items()))


def has_bits(bits: int, text: str) -> Rule:
    """All of these bits set."""
    return Rule(lambda value: int(value) & bits == bits, text)


def lacks_bits(bits: int, text: str) -> Rule:
    """None of these bits set."""
    return Rule(lambda value: int(value) & bits == 0, text)


Question = tuple[Parameter, ...]
"""The names that one parameter has had."""

PX4_QUESTIONS: tuple[Question, ...] = (
    # At the default of 1.0 s the vehicle flew on at full speed for 1.1 to 1.4 s.
    (Parameter("COM_OF_LOSS_T", "flies on this long without setpoints", between(0.5, 1.0), "0.5", "s"),),
    # At 0, without a remote control, the vehicle drifted and sank at 0.6 m/s; at 5 it held its position.
    (Parameter("COM_OBL_RC_ACT", "reaction when setpoints end", one_of({5: "Hold", 3: "Return", 4: "Land"}), "5"),),
    # At 1 the sticks do not break OFFBOARD.
    (
        Parameter(
            "COM_RC_OVERRIDE",
            "lets sticks take over",
            has_bits(2, "bit 1 set (sticks end OFFBOARD)"),
            "3",
            before=(1, 18),
        ),
        Parameter(
            "MAN_OVERRIDE_SPD",
            "stick speed that takes over, full travel a second",
            between(0.0, 3.0),
            "1",
            "1/s",
            since=(1, 18),
        ),
    ),
    (
        Parameter("COM_RC_STICK_OV", "stick speed that takes over", between(5.0, 40.0), "30", "%/s", before=(1, 18)),
        Parameter("MAN_OVERRIDE_SPD", "stick speed that takes over", None, "", "1/s", since=(1, 18)),
    ),
    # The sticks are blocked for this long after a failsafe began.
    (Parameter("COM_FAIL_ACT_T", "blocks sticks for this long in a failsafe", between(0.0, 5.0), "5", "s"),),
    (
        Parameter(
            "NAV_RCL_ACT",
            "reaction when the remote control is lost",
            one_of({2: "Return", 1: "Hold", 3: "Land"}),
            "2",
        ),
    ),
    (Parameter("COM_RCL_EXCEPT", "modes without that reaction", lacks_bits(4, "bit 2 not set (OFFBOARD)"), "0"),),
    (
        Parameter(
            "COM_RC_IN_MODE",
            "sources of the sticks",
            Rule(lambda value: value != 4, "not 4 (no sticks at all)"),
            "3",
        ),
    ),
    (
        Parameter(
            "COM_LOW_BAT_ACT",
            "reaction to a critical battery",
            one_of({3: "Return, then Land", 2: "Land"}),
            "3",
        ),
    ),
    (Parameter("NAV_DLL_ACT", "reaction when the ground station is lost"),),
    (Parameter("GF_ACTION", "reaction at the fence", one_of({2: "Hold", 3: "Return", 5: "Land"}), "2"),),
    # As far and as high as our own fence and ceiling (follow/safety/limits.py), with room for braking.
    (Parameter("GF_MAX_HOR_DIST", "fence radius", up_to(FENCE_M), "350", "m"),),
    (Parameter("GF_MAX_VER_DIST", "fence height", up_to(FENCE_HEIGHT_M), "120", "m"),),
    (Parameter("RTL_RETURN_ALT", "height of a return", None, "", "m"),),
)

ARDUPILOT_QUESTIONS: tuple[Question, ...] = (
    # At the default of 3.0 s the vehicle flew and turned on for 3 s: 6.5 m at 2 m/s.
    (Parameter("GUID_TIMEOUT", "flies on this long without setpoints", between(0.5, 1.0), "1.0", "s"),),
    (
        Parameter(
            "FS_THR_ENABLE",
            "reaction when the remote control is lost",
            one_of({1: "RTL", 3: "Land", 4: "SmartRTL or RTL", 5: "SmartRTL or Land", 6: "RTL", 7: "Brake or Land"}),
            "1",
        ),
    ),
    (Parameter("FS_OPTIONS", "exceptions from failsafes", lacks_bits(4, "bit 2 not set (GUIDED goes on)"), "16"),),
    (
        Parameter(
            "BATT_FS_LOW_ACT",
            "reaction to a low battery",
            one_of({2: "RTL", 1: "Land", 3: "SmartRTL or RTL", 4: "SmartRTL or Land", 6: "RTL", 7: "Brake or Land"}),
            "2",
        ),
    ),
    (Parameter("BATT_FS_CRT_ACT", "reaction to a critical battery"),),
    (
        Parameter(
            "FS_EKF_ACTION",
            "reaction when the estimate fails",
            one_of({1: "Land", 2: "AltHold", 3: "Land from all modes"}),
            "1",
        ),
    ),
    (Parameter("FS_GCS_ENABLE", "reaction when the ground station is lost"),),
    (Parameter("FS_GCS_TIMEOUT", "counts the ground station as lost after", None, "", "s"),),
    (Parameter("FENCE_ENABLE", "fence on", one_of({1: "on"}), "1"),),
    (Parameter("FENCE_TYPE", "kinds of fence", has_bits(3, "bits 0 and 1 set (height, circle)"), "7"),),
    (
        Parameter(
            "FENCE_ACTION", "reaction at the fence", Rule(lambda value: value >= 1, "1 or more (0 only reports)"), "1"
        ),
    ),
    (Parameter("FENCE_RADIUS", "fence radius", up_to(FENCE_M), "300", "m"),),
    (Parameter("FENCE_ALT_MAX", "fence height", up_to(FENCE_HEIGHT_M), "100", "m"),),
    # At its default of 3 the vehicle stops 2 m inside the fence, in GUIDED, and no longer obeys (docs/vehicle.md).
    (Parameter("AVOID_ENABLE", "3: stops 2 m inside the fence and stays in GUIDED"),),
    (
        Parameter("WP_ACC", "acceleration limit", None, "", "m/s2"),
        Parameter("WPNAV_ACCEL", "acceleration limit", None, "", "m/s2", 0.01),
    ),
    (
        Parameter("PSC_NE_JERK", "jerk limit", None, "", "m/s3"),
        Parameter("PSC_JERK_NE", "jerk limit", None, "", "m/s3"),
        Parameter("PSC_JERK_XY", "jerk limit", None, "", "m/s3", before=(4, 7)),
    ),
    (Parameter("ATC_SLEW_YAW", "yaw rate limit", None, "", "deg/s", 0.01),),
    (
        Parameter("ATC_ANGLE_MAX", "tilt limit", None, "", "deg", since=(4, 7)),
        Parameter("ANGLE_MAX", "tilt limit", None, "", "deg", 0.01, before=(4, 7)),
    ),
    (
        Parameter("RTL_ALT_M", "height of a return", None, "", "m", since=(4, 7)),
        Parameter("RTL_ALT", "height of a return", None, "", "m", 0.01, before=(4, 7)),
    ),
    (
        Parameter("LAND_SPD_MS", "last speed of a landing", None, "", "m/s", since=(4, 7)),
        Parameter("LAND_SPEED", "last speed of a landing", None, "", "m/s", 0.01, before=(4, 7)),
    ),
    (
        Parameter("MAV_GCS_SYSID", "system id that may send sticks", since=(4, 7)),
        Parameter("SYSID_MYGCS", "system id that may send sticks", before=(4, 7)),
    ),
)

QUESTIONS: dict[Autopilot, tuple[Question, ...]] = {
    Autopilot.PX4: PX4_QUESTIONS,
    Autopilot.ARDUPILOT: ARDUPILOT_QUESTIONS,
}

SIMULATOR_PARAMETER: dict[Autopilot, str] = {Autopilot.PX4: "SIM_BAT_DRAIN", Autopilot.ARDUPILOT: "SIM_SPEEDUP"}
"""A parameter that only simulators have (PX4's SITL module battery_simulator, ArduPilot's SITL)."""


def names(autopilot: Autopilot) -> tuple[str, ...]:
    """Every parameter to read, by all its names, each once."""
    needed = (parameter.name for question in QUESTIONS[autopilot] for parameter in question)
    return tuple(dict.fromkeys((*needed, SIMULATOR_PARAMETER[autopilot])))


def answered(question: Question, known: Mapping[str, float], firmware: Firmware | None) -> Parameter:
    """The parameter of a question that the autopilot has, or else the one that its firmware should have."""
    reported = [parameter for parameter in question if parameter.name in known]
    should = [parameter for parameter in question if parameter.exists_in(firmware)]
    return (reported or should or list(question))[0]
