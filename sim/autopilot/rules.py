"""Where PX4 and ArduCopter differ, as measured on PX4 1.16 and ArduCopter 4.7 over MAVLink, 20 setpoints a second."""

import math
from dataclasses import replace
from typing import ClassVar

from follow.geometry import ned_to_heading
from follow.link.flight_modes import STREAM_TIMEOUT_S
from follow.messages import NEVER, Autopilot, Setpoint
from sim.autopilot.core import STEP_S, AutopilotCore, AutopilotMode, Command, Guidance, Result
from sim.dynamics import Vehicle

LOCAL_NED, LOCAL_OFFSET_NED, BODY_NED, BODY_OFFSET_NED = 1, 7, 8, 9
VELOCITY_BITS = 0b111 << 3
YAW_RATE_BIT = 1 << 11
STREAM_SLACK_S = STREAM_TIMEOUT_S[Autopilot.PX4] - 1.0  # PX4 reacts this much later than COM_OF_LOSS_T (default 1.0)
STREAM_RECENT_S = 0.5  # PX4: OFFBOARD needs setpoints at more than 2 Hz; here one recent setpoint is enough
STICKS_LAST_S = 0.5  # PX4: COM_RC_LOSS_T's default
STICK_TIME_S = 0.25  # PX4 1.18: a stick that moved is at rest again after about this
STICK_FILTER_S = 0.1  # PX4 to 1.17: time constant of the filter on a stick's speed
AVOID_MARGIN_M = 2.0  # ArduCopter: FENCE_MARGIN's default; seen to stop this far inside the fence
AVOID_ACCEL_M_S2 = 1.0  # deceleration toward it, low enough for the dead time and the jerk limit
AVOID_TIME_S = 1.5  # ... and the time constant of the last metres


