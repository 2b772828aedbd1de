"""A vehicle in somebody's hands, propellers off, turned back and forth, for tests of `follow doctor --wave`."""

import math
from dataclasses import replace

import numpy as np

from follow.geometry import Array, body_to_ned
from follow.messages import Autopilot, Setpoint
from sim.dynamics import Vehicle, VehicleTruth

CHEST_M = 1.5  # height of the hands above the ground
LEVER_M = (0.25, 0.0, 0.05)  # from the wrists, about which it turns, to the vehicle; body axes
SWINGS = ((0.45, 0.37), (0.28, 0.53), (0.30, 0.61))  # amplitude (rad) and frequency (Hz) in yaw, pitch, roll
EASE_S = 1.0  # the swings grow from rest over this time
SWAY_M, SWAY_HZ = 0.03, 0.23  # the hands drift a little


class WavedVehicle(Vehicle):
    """Not flown: its attitude is a smooth function of time, about a place `CHEST_M` above the ground."""

    def __init__(self, autopilot: Autopilot, start: VehicleTruth, amount: float = 1.0) -> None:
        held = replace(start, north_m_s=0.0, east_m_s=0.0, down_m_s=0.0, down_m=-start.ground_m)
        super().__init__(autopilot, held, ground=lambda _north, _east: start.ground_m)
        self.start, self.amount = held, amount
        self.motion = self.at(held.t_s)

    def step(self, setpoint: Setpoint | None, dt_s: float) -> VehicleTruth:
        """Let `dt_s` pass; no setpoint moves it."""
        self.motion = self.at(self.motion.t_s + dt_s)
        return self.motion

    def at(self, t_s: float) -> VehicleTruth:
        """The vehicle's motion at a time."""
        yaw, pitch, roll = self.angles(t_s)
        place, before = self.place(t_s), self.place(t_s - 1e-3)
        speed = (place - before) / 1e-3
        yaw_rate = (yaw - self.angles(t_s - 1e-3)[0]) / 1e-3
        north, east, down = place.tolist()
        return replace(
            self.start,
            t_s=t_s,
            north_m=north,
            east_m=east,
            down_m=down,
            north_m_s=float(speed[0]),
            east_m_s=float(speed[1]),
            down_m_s=float(speed[2]),
            roll_rad=roll,
            pitch_rad=pitch,
            yaw_rad=math.remainder(yaw, math.tau),
            yaw_rate_rad_s=yaw_rate,
            landed=True,
        )

    def angles(self, t_s: float) -> tuple[float, float, float]:
        """Yaw, pitch and roll, radians."""
        since = max(t_s - self.start.t_s, 0.0)
        ease = self.amount * min(since / EASE_S, 1.0) ** 2
        yaw, pitch, roll = (
            ease * amplitude * math.sin(math.tau * hertz * since + n) for n, (amplitude, hertz) in enumerate(SWINGS)
        )
        return self.start.yaw_rad + yaw, pitch, roll

    def place(self, t_s: float) -> Array:
        """(3,) NED metres."""
        yaw, pitch, roll = self.angles(t_s)
        since = t_s - self.start.t_s
        sway = self.amount * SWAY_M * np.array([math.sin(math.tau * SWAY_HZ * since), math.cos(2 * since), 0.0])
        base = np.array([self.start.north_m, self.start.east_m, -self.start.ground_m - CHEST_M])
        return base + sway + body_to_ned(roll, pitch, yaw) @ np.array(LEVER_M)
