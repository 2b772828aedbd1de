"""The telemetry of a simulated autopilot: one function per message, of the flight and its time since boot."""

import math
from collections.abc import Callable
from typing import Any

from pymavlink.dialects.v20 import common as dialect

from follow.messages import Autopilot
from sim.autopilot.core import NO_PWM, AutopilotCore
from sim.autopilot.parameters import DEFAULT_FIRMWARE

Message = dialect.MAVLink_message

# Home: the SITL defaults of PX4 (Zurich) and ArduPilot (Canberra), degrees and metres above sea level
ORIGINS = {
    Autopilot.PX4: (47.397742, 8.545594, 488.0),
    Autopilot.ARDUPILOT: (-35.363262, 149.165237, 584.0),
}
METRES_PER_DEGREE = 111_319.5  # at the equator, WGS 84
ALL_SENSORS = (
    dialect.MAV_SYS_STATUS_SENSOR_3D_GYRO
    | dialect.MAV_SYS_STATUS_SENSOR_3D_ACCEL
    | dialect.MAV_SYS_STATUS_SENSOR_3D_MAG
    | dialect.MAV_SYS_STATUS_SENSOR_ABSOLUTE_PRESSURE
    | dialect.MAV_SYS_STATUS_SENSOR_GPS
    | dialect.MAV_SYS_STATUS_AHRS
    | dialect.MAV_SYS_STATUS_SENSOR_BATTERY
    | dialect.MAV_SYS_STATUS_PREARM_CHECK
)
RELEASE = 0xFF  # FIRMWARE_VERSION_TYPE


def ms(t_s: float) -> int:
    """Milliseconds since boot, as uint32."""
    return round(t_s * 1e3) & 0xFFFFFFFF


def us(t_s: float) -> int:
    """Microseconds since boot."""
    return round(t_s * 1e6)


def position(flight: AutopilotCore) -> tuple[int, int, float]:
    """Latitude and longitude in 1e-7 degrees and metres above sea level, on a flat earth about the origin."""
    lat, lon, alt = ORIGINS[flight.autopilot]
    motion = flight.vehicle.motion
    lat_now = lat + motion.north_m / METRES_PER_DEGREE
    lon_now = lon + motion.east_m / (METRES_PER_DEGREE * math.cos(math.radians(lat)))
    return round(lat_now * 1e7), round(lon_now * 1e7), alt - motion.down_m


def _heartbeat(flight: AutopilotCore, _t_s: float) -> Message:
    """The only true source for mode and arming."""
    mode = flight.modes[flight.mode]
    px4 = flight.autopilot is Autopilot.PX4
    custom = mode.number << 16 | mode.sub << 24 if px4 else mode.number
    base = dialect.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
    if flight.armed:
        base |= dialect.MAV_MODE_FLAG_SAFETY_ARMED
    autopilot = dialect.MAV_AUTOPILOT_PX4 if px4 else dialect.MAV_AUTOPILOT_ARDUPILOTMEGA
    status = dialect.MAV_STATE_ACTIVE if flight.armed else dialect.MAV_STATE_STANDBY
    return dialect.MAVLink_heartbeat_message(dialect.MAV_TYPE_QUADROTOR, autopilot, base, custom, status, 3)


def _attitude(flight: AutopilotCore, t_s: float) -> Message:
    m = flight.vehicle.motion
    return dialect.MAVLink_attitude_message(ms(t_s), m.roll_rad, m.pitch_rad, m.yaw_rad, 0.0, 0.0, m.yaw_rate_rad_s)


def _attitude_quaternion(flight: AutopilotCore, t_s: float) -> Message:
    m = flight.vehicle.motion
    cr, sr = math.cos(m.roll_rad / 2), math.sin(m.roll_rad / 2)
    cp, sp = math.cos(m.pitch_rad / 2), math.sin(m.pitch_rad / 2)
    cy, sy = math.cos(m.yaw_rad / 2), math.sin(m.yaw_rad / 2)
    w, x = cr * cp * cy + sr * sp * sy, sr * cp * cy - cr * sp * sy
    y, z = cr * sp * cy + sr * cp * sy, cr * cp * sy - sr * sp * cy
    return dialect.MAVLink_attitude_quaternion_message(ms(t_s), w, x, y, z, 0.0, 0.0, m.yaw_rate_rad_s)


