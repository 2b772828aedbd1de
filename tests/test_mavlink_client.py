"""The client and the simulated autopilot, wired in memory: each is the other's test."""

import math

import pytest
from pymavlink.dialects.v20 import common as dialect

from follow.mavlink import MavlinkClient
from follow.messages import HOVER, Autopilot, Setpoint
from sim.autopilot_system import AutopilotSystem
from sim.dynamics import Motion, Vehicle

BOTH = pytest.mark.parametrize("autopilot", list(Autopilot))
CONTROL = {Autopilot.PX4: "OFFBOARD", Autopilot.ARDUPILOT: "GUIDED"}
HOLD = {Autopilot.PX4: "HOLD", Autopilot.ARDUPILOT: "BRAKE"}
STEP_S = 0.02


class Pair:
    """A client and an autopilot in lockstep; `setpoint` is streamed while it is not None."""

    def __init__(self, autopilot: Autopilot, height_m: float = 10.0, **client):
        start = Motion(down_m=-height_m)
        self.system = AutopilotSystem(autopilot, Vehicle(autopilot, start))
        self.client = MavlinkClient(**client)
        self.t_s = 0.0
        self.setpoint: Setpoint | None = None
        self.to_autopilot = lambda packets: packets
        self.to_client = lambda packets: packets

    def run(self, seconds: float) -> None:
        for _ in range(round(seconds / STEP_S)):
            self.t_s += STEP_S
            self.client.send_setpoint(self.setpoint, self.t_s)
            self.client.step(self.t_s)
            for packet in self.to_autopilot(self.client.take()):
                self.system.receive(packet)
            self.system.step(self.t_s)
            for packet in self.to_client(self.system.take()):
                self.client.receive(packet, self.t_s)

    @property
    def state(self):
        return self.client.state(self.t_s)

    def fly(self) -> "Pair":
        """Until the vehicle obeys."""
        self.run(2.0)
        self.setpoint = HOVER
        self.client.take_control()
        self.run(3.0)
        assert self.state.in_control
        return self


@BOTH
def test_the_vehicle_is_found_and_its_state_is_the_vehicles(autopilot):
    pair = Pair(autopilot)
    pair.run(5.0)
    state, motion = pair.state, pair.system.flight.vehicle.motion
    assert (state.autopilot, state.armed, state.landed) == (autopilot, True, False)
    assert pair.t_s - state.attitude_t_s <= 0.1
    assert pair.t_s - state.position_t_s <= 0.1
    assert pair.t_s - state.heartbeat_t_s <= 1.1
    assert state.down_m == pytest.approx(motion.down_m, abs=0.1)
    assert state.mode == pair.system.flight.mode


@BOTH
def test_rates_asked_for_arrive(autopilot):
    pair = Pair(autopilot)
    pair.run(3.0)
    before = dict(pair.client.heard.counts)
    pair.run(4.0)
    came = {name: (count - before.get(name, 0)) / 4.0 for name, count in pair.client.heard.counts.items()}
    assert came["ATTITUDE"] == pytest.approx(50, rel=0.1)
    assert came["LOCAL_POSITION_NED"] == pytest.approx(25, rel=0.1)


@BOTH
def test_nothing_changes_the_mode_unasked(autopilot):
    pair = Pair(autopilot)
    before = pair.system.flight.mode
    pair.setpoint = Setpoint(forward_m_s=1.0)
    pair.run(5.0)
    assert pair.system.flight.mode == before
    assert not pair.state.in_control


@BOTH
def test_control_is_taken_on_order_and_the_vehicle_obeys(autopilot):
    pair = Pair(autopilot).fly()
    assert pair.state.mode == CONTROL[autopilot]
    pair.setpoint = Setpoint(forward_m_s=2.0)
    pair.run(5.0)
    assert pair.state.north_m_s == pytest.approx(2.0, abs=0.3)


@BOTH
def test_another_mode_ends_control_for_good(autopilot):
    pair = Pair(autopilot).fly()
    pair.system.flight.enter("RTL")
    pair.run(2.0)
    assert not pair.state.in_control
    pair.system.flight.enter(CONTROL[autopilot])
    pair.run(2.0)
    assert pair.state.mode == CONTROL[autopilot]
    assert not pair.state.in_control
    pair.client.take_control()
    pair.run(2.0)
    assert pair.state.in_control


@BOTH
def test_hold_is_asked_only_by_who_is_in_control(autopilot):
    pair = Pair(autopilot)
    pair.run(2.0)
    pair.system.flight.enter("RTL")
    pair.run(2.0)
    assert not pair.client.hold()
    pair.run(1.0)
    assert pair.system.flight.mode in ("RTL", "LAND")
    pair = Pair(autopilot).fly()
    assert pair.client.hold()
    pair.run(2.0)
    assert pair.state.mode == HOLD[autopilot]


@BOTH
def test_a_disarmed_vehicle_is_not_in_control(autopilot):
    pair = Pair(autopilot).fly()
    pair.system.flight.disarm(force=True)
    pair.run(1.2)
    assert not pair.state.armed
    assert not pair.state.in_control


@BOTH
def test_the_setpoint_on_the_wire(autopilot):
    pair = Pair(autopilot)
    pair.run(1.5)
    pair.client.take()
    pair.client.send_setpoint(Setpoint(1.0, 2.0, -0.5, 0.3), pair.t_s)
    (packet,) = pair.client.take()
    message = dialect.MAVLink(None).parse_char(packet)
    assert message.get_type() == "SET_POSITION_TARGET_LOCAL_NED"
    assert (message.get_srcSystem(), message.get_srcComponent()) == (1, 191)
    assert (message.target_system, message.target_component) == (1, 1)
    assert (message.coordinate_frame, message.type_mask) == (8, 0x05C7)
    assert (message.vx, message.vy, message.vz) == (1.0, 2.0, -0.5)
    assert message.yaw_rate == pytest.approx(0.3)
    assert all(math.isfinite(getattr(message, name)) for name in message.get_fieldnames() if name != "type")


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_a_number_that_is_not_finite_is_never_sent(bad):
    pair = Pair(Autopilot.PX4)
    pair.run(1.5)
    with pytest.raises(ValueError, match="finite"):
        pair.client.send_setpoint(Setpoint(yaw_rate_rad_s=bad), pair.t_s)


@BOTH
def test_parameters_are_read_with_their_type(autopilot):
    pair = Pair(autopilot)
    pair.run(1.5)
    for name in pair.system.flight.parameters:
        pair.client.request_parameter(name)
    pair.run(0.5)
    assert pair.client.heard.parameters == pytest.approx(pair.system.flight.parameters)
