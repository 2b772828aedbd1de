"""A request for Hold or BRAKE never takes the vehicle from the pilot: a heartbeat must show our mode."""

import pytest
from pymavlink.dialects.v20 import common as dialect

from follow.flight.live_flight import taking_and_giving
from follow.link.flight_modes import MODES_OF
from follow.messages import (
    HOVER,
    NO_INSTRUCTION,
    Autopilot,
    Cause,
    Decision,
    Estimate,
    Instruction,
    Mode,
    Reason,
    Release,
    Tick,
)
from sim.autopilot.core import Result
from tests.support.autopilot_pair import Pair

BOTH = pytest.mark.parametrize("autopilot", list(Autopilot))
MANUAL = {Autopilot.PX4: "POSCTL", Autopilot.ARDUPILOT: "LOITER"}


def requested(pair: Pair) -> list[str]:
    """Collects the names of the modes that the client requests from now on."""
    modes: list[str] = []
    ask = pair.system.flight.ask_mode

    def noted(number: int, sub: int) -> list[Result]:
        known = pair.system.flight.modes.items()
        modes.append(next(name for name, mode in known if (mode.number, mode.sub) == (number, sub)))
        return ask(number, sub)

    pair.system.flight.ask_mode = noted
    return modes


@BOTH
@pytest.mark.parametrize("later_s", [0.0, 0.02, 0.1, 0.3, 0.6, 0.98])
@pytest.mark.parametrize("phase_s", [0.0, 0.3, 0.5, 0.98])
def test_a_pilot_who_switched_just_before_the_stream_ended_keeps_the_vehicle(autopilot, later_s, phase_s):
    """c03, c21: whatever the time between his switch, our end and the autopilot's heartbeats."""
    pair = Pair(autopilot).fly()
    pair.run(phase_s)
    modes = requested(pair)
    pair.system.flight.enter(MANUAL[autopilot])
    pair.run(later_s)
    pair.setpoint = None
    pair.run(5.0)
    assert modes == []
    assert pair.state.mode == MANUAL[autopilot]
    assert not pair.client.is_asking()


@BOTH
def test_hold_is_requested_within_a_round_trip_when_the_vehicle_is_still_ours(autopilot):
    pair = Pair(autopilot).fly()
    modes = requested(pair)
    pair.setpoint = None
    pair.run(0.1)
    assert modes == [MODES_OF[autopilot].hold]
    pair.run(2.0)
    assert len(modes) == 1
    assert pair.system.flight.mode == MODES_OF[autopilot].hold


@BOTH
@pytest.mark.parametrize("first", [True, False])
def test_for_the_pilots_sticks_a_mode_in_which_they_act_is_requested(autopilot, first):
    pair = Pair(autopilot).fly()
    modes = requested(pair)
    if first:
        pair.client.hold(for_sticks=True)
    pair.setpoint = None
    pair.client.send_setpoint(None, pair.t_s)
    if not first:
        pair.client.hold(for_sticks=True)
    pair.run(2.0)
    assert modes == [MANUAL[autopilot]]
    assert pair.system.flight.mode == MANUAL[autopilot]


@BOTH
def test_the_stick_mode_is_requested_out_of_our_own_hold_only(autopilot):
    pair = Pair(autopilot).fly()
    pair.setpoint = None
    pair.run(2.0)
    assert pair.state.mode == MODES_OF[autopilot].hold
    modes = requested(pair)
    assert pair.client.hold(for_sticks=True)
    pair.run(2.0)
    assert modes == [MANUAL[autopilot]]
    pair.system.flight.enter(MODES_OF[autopilot].hold)  # the pilot's own choice
    pair.run(2.0)
    assert not pair.client.hold(for_sticks=True)
    pair.run(2.0)
    assert modes == [MANUAL[autopilot]]


@BOTH
def test_a_refused_takeover_gives_its_reason_and_no_request_for_hold_follows(autopilot):
    pair = Pair(autopilot)
    pair.system.flight.enter(MANUAL[autopilot])
    pair.run(2.0)
    modes = requested(pair)
    flight, ask = pair.system.flight, pair.system.flight.ask_mode

    def refuse(number: int, sub: int) -> list[Result]:
        ask(number, sub)
        flight.enter(MANUAL[autopilot])
        flight.texts.append("Reject: no position")
        return [Result.ACCEPTED, Result.DENIED] if autopilot is Autopilot.PX4 else [Result.DENIED]

    flight.ask_mode = refuse
    pair.setpoint = HOVER
    pair.client.take_control()
    pair.run(3.0)
    assert modes == [MODES_OF[autopilot].control]
    assert pair.state.refusal == f"the autopilot refused {modes[0]} (DENIED): Reject: no position"
    pair.setpoint = None
    pair.run(5.0)
    assert len(modes) == 1
    assert pair.state.mode == MANUAL[autopilot]
    flight.ask_mode = ask
    pair.setpoint = HOVER
    pair.client.take_control()
    assert pair.state.refusal == "", "a new request forgets it"


