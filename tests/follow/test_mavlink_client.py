"""The client and the simulated autopilot, wired in memory: each is the other's test."""

import math
from collections import deque
from random import Random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common as dialect

from follow.messages import HOVER, Autopilot, Setpoint
from tests.support.autopilot_pair import CONTROL, HOLD, Pair

BOTH = pytest.mark.parametrize("autopilot", list(Autopilot))


@BOTH
def test_the_vehicle_is_found_and_its_state_is_the_vehicles(autopilot):
    pair = Pair(autopilot)
    pair.run(5.0)
    state, motion = pair.state, pair.system.flight.vehicle.motion
    assert (state.autopilot, state.armed, state.in_air) == (autopilot, True, True)
    assert pair.t_s - state.attitude_t_s <= 0.1
    assert pair.t_s - state.position_t_s <= 0.1
    assert pair.t_s - state.heartbeat_t_s <= 1.1
    assert state.down_m == pytest.approx(motion.down_m, abs=0.1)
    assert state.mode == pair.system.flight.mode


@BOTH
def test_requested_message_rates_are_set(autopilot):
    pair = Pair(autopilot)
    pair.run(3.0)
    before = dict(pair.client.heard.counts)
    pair.run(4.0)
    came = {name: (count - before.get(name, 0)) / 4.0 for name, count in pair.client.heard.counts.items()}
    assert came["ATTITUDE"] == pytest.approx(50, rel=0.1)
    assert came["LOCAL_POSITION_NED"] == pytest.approx(25, rel=0.1)


@BOTH
def test_nothing_changes_the_mode_without_an_order(autopilot):
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
def test_hold_is_requested_only_while_in_control(autopilot):
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


@BOTH
def test_a_pause_of_our_own_ends_in_hold_and_not_in_a_resumed_stream(autopilot):
    pair = Pair(autopilot)
    pair.system.flight.parameters.update({"COM_OBL_RC_ACT": 5} if autopilot is Autopilot.PX4 else {})
    pair.fly()
    pair.setpoint = Setpoint(forward_m_s=1.0)
    pair.run(1.0)
    hang_s = 1.0
    pair.t_s += hang_s  # a process that was stopped: neither side heard of the other
    pair.system.step(pair.t_s)
    pair.run(2.5)
    assert not pair.state.in_control
    assert pair.state.mode == HOLD[autopilot]


@BOTH
def test_the_end_of_the_stream_requests_hold(autopilot):
    pair = Pair(autopilot).fly()
    pair.setpoint = None
    pair.run(1.5)
    assert pair.state.mode == HOLD[autopilot]


@BOTH
def test_a_stream_that_ends_after_a_takeover_requests_nothing(autopilot):
    pair = Pair(autopilot).fly()
    pair.system.flight.enter("LAND")
    pair.run(1.2)
    pair.setpoint = None
    pair.run(1.0)
    assert pair.system.flight.mode == "LAND"


@BOTH
def test_control_is_not_requested_before_setpoints_stream(autopilot):
    pair = Pair(autopilot)
    pair.run(2.0)
    before = pair.state.mode
    pair.client.take_control()
    pair.run(3.0)
    assert pair.state.mode == before
    pair.setpoint = HOVER
    pair.run(3.0)
    assert pair.state.in_control


@BOTH
def test_control_is_taken_with_thirty_percent_packet_loss(autopilot):
    random = Random(3)
    pair = Pair(autopilot)
    lossy = lambda packets: [packet for packet in packets if random.random() > 0.3]  # noqa: E731 (one line, used twice)
    pair.to_autopilot = pair.to_client = lossy
    pair.run(4.0)
    pair.setpoint = HOVER
    pair.client.take_control()
    pair.run(5.0)
    assert pair.state.in_control