class Px4Flight(AutopilotCore):
    """PX4, multicopter."""

    autopilot = Autopilot.PX4
    modes: ClassVar = {
        "MANUAL": AutopilotMode(1, 0, Guidance.STICKS),
        "ALTCTL": AutopilotMode(2, 0, Guidance.STICKS),
        "POSCTL": AutopilotMode(3, 0, Guidance.STICKS),
        "TAKEOFF": AutopilotMode(4, 2, Guidance.CLIMB),
        "HOLD": AutopilotMode(4, 3, Guidance.STAY),
        "MISSION": AutopilotMode(4, 4, Guidance.STAY),
        "RTL": AutopilotMode(4, 5, Guidance.RETURN),
        "LAND": AutopilotMode(4, 6, Guidance.LAND),
        "OFFBOARD": AutopilotMode(6, 0, Guidance.VELOCITY),
        "STABILIZED": AutopilotMode(7, 0, Guidance.STICKS),
    }
    ground_mode = "HOLD"
    stay_mode = "HOLD"
    LOSS_MODES: ClassVar = {0: "POSCTL", 1: "ALTCTL", 2: "STABILIZED", 3: "RTL", 4: "LAND", 5: "HOLD"}

    def __init__(self, vehicle: Vehicle, firmware: str = ""):
        super().__init__(vehicle, firmware)
        self._lost_stream = False  # in the failsafe of a lost stream: OFFBOARD is still the user's intention
        self._rested = (0.0, 0.0, 0.0, 0.0)  # the sticks, low-passed

    def take_setpoint(self, frame: int, mask: int, velocity: tuple[float, float, float], yaw_rate: float) -> None:
        """Frames 1 and 8 only: a setpoint in another frame is ignored."""
        if frame not in (LOCAL_NED, BODY_NED):
            return
        usable = not mask & VELOCITY_BITS and all(map(math.isfinite, velocity))
        x, y, down = velocity if usable else (0.0, 0.0, 0.0)
        turning = 0.0 if mask & YAW_RATE_BIT or not math.isfinite(yaw_rate) else yaw_rate
        self.command = Command(self.t_s, x, y, down, turning, frame == BODY_NED)
        if self._lost_stream:  # it re-enters OFFBOARD by itself
            self._lost_stream = False
            super().enter("OFFBOARD")

    def enter(self, mode: str) -> None:
        """Change the mode now; this ends the failsafe of a lost stream."""
        self._lost_stream = False
        super().enter(mode)

    def take_off(self, height_m: float) -> Result:
        """NAV_TAKEOFF: to MIS_TAKEOFF_ALT unless a height is given, then HOLD."""
        self._climb_to_m = height_m if height_m > 0.0 else float(self.parameters["MIS_TAKEOFF_ALT"])
        self.enter("TAKEOFF")
        return Result.ACCEPTED

    def _change(self, name: str) -> list[Result]:
        """Two ACKs: the first is always ACCEPTED, the second is the result."""
        command = self.command
        streaming = command is not None and self.t_s - command.t_s < STREAM_RECENT_S
        if name == "OFFBOARD" and not streaming:
            return [Result.ACCEPTED, Result.TEMPORARILY_REJECTED]
        self.enter(name)
        return [Result.ACCEPTED, Result.ACCEPTED]

    def _refusal_to_arm(self) -> str:
        if self.mode in ("RTL", "LAND"):
            return f"Arming denied: {self.mode} mode"
        return ""

    def _watch(self) -> None:
        super()._watch()
        loss_s = float(self.parameters["COM_OF_LOSS_T"]) + STREAM_SLACK_S
        if self.mode == "OFFBOARD" and self.command is not None and self.t_s - self.command.t_s > loss_s:
            self.texts.append("Offboard control lost")
            self.enter(self.LOSS_MODES.get(int(self.parameters["COM_OBL_RC_ACT"]), "LAND"))
            self._lost_stream = True
        if self.armed and self._sticks_take_over():
            self.texts.append("Pilot took over using sticks")
            self.enter("POSCTL")
        action = int(self.parameters["NAV_DLL_ACT"])
        silent_s = self.t_s - self.ground_station_t_s
        if self.armed and action and float(self.parameters["COM_DL_LOSS_T"]) < silent_s < math.inf:
            self.ground_station_t_s = NEVER
            self.texts.append("GCS connection lost")
            self.enter({1: "HOLD", 2: "RTL"}.get(action, "LAND"))

    def _sticks_take_over(self) -> bool:
        """Whether a stick moves, as PX4 takes over by movement and not by deflection.

        Up to 1.17 COM_RC_STICK_OV is how fast it must move, in hundredths of half its travel a second (ManualControl
        and MovingDiff of 1.16), and COM_RC_OVERRIDE in which modes that counts: automatic (bit 0), OFFBOARD (bit 1).
        From 1.18 MAN_OVERRIDE_SPD is how fast, and counts in both unless it is negative.
        """
        sticks = self.sticks or (0.0, 0.0, 0.0, 0.0)
        filter_s = STICK_TIME_S if "MAN_OVERRIDE_SPD" in self.parameters else STICK_FILTER_S
        keep = math.exp(-STEP_S / filter_s)
        self._rested = tuple(keep * old + (1.0 - keep) * now for old, now in zip(self._rested, sticks, strict=True))
        speed = max(abs(now - rested) for now, rested in zip(sticks, self._rested, strict=True)) / filter_s
        if "MAN_OVERRIDE_SPD" in self.parameters:
            least = float(self.parameters["MAN_OVERRIDE_SPD"])
            return least >= 0.0 and speed / 2.0 > least and self._may_take_over(3)
        least = float(self.parameters["COM_RC_STICK_OV"]) / 100.0
        return speed > least and self._may_take_over(int(self.parameters["COM_RC_OVERRIDE"]))

    def _may_take_over(self, where: int) -> bool:
        auto = self.modes[self.mode].number == 4
        return bool(self.mode == "OFFBOARD" and where & 2) or bool(auto and where & 1)

    @property
    def charge_state(self) -> int:
        """By BAT_LOW_THR, BAT_CRIT_THR and BAT_EMERGEN_THR."""
        levels = (self.parameters[name] for name in ("BAT_LOW_THR", "BAT_CRIT_THR", "BAT_EMERGEN_THR"))
        return 1 + sum(self.battery < level for level in levels)

    def _sticks_last_s(self) -> float:
        return STICKS_LAST_S

    def _idle_limit_s(self) -> float:
        flown = self._landed_t_s > self._armed_t_s
        return float(self.parameters["COM_DISARM_LAND" if flown else "COM_DISARM_PRFLT"])

    def _outside_fence(self, distance_m: float, height_m: float) -> bool:
        far, high = self.parameters["GF_MAX_HOR_DIST"], self.parameters["GF_MAX_VER_DIST"]
        return 0.0 < far < distance_m or 0.0 < high < height_m

    def _fence_mode(self) -> str | None:
        return {2: "HOLD", 3: "RTL", 5: "LAND"}.get(int(self.parameters["GF_ACTION"]))

    def _battery_low(self) -> bool:
        return self.battery < self.parameters["BAT_CRIT_THR"]

    def _battery_mode(self) -> str | None:
        return {2: "LAND", 3: "RTL"}.get(int(self.parameters["COM_LOW_BAT_ACT"]))


