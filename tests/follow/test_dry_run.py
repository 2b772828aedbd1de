"""A dry run receives telemetry, pretends FOLLOW, and sends nothing that could move the vehicle."""

from types import SimpleNamespace

import pytest
from pymavlink.dialects.v20 import common as dialect

from follow.link.dry_run import TELEMETRY, DryRunLink, moves_nothing
from follow.messages import HOVER, Autopilot, Mode, Order
from follow.operator.authority import Operator
from follow.safety.gate import Safety
from tests.follow.test_link_identity import VEHICLE, Mailbox, speak
from tests.support.autopilot_pair import Pair
from tests.support.gate_rig import LIMITS, flying, seen

MOVING = {
    "SET_POSITION_TARGET_LOCAL_NED": (0, 1, 1, 8, 0x05C7, *(0.0,) * 11),
    "SET_POSITION_TARGET_GLOBAL_INT": (0, 1, 1, 6, 0, 0, 0, *(0.0,) * 9),
    "SET_ATTITUDE_TARGET": (0, 1, 1, 0, (1.0, 0.0, 0.0, 0.0), *(0.0,) * 4),
    "MANUAL_CONTROL": (1, 0, 0, 0, 0, 0),
    "RC_CHANNELS_OVERRIDE": (1, 1, *(0,) * 8),
    "SET_MODE": (1, 1, 0),
    "PARAM_SET": (1, 1, b"A", 0.0, 9),
}


def packed(message) -> bytes:
    return message.pack(dialect.MAVLink(None, 1, 191))


@pytest.mark.parametrize("name", MOVING)
def test_a_dry_run_blocks_messages_that_move_the_vehicle(name):
    message = getattr(dialect, f"MAVLink_{name.lower()}_message")(*MOVING[name])
    assert not moves_nothing(packed(message))


def test_of_all_commands_only_requests_of_telemetry_pass():
    passed = {number for number in range(0, 65536, 1) if moves_nothing(packed_command(number))}
    assert passed == set(TELEMETRY)


def packed_command(number: int) -> bytes:
    """COMMAND_LONG, written by hand: only its number differs."""
    payload = bytes(28) + number.to_bytes(2, "little") + b"\x01\x01\x00"
    return bytes([0xFD, len(payload), 0, 0, 0, 1, 191, 76, 0, 0]) + payload + b"\0\0"


def test_the_hand_written_command_is_the_packed_one():
    message = dialect.MAVLink_command_long_message(1, 1, 176, 0, *(0.0,) * 7)
    assert packed(message)[10:40] == packed_command(176)[10:40]


@pytest.mark.parametrize("autopilot", Autopilot)
def test_a_dry_run_pretends_follow_until_the_mode_changes_and_sends_no_setpoint(autopilot):
    mailbox = Mailbox()
    link = DryRunLink(mailbox)
    pair = Pair(autopilot)
    pair.system.step(1.0)
    speak(link, pair.system.take(), VEHICLE)
    assert not link.state().in_control
    link.take_control()
    assert link.state().in_control
    for _ in range(20):
        link.send(HOVER)
    link.hold()
    assert not link.state().in_control
    link.take_control()
    pair.system.flight.enter("LAND")
    pair.system.step(2.5)
    speak(link, pair.system.take(), VEHICLE)
    assert link.state().mode == "LAND"
    assert not link.state().in_control
    parser = dialect.MAVLink(None)
    sent = [message for packet, _ in mailbox.sent for message in parser.parse_buffer(packet) or []]
    assert sent
    for message in sent:
        assert message.get_type() not in MOVING
        assert message.get_type() != "COMMAND_LONG" or message.command in TELEMETRY


def test_in_a_dry_run_the_gate_reaches_follow_and_decides_setpoints():
    safety, engaged = Safety(LIMITS), False
    safety.order(Order.FOLLOW)
    modes = []
    for i in range(30):
        t_s = i / 30
        state = flying(t_s, in_control=engaged, mode="HOLD")
        decision = safety.allow(HOVER, seen(t_s), state, t_s)
        engaged = engaged or decision.mode is Mode.ENGAGE
        modes.append(decision.mode)
    assert modes[-1] is Mode.FOLLOW
    assert decision.setpoint is not None


def test_sticks_end_no_pretended_follow_but_end_a_real_one():
    for watches in (True, False):
        heard = SimpleNamespace(rc_channels=(1500,) * 8, rc_t_s=0.0, steering={}, joysticks={})
        ended = []
        operator = Operator(lambda _line: None, heard=heard)
        operator.watches_sticks = watches
        operator.mode = Mode.FOLLOW
        for i in range(60):
            heard.rc_t_s = i / 30
            heard.rc_channels = (1500, 1500 + 8 * max(i - 20, 0), *(1500,) * 6)
            operator.state = flying(i / 30)
            ended.append(operator().order)
        assert (Order.OBSERVE in ended) is watches
