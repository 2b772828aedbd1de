"""Where PX4 1.16 and ArduCopter 4.7 differ, as measured on both over MAVLink with 20 setpoints a second."""

import math
from typing import ClassVar

from follow.messages import NEVER, Autopilot
from sim.autopilot.core import AutopilotCore, AutopilotMode, Command, Result
from sim.dynamics import Vehicle

LOCAL_NED, LOCAL_OFFSET_NED, BODY_NED, BODY_OFFSET_NED = 1, 7, 8, 9
VELOCITY_BITS = 0b111 << 3
YAW_RATE_BIT = 1 << 11
STREAM_SLACK_S = 0.15  # PX4: kept OFFBOARD at 1.2 Hz, flapped at 0.8 Hz, braked 1.1-1.4 s after the last setpoint
STREAM_RECENT_S = 0.5  # PX4: OFFBOARD needs setpoints at more than 2 Hz; its firmware is content with a fresh one
STICKS_LAST_S = 0.5  # PX4: COM_RC_LOSS_T's default


class Px4Flight(AutopilotCore):
    """PX4 1.16, multicopter."""

    autopilot = Autopilot.PX4
    modes: ClassVar = {
        "MANUAL": AutopilotMode(1, 0, "sticks"),
        "ALTCTL": AutopilotMode(2, 0, "sticks"),
        "POSCTL": AutopilotMode(3, 0, "sticks"),
        "TAKEOFF": AutopilotMode(4, 2, "climb"),
        "HOLD": AutopilotMode(4, 3, "stay"),
        "MISSION": AutopilotMode(4, 4, "stay"),
        "RTL": AutopilotMode(4, 5, "return"),
        "LAND": AutopilotMode(4, 6, "land"),
        "OFFBOARD": AutopilotMode(6, 0, "velocity"),
        "STABILIZED": AutopilotMode(7, 0, "sticks"),
    }
    ground_mode = "HOLD"
    stay_mode = "HOLD"
    LOSS_MODES: ClassVar = {0: "POSCTL", 1: "ALTCTL", 2: "STABILIZED", 3: "RTL", 4: "LAND", 5: "HOLD"}

    def __init__(self, vehicle: Vehicle):
        super().__init__(vehicle)
        self._lost_stream = False  # in the failsafe of a lost stream: OFFBOARD is still what the user wants

    def take_setpoint(self, frame: int, mask: int, velocity: tuple[float, float, float], yaw_rate: float) -> None:
        """Frames 1 and 8 only: a setpoint in another is as good as none."""
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
        """Change the mode now; a failsafe of a lost stream is over."""
        self._lost_stream = False
        super().enter(mode)

    def take_off(self, height_m: float) -> Result:
        """NAV_TAKEOFF: to MIS_TAKEOFF_ALT unless a height is given, then HOLD."""
        self._climb_to_m = height_m if height_m > 0.0 else float(self.parameters["MIS_TAKEOFF_ALT"])
        self.enter("TAKEOFF")
        return Result.ACCEPTED

    def _change(self, name: str) -> list[Result]:
        """Two answers, the first always ACCEPTED; the second tells."""
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
        share = max(map(abs, self.sticks)) if self.sticks else 0.0
        if 100.0 * share > self.parameters["COM_RC_STICK_OV"]:
            offboard = self.mode == "OFFBOARD" and int(self.parameters["COM_RC_OVERRIDE"]) & 2
            auto = self.modes[self.mode].number == 4 and int(self.parameters["COM_RC_OVERRIDE"]) & 1
            if self.armed and (offboard or auto):
                self.texts.append("Pilot took over using sticks")
                self.enter("POSCTL")
        action = int(self.parameters["NAV_DLL_ACT"])
        silent_s = self.t_s - self.ground_station_t_s
        if self.armed and action and float(self.parameters["COM_DL_LOSS_T"]) < silent_s < math.inf:
            self.ground_station_t_s = NEVER
            self.texts.append("GCS connection lost")
            self.enter({1: "HOLD", 2: "RTL"}.get(action, "LAND"))

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
    """ArduCopter 4.7."""

    autopilot = Autopilot.ARDUPILOT
    modes: ClassVar = {
        "STABILIZE": AutopilotMode(0, 0, "sticks"),
        "ALT_HOLD": AutopilotMode(2, 0, "sticks"),
        "AUTO": AutopilotMode(3, 0, "stay"),
        "GUIDED": AutopilotMode(4, 0, "guided"),
        "LOITER": AutopilotMode(5, 0, "stay"),
        "RTL": AutopilotMode(6, 0, "return"),
        "LAND": AutopilotMode(9, 0, "land"),
        "POSHOLD": AutopilotMode(16, 0, "stay"),
        "BRAKE": AutopilotMode(17, 0, "stay"),
    }
    ground_mode = "STABILIZE"
    stay_mode = "LOITER"

    def __init__(self, vehicle: Vehicle):
        super().__init__(vehicle)
        self._climbing = False
        self._broken = False  # an internal error: no arming until a restart

    def take_setpoint(self, frame: int, mask: int, velocity: tuple[float, float, float], yaw_rate: float) -> None:
        """Frames 1, 7, 8 and 9; any other stops the vehicle.  Only GUIDED listens, and only in the air."""
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
            turning = None  # it turns toward its course
        self.command = Command(self.t_s, x, y, down, turning, frame in (BODY_NED, BODY_OFFSET_NED))
        self._climbing = False

    def enter(self, mode: str) -> None:
        """Change the mode now, forgetting what was commanded in the last one."""
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

    def _guide_guided(self):
        return self._guide_climb() if self._climbing else self._guide_velocity()

    def _climbed(self) -> None:
        """It stays in GUIDED, where it is."""
        self._climbing = False
        north, east, _ = self._point
        self._point = (north, east, -self._climb_to_m)

    def _change(self, name: str) -> list[Result]:
        """One answer, and the mode at once."""
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

    def _battery_low(self) -> bool:
        return self.battery < 0.1

    def _battery_mode(self) -> str | None:
        return {1: "LAND", 2: "RTL"}.get(int(self.parameters["BATT_FS_LOW_ACT"]))


RULES: dict[Autopilot, type[AutopilotCore]] = {Autopilot.PX4: Px4Flight, Autopilot.ARDUPILOT: ArduCopterFlight}