def _local_position_ned(flight: AutopilotCore, t_s: float) -> Message:
    m = flight.vehicle.reported
    speed = m.north_m_s, m.east_m_s, m.down_m_s
    return dialect.MAVLink_local_position_ned_message(ms(t_s), *flight.believed_ned_m(), *speed)


def _odometry(flight: AutopilotCore, t_s: float) -> Message | None:
    """PX4's, for its reset counter."""
    if flight.autopilot is not Autopilot.PX4:
        return None
    m, unknown = flight.vehicle.reported, [math.nan] * 21
    frames = dialect.MAV_FRAME_LOCAL_NED, dialect.MAV_FRAME_LOCAL_FRD
    level = [math.cos(m.yaw_rad / 2), 0.0, 0.0, math.sin(m.yaw_rad / 2)]
    speed = m.north_m_s, m.east_m_s, m.down_m_s, 0.0, 0.0, m.yaw_rate_rad_s
    return dialect.MAVLink_odometry_message(
        us(t_s), *frames, *flight.believed_ned_m(), level, *speed, unknown, unknown, flight.resets % 256
    )


def _distance_sensor(flight: AutopilotCore, t_s: float) -> Message | None:
    """A rangefinder that looks down from a vehicle that has one; the ground is level with home."""
    if flight.rangefinder_m <= 0.0:
        return None
    m = flight.vehicle.motion
    slant_m = -m.down_m / max(math.cos(m.roll_rad) * math.cos(m.pitch_rad), 0.1)
    far_cm = round(100 * flight.rangefinder_m)
    seen_cm = min(round(100 * slant_m), far_cm)
    down = dialect.MAV_SENSOR_ROTATION_PITCH_270
    return dialect.MAVLink_distance_sensor_message(ms(t_s), 10, far_cm, seen_cm, 0, 0, down, 255)


def _global_position_int(flight: AutopilotCore, t_s: float) -> Message:
    lat, lon, alt = position(flight)
    m = flight.vehicle.reported
    speed = round(m.north_m_s * 100), round(m.east_m_s * 100), round(m.down_m_s * 100)
    heading = round(math.degrees(m.yaw_rad) % 360.0 * 100) % 36000
    height = round((flight.datum_down_m - flight.believed_ned_m()[2]) * 1000)
    return dialect.MAVLink_global_position_int_message(ms(t_s), lat, lon, round(alt * 1000), height, *speed, heading)


def _gps_raw_int(flight: AutopilotCore, t_s: float) -> Message:
    lat, lon, alt = position(flight)
    m = flight.vehicle.motion
    speed = round(math.hypot(m.north_m_s, m.east_m_s) * 100)
    return dialect.MAVLink_gps_raw_int_message(us(t_s), 3, lat, lon, round(alt * 1000), 80, 80, speed, 0, 14)


def _extended_sys_state(flight: AutopilotCore, _t_s: float) -> Message:
    on_ground = flight.vehicle.motion.landed
    if flight.is_landing:
        state = dialect.MAV_LANDED_STATE_LANDING
    elif flight.is_taking_off:
        state = dialect.MAV_LANDED_STATE_TAKEOFF
    else:
        state = dialect.MAV_LANDED_STATE_ON_GROUND if on_ground else dialect.MAV_LANDED_STATE_IN_AIR
    return dialect.MAVLink_extended_sys_state_message(0, state)


def _sys_status(flight: AutopilotCore, _t_s: float) -> Message:
    percent = round(100 * flight.battery)
    battery = round(1000 * (10.5 + 2.1 * flight.battery)), 1200, percent
    # A ground station reports an unhealthy fence as crossed, also if none is set.
    healthy = ALL_SENSORS if flight.beyond_fence else ALL_SENSORS | dialect.MAV_SYS_STATUS_GEOFENCE
    present = ALL_SENSORS
    if flight.has_remote:
        present |= dialect.MAV_SYS_STATUS_SENSOR_RC_RECEIVER
        if flight.sticks is not None:
            healthy |= dialect.MAV_SYS_STATUS_SENSOR_RC_RECEIVER
    return dialect.MAVLink_sys_status_message(present, present, healthy, 300, *battery, 0, 0, 0, 0, 0, 0)


