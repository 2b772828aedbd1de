"""The replay link: a simple simulated vehicle, so that recorded footage can be run through servo and gate.

Recorded footage does not react to the vehicle.  `follow.camera.window` makes it react: a virtual camera shows a window
of each image, and the vehicle's yaw and height move the window, so that bad control loses a real target.
"""

import math
from collections.abc import Callable
from dataclasses import replace
from types import TracebackType

from typing_extensions import Self

from follow.geometry import heading_to_ned
from follow.link.flight_modes import MODES_OF, STREAM_TIMEOUT_S
from follow.messages import HOVER, Autopilot, Landed, Setpoint, VehicleState

# Time to 63 % of a step, dead time included: the mean of PX4 1.16 and ArduCopter 4.7-dev, as measured.
YAW_TAU_S = 0.37  # 0.45 and 0.29 to 0.5 rad/s
SPEED_TAU_S = 0.77  # 0.67 and 0.87 to 2 m/s
CLIMB_TAU_S = 0.55  # 0.31 and 0.79 to 1 m/s
FASTEST_M_S = 20.0  # above PX4's MPC_XY_VEL_MAX (12) and ArduPilot's usual WPNAV_SPEED
FASTEST_YAW_RAD_S = math.radians(200.0)  # ArduPilot's ATC_SLEW_YAW allows up to 180 deg/s, PX4's MPC_MAN_Y_MAX 400


class ReplayLink:
    """A vehicle with first-order responses, whose time advances by one frame period at each `send`.

    With `now`, which gives the time of the present round, it flies until then instead: footage of variable frame rate.
    With `holds_place` its horizontal position is fixed whatever speed is commanded: the footage's camera did not move.
    `refused` counts, by rule, the setpoints that were not obeyed and the stream timeouts.
    """

    def __init__(
        self,
        fps: float,
        height_m: float,
        autopilot: Autopilot = Autopilot.PX4,
        holds_place: bool = False,
        now: Callable[[], float] | None = None,
    ) -> None:
        self._fps = fps
        self._autopilot = autopilot
        self._holds_place = holds_place
        self._now = now
        self._round = 0
        self._obeyed = HOVER
        self._streaming, self._silent_s = True, 0.0
        self.refused = {"too fast": 0, "stream timeout": 0}
        self._state = self._stamped(VehicleState(0.0, down_m=-height_m, autopilot=autopilot), 0.0)

    def state(self) -> VehicleState:
        """The vehicle now; all telemetry has the time of the frame."""
        if self._now is not None and self._now() > self._state.t_s:
            self._pass_time(self._now())
        return self._state

    def send(self, setpoint: Setpoint | None) -> None:
        """Check the setpoint as an autopilot would, then fly it for one period.

        Raises ValueError for a setpoint that is not finite.
        """
        if setpoint is not None:
            setpoint.require_finite()
        self._streaming = setpoint is not None
        if setpoint is not None and not _within(setpoint):
            self.refused["too fast"] += 1
        elif setpoint is not None:
            self._silent_s = 0.0
            self._obeyed = setpoint
        self._round += 1
        if self._now is None:
            self._pass_time(self._round / self._fps)

    def _pass_time(self, t_s: float) -> None:
        """Fly the last accepted setpoint until `t_s`."""
        dt = 1 / self._fps if self._now is None else t_s - self._state.t_s
        if not self._streaming:
            timeout = STREAM_TIMEOUT_S[self._autopilot]
            self.refused["stream timeout"] += self._silent_s < timeout <= self._silent_s + dt
            self._silent_s += dt
            if self._silent_s >= timeout:
                self._obeyed = HOVER
        self._fly(t_s, dt)

    def _fly(self, t_s: float, dt: float) -> None:
        old, setpoint = self._state, self._obeyed
        turned = 1 - math.exp(-dt / YAW_TAU_S)
        sped = 1 - math.exp(-dt / SPEED_TAU_S)
        climbed = 1 - math.exp(-dt / CLIMB_TAU_S)
        yaw_rate = old.yaw_rate_rad_s + turned * (setpoint.yaw_rate_rad_s - old.yaw_rate_rad_s)
        yaw = math.remainder(old.yaw_rad + dt * yaw_rate, math.tau)
        north, east = heading_to_ned(setpoint.forward_m_s, setpoint.right_m_s, yaw)
        if self._holds_place:
            north = east = 0.0
        north_m_s = old.north_m_s + sped * (north - old.north_m_s)
        east_m_s = old.east_m_s + sped * (east - old.east_m_s)
        down_m_s = old.down_m_s + climbed * (setpoint.down_m_s - old.down_m_s)
        flown = replace(
            old,
            yaw_rad=yaw,
            yaw_rate_rad_s=yaw_rate,
            north_m=old.north_m + dt * north_m_s,
            east_m=old.east_m + dt * east_m_s,
            down_m=old.down_m + dt * down_m_s,
            north_m_s=north_m_s,
            east_m_s=east_m_s,
            down_m_s=down_m_s,
        )
        self._state = self._stamped(flown, t_s)

    def _stamped(self, state: VehicleState, t_s: float) -> VehicleState:
        mode = MODES_OF[self._autopilot].control
        return replace(
            state,
            t_s=t_s,
            attitude_t_s=t_s,
            position_t_s=t_s,
            heartbeat_t_s=t_s,
            mode=mode,
            in_control=True,
            armed=True,
            landed_t_s=t_s,
            landed=Landed.IN_AIR,
        )

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.send(HOVER)


def _within(setpoint: Setpoint) -> bool:
    speed = math.hypot(setpoint.forward_m_s, setpoint.right_m_s, setpoint.down_m_s)
    return speed <= FASTEST_M_S and abs(setpoint.yaw_rate_rad_s) <= FASTEST_YAW_RAD_S
