"""The built-in vehicle with a simulated pilot, in real time: for a user who tries FOLLOW and STOP.

Before FOLLOW the simulated pilot flies the vehicle to a place behind the target.  After STOP it hovers for some
seconds; then the pilot takes it back behind the target, so that the user can try again.
"""

import math
import time
from collections.abc import Callable
from dataclasses import replace

from follow.geometry import heading_to_ned, ned_to_heading
from follow.link.flight_modes import MODES_OF
from follow.messages import HOVER, Autopilot, Setpoint, VehicleState
from sim.dynamics import Vehicle, VehicleTruth
from sim.link import SimLink
from sim.scene.world import ActorPose

HOVERS_S = 8.0  # after STOP, before the pilot takes the vehicle back to the target
APPROACH_PER_S, APPROACH_M_S = 0.5, 5.0
TURN_PER_S, TURN_RAD_S = 1.0, 0.8
CLIMB_PER_S, CLIMB_M_S = 0.5, 2.0
AHEAD_S = 0.1  # over which the pilot judges the target's velocity
BEHIND_S = 0.5  # a run that is later than this does not catch up: simulated time then falls behind the clock


class PilotedLink(SimLink):
    """A Link to a vehicle that its pilot flies until `take_control`, and again some time after `hold`.

    `target` gives the target's pose at a time of the flight; the pilot keeps `standoff_m` behind it and `height_m`
    above its ground.
    """

    def __init__(
        self, vehicle: Vehicle, target: Callable[[float], ActorPose], standoff_m: float, height_m: float
    ) -> None:
        super().__init__(vehicle)
        self._target, self._standoff_m, self._height_m = target, standoff_m, height_m
        self._modes = MODES_OF[vehicle.autopilot]
        self.mode = self._modes.sticks
        self._held_t_s = 0.0

    @property
    def in_control(self) -> bool:
        """Whether the vehicle obeys setpoints."""
        return self.mode == self._modes.control

    def take_control(self) -> None:
        """Enter OFFBOARD or GUIDED, as after the program's request."""
        self.mode = self._modes.control

    def hold(self, *, for_sticks: bool = False) -> None:
        """Leave control for a hovering mode or, `for_sticks`, the mode that obeys the pilot's sticks."""
        if self.in_control:
            self.mode = self._modes.sticks if for_sticks or self.vehicle.autopilot is Autopilot.ARDUPILOT else "HOLD"
            self._held_t_s = self.vehicle.motion.t_s

    def send(self, setpoint: Setpoint | None) -> None:
        """As any link; at the end of the stream (None) Hold is requested, as by the real link."""
        super().send(setpoint)
        if setpoint is None:
            self.hold()

    def state(self) -> VehicleState:
        """The state as telemetry reports it."""
        return replace(super().state(), mode=self.mode, in_control=self.in_control)

    def advance(self, dt_s: float) -> VehicleTruth:
        """Let time pass; the pilot takes over again after a while of hovering."""
        if self.mode == "HOLD" and self.vehicle.motion.t_s - self._held_t_s > HOVERS_S:
            self.mode = self._modes.sticks
        return super().advance(dt_s)

    def _obeyed(self) -> Setpoint:
        if self.in_control:
            return super()._obeyed()
        hovers = self._held_t_s > 0.0 and self.vehicle.motion.t_s - self._held_t_s <= HOVERS_S
        return HOVER if hovers else self._by_hand()

    def _by_hand(self) -> Setpoint:
        """The pilot's setpoint: toward the place behind the target, the nose turned toward the target."""
        m = self.vehicle.motion
        pose, soon = self._target(m.t_s), self._target(m.t_s + AHEAD_S)
        back = heading_to_ned(-self._standoff_m, 0.0, pose.heading_rad)
        north, east = pose.north_m + back[0] - m.north_m, pose.east_m + back[1] - m.east_m
        slower = min(1.0, APPROACH_M_S / max(APPROACH_PER_S * math.hypot(north, east), 1e-6))
        north_m_s = APPROACH_PER_S * slower * north + (soon.north_m - pose.north_m) / AHEAD_S
        east_m_s = APPROACH_PER_S * slower * east + (soon.east_m - pose.east_m) / AHEAD_S
        bearing = math.atan2(pose.east_m - m.east_m, pose.north_m - m.north_m)
        turn = TURN_PER_S * math.remainder(bearing - m.yaw_rad, math.tau)
        down = CLIMB_PER_S * (pose.down_m - self._height_m - m.down_m)
        return Setpoint(
            *ned_to_heading(north_m_s, east_m_s, m.yaw_rad),
            min(max(down, -CLIMB_M_S), CLIMB_M_S),
            min(max(turn, -TURN_RAD_S), TURN_RAD_S),
        )


class RealTimePace:
    """Carries a camera in real time: a step of `dt_s` takes that long, or longer on a slow machine."""

    def __init__(self, link: SimLink, clock: Callable[[], float] = time.monotonic) -> None:
        self._link, self._clock = link, clock
        self._due_s: float | None = None

    def advance(self, dt_s: float) -> VehicleTruth:
        """Sleep until the step is due, then let it pass."""
        now_s = self._clock()
        due_s = now_s if self._due_s is None else self._due_s + dt_s
        self._due_s = max(due_s, now_s - BEHIND_S)
        if self._due_s > now_s:
            time.sleep(self._due_s - now_s)
        return self._link.advance(dt_s)
