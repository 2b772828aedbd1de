"""The parameters of the simulated autopilots: those that the simulated flight obeys, and those that it only reports,
because `follow doctor` and ground stations ask for them.  Names, types and defaults are those of PX4 1.16 and
ArduCopter 4.7.
"""

from follow.messages import Autopilot

OBEYED: dict[Autopilot, dict[str, float | int]] = {
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
        "BAT_CRIT_THR": 0.07,  # of full
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
        "RC_OVERRIDE_TIME": 3.0,  # s, -1 for ever
    },
}

# Reported, not obeyed: whatever they are set to, the flight stays the same
REPORTED: dict[Autopilot, dict[str, float | int]] = {
    Autopilot.PX4: {
        "COM_FAIL_ACT_T": 5.0,  # s
        "NAV_RCL_ACT": 2,
        "MPC_TKO_SPEED": 1.5,  # m/s
        "MPC_LAND_SPEED": 0.7,  # m/s
        "MPC_XY_VEL_MAX": 12.0,  # m/s
        "MPC_XY_CRUISE": 5.0,  # m/s
        "RTL_RETURN_ALT": 60.0,  # m
        "MAV_SYS_ID": 1,
        "SYS_AUTOSTART": 10040,
    },
    Autopilot.ARDUPILOT: {
        "GUID_OPTIONS": 0,
        "FS_OPTIONS": 16,
        "WPNAV_ACCEL": 250.0,  # cm/s2
        "WPNAV_SPEED": 1000.0,  # cm/s
        "PSC_JERK_XY": 5.0,  # m/s3
        "ATC_SLEW_YAW": 6000.0,  # cdeg/s
        "RTL_ALT": 1500,  # cm
        "LAND_SPEED": 50,  # cm/s
        "SYSID_THISMAV": 1,
        "SYSID_MYGCS": 255,
    },
}

DEFAULTS = {autopilot: OBEYED[autopilot] | REPORTED[autopilot] for autopilot in Autopilot}
"""All of them, as each is at the start."""
