"""The parameters of the simulated autopilots, with the names, types, units and defaults of each firmware version.

OBEYED ones change the simulated flight; REPORTED ones only answer `follow doctor` and ground stations.
"""

import math
from dataclasses import replace

from follow.messages import Autopilot
from sim.measured import ResponseModel, SpeedLimits, tilt_m_s2

Table = dict[str, float | int]

OBEYED: dict[Autopilot, Table] = {
    Autopilot.PX4: {
        "COM_OF_LOSS_T": 1.0,  # s
        "COM_OBL_RC_ACT": 0,  # 0 position, 3 return, 4 land, 5 hold
        "COM_RC_OVERRIDE": 1,  # bit 1: sticks break OFFBOARD
        "COM_RC_STICK_OV": 30.0,  # %
        "COM_DL_LOSS_T": 10,  # s
        "COM_LOW_BAT_ACT": 0,  # 0 warn, 2 land, 3 return
        "COM_DISARM_LAND": 2.0,  # s
        "COM_DISARM_PRFLT": 10.0,  # s
        "NAV_DLL_ACT": 0,  # 0 off, 1 hold, 2 return, 3 land
        "GF_ACTION": 2,  # 1 warn, 2 hold, 3 return, 5 land
        "GF_MAX_HOR_DIST": 0.0,  # m, 0 off
        "GF_MAX_VER_DIST": 0.0,  # m, 0 off
        "MIS_TAKEOFF_ALT": 2.5,  # m
        "BAT_LOW_THR": 0.15,  # of full
        "BAT_CRIT_THR": 0.07,
        "BAT_EMERGEN_THR": 0.05,
        "MPC_TILTMAX_AIR": 45.0,  # deg
        "MPC_XY_VEL_MAX": 12.0,  # m/s
        "MPC_Z_VEL_MAX_UP": 3.0,  # m/s
        "MPC_Z_VEL_MAX_DN": 1.5,  # m/s
    },
    Autopilot.ARDUPILOT: {
        "GUID_TIMEOUT": 3.0,  # s
        "FS_GCS_ENABLE": 0,  # 0 off, 1 return, 5 land
        "FS_GCS_TIMEOUT": 5.0,  # s
        "FENCE_ENABLE": 0,
        "FENCE_TYPE": 7,  # bit 0 altitude, bit 1 circle, bit 2 polygon
        "FENCE_ACTION": 1,  # 0 report, 1 return, 2 land, 4 brake
        "FENCE_ALT_MAX": 100.0,  # m
        "FENCE_RADIUS": 300.0,  # m
        "DISARM_DELAY": 10,  # s
        "BATT_FS_LOW_ACT": 0,  # 0 none, 1 land, 2 return
        "AVOID_ENABLE": 3,  # bit 0: stops 2 m inside a fence, in GUIDED
        "RC_OVERRIDE_TIME": 3.0,  # s, -1 for ever
        "ATC_SLEW_YAW": 6000.0,  # cdeg/s
        "WP_ACC": 2.5,  # m/s2
        "PSC_JERK_NE": 5.0,  # m/s3
        "ATC_ANGLE_MAX": 30.0,  # deg
    },
}

REPORTED: dict[Autopilot, Table] = {
    Autopilot.PX4: {
        "COM_FAIL_ACT_T": 5.0,  # s
        "COM_RC_IN_MODE": 3,
        "COM_RCL_EXCEPT": 0,
        "NAV_RCL_ACT": 2,
        "MPC_TKO_SPEED": 1.5,  # m/s
        "MPC_LAND_SPEED": 0.7,  # m/s
        "MPC_XY_CRUISE": 5.0,  # m/s
        "RTL_RETURN_ALT": 30.0,  # m
        "MAV_SYS_ID": 1,
        "SYS_AUTOSTART": 10040,
        "SIM_BAT_DRAIN": 60.0,  # s
    },
    Autopilot.ARDUPILOT: {
        "GUID_OPTIONS": 0,
        "FS_OPTIONS": 16,
        "FS_THR_ENABLE": 1,
        "FS_EKF_ACTION": 1,
        "BATT_FS_CRT_ACT": 0,
        "SIM_SPEEDUP": 1.0,
        "WP_SPD": 10.0,  # m/s
        "RTL_ALT_M": 15.0,  # m
        "LAND_SPD_MS": 0.5,  # m/s
        "MAV_SYSID": 1,
        "MAV_GCS_SYSID": 255,
    },
}

