"""The built-in vehicle behind the Link seam, in lockstep: time passes only when the camera calls `advance`."""

import math
from collections import deque
from types import TracebackType

from typing_extensions import Self

from follow.geometry import ned_to_heading
from follow.link.flight_modes import MODES_OF, STREAM_TIMEOUT_S
from follow.messages import HOVER, Autopilot, Landed, Setpoint, VehicleState
from sim.dynamics import Vehicle, VehicleTruth
from sim.measured import PX4_SINK_M_S

TELEMETRY_DELAY_S = 0.03  # attitude at 50 Hz over a serial line: half a period and the transmission


def present(m: VehicleTruth) -> Setpoint:
    """The setpoint that keeps the present velocity."""
    return Setpoint(*ned_to_heading(m.north_m_s, m.east_m_s, m.yaw_rad), m.down_m_s, m.yaw_rate_rad_s)


class SimLink:
    """A Link to a `Vehicle`.  `advance` is the clock; the camera drives it."""

    def __init__(self, vehicle: Vehicle, telemetry_delay_s: float = TELEMETRY_DELAY_S) -> None:
        self.vehicle = vehicle
        self.setpoint = present(vehicle.reported)  # until our first setpoint it keeps the velocity of its start
        self.sent_t_s: float | None = None
        self._delay_s = telemetry_delay_s
        self._reports: deque[VehicleTruth] = deque([vehicle.reported])

    def advance(self, dt_s: float) -> VehicleTruth:
        """Let time pass and return the vehicle's true state at its end."""
        vehicle = self.vehicle
        if dt_s > 0.0:
            vehicle.step(self._obeyed(), dt_s)
            self._reports.append(vehicle.reported)
        while len(self._reports) > 1 and self._reports[1].t_s <= vehicle.motion.t_s - self._delay_s + 1e-9:
            self._reports.popleft()
        return vehicle.motion

    def obeys(self) -> bool:
        """Whether the autopilot still obeys the stream of setpoints."""
        if self.sent_t_s is None:
            return True
        return self.vehicle.motion.t_s - self.sent_t_s < STREAM_TIMEOUT_S[self.vehicle.autopilot]

    def _obeyed(self) -> Setpoint:
        if self.obeys():
            return self.setpoint
        return Setpoint(down_m_s=PX4_SINK_M_S) if self.vehicle.autopilot is Autopilot.PX4 else HOVER

    def state(self) -> VehicleState:
        """The state as telemetry reports it, `telemetry_delay_s` old."""
        m, autopilot = self._reports[0], self.vehicle.autopilot
        px4_lost = autopilot is Autopilot.PX4 and not self.obeys()
        return VehicleState(
            t_s=self.vehicle.motion.t_s,
            attitude_t_s=m.t_s,
            roll_rad=m.roll_rad,
            pitch_rad=m.pitch_rad,
            yaw_rad=m.yaw_rad,
            yaw_rate_rad_s=m.yaw_rate_rad_s,
            position_t_s=m.t_s,
            north_m=m.north_m,
            east_m=m.east_m,
            down_m=m.down_m,
            north_m_s=m.north_m_s,
            east_m_s=m.east_m_s,
            down_m_s=m.down_m_s,
            heartbeat_t_s=math.floor(self.vehicle.motion.t_s),
            autopilot=autopilot,
            mode="POSCTL" if px4_lost else MODES_OF[autopilot].control,
            in_control=not px4_lost,
            armed=True,
            landed_t_s=m.t_s,
            landed=Landed.ON_GROUND if m.landed else Landed.IN_AIR,
        )

    def send(self, setpoint: Setpoint | None) -> None:
        """Give the vehicle its next setpoint; None sends nothing, so that its own failsafe acts after a while.

        Raises ValueError for a setpoint that is not finite.
        """
        if setpoint is not None:
            setpoint.require_finite()
            self.setpoint, self.sent_t_s = setpoint, self.vehicle.motion.t_s

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.send(HOVER)
