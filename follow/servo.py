"""The visual servo: yaw keeps the target across the middle, climb up and down, forward speed at its stand-off."""

import math
from dataclasses import dataclass, field

from follow.messages import NEVER, Estimate, Setpoint, VehicleState
from follow.pid import Gains, Pid

YAW = Gains(kp=1.5, ki=0.1, limit=1.5)  # 1/s: a third of the bandwidth of both autopilots' yaw (0.2 s)
CLIMB = Gains(kp=0.8, ki=0.05, limit=2.0)  # 1/s, on metres of height
FORWARD = Gains(kp=0.6, ki=0.05, limit=20.0)  # 1/s, on metres of range; velocity answers within 0.7 s


@dataclass(frozen=True, slots=True)
class ServoConfig:
    """Gains and the wanted picture."""

    standoff_m: float = 12.0  # along the ground; a person of 1.8 m is then some 50 pixels high in 640x360
    yaw: Gains = YAW
    climb: Gains = CLIMB
    forward: Gains = FORWARD
    feed_forward: float = 1.0  # share of the target's own velocity that is flown with it


@dataclass(slots=True)
class Servo:
    """Estimate in, wish out.  `down_rad` is the camera's angle below the nose: it decides where the middle is."""

    down_rad: float
    config: ServoConfig = field(default_factory=ServoConfig)
    yaw: Pid = field(init=False)
    climb: Pid = field(init=False)
    forward: Pid = field(init=False)
    t_s: float = NEVER

    def __post_init__(self) -> None:
        c = self.config
        self.yaw, self.climb, self.forward = Pid(c.yaw), Pid(c.climb), Pid(c.forward)

    def update(self, estimate: Estimate, state: VehicleState) -> Setpoint:
        """The velocity that would keep the estimated target where it is wanted; zero before it was ever seen."""
        dt = estimate.t_s - self.t_s if self.t_s > NEVER else 0.0
        self.t_s = estimate.t_s
        if estimate.seen_t_s == NEVER:
            return Setpoint()
        c = self.config
        heading = state.yaw_rad
        along = math.cos(estimate.azimuth_rad), math.sin(estimate.azimuth_rad)
        target = (
            math.cos(heading) * estimate.north_m_s + math.sin(heading) * estimate.east_m_s,
            math.cos(heading) * estimate.east_m_s - math.sin(heading) * estimate.north_m_s,
        )
        radial = along[0] * target[0] + along[1] * target[1]
        near = estimate.range_m
        closing = -self.forward.update(c.standoff_m - near, near, dt) + c.feed_forward * radial
        own_forward, own_right, _ = state.body_velocity_m_s()
        across = along[0] * (target[1] - own_right) - along[1] * (target[0] - own_forward)
        yaw_rate = self.yaw.update(estimate.azimuth_rad, -estimate.azimuth_rad, dt)
        yaw_rate += c.feed_forward * across / max(near, 1.0)
        # Height that puts the target in the picture's middle row at the pitch now flown.
        wanted = math.tan(min(max(self.down_rad - state.pitch_rad, 0.1), 1.4))
        excess = near * (math.tan(min(estimate.depression_rad, 1.4)) - wanted)
        descend = -self.climb.update(-excess, excess, dt)
        return Setpoint(closing * along[0], closing * along[1], descend, yaw_rate)
