"""Sticks that trim by option: the first 30 % of their travel trims the flight, more is a takeover."""

from dataclasses import replace
from types import SimpleNamespace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from follow.cli.commands import RunCommand
from follow.messages import Cause, Mode, Order
from follow.operator.authority import Operator
from follow.operator.consoles import AROUND_M_S, RAISE_RANGE, SPOTLIGHT, STANDOFF_RANGE, TRIMS, ConsoleCommand, Consoles
from follow.operator.stick_trims import REST_US, StickTrims, TrimSticks, parse_trims
from follow.operator.sticks import STICK_US
from follow.selection import AS_SET, HOVER_HERE, Wanted
from tests.follow.test_consoles import tick

STICKS = TrimSticks(1, -2, 3)
RIGHT, FORWARD, UP, YAW = range(4)
REST = (1500, 1500, 1480, 1510)


class Hands:
    """A pilot's hands on the sticks, a flight in FOLLOW at 20 rounds a second."""

    def __init__(self, sticks=STICKS, trims=True):
        self.heard = SimpleNamespace(rc_channels=REST, rc_t_s=0.0, steering={}, joysticks={})
        self.lines, self.t_s, self.mode = [], 10.0, Mode.FOLLOW
        self.operator = Operator(self.lines.append, heard=self.heard)
        self.consoles = Consoles(self.operator, lambda _choice: "", self.lines.append)
        self.trims = StickTrims(sticks, self.consoles, self.heard) if trims else None
        self.orders = []
        self.run(0.5)

    def run(self, seconds, healthy=True, heard=True):
        for _ in range(round(seconds / 0.05)):
            self.t_s += 0.05
            self.heard.rc_t_s = self.t_s if heard else self.heard.rc_t_s
            now = tick(self.t_s, self.mode)
            now = replace(now, state=replace(now.state, rc_healthy=healthy))
            self.operator.see(now)
            self.consoles.see(now)
            if self.trims is not None:
                self.trims.see(now)
            self.orders.append(self.operator.instruction())

    def push(self, stick, us, seconds=1.0, **how):
        self.heard.rc_channels = tuple(rest + us * (k == stick) for k, rest in enumerate(REST))
        self.run(seconds, **how)

    @property
    def wanted(self):
        return self.consoles.wanted

    def taken_over(self):
        return [o.reason.cause for o in self.orders if o.order is Order.OBSERVE]


def test_forward_on_a_reversed_channel_goes_nearer_and_back_goes_farther():
    hands = Hands()
    hands.push(FORWARD, -140)
    nearer = hands.wanted.standoff_factor
    assert 0.8 < nearer < 0.9
    hands.push(FORWARD, 140, 2.0)
    assert hands.wanted.standoff_factor > 1.05
    hands.push(FORWARD, 0)
    assert hands.wanted.standoff_factor > 1.05, "it stays as it was trimmed"
    assert sum("sticks: stand-off" in line for line in hands.lines) == 1
    assert not hands.taken_over()


def test_up_raises_and_right_moves_aside_only_while_it_is_held():
    hands = Hands()
    hands.push(UP, 120)
    assert 0.01 < hands.wanted.raise_rad < 0.05
    hands.push(RIGHT, 150)
    assert hands.wanted.around_m_s == pytest.approx(AROUND_M_S)
    hands.push(RIGHT, -60)
    assert -0.3 < hands.wanted.around_m_s < 0.0
    hands.push(RIGHT, 0)
    assert hands.wanted.around_m_s == 0.0


@pytest.mark.parametrize("stick", [RIGHT, FORWARD, UP, YAW])
@pytest.mark.parametrize("us", [STICK_US + 10, -300, 400])
def test_beyond_thirty_percent_it_takes_over_with_the_option_and_without(stick, us):
    for trims in (True, False):
        hands = Hands(trims=trims)
        hands.push(stick, us, 0.3)
        assert Cause.STICK in hands.taken_over()
        assert hands.wanted == AS_SET, "and a stick that takes over trims nothing"


def test_without_the_option_nothing_is_trimmed():
    hands = Hands(trims=False)
    hands.push(FORWARD, -140)
    assert hands.wanted == AS_SET


@pytest.mark.parametrize("us", [REST_US, -REST_US, 10, 0])
def test_a_stick_that_rests_trims_nothing(us):
    hands = Hands()
    for stick in (RIGHT, FORWARD, UP):
        hands.push(stick, us)
    assert hands.wanted == AS_SET


def test_where_the_sticks_rested_as_follow_began_is_their_middle():
    hands = Hands()
    hands.mode = Mode.READY
    hands.heard.rc_channels = (1500, 1500, 1100, 1500)  # a throttle at the bottom
    hands.run(1.0)
    hands.mode = Mode.FOLLOW
    hands.run(1.0)
    assert hands.wanted == AS_SET