FIRMWARES: dict[Autopilot, tuple[str, ...]] = {
    Autopilot.PX4: ("1.14", "1.16", "1.18"),
    Autopilot.ARDUPILOT: ("4.5", "4.7"),
}
DEFAULT_FIRMWARE = {Autopilot.PX4: "1.16", Autopilot.ARDUPILOT: "4.7"}

# Parameters of the tables above that a version lacks, and parameters that it has in addition
LACKS: dict[tuple[Autopilot, str], tuple[str, ...]] = {
    (Autopilot.PX4, "1.18"): ("COM_RC_OVERRIDE", "COM_RC_STICK_OV"),
    (Autopilot.ARDUPILOT, "4.5"): (
        "WP_ACC",
        "WP_SPD",
        "PSC_JERK_NE",
        "RTL_ALT_M",
        "LAND_SPD_MS",
        "ATC_ANGLE_MAX",
        "MAV_SYSID",
        "MAV_GCS_SYSID",
    ),
}
ADDS: dict[tuple[Autopilot, str], Table] = {
    (Autopilot.PX4, "1.18"): {"MAN_OVERRIDE_SPD": 1.0},  # stick travel a second, 1/s; negative: off
    (Autopilot.ARDUPILOT, "4.5"): {
        "WPNAV_ACCEL": 250.0,  # cm/s2
        "WPNAV_SPEED": 1000.0,  # cm/s
        "PSC_JERK_XY": 5.0,  # m/s3
        "RTL_ALT": 1500,  # cm
        "LAND_SPEED": 50,  # cm/s
        "ANGLE_MAX": 3000,  # cdeg
        "SYSID_THISMAV": 1,
        "SYSID_MYGCS": 255,
    },
}


def defaults(autopilot: Autopilot, firmware: str = "") -> Table:
    """The parameters of a firmware version as each is at the start; raises ValueError for an unknown version."""
    firmware = firmware or DEFAULT_FIRMWARE[autopilot]
    if firmware not in FIRMWARES[autopilot]:
        known = ", ".join(FIRMWARES[autopilot])
        raise ValueError(f"the firmware of {autopilot.value} must be one of {known}, not {firmware!r}")
    lacks = LACKS.get((autopilot, firmware), ())
    table = {name: value for name, value in (OBEYED[autopilot] | REPORTED[autopilot]).items() if name not in lacks}
    return table | ADDS.get((autopilot, firmware), {})


def flown(response: ResponseModel, parameters: Table) -> ResponseModel:
    """The response with the limits that the parameters set: tilt, speeds, acceleration, jerk and turning."""

    def value(default: float, *names: str) -> float:
        """Of the first name that is in the table."""
        return next((float(parameters[name]) for name in names if name in parameters), default)

    level, turn = response.horizontal, response.turn
    tilt_deg = value(value(4500.0, "ANGLE_MAX") / 100.0, "MPC_TILTMAX_AIR", "ATC_ANGLE_MAX")
    level = replace(
        level,
        limit_m_s2=tilt_m_s2(math.radians(tilt_deg)),
        ramp_m_s2=value(value(100.0 * level.ramp_m_s2, "WPNAV_ACCEL") / 100.0, "WP_ACC"),
        jerk_m_s3=value(level.jerk_m_s3, "PSC_JERK_NE", "PSC_JERK_XY"),
    )
    names = "MPC_XY_VEL_MAX", "MPC_Z_VEL_MAX_UP", "MPC_Z_VEL_MAX_DN"
    limits = SpeedLimits(*(value(math.inf, name) for name in names))
    if "ATC_SLEW_YAW" in parameters:
        turn = replace(turn, rate_limit_rad_s=math.radians(value(0.0, "ATC_SLEW_YAW") / 100.0))
    return replace(response, horizontal=level, turn=turn, limits=limits)
