"""The transition table: properties that a reviewer can check without the gate."""

import pytest

from follow.messages import Autopilot, Mode, VehicleState
from follow.safety.modes import FLYING, OPEN_MODES, STREAMING, TABLE, Event, Standing, after, standing


@pytest.mark.parametrize("event", Event)
@pytest.mark.parametrize("where", Standing)
@pytest.mark.parametrize("mode", Mode)
def test_every_triple_has_a_next_mode(mode, where, event):
    assert after(mode, where, event) in Mode


def test_only_a_granted_order_out_of_an_open_mode_starts_a_stream():
    for (mode, where, event), then in TABLE.items():
        if mode not in STREAMING and then in STREAMING:
            assert event is Event.ORDER_FOLLOW
            assert where is not Standing.CLOSED


def test_only_a_vehicle_that_obeys_enters_a_flying_mode_other_than_brake():
    for (mode, where, _), then in TABLE.items():
        if then in FLYING and then is not Mode.BRAKE and mode is not then:
            assert where is Standing.OURS


@pytest.mark.parametrize("where", Standing)
def test_a_takeover_and_an_order_to_observe_end_every_flying_mode(where):
    for mode in FLYING:
        assert after(mode, where, Event.CONTROL_LOST) is Mode.ENDED
        assert after(mode, where, Event.ORDER_OBSERVE) is Mode.ENDED


def test_ended_stays_ended_until_the_operator_orders_again():
    assert {event for (mode, _, event) in TABLE if mode is Mode.ENDED} == {Event.ASKED}
    assert all(after(Mode.ENDED, where, Event.ASKED) not in STREAMING for where in Standing)


def test_every_mode_can_be_reached_and_left():
    assert {Mode.OBSERVE} | set(TABLE.values()) == set(Mode)
    assert {mode for mode, _, _ in TABLE} == set(Mode)


def test_no_streaming_mode_lasts_for_ever_without_a_target_or_control():
    """From each streaming mode, the events that time brings lead to ENDED."""
    time_brings = (Event.TIMEOUT, Event.UNSEEN, Event.LONG_UNSEEN, Event.GIVEN_UP, Event.HOLD_OVER, Event.STOPPED)
    for start in STREAMING:
        mode = start
        for event in time_brings:
            mode = after(mode, Standing.OURS, event)
        assert mode is Mode.ENDED


@pytest.mark.parametrize("autopilot", Autopilot)
@pytest.mark.parametrize("name", ["RTL", "LAND", "TAKEOFF", "AUTO", "MISSION", "BRAKE", "SMART_RTL", "MODE 99", ""])
def test_a_mode_that_is_not_listed_is_closed(autopilot, name):
    assert standing(VehicleState(0.0, autopilot=autopilot, mode=name)) is Standing.CLOSED
    assert standing(VehicleState(0.0, mode="HOLD")) is Standing.CLOSED  # an unknown autopilot
    assert all(standing(VehicleState(0.0, autopilot=autopilot, mode=m)) is Standing.OPEN for m in OPEN_MODES[autopilot])