@BOTH
def test_a_request_that_changes_nothing_gives_its_reason(autopilot):
    pair = Pair(autopilot)
    pair.run(2.0)
    before = pair.system.flight.mode
    pair.system.flight.ask_mode = lambda _number, _sub: [Result.ACCEPTED]
    pair.setpoint = HOVER
    pair.client.take_control()
    pair.run(8.0)
    control = MODES_OF[autopilot].control
    assert pair.state.refusal == f"the autopilot stayed in {before} after 1 requests for {control}"


@BOTH
def test_an_order_taken_back_before_the_mode_was_shown_still_ends_in_hold(autopilot):
    """PX4 may enter OFFBOARD before its heartbeat shows it; the vehicle must not stay in it."""
    pair = Pair(autopilot)
    pair.run(2.0)
    control = MODES_OF[autopilot].control
    late: list[bytes] = []
    pair.setpoint = HOVER
    pair.client.take_control()
    modes = requested(pair)
    while control not in modes:
        pair.run(0.02)
    pair.to_client = lambda packets: (late.extend(packets), [])[1]
    pair.setpoint = None
    pair.run(0.2)
    pair.to_client = lambda packets: packets
    pair.run(3.0)
    assert pair.system.flight.mode == MODES_OF[autopilot].hold


@BOTH
def test_after_a_pause_of_our_own_the_stream_does_not_resume_by_itself(autopilot):
    """PX4, which has meanwhile fallen back, would re-enter OFFBOARD at the next setpoint."""
    pair = Pair(autopilot)
    pair.system.flight.parameters.update({"COM_OBL_RC_ACT": 5} if autopilot is Autopilot.PX4 else {})
    pair.fly()
    for _ in range(80):  # our process stands still, the autopilot does not
        pair.t_s += 0.02
        pair.system.step(pair.t_s)
    sent: list[bytes] = []
    pair.to_autopilot = lambda packets: (sent.extend(packets), packets)[1]
    pair.run(3.0)
    assert not [packet for packet in sent if packet[7] == 84]
    assert pair.system.flight.mode == MODES_OF[autopilot].hold
    pair.client.take_control()
    pair.run(3.0)
    assert pair.state.in_control


@BOTH
def test_a_mode_is_seen_within_a_quarter_of_a_second(autopilot):
    pair = Pair(autopilot).fly()
    for mode in (MANUAL[autopilot], "RTL"):
        pair.system.flight.enter(mode)
        pair.run(0.26)
        assert pair.state.mode == mode


def test_a_heartbeat_is_requested_because_px4_keeps_its_stream_at_one_hertz():
    pair = Pair(Autopilot.PX4)
    interval = dialect.MAVLink_command_long_message(1, 1, 511, 0, 0, 2e5, 0, 0, 0, 0, 0)
    pair.system.receive(interval.pack(dialect.MAVLink(None, 1, 191)))
    pair.to_autopilot = lambda _packets: []
    pair.run(5.0)
    assert pair.client.heard.counts["HEARTBEAT"] == 5


def cut(pair: Pair, seconds: float) -> None:
    """Neither side receives the other; our stream ends because its telemetry is stale."""
    ways = pair.to_autopilot, pair.to_client
    pair.to_autopilot = pair.to_client = lambda _packets: []
    pair.setpoint = None
    pair.run(seconds)
    pair.to_autopilot, pair.to_client = ways


@pytest.mark.parametrize("seconds", [3.5, 5.0, 30.0])
@pytest.mark.parametrize(("for_sticks", "wanted"), [(True, "LOITER"), (False, "BRAKE")])
def test_after_a_lost_link_a_vehicle_still_in_our_mode_is_reported_and_released_on_order(seconds, for_sticks, wanted):
    pair = Pair(Autopilot.ARDUPILOT).fly()
    modes, texts = requested(pair), said_to(pair)
    cut(pair, seconds)
    pair.run(12.0)
    assert modes == []
    assert texts == ["Still in GUIDED, nothing sent: switch to LOITER"] * 2
    assert pair.client.hold(for_sticks=for_sticks)
    pair.run(12.0)
    assert modes == [wanted]
    assert pair.system.flight.mode == wanted
    assert len(texts) == 2


@BOTH
def test_a_mode_that_the_pilot_chose_while_the_link_was_lost_is_kept(autopilot):
    pair = Pair(autopilot).fly()
    modes, texts = requested(pair), said_to(pair)
    cut(pair, 2.0)
    pair.system.flight.enter("RTL")
    cut(pair, 3.0)
    pair.run(1.2)
    assert not pair.client.hold()
    assert not pair.client.hold(for_sticks=True)
    pair.run(2.0)
    assert (modes, texts) == ([], [])


