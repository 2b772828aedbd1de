"""A raw MAVLink peer of the simulated autopilot, without any code of ours on its side."""

from pymavlink.dialects.v20 import common as dialect

from follow.geometry import ned_to_heading
from follow.messages import Autopilot
from sim.autopilot.system import AutopilotSystem
from sim.dynamics import Vehicle, VehicleTruth
from tests.support.autopilot_pair import CONTROL

NUMBERS = {
    Autopilot.PX4: {"OFFBOARD": (6, 0), "HOLD": (4, 3), "RTL": (4, 5), "POSCTL": (3, 0)},
    Autopilot.ARDUPILOT: {"GUIDED": (4, 0), "BRAKE": (17, 0), "RTL": (6, 0), "LOITER": (5, 0)},
}
FULL = 0x05C7


class Bench:
    """A raw MAVLink peer of a vehicle that hovers 10 m high; no code of ours on its side."""

    def __init__(self, autopilot: Autopilot, height_m: float = 10.0, firmware: str = "", **parameters: float):
        vehicle = Vehicle(autopilot, VehicleTruth(down_m=-height_m))
        self.system = AutopilotSystem(autopilot, vehicle, firmware=firmware)
        self.flight = self.system.flight
        self.flight.parameters.update(parameters)
        self.autopilot = autopilot
        self.mav = dialect.MAVLink(None, 1, 191)
        self.ears = dialect.MAVLink(None)
        self.t_s = 0.0
        self.heard = []

    def say(self, message, mav=None) -> None:
        self.system.receive(message.pack(mav or self.mav))

    def velocity(self, x=0.0, y=0.0, z=0.0, yaw_rate=0.0, frame=8, mask=FULL, mav=None) -> None:
        setpoint = 0, 1, 1, frame, mask, 0, 0, 0, x, y, z, 0, 0, 0, 0, yaw_rate
        self.say(dialect.MAVLink_set_position_target_local_ned_message(*setpoint), mav)

    def mode(self, name: str) -> list[int]:
        self.heard.clear()
        self.say(dialect.MAVLink_command_long_message(1, 1, 176, 0, 1, *NUMBERS[self.autopilot][name], 0, 0, 0, 0))
        self.wait(0.02)
        return [message.result for message in self.heard if message.get_type() == "COMMAND_ACK"]

    def command(self, number: int, *params: float) -> int:
        self.heard.clear()
        self.say(dialect.MAVLink_command_long_message(1, 1, number, 0, *params, *(0.0,) * (7 - len(params))))
        self.wait(0.02)
        return next(message.result for message in self.heard if message.get_type() == "COMMAND_ACK")

    def wait(self, seconds: float) -> None:
        for _ in range(round(seconds / 0.02)):
            self.t_s += 0.02
            self.system.step(self.t_s)
            for packet in self.system.take():
                self.heard.extend(self.ears.parse_buffer(packet) or ())

    def stream(self, seconds: float, rate_hz: float = 25.0, **setpoint) -> None:
        for _ in range(round(seconds * rate_hz)):
            self.velocity(**setpoint)
            self.wait(1 / rate_hz)

    def under_control(self) -> "Bench":
        self.stream(1.5)
        self.mode(CONTROL[self.autopilot])
        assert self.flight.mode == CONTROL[self.autopilot]
        return self

    def body_velocity(self):
        """As the autopilot reports it."""
        m = self.flight.vehicle.reported
        return *ned_to_heading(m.north_m_s, m.east_m_s, m.yaw_rad), m.down_m_s

    def heard_last(self, kind: str):
        return next(m for m in reversed(self.heard) if m.get_type() == kind)

    def healthy(self) -> int:
        return self.heard_last("SYS_STATUS").onboard_control_sensors_health

    def mode_in_heartbeat(self) -> int:
        return self.heard_last("HEARTBEAT").custom_mode