@pytest.mark.parametrize("how", [{"healthy": False}, {"heard": False}])
def test_a_remote_control_that_is_lost_trims_nothing(how):
    hands = Hands()
    hands.run(2.5, **how)
    before = hands.wanted
    hands.push(FORWARD, -140, **how)
    assert hands.wanted == before


@pytest.mark.parametrize("mode", [mode for mode in Mode if mode is not Mode.FOLLOW])
def test_only_a_flight_that_follows_is_trimmed(mode):
    hands = Hands()
    hands.mode = mode
    hands.push(UP, 140)
    assert hands.wanted.raise_rad == 0.0


@pytest.mark.parametrize("mode", [HOVER_HERE, SPOTLIGHT])
@pytest.mark.parametrize("stick", [RIGHT, FORWARD, UP])
def test_a_holding_vehicle_is_trimmed_neither_by_sticks_nor_by_buttons(mode, stick):
    hands = Hands()
    hands.consoles.wanted = Wanted(mode=mode)
    hands.push(stick, 140)
    hands.push(stick, -140)
    assert not hands.consoles.order(ConsoleCommand.FARTHER, "page 1").done
    assert hands.wanted == Wanted(mode=mode)


@pytest.mark.parametrize(
    ("mode", "acting"),
    [
        ("chase", TRIMS),
        ("orbit", TRIMS[:4]),
        ("profile", TRIMS[:4]),
        ("top-down", ()),
        ("spotlight", ()),
        ("hover", ()),
    ],
)
@pytest.mark.parametrize("is_set", [True, False])
def test_a_trim_that_would_change_nothing_is_refused_and_does_not_wait_for_another_mode(mode, acting, is_set):
    hands = Hands()
    if is_set:
        hands.consoles.set_mode = mode
    else:
        hands.consoles.wanted = Wanted(mode=mode)
    before = hands.wanted
    done = tuple(command for command in TRIMS if hands.consoles.order(command, "page 1").done)
    assert done == acting
    assert acting or hands.wanted == before
    hands.consoles.wanted = before
    for stick, commands in {FORWARD: TRIMS[:2], UP: TRIMS[2:4], RIGHT: TRIMS[4:]}.items():
        hands.push(stick, 140)
        assert (hands.wanted != before) is bool(set(commands) & set(acting))
        hands.push(stick, 0)
        hands.consoles.wanted = before


@pytest.mark.parametrize("stick", [RIGHT, FORWARD, UP])
@pytest.mark.parametrize("lost", [{"mode": Mode.COAST}, {"mode": Mode.SEARCH}, {"heard": False}, {"healthy": False}])
def test_a_stick_held_through_a_signal_loss_and_released_trims_nothing(stick, lost):
    hands = Hands()
    hands.push(stick, -140)
    hands.mode = lost.get("mode", Mode.FOLLOW)
    hands.run(0.3 if "heard" not in lost else 2.5, heard=lost.get("heard", True), healthy=lost.get("healthy", True))
    hands.mode = Mode.FOLLOW
    hands.push(stick, -140)
    hands.push(stick, 0)
    before = hands.wanted
    hands.push(stick, 0, 3.0)
    assert hands.wanted == before, "nobody touches a stick"
    assert hands.wanted.around_m_s == 0.0


@given(st.lists(st.tuples(*(st.integers(-STICK_US, STICK_US) for _ in range(4))), max_size=15))
def test_for_any_stick_movement_the_trims_stay_bounded_and_order_nothing(moves):
    hands = Hands()
    for move in moves:
        hands.heard.rc_channels = tuple(a + b for a, b in zip(REST, move, strict=True))
        hands.run(0.5)
        assert STANDOFF_RANGE[0] <= hands.wanted.standoff_factor <= STANDOFF_RANGE[1]
        assert RAISE_RANGE[0] <= hands.wanted.raise_rad <= RAISE_RANGE[1]
        assert abs(hands.wanted.around_m_s) <= AROUND_M_S
    assert all(order.order is None for order in hands.orders)


@pytest.mark.parametrize(
    "text", ["", "1,2", "1,2,2", "0,1,2", "1,2,5", "a,b,c", "1,2,3,4", "1;2;3", "--1,2,3", "1,-,3"]
)
def test_invalid_channels_are_refused(text):
    with pytest.raises(ValueError, match="--stick-trims names three different channels"):
        RunCommand("udpin:127.0.0.1:14540", stick_trims=text)


def test_channels():
    assert parse_trims("1,-2,3") == STICKS
    assert parse_trims("4, 2, -3") == TrimSticks(4, 2, -3)
