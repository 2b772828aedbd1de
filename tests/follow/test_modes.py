import pytest

from follow.messages import Mode
from follow.safety.modes import FLYING, STREAMING, TABLE, Event, after


@pytest.mark.parametrize("event", Event)
@pytest.mark.parametrize("mode", Mode)
def test_every_mode_answers_every_event_with_a_mode(mode, event):
    assert after(mode, event) in Mode


def test_nothing_but_an_order_makes_a_silent_mode_speak():
    for (mode, event), then in TABLE.items():
        if mode not in STREAMING and then in STREAMING:
            assert event is Event.ORDER_FOLLOW


def test_a_takeover_ends_every_flying_mode():
    for mode in FLYING:
        assert after(mode, Event.CONTROL_LOST) is Mode.ENDED
        assert after(mode, Event.ORDER_OBSERVE) is Mode.ENDED


def test_ended_stays_ended_until_the_operator_asks_again():
    leaving = {event for (mode, event) in TABLE if mode is Mode.ENDED}
    assert leaving == {Event.ORDER_FOLLOW}
    assert after(Mode.ENDED, Event.ORDER_FOLLOW) not in STREAMING


def test_every_mode_can_be_reached_and_left():
    reached = {Mode.OBSERVE} | set(TABLE.values())
    assert reached == set(Mode)
    assert {mode for mode, _ in TABLE} == set(Mode)
