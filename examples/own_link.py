"""Your own vehicle in the loop: a class that reports its state and takes setpoints, here a point without inertia.

    python examples/own_link.py

`state` and `send` are the whole Link.  `advance` is only needed because the drawn scene drives this vehicle's time.
No setpoint is sent while a group of the state is missing, old or unsafe; the decision's reason says which.
"""

from dataclasses import replace

from typing_extensions import Self

from follow.control.acquire import Acquire
from follow.control.servo import Servo, ServoConfig
from follow.control.target import Target
from follow.flight.session import once
from follow.geometry import heading_to_ned
from follow.loop import follow
from follow.messages import HOVER, Autopilot, Landed, Order, Setpoint, Tick, VehicleState
from follow.safety.gate import Safety
from racf import Racf
from sim.camera import SceneCamera
from sim.dynamics import VehicleTruth
from sim.scenarios import SCENARIOS


class PointMass:
    """A Link to a vehicle without inertia: it has the velocity and yaw rate of the last setpoint."""

    def __init__(self, start: VehicleTruth) -> None:
        self.motion = start
        self.setpoint = HOVER

    def state(self) -> VehicleState:
        """The state as telemetry would report it now; each group has the time at which it was measured.

        `in_control`, `armed` and `landed` must be reported by the vehicle itself: FOLLOW is refused on the ground, and
        while it is not known whether the vehicle flies.
        """
        m = self.motion
        groups = ("t_s", "attitude_t_s", "position_t_s", "heartbeat_t_s", "landed_t_s")
        fresh = dict.fromkeys(groups, m.t_s)
        position = {"north_m": m.north_m, "east_m": m.east_m, "down_m": m.down_m}
        velocity = {"north_m_s": m.north_m_s, "east_m_s": m.east_m_s, "down_m_s": m.down_m_s}
        attitude = {"yaw_rad": m.yaw_rad, "yaw_rate_rad_s": m.yaw_rate_rad_s}
        flies = {"in_control": True, "armed": True, "landed": Landed.IN_AIR}
        return VehicleState(**fresh, **position, **velocity, **attitude, **flies)

    def send(self, setpoint: Setpoint | None) -> None:
        """Take the gate's setpoint; None sends nothing, so that a real autopilot's failsafe acts."""
        self.setpoint = setpoint or HOVER

    def advance(self, dt_s: float) -> VehicleTruth:
        """Fly for a while."""
        m, s = self.motion, self.setpoint
        north, east = heading_to_ned(s.forward_m_s, s.right_m_s, m.yaw_rad)
        self.motion = replace(
            m,
            t_s=m.t_s + dt_s,
            north_m=m.north_m + north * dt_s,
            east_m=m.east_m + east * dt_s,
            down_m=m.down_m + s.down_m_s * dt_s,
            yaw_rad=m.yaw_rad + s.yaw_rate_rad_s * dt_s,
            **{"north_m_s": north, "east_m_s": east, "down_m_s": s.down_m_s, "yaw_rate_rad_s": s.yaw_rate_rad_s},
        )
        return self.motion

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_error: object) -> None:
        """The vehicle hovers at the end, whatever the reason."""
        self.send(HOVER)


def main(seconds: float = 10.0) -> list[Tick]:
    """Follow the drawn walker; returns every round."""
    scenario = replace(SCENARIOS["walker"], duration_s=seconds)
    world = scenario.world(0)
    link = PointMass(scenario.start(world, 0))
    mount = scenario.camera_settings(Autopilot.PX4)
    camera = SceneCamera(world, link, mount, seconds, 0)
    tracker = Racf()
    parts = (
        Acquire(tracker.init, tracker.update, camera.first()[1]),
        Target(mount.intrinsics, mount.down_rad),
        Servo(mount.down_rad, ServoConfig(standoff_m=scenario.standoff_m)),
        Safety(),
    )
    ticks: list[Tick] = []
    with camera, link:
        for tick in follow(camera, link, *parts, once(Order.FOLLOW)):
            if not ticks or tick.decision.reason != ticks[-1].decision.reason:
                print(f"{tick.state.t_s:5.1f} s: {tick.decision.mode.value} ({tick.decision.reason})")
            ticks.append(tick)
    sent = sum(tick.decision.setpoint is not None for tick in ticks)
    print(f"{len(ticks)} rounds, {sent} setpoints sent, the target is {ticks[-1].estimate.range_m:.1f} m away")
    return ticks


if __name__ == "__main__":
    main()