class ArduCopterFlight(AutopilotCore):
    """ArduCopter."""

    autopilot = Autopilot.ARDUPILOT
    modes: ClassVar = {
        "STABILIZE": AutopilotMode(0, 0, Guidance.STICKS),
        "ALT_HOLD": AutopilotMode(2, 0, Guidance.STICKS),
        "AUTO": AutopilotMode(3, 0, Guidance.STAY),
        "GUIDED": AutopilotMode(4, 0, Guidance.VELOCITY),
        "LOITER": AutopilotMode(5, 0, Guidance.STAY),
        "RTL": AutopilotMode(6, 0, Guidance.RETURN),
        "LAND": AutopilotMode(9, 0, Guidance.LAND),
        "POSHOLD": AutopilotMode(16, 0, Guidance.STAY),
        "BRAKE": AutopilotMode(17, 0, Guidance.STAY),
    }
    ground_mode = "STABILIZE"
    stay_mode = "LOITER"

    def __init__(self, vehicle: Vehicle, firmware: str = ""):
        super().__init__(vehicle, firmware)
        self._climbing = False
        self._broken = False  # an internal error: no arming until a restart

    def take_setpoint(self, frame: int, mask: int, velocity: tuple[float, float, float], yaw_rate: float) -> None:
        """Frames 1, 7, 8 and 9; any other stops the vehicle.  Only in GUIDED, and only in the air."""
        if self.mode != "GUIDED" or self.vehicle.motion.landed:
            return
        if not all(map(math.isfinite, (*velocity, yaw_rate))):
            self._broken = True
            self.texts.append("Internal Errors 0x1000")
            return
        known = frame in (LOCAL_NED, LOCAL_OFFSET_NED, BODY_NED, BODY_OFFSET_NED)
        x, y, down = velocity if known and not mask & VELOCITY_BITS else (0.0, 0.0, 0.0)
        turning = yaw_rate if known else 0.0
        if known and mask & YAW_RATE_BIT:
            turning = None  # turn to the course
        self.command = Command(self.t_s, x, y, down, turning, frame in (BODY_NED, BODY_OFFSET_NED))
        self._climbing = False

    def enter(self, mode: str) -> None:
        """Change the mode now and drop the last mode's setpoint."""
        if mode != self.mode:
            self.command = None
            self._climbing = False
        super().enter(mode)

    def take_off(self, height_m: float) -> Result:
        """NAV_TAKEOFF: only armed, in GUIDED, on the ground."""
        if not self.armed or self.mode != "GUIDED" or not self.vehicle.motion.landed:
            return Result.FAILED
        self._climb_to_m = height_m
        self._climbing = True
        return Result.ACCEPTED

    @property
    def is_taking_off(self) -> bool:
        """Whether it climbs to its take-off height; it stays in GUIDED."""
        return self._climbing

    def _guide_velocity(self) -> Setpoint:
        return self._guide_climb() if self._climbing else self._avoiding(super()._guide_velocity())

    def _avoiding(self, setpoint: Setpoint) -> Setpoint:
        """AVOID_ENABLE (bit 0: fences) stops GUIDED 2 m inside a circle fence; the vehicle slides along the fence."""
        avoids = int(self.parameters["AVOID_ENABLE"]) & 1 and self.parameters["FENCE_ENABLE"]
        motion = self.vehicle.motion
        out = motion.north_m - self.home[0], motion.east_m - self.home[1]
        distance = math.hypot(*out)
        if not avoids or not int(self.parameters["FENCE_TYPE"]) & 2 or distance == 0.0:
            return setpoint
        room = float(self.parameters["FENCE_RADIUS"]) - AVOID_MARGIN_M - distance
        fastest = math.sqrt(2.0 * AVOID_ACCEL_M_S2 * room) if room > 0.0 else 0.0
        fastest = min(fastest, max(room, 0.0) / AVOID_TIME_S)
        forward, right = ned_to_heading(out[0] / distance, out[1] / distance, motion.yaw_rad)
        excess = max(setpoint.forward_m_s * forward + setpoint.right_m_s * right - fastest, 0.0)
        return replace(
            setpoint,
            forward_m_s=setpoint.forward_m_s - excess * forward,
            right_m_s=setpoint.right_m_s - excess * right,
        )

    def _climbed(self) -> None:
        """It stays in GUIDED and keeps its position."""
        self._climbing = False
        north, east, _ = self._point
        self._point = (north, east, -self._climb_to_m)

    def _change(self, name: str) -> list[Result]:
        """One ACK, and the mode changes at once."""
        self.enter(name)
        return [Result.ACCEPTED]

    def _refusal_to_arm(self) -> str:
        if self._broken:
            return "PreArm: Internal errors 0x1000"
        if self.mode in ("RTL", "LAND", "BRAKE", "AUTO"):
            return f"Arm: {self.mode} mode not armable"
        return ""

    def _watch(self) -> None:
        super()._watch()
        command = self.command
        if command is not None and self.t_s - command.t_s > self.parameters["GUID_TIMEOUT"]:
            self.command = Command(math.inf, 0.0, 0.0, 0.0, 0.0, body=True)  # it stops, and stays in GUIDED
        action = int(self.parameters["FS_GCS_ENABLE"])
        silent_s = self.t_s - self.ground_station_t_s
        if self.armed and action and self.parameters["FS_GCS_TIMEOUT"] < silent_s < math.inf:
            self.ground_station_t_s = NEVER
            self.texts.append("GCS Failsafe")
            self.enter("LAND" if action == 5 else "RTL")

    def _sticks_last_s(self) -> float:
        seconds = float(self.parameters["RC_OVERRIDE_TIME"])
        return math.inf if seconds < 0.0 else seconds

    def _idle_limit_s(self) -> float:
        return 0.5 if self.mode in ("LAND", "RTL") else float(self.parameters["DISARM_DELAY"])

    def _outside_fence(self, distance_m: float, height_m: float) -> bool:
        kinds = int(self.parameters["FENCE_TYPE"]) if self.parameters["FENCE_ENABLE"] else 0
        too_high = bool(kinds & 1) and height_m > self.parameters["FENCE_ALT_MAX"]
        return too_high or (bool(kinds & 2) and distance_m > self.parameters["FENCE_RADIUS"])

    def _fence_mode(self) -> str | None:
        return {1: "RTL", 2: "LAND", 4: "BRAKE"}.get(int(self.parameters["FENCE_ACTION"]))

    @property
    def charge_state(self) -> int:
        """Low below a tenth, where the voltage of this battery falls to BATT_LOW_VOLT under load."""
        return 2 if self._battery_low() else 1

    def _battery_low(self) -> bool:
        return self.battery < 0.1

    def _battery_mode(self) -> str | None:
        return {1: "LAND", 2: "RTL"}.get(int(self.parameters["BATT_FS_LOW_ACT"]))


RULES: dict[Autopilot, type[AutopilotCore]] = {Autopilot.PX4: Px4Flight, Autopilot.ARDUPILOT: ArduCopterFlight}