def _battery_status(flight: AutopilotCore, _t_s: float) -> Message:
    cells = [round(1000 * (3.5 + 0.7 * flight.battery))] * 3 + [0xFFFF] * 7
    percent = round(100 * flight.battery)
    return dialect.MAVLink_battery_status_message(
        0, 1, 1, 0x7FFF, cells, 1200, -1, -1, percent, charge_state=flight.charge_state
    )


def _home_position(flight: AutopilotCore, t_s: float) -> Message:
    lat, lon, alt = ORIGINS[flight.autopilot]
    global_e7 = round(lat * 1e7), round(lon * 1e7), round(alt * 1000)
    return dialect.MAVLink_home_position_message(
        *global_e7, *flight.home, flight.datum_down_m, [1.0, 0.0, 0.0, 0.0], 0.0, 0.0, 0.0, us(t_s)
    )


def _gps_global_origin(flight: AutopilotCore, t_s: float) -> Message:
    """Where the estimator's zero lies: above the ground of the start by its datum."""
    lat, lon, alt = ORIGINS[flight.autopilot]
    height_mm = round((alt + flight.datum_down_m) * 1000)
    return dialect.MAVLink_gps_global_origin_message(round(lat * 1e7), round(lon * 1e7), height_mm, us(t_s))


def _vfr_hud(flight: AutopilotCore, _t_s: float) -> Message:
    m = flight.vehicle.reported
    speed = math.hypot(m.north_m_s, m.east_m_s)
    heading = round(math.degrees(m.yaw_rad) % 360.0) % 360
    throttle = 50 if flight.armed else 0
    return dialect.MAVLink_vfr_hud_message(speed, speed, heading, throttle, position(flight)[2], -m.down_m_s)


def _rc_channels(flight: AutopilotCore, t_s: float) -> Message:
    pwm = [NO_PWM] * 18
    if flight.sticks is not None:
        pitch, roll, down, yaw = flight.sticks
        pwm[:4] = (round(1500 + 500 * s) for s in (roll, -pitch, -down, yaw))
    pwm[4 : 4 + len(flight.switches)] = flight.switches
    count = sum(value != NO_PWM for value in pwm)
    channels: Any = (count, *pwm, 255 if count else 0)  # too many for a type checker
    return dialect.MAVLink_rc_channels_message(ms(t_s), *channels)


def _position_target_local_ned(flight: AutopilotCore, t_s: float) -> Message:
    c = flight.command
    if c is None or c.yaw_rate_rad_s is None:
        return dialect.MAVLink_position_target_local_ned_message(ms(t_s), 1, 0xFFF, *(0.0,) * 11)
    velocity = c.x_m_s, c.y_m_s, c.down_m_s
    frame = dialect.MAV_FRAME_BODY_NED if c.body else dialect.MAV_FRAME_LOCAL_NED
    return dialect.MAVLink_position_target_local_ned_message(
        ms(t_s), frame, 0x05C7, 0.0, 0.0, 0.0, *velocity, 0.0, 0.0, 0.0, 0.0, c.yaw_rate_rad_s
    )


def autopilot_version(autopilot: Autopilot, firmware: str) -> Message:
    """AUTOPILOT_VERSION of a firmware version such as "1.16"."""
    px4 = autopilot is Autopilot.PX4
    major, minor = map(int, firmware.split("."))
    abilities = (
        dialect.MAV_PROTOCOL_CAPABILITY_MAVLINK2
        | dialect.MAV_PROTOCOL_CAPABILITY_SET_POSITION_TARGET_LOCAL_NED
        | dialect.MAV_PROTOCOL_CAPABILITY_MISSION_INT
        | dialect.MAV_PROTOCOL_CAPABILITY_COMMAND_INT
        | (
            dialect.MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_BYTEWISE
            if px4
            else dialect.MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_C_CAST
        )
    )
    git = [0] * 8
    return dialect.MAVLink_autopilot_version_message(
        abilities, major << 24 | minor << 16 | RELEASE, 0, 0, 0, git, git, git, 0x1209, 0x5741, 0x5113, [1] + [0] * 17
    )