@BOTH
def test_duplicated_and_reordered_packets_do_not_turn_time_back(autopilot):
    random = Random(4)
    pair = Pair(autopilot)
    waiting: list[bytes] = []

    def shuffled(packets):
        waiting.extend(packets * 2)
        random.shuffle(waiting)
        out = waiting[:-3]
        del waiting[:-3]
        return out

    pair.to_client = shuffled
    pair.run(2.0)
    latest = -math.inf
    for _ in range(100):
        pair.run(0.02)
        assert pair.state.attitude_t_s >= latest
        latest = pair.state.attitude_t_s
    assert pair.t_s - latest < 0.2


@BOTH
def test_garbage_between_packets_costs_no_packet(autopilot):
    random = Random(5)
    pair = Pair(autopilot)
    noise = lambda packets: [p for packet in packets for p in (random.randbytes(40), packet)]  # noqa: E731
    pair.to_client = noise
    pair.run(3.0)
    clean = Pair(autopilot)
    clean.run(3.0)
    assert pair.client.heard.counts == clean.client.heard.counts
    assert pair.client.packets.unreadable > 1000


def test_messages_of_another_system_component_or_type_are_ignored():
    pair = Pair(Autopilot.PX4)
    strangers = [
        (1, 100, dialect.MAV_TYPE_CAMERA, 8),
        (255, 190, dialect.MAV_TYPE_GCS, 8),
        (7, 1, 2, 3),
        (1, 191, 18, 8),
    ]
    for system, component, kind, autopilot in strangers[:2]:
        mav = dialect.MAVLink(None, system, component)
        pair.client.receive(mav.heartbeat_encode(kind, autopilot, 0, 0, 4).pack(mav), 0.0)
        assert pair.client.vehicle_id is None
    pair.run(2.0)
    before = pair.state
    for system, component, kind, autopilot in strangers:
        mav = dialect.MAVLink(None, system, component)
        pair.client.receive(mav.heartbeat_encode(kind, autopilot, 0xFF, 9, 4).pack(mav), pair.t_s)
        pair.client.receive(mav.attitude_encode(1_000_000, 1, 1, 1, 1, 1, 1).pack(mav), pair.t_s)
    assert pair.state == before


def test_the_vehicle_of_the_given_system_id_is_chosen():
    pair = Pair(Autopilot.PX4, system_id=7)
    pair.run(2.0)
    assert pair.client.vehicle_id is None
    mav = dialect.MAVLink(None, 7, 1)
    pair.client.receive(mav.heartbeat_encode(2, 3, 1, 4, 4).pack(mav), pair.t_s)
    assert pair.client.vehicle_id == 7
    assert pair.state.autopilot is Autopilot.ARDUPILOT


def test_a_second_sender_of_setpoints_is_seen():
    pair = Pair(Autopilot.PX4)
    pair.run(2.0)
    mav = dialect.MAVLink(None, 1, 192)
    other = mav.set_position_target_local_ned_encode(0, 1, 1, 8, 0x05C7, *(0.0,) * 11).pack(mav)
    pair.client.receive(other, pair.t_s)
    assert pair.client.heard.steering == {(1, 192): pair.t_s}


def test_a_ground_stations_sticks_are_sticks_and_not_setpoints():
    pair = Pair(Autopilot.PX4)
    pair.run(2.0)
    mav = dialect.MAVLink(None, 255, 190)
    pair.client.receive(mav.manual_control_encode(1, 500, -1000, 0, 0x7FFF, 0).pack(mav), pair.t_s)
    assert pair.client.heard.joysticks == {(255, 190): (pair.t_s, (1750, 1000, 1500, 1500))}
    override = mav.rc_channels_override_encode(1, 1, 1200, 0, 1000, 0xFFFF, *(0,) * 4)
    pair.client.receive(override.pack(mav), pair.t_s)
    assert pair.client.heard.joysticks[255, 190] == (pair.t_s, (1200, 1500, 1000, 1500))
    assert not pair.client.heard.steering


@pytest.mark.parametrize("boot_s", [0.0, 100.0, 5e4])
def test_measurement_times_are_ours_whatever_the_vehicles_clock(boot_s):
    pair = Pair(Autopilot.PX4)
    pair.system._boot_s = boot_s
    pair.run(3.0)
    delay = deque([[]] * 5)  # 100 ms on the way to us
    pair.to_client = lambda packets: (delay.append(packets), delay.popleft())[1]
    pair.run(3.0)
    assert pair.t_s - pair.state.attitude_t_s == pytest.approx(0.1, abs=0.03)


