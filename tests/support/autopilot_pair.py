"""A client and a simulated autopilot wired in memory, in lockstep on one clock."""

from collections.abc import Callable

from follow.link.client import MavlinkClient
from follow.messages import HOVER, Autopilot, Setpoint, VehicleState
from sim.autopilot.system import AutopilotSystem
from sim.dynamics import Vehicle, VehicleTruth

STEP_S = 0.02
CONTROL = {Autopilot.PX4: "OFFBOARD", Autopilot.ARDUPILOT: "GUIDED"}
HOLD = {Autopilot.PX4: "HOLD", Autopilot.ARDUPILOT: "BRAKE"}
Way = Callable[[list[bytes]], list[bytes]]


class Pair:
    """`setpoint` is streamed while it is not None; `to_autopilot` and `to_client` may spoil what passes.

    The remote control is on, with its sticks at rest.
    """

    def __init__(
        self, autopilot: Autopilot, height_m: float = 10.0, key: bytes | None = None, firmware: str = "", **client
    ):
        start = VehicleTruth(down_m=-height_m)
        self.system = AutopilotSystem(autopilot, Vehicle(autopilot, start), key=key, firmware=firmware)
        self.system.flight.resting_sticks = self.system.flight.sticks = (0.0, 0.0, 0.0, 0.0)
        self.client = MavlinkClient(**client)
        self.t_s = 0.0
        self.setpoint: Setpoint | None = None
        self.to_autopilot: Way = lambda packets: packets
        self.to_client: Way = lambda packets: packets

    def run(self, seconds: float) -> None:
        for _ in range(round(seconds / STEP_S)):
            self.t_s += STEP_S
            self.client.send_setpoint(self.setpoint, self.t_s)
            self.client.step(self.t_s)
            for packet in self.to_autopilot(self.client.take()):
                self.system.receive(packet)
            self.system.step(self.t_s)
            for packet in self.to_client(self.system.take()):
                self.client.receive(packet, self.t_s, datagram=True)

    @property
    def state(self) -> VehicleState:
        return self.client.state(self.t_s)

    @property
    def motion(self) -> VehicleTruth:
        return self.system.flight.vehicle.motion

    def fly(self) -> "Pair":
        """Until the vehicle obeys."""
        self.run(2.0)
        self.setpoint = HOVER
        self.client.take_control()
        self.run(3.0)
        assert self.state.in_control
        return self
