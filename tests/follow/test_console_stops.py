"""An order given before a stop, or for another target, has no effect after it."""

from dataclasses import replace

import pytest
from pymavlink.dialects.v20 import common as dialect

from follow.cli.commands import RunCommand
from follow.cli.ground import carried_alone, ground_side
from follow.geometry import Intrinsics
from follow.link.packets import Packets
from follow.messages import Instruction, Mode, Order, VehicleState
from follow.operator.consoles import DRAWN_S
from follow.selection import Wanted
from tests.follow.test_consoles import GROUND, PAGE, Desk, tick

BOX = (0.45, 0.4, 0.55, 0.7)


def instructed(desk, order, t_s, mode=Mode.READY):
    """A round that executed an order of any console."""
    desk.consoles.see(replace(tick(t_s, mode, desk.has_target), instruction=Instruction(order)))


@pytest.mark.parametrize("is_flown", [False, True])
def test_follow_that_waits_does_not_fly_to_a_target_that_is_chosen_afterwards(is_flown):
    desk = Desk()
    desk.draw()
    desk.at(2.0, Mode.READY)
    assert desk.order("follow").done
    if is_flown:  # the gate has it already, and waits for the target or for the vehicle
        assert desk.ordered() == [Order.FOLLOW]
        instructed(desk, Order.FOLLOW, 2.1, Mode.OBSERVE)
    assert desk.draw() == ""
    assert desk.operator.instruction().order is Order.OBSERVE, "the order was for the target before"
    assert desk.ordered() == []
    instructed(desk, Order.OBSERVE, 2.2)
    assert desk.order("follow").done, "drawn a moment ago"
    assert desk.ordered() == [Order.FOLLOW]


def test_a_target_that_is_chosen_during_a_takeover_is_only_tracked():
    desk = Desk()
    desk.draw()
    desk.at(2.0, Mode.ENGAGE)
    desk.draw()
    assert desk.consoles.wanted == Wanted(mode="spotlight")
    assert desk.ordered() == []


def test_a_selection_without_a_queued_order_orders_nothing():
    desk = Desk()
    instructed(desk, Order.FOLLOW, 1.2)
    instructed(desk, None, 1.3, Mode.FOLLOW)
    instructed(desk, None, 1.4, Mode.ENDED)
    desk.draw()
    assert desk.ordered() == []


@pytest.mark.parametrize("by", ["page", "key", "mode switch", "landed"])
def test_a_tap_does_not_order_follow_after_a_stop_during_the_search_for_its_box(by):
    desk = Desk(follows=True)
    desk.consoles.is_looking = lambda: True
    assert desk.draw(GROUND) == ""
    if by == "page":
        desk.order("stop", PAGE)
        assert desk.ordered() == [Order.OBSERVE]
    elif by == "key":
        instructed(desk, Order.OBSERVE, 1.5)
    elif by == "mode switch":
        for mode in ("HOLD", "RTL"):
            desk.consoles.see(replace(tick(1.2, Mode.OBSERVE), state=VehicleState(1.2, mode=mode)))
    else:
        desk.at(1.2, Mode.FOLLOW)
        desk.at(1.3, Mode.ENDED)
    desk.consoles.decided("")
    assert desk.ordered() == [], "the box is tracked; nobody has ordered FOLLOW since"
    desk.at(2.0, Mode.READY)
    desk.draw(GROUND)
    desk.consoles.decided("")
    assert desk.ordered() == [Order.FOLLOW], "a tap after it is a new one"


def test_with_ground_follows_a_box_of_the_ground_station_flies_and_one_on_the_page_does_not():
    desk = Desk()
    command = RunCommand("udpin:127.0.0.1:1", camera="scene:walker", ground="link", ground_follows=True)
    lens = Intrinsics.from_fov(640, 360, 1.2)
    ground = ground_side(command, carried_alone(lambda: 1.0), lens, desk.consoles, None, None)
    box = dialect.MAVLink_command_long_message(1, 100, dialect.MAV_CMD_CAMERA_TRACK_RECTANGLE, 0, *BOX, 0, 0, 0)
    (message,) = Packets(1, 1).read(Packets(255, 190).write(box))
    ground.see(desk.consoles.tick)
    ground.hear(message, 1.0)
    ground.see(desk.consoles.tick)
    assert desk.ordered() == [Order.FOLLOW]
    desk.at(2.0, Mode.READY)
    desk.consoles.release("the ground station 255/190")
    assert desk.draw(PAGE) == ""
    assert desk.ordered() == [], "it waits for FOLLOW"


@pytest.mark.parametrize("by", [PAGE, GROUND, "key"])
def test_what_was_proposed_before_a_stop_is_not_confirmed_after_it(by):
    desk = Desk()
    desk.draw()
    desk.at(2.0 + DRAWN_S, Mode.READY)
    assert not desk.order("follow").done
    if by == "key":
        instructed(desk, Order.OBSERVE, 2.1 + DRAWN_S)
    else:
        desk.order("stop", by)
    desk.ordered()
    desk.at(2.2 + DRAWN_S, Mode.READY)
    assert not desk.order("confirm").done
    assert desk.ordered() == []