def test_a_restarted_autopilot_is_heard_again():
    pair = Pair(Autopilot.ARDUPILOT)
    pair.run(4.0)
    pair.system = Pair(Autopilot.ARDUPILOT).system
    pair.system.step(pair.t_s)
    pair.system._boot_s = -pair.t_s
    pair.run(4.0)
    assert pair.t_s - pair.state.attitude_t_s < 0.05
    before = pair.client.heard.counts["ATTITUDE"]
    pair.run(2.0)
    assert pair.client.heard.counts["ATTITUDE"] - before == pytest.approx(100, rel=0.1)


@settings(max_examples=200, deadline=None)
@given(chunks=st.lists(st.binary(max_size=300), max_size=20), seed=st.integers(0, 1 << 30))
def test_no_bytes_crash_or_stop_the_client(chunks, seed):
    random = Random(seed)
    pair = Pair(Autopilot.PX4)
    pair.run(0.2)
    pair.system.step(pair.t_s)
    good = b"".join(pair.system.take())
    for chunk in chunks:
        mutated = bytearray(good)
        for _ in range(5):
            if mutated:
                mutated[random.randrange(len(mutated))] = random.randrange(256)
        pair.client.receive(chunk + bytes(mutated), pair.t_s, datagram=bool(seed % 2))
    mav = dialect.MAVLink(None, 1, 1)
    for _ in range(30):  # a stream needs up to one longest packet of new bytes to find its step again
        pair.client.receive(mav.heartbeat_encode(2, 12, 1, 0, 4).pack(mav), pair.t_s + 1.0)
    assert pair.client.state(pair.t_s + 1.0).heartbeat_t_s == pair.t_s + 1.0


@pytest.mark.parametrize("pace", [0.9, 0.95, 1.0, 1.05])
def test_a_simulated_autopilot_that_does_not_keep_real_time_is_not_taken_for_stale(pace):
    pair = Pair(Autopilot.PX4)
    step = pair.system.step
    pair.system.step = lambda t_s: step(pace * t_s)
    pair.run(3.0)
    for _ in range(100):
        pair.run(0.1)
        assert pair.t_s - pair.state.attitude_t_s < 0.1  # the gate's limit


@BOTH
@pytest.mark.parametrize("after_s", [0.1, 0.4, 0.7, 1.0])
@pytest.mark.parametrize("before", [{Autopilot.PX4: "POSCTL", Autopilot.ARDUPILOT: "LOITER"}, HOLD])
def test_the_request_for_hold_is_repeated_until_a_later_heartbeat_confirms_it(autopilot, after_s, before):
    pair = Pair(autopilot)
    pair.run(2.0)
    pair.system.flight.enter(before[autopilot])
    pair.run(1.2)
    pair.setpoint = HOVER
    pair.client.take_control()
    while pair.system.flight.mode != CONTROL[autopilot]:
        pair.run(0.02)
    pair.run(after_s)
    lost: list[bytes] = []

    def lose_the_first(packets: list[bytes]) -> list[bytes]:
        asked = [p for p in packets if int.from_bytes(p[7:10], "little") == 76 and p[10 + 28] == 176]
        if asked and not lost:
            lost.extend(asked)
            return [p for p in packets if p not in asked]
        return packets

    pair.to_autopilot = lose_the_first
    pair.setpoint = None
    pair.run(3.0)
    assert lost
    assert pair.system.flight.mode == HOLD[autopilot]


def test_a_sender_that_steers_another_vehicle_is_no_second_sender():
    pair = Pair(Autopilot.PX4)
    pair.run(2.0)
    mav = dialect.MAVLink(None, 2, 191)
    other = mav.set_position_target_local_ned_encode(0, 2, 1, 8, 0x05C7, *(0.0,) * 11).pack(mav)
    pair.client.receive(other, pair.t_s)
    assert not pair.client.heard.steering