def _system_time(_flight: AutopilotCore, t_s: float) -> Message:
    return dialect.MAVLink_system_time_message(0, ms(t_s))


REPORTS: dict[int, Callable[[AutopilotCore, float], Message | None]] = {
    dialect.MAVLINK_MSG_ID_HEARTBEAT: _heartbeat,
    dialect.MAVLINK_MSG_ID_ATTITUDE: _attitude,
    dialect.MAVLINK_MSG_ID_ATTITUDE_QUATERNION: _attitude_quaternion,
    dialect.MAVLINK_MSG_ID_LOCAL_POSITION_NED: _local_position_ned,
    dialect.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: _global_position_int,
    dialect.MAVLINK_MSG_ID_GPS_RAW_INT: _gps_raw_int,
    dialect.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: _extended_sys_state,
    dialect.MAVLINK_MSG_ID_SYS_STATUS: _sys_status,
    dialect.MAVLINK_MSG_ID_BATTERY_STATUS: _battery_status,
    dialect.MAVLINK_MSG_ID_HOME_POSITION: _home_position,
    dialect.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN: _gps_global_origin,
    dialect.MAVLINK_MSG_ID_VFR_HUD: _vfr_hud,
    dialect.MAVLINK_MSG_ID_RC_CHANNELS: _rc_channels,
    dialect.MAVLINK_MSG_ID_POSITION_TARGET_LOCAL_NED: _position_target_local_ned,
    dialect.MAVLINK_MSG_ID_AUTOPILOT_VERSION: lambda flight, _t_s: autopilot_version(
        flight.autopilot, DEFAULT_FIRMWARE[flight.autopilot]
    ),
    dialect.MAVLINK_MSG_ID_SYSTEM_TIME: _system_time,
    dialect.MAVLINK_MSG_ID_ODOMETRY: _odometry,
    dialect.MAVLINK_MSG_ID_DISTANCE_SENSOR: _distance_sensor,
}
"""Message id -> the function that makes it."""

# Hz before any request: PX4's onboard mode, reduced to what is used here, and ArduPilot with 4 in its SR0_*
# parameters, as a ground station leaves them
UNASKED_HZ: dict[Autopilot, dict[int, float]] = {
    Autopilot.PX4: {
        dialect.MAVLINK_MSG_ID_HEARTBEAT: 1.0,
        dialect.MAVLINK_MSG_ID_SYS_STATUS: 1.0,
        dialect.MAVLINK_MSG_ID_ATTITUDE: 20.0,
        dialect.MAVLINK_MSG_ID_LOCAL_POSITION_NED: 10.0,
        dialect.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: 5.0,
        dialect.MAVLINK_MSG_ID_GPS_RAW_INT: 1.0,
        dialect.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: 1.0,
        dialect.MAVLINK_MSG_ID_HOME_POSITION: 0.5,
        dialect.MAVLINK_MSG_ID_BATTERY_STATUS: 0.5,
        dialect.MAVLINK_MSG_ID_VFR_HUD: 2.0,
    },
    Autopilot.ARDUPILOT: {
        dialect.MAVLINK_MSG_ID_HEARTBEAT: 1.0,
        dialect.MAVLINK_MSG_ID_SYS_STATUS: 4.0,
        dialect.MAVLINK_MSG_ID_ATTITUDE: 4.0,
        dialect.MAVLINK_MSG_ID_LOCAL_POSITION_NED: 4.0,
        dialect.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: 4.0,
        dialect.MAVLINK_MSG_ID_GPS_RAW_INT: 4.0,
        dialect.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: 4.0,
        dialect.MAVLINK_MSG_ID_VFR_HUD: 4.0,
    },
}
