"""The flight modes of PX4 and ArduCopter: names, numbers on the wire, and how long each obeys without setpoints.

PX4 packs a main and a sub mode into HEARTBEAT.custom_mode (`px4_custom_mode.h`: main << 16 | sub << 24); ArduCopter
numbers its modes (`ArduCopter/mode.h`).  Names are upper case and short, as ground stations print them.
"""

from dataclasses import dataclass

from follow.messages import Autopilot

PX4_MODES: dict[tuple[int, int], str] = {
    (1, 0): "MANUAL",
    (2, 0): "ALTCTL",
    (3, 0): "POSCTL",
    (3, 1): "ORBIT",
    (4, 1): "READY",
    (4, 2): "TAKEOFF",
    (4, 3): "HOLD",
    (4, 4): "MISSION",
    (4, 5): "RTL",
    (4, 6): "LAND",
    (4, 8): "FOLLOW_TARGET",
    (4, 9): "PRECLAND",
    (5, 0): "ACRO",
    (6, 0): "OFFBOARD",
    (7, 0): "STABILIZED",
}
"""(main, sub) -> name."""

ARDUCOPTER_MODES: dict[int, str] = {
    0: "STABILIZE",
    1: "ACRO",
    2: "ALT_HOLD",
    3: "AUTO",
    4: "GUIDED",
    5: "LOITER",
    6: "RTL",
    7: "CIRCLE",
    9: "LAND",
    11: "DRIFT",
    13: "SPORT",
    14: "FLIP",
    15: "AUTOTUNE",
    16: "POSHOLD",
    17: "BRAKE",
    18: "THROW",
    19: "AVOID_ADSB",
    20: "GUIDED_NOGPS",
    21: "SMART_RTL",
    22: "FLOWHOLD",
    23: "FOLLOW",
    24: "ZIGZAG",
    27: "AUTO_RTL",
}
"""custom_mode -> name."""


@dataclass(frozen=True, slots=True)
class ModeNames:
    """The modes that this program may request.

    `control` obeys velocity setpoints; `hold` stops the vehicle and keeps its position; `sticks` keeps its position and
    obeys the pilot's sticks.
    """

    control: str
    hold: str
    sticks: str


MODES_OF: dict[Autopilot, ModeNames] = {
    Autopilot.PX4: ModeNames(control="OFFBOARD", hold="HOLD", sticks="POSCTL"),
    Autopilot.ARDUPILOT: ModeNames(control="GUIDED", hold="BRAKE", sticks="LOITER"),
}

STREAM_TIMEOUT_S: dict[Autopilot, float] = {Autopilot.PX4: 1.2, Autopilot.ARDUPILOT: 3.0}
"""Seconds after the last setpoint for which the autopilot still obeys it, at default parameters.

Measured over MAVLink: PX4 1.16 (COM_OF_LOSS_T = 1.0 s) flew on for 1.1 to 1.4 s, ArduCopter 4.7-dev for its
GUID_TIMEOUT of 3.0 s.
"""


def mode_name(autopilot: Autopilot, custom_mode: int) -> str:
    """The mode's name, or `MODE <number>` if the tables do not have it."""
    if autopilot is Autopilot.PX4:
        return PX4_MODES.get((custom_mode >> 16 & 0xFF, custom_mode >> 24 & 0xFF), f"MODE {custom_mode}")
    return ARDUCOPTER_MODES.get(custom_mode, f"MODE {custom_mode}")


def mode_params(autopilot: Autopilot, name: str) -> tuple[int, int]:
    """Parameters 2 and 3 of MAV_CMD_DO_SET_MODE for one of the names above."""
    if autopilot is Autopilot.PX4:
        return next(numbers for numbers, known in PX4_MODES.items() if known == name)
    return next(number for number, known in ARDUCOPTER_MODES.items() if known == name), 0