def said_to(pair: Pair) -> list[str]:
    """Collects the texts that the client sends to the autopilot from now on."""
    texts: list[str] = []
    way, reader = pair.to_autopilot, dialect.MAVLink(None)

    def noted(packets: list[bytes]) -> list[bytes]:
        messages = [message for packet in packets for message in reader.parse_buffer(packet) or ()]
        texts.extend(message.text for message in messages if message.get_type() == "STATUSTEXT")
        return way(packets)

    pair.to_autopilot = noted
    return texts


def test_px4_that_goes_back_to_offboard_by_itself_when_control_is_ordered_again_obeys():
    pair = Pair(Autopilot.PX4)
    pair.system.flight.parameters["COM_OBL_RC_ACT"] = 5
    pair.fly()
    cut(pair, 5.0)
    pair.run(2.0)
    assert (pair.state.mode, pair.state.in_control) == ("HOLD", False)
    modes = requested(pair)
    pair.setpoint = HOVER
    pair.client.take_control()
    pair.run(0.6)
    assert modes == []
    assert (pair.state.mode, pair.state.in_control) == ("OFFBOARD", True)
    pair.setpoint = None
    pair.run(2.0)
    assert (modes, pair.state.mode) == (["HOLD"], "HOLD")


def test_a_stick_that_moves_again_requests_the_stick_mode_again():
    """The first requests were lost on their way: the vehicle hovers in GUIDED, where no stick acts."""
    pair = Pair(Autopilot.ARDUPILOT).fly()
    reason = Reason(Cause.STICK, "roll")
    ended = Decision(None, Mode.ENDED, reason=reason, release=Release.STICKS)
    moved, rests = Instruction(reason=reason), NO_INSTRUCTION

    def rounds(instructions):
        for instruction in instructions:
            state = pair.state
            yield Tick(
                None, None, state, Estimate(state.t_s, 0.0, 0.4, 12.0, 1.0), HOVER, ended, instruction=instruction
            )
            pair.setpoint = None
            pair.run(0.1)

    heard, pair.to_autopilot = pair.to_autopilot, lambda packets: []
    ticks = taking_and_giving(rounds([moved, *[rests] * 79, moved, *[rests] * 20]), pair.client)
    for i, _ in enumerate(ticks):
        if i == 60:
            assert pair.system.flight.mode == "GUIDED"
            pair.to_autopilot = heard
    assert pair.system.flight.mode == MODES_OF[Autopilot.ARDUPILOT].sticks


@BOTH
@pytest.mark.parametrize("addressee", [(255, 190), (1, 195), (1, 0), (0, 191), (0, 0), (1, 191)])
def test_only_a_refusal_that_is_addressed_to_us_or_to_nobody_ends_our_request(autopilot, addressee):
    """A ground station's own request may be refused at the same time; old autopilots leave the addressee 0."""
    pair = Pair(autopilot).fly()
    pair.setpoint = None
    pair.to_autopilot = lambda _packets: []  # our first request is lost
    pair.run(1.2)
    assert pair.client.requested_mode == MODES_OF[autopilot].hold
    mav = dialect.MAVLink(None, srcSystem=1, srcComponent=1)
    command, denied = dialect.MAV_CMD_DO_SET_MODE, dialect.MAV_RESULT_DENIED
    answer = dialect.MAVLink_command_ack_message(command, denied, 0, 0, *addressee)
    pair.client.receive(answer.pack(mav), pair.t_s, datagram=True)
    is_ours = addressee[0] in (0, 1) and addressee[1] in (0, 191)
    assert pair.client.is_asking() is not is_ours
    assert bool(pair.state.refusal) is is_ours
    if not is_ours:
        pair.to_autopilot = lambda packets: packets
        pair.run(3.0)
        assert pair.state.mode != MODES_OF[autopilot].control


@BOTH
def test_a_link_lost_in_our_mode_is_reported_repeatedly(autopilot, caplog):
    pair = Pair(autopilot).fly()
    pair.to_autopilot = pair.to_client = lambda _packets: []
    pair.run(2.0)
    pair.setpoint = None
    pair.run(30.0)
    lines = [line for line in caplog.messages if line.startswith("nothing heard from the vehicle for")]
    control, sticks = MODES_OF[autopilot].control, MODES_OF[autopilot].sticks
    assert lines[0] == f"nothing heard from the vehicle for 3 s: it was in {control}, switch to {sticks}"
    assert len(lines) in (3, 4)
    assert (pair.client.requested_times, pair.state.mode) == (0, control)
