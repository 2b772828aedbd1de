"""Consoles: one commands, STOP works from all, an old selection needs CONFIRM, trims are bounded."""

import contextlib
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from follow.cli.commands import RunCommand
from follow.cli.run import check
from follow.messages import HOVER, Decision, Estimate, Frame, Mode, Order, Tick, VehicleState
from follow.operator.authority import Operator
from follow.operator.consoles import CONFIRM_S, DRAWN_S, SILENT_S, ConsoleCommand, Consoles
from follow.operator.told import TEXT_EVERY_S, PilotTexts
from follow.selection import AS_SET, HOVER_HERE, Cleared, KeptStandoff, Selection, TrackingState, Wanted
from racf.box import Box
from racf.commandline import UsageError
from racf.track import Track

BOX = Box(320, 180, 16, 36)
PAGE, GROUND = "the page", "the ground station 255/190"


def tick(t_s, mode, has_target=True, notes=(), frame=True):
    track = Track(BOX, BOX, 30.0, 100.0, 0.9) if has_target else None
    image = Frame(np.zeros((360, 640, 3), np.uint8), t_s, round(t_s * 20)) if frame else None
    seen = Estimate(t_s, 0.0, 0.4, 20.0, 0.5, seen_t_s=t_s)
    return Tick(image, track, VehicleState(t_s), seen, HOVER, Decision(None, mode, notes))


class Desk:
    """Consoles beside an operator; time goes on by `at`."""

    def __init__(self, follows=False, **options):
        self.follows = follows  # as with --ground-follows
        self.lines, self.chosen, self.refusal = [], [], ""
        self.operator = Operator(self.lines.append)
        self.consoles = Consoles(self.operator, self.select, self.lines.append, **options)
        self.has_target = False
        self.at(1.0, Mode.READY)

    def select(self, choice):
        self.chosen.append(choice)
        self.has_target = isinstance(choice, Selection) and not self.refusal
        return self.refusal

    def at(self, t_s, mode):
        self.consoles.see(tick(t_s, mode, self.has_target))

    def draw(self, by=PAGE):
        return self.consoles.choose(Selection(0.5, 0.5, 0.025, 0.1, 1.0, by), flies=self.follows)

    def order(self, command, by=PAGE):
        return self.consoles.order(ConsoleCommand(command), by)

    def ordered(self):
        waiting, self.operator.waiting[:] = list(self.operator.waiting), []
        return [order for order, _by in waiting]


def test_a_drawn_target_is_tracked_and_follow_flies_to_it():
    desk = Desk()
    assert not desk.order("follow").done
    assert desk.draw() == ""
    assert desk.ordered() == [], "a selection orders nothing"
    desk.at(2.0, Mode.READY)
    assert desk.consoles.status.state is TrackingState.ACTIVE
    assert desk.consoles.status.box == pytest.approx((0.5, 0.5, 0.025, 0.1))
    assert desk.order("follow").done
    assert desk.ordered() == [Order.FOLLOW]


def test_an_old_target_is_proposed_first_and_followed_after_confirm():
    desk = Desk()
    desk.draw()
    desk.at(1.1 + DRAWN_S, Mode.READY)
    reply = desk.order("follow")
    assert not reply.done
    assert "20 m away" in reply.words
    assert desk.ordered() == []
    desk.at(1.2 + DRAWN_S + CONFIRM_S, Mode.READY)
    assert not desk.order("confirm").done, "too late"
    desk.order("follow")
    desk.at(1.3 + DRAWN_S + CONFIRM_S, Mode.READY)
    assert desk.order("confirm").done
    assert desk.ordered() == [Order.FOLLOW]


def test_one_console_commands_and_stop_works_from_all():
    desk = Desk()
    desk.draw(PAGE)
    desk.at(2.0, Mode.READY)
    assert "commands" in desk.order("follow", GROUND).words
    assert desk.draw(GROUND) != ""
    assert desk.order("stop", GROUND).done
    assert desk.ordered() == [Order.OBSERVE]
    assert desk.consoles.release(PAGE).done
    assert desk.order("follow", GROUND).done


def test_a_silent_console_loses_the_command():
    desk = Desk()
    desk.draw(PAGE)
    desk.at(2.0 + SILENT_S, Mode.READY)
    desk.order("spotlight", GROUND)
    assert desk.consoles.commander == GROUND


def test_a_changed_target_is_only_tracked_until_follow_is_ordered_again():
    desk = Desk()
    desk.draw()
    desk.at(2.0, Mode.READY)
    desk.order("follow")
    desk.at(3.0, Mode.FOLLOW)
    assert desk.consoles.wanted.mode == ""
    desk.draw()
    assert desk.consoles.wanted.mode == "spotlight"
    desk.at(4.0, Mode.FOLLOW)
    assert desk.order("follow").done
    assert desk.consoles.wanted == AS_SET


def test_hold_hovers_in_control_and_an_end_resets_the_chosen_geometry():
    desk = Desk()
    desk.draw()
    desk.at(2.0, Mode.FOLLOW)
    assert desk.order("hold").done
    assert desk.consoles.wanted.mode == HOVER_HERE
    assert desk.ordered() == []
    desk.at(3.0, Mode.ENDED)
    assert desk.consoles.wanted == AS_SET


@given(st.lists(st.sampled_from(["nearer", "farther", "higher", "lower", "left", "right", "orbit", "chase"])))
def test_trims_stay_bounded_and_the_sideways_move_ends(presses):
    desk = Desk()
    desk.draw()
    t_s = 2.0
    for press in presses:
        desk.at(t_s, Mode.FOLLOW)
        desk.order(press)
        t_s += 0.1
        wanted = desk.consoles.wanted
        assert 0.5 <= wanted.standoff_factor <= 2.5
        assert abs(wanted.raise_rad) <= 0.16
    desk.at(t_s + 3.0, Mode.FOLLOW)
    assert desk.consoles.wanted.around_m_s == 0.0
    assert desk.ordered() == [], "a trim is no order"


def test_a_trim_stops_at_the_nearest_permitted_distance_gives_the_reason_and_does_not_wind_up():
    desk = Desk(standoff_m=12.0, nearest=KeptStandoff(9.0, "nearer, its feet leave the image"))
    desk.draw()
    desk.at(2.0, Mode.FOLLOW)
    replies = [desk.order("nearer").words for _ in range(6)]
    assert "the least" not in replies[0]
    assert "stand-off 9 m (the least: nearer, its feet leave the image)" in replies[-1]
    assert desk.consoles.wanted.standoff_factor == pytest.approx(0.75)
    assert "stand-off 10 m," in desk.order("farther").words, "one press back acts at once"


def test_the_proposed_stand_off_is_the_one_that_will_be_kept():
    desk = Desk(standoff_m=12.0)
    assert desk.consoles.proposal().startswith("chase at 12 m")
    desk.consoles.kept = lambda: KeptStandoff(18.0, "the target is far below")
    assert desk.consoles.proposal().startswith("chase at 18 m, as the target is far below")


def test_a_refused_selection_goes_back_with_its_reason_and_a_flood_is_one():
    desk = Desk()
    desk.refusal = "box outside the image"
    assert desk.draw() == "box outside the image"
    desk.refusal = ""
    for _ in range(1000):
        desk.draw()
    assert len(desk.chosen) == 1
    desk.at(2.0, Mode.READY)
    assert desk.draw() == ""
    assert desk.consoles.choose(Cleared(PAGE)) == ""
    assert desk.ordered() == [Order.OBSERVE]


class Ears:
    def __init__(self):
        self.texts, self.values = [], []

    def tell(self, text, severity):
        self.texts.append((text, severity))

    def tell_value(self, name, value, t_s):
        self.values.append((name, value, t_s))


def test_the_pilot_is_told_of_changes_at_most_once_a_second_in_fifty_characters():
    ears = Ears()
    texts = PilotTexts(ears)
    sent = 0
    for k in range(600):
        modes = [Mode.READY, Mode.ENGAGE, Mode.FOLLOW, Mode.COAST, Mode.SEARCH, Mode.HOLD, Mode.ENDED]
        before = len(ears.texts)
        texts.see(tick(0.05 * k, modes[k // 60 % 7], notes=("slower: limits.fence_m (near the border)",)))
        assert len(ears.texts) - before <= 1
        sent += len(ears.texts) - before
    assert sent <= 30.0 / TEXT_EVERY_S + 1
    told = [text for text, _severity in ears.texts]
    for word in ("ready", "taking over", "following", "target lost", "searching", "given up", "ended", "fence"):
        assert any(word in text for text in told), word
    assert {name for name, _value, _t in ears.values} == {"flw_range", "flw_height", "flw_conf"}
    assert 55 <= len([1 for name, _value, _t in ears.values if name == "flw_range"]) <= 61


def test_a_momentary_loss_is_not_reported():
    ears = Ears()
    texts = PilotTexts(ears)
    for k in range(100):
        texts.see(tick(0.05 * k, Mode.COAST if k % 20 < 5 else Mode.FOLLOW))
    assert not any("lost" in text for text, _severity in ears.texts)


def test_an_open_ground_address_needs_ground_unsigned_and_excludes_ground_follows():
    command = RunCommand(link="udpin:127.0.0.1:1", camera="scene:walker", ground_follows=True)
    check(replace(command, ground="udpin:127.0.0.1:5"))
    check(replace(command, ground="udpin:0.0.0.0:5", ground_follows=False, ground_unsigned=True))
    for follows, unsigned in ((False, False), (True, False), (True, True)):
        with pytest.raises(UsageError, match="must not choose the target or order FOLLOW"):
            check(replace(command, ground="udpin:0.0.0.0:5", ground_follows=follows, ground_unsigned=unsigned))


def test_a_ground_station_that_vanishes_while_it_commands_changes_nothing_and_frees_the_command():
    desk = Desk()
    desk.draw(GROUND)
    desk.at(1.0, Mode.READY)
    assert desk.order("follow", GROUND).done
    assert desk.ordered() == [Order.FOLLOW]
    wanted = desk.consoles.wanted
    for k in range(1, 400):  # 20 s in which it is not heard
        t_s = 1.0 + 0.05 * k
        desk.at(t_s, Mode.FOLLOW)
        reply = desk.order("farther", PAGE) if k in (20, 180) else None
        assert reply is None or "commands: hand over" in reply.words
        assert desk.consoles.wanted == wanted
        assert desk.ordered() == []
    assert t_s > 1.0 + SILENT_S
    assert desk.order("farther", PAGE).done, "the next console that orders commands"
    desk.order("stop", GROUND)
    assert desk.ordered() == [Order.OBSERVE], "who comes back can still stop"


@pytest.mark.parametrize("mode", [Mode.COAST, Mode.SEARCH, Mode.HOLD])
def test_while_the_target_is_lost_another_can_be_chosen_and_an_old_one_is_confirmed(mode):
    desk = Desk()
    desk.draw()
    desk.at(1.0, Mode.READY)
    assert desk.order("follow").done
    desk.ordered()
    desk.at(1.0 + DRAWN_S + 2.0, mode)
    assert desk.order("follow").words.startswith("CONFIRM: ")
    assert desk.ordered() == [], "nothing is flown before CONFIRM"
    assert desk.order("confirm").done
    assert desk.ordered() == ([Order.FOLLOW] if mode is Mode.HOLD else []), "in HOLD the gate needs the order again"
    assert desk.draw() == ""
    assert desk.consoles.wanted == Wanted(mode="spotlight"), "who is chosen in flight is looked at"
    assert desk.ordered() == []
    assert desk.order("follow").done, "drawn a moment ago"


@pytest.mark.parametrize(
    ("link", "ground", "is_one"),
    [
        ("udpin:127.0.0.1:14540", "udpin:127.0.0.1:14540", True),
        ("udpin:0.0.0.0:14540", "udpin:127.0.0.1:14540", True),
        ("mavsdk+udpin://0.0.0.0:14540", "udpin:localhost:14540", True),
        ("udpin:127.0.0.1:14540", "udpin:127.1:14540", True),
        ("udpin:LocalHost:14540", "udpin:127.000.000.001:014540", True),
        ("udpin:127.0.0.1:14540", "udpin:0:14540", True),
        ("serial:/dev/ttyS0:57600", "serial:/dev/../dev/ttyS0:115200", True),
        ("udpin:127.0.0.1:14540", "udpin:127.0.0.1:14541", False),
        ("udpin:127.0.0.1:14540", "udpin:127.0.0.2:14540", False),
        ("udpout:127.0.0.1:14540", "udpin:127.0.0.1:14540", False),
        ("serial:/dev/ttyS0:57600", "udpin:127.0.0.1:14540", False),
        ("udpin:127.0.0.1:14540", "link", False),
    ],
)
def test_link_and_ground_on_one_port_are_refused_before_anything_starts(link, ground, is_one):
    command = RunCommand(link=link, camera="scene:walker", ground=ground)
    refused = pytest.raises(UsageError, match="are one place, and only one of them can have it: give --ground another")
    with refused if is_one else contextlib.nullcontext():
        check(command)


@pytest.mark.parametrize("follows", [False, True])
def test_a_tap_that_finds_nothing_orders_nothing(follows):
    desk = Desk(follows=follows)
    desk.draw()
    desk.ordered()
    desk.at(1.0 + DRAWN_S + 1.0, Mode.READY)
    desk.consoles.is_looking = lambda: True
    assert desk.draw() == ""
    assert desk.ordered() == [], "nobody knows yet what is there"
    desk.consoles.decided("nothing stands out there: draw a box")
    assert desk.ordered() == []
    reply = desk.order("follow")
    assert not reply.done, "the target of long ago is not what the person tapped now"
    assert "CONFIRM" in reply.words


def test_a_tap_that_finds_something_counts_as_drawn():
    desk = Desk(follows=True)
    desk.consoles.is_looking = lambda: True
    desk.draw()
    desk.consoles.decided("")
    assert desk.ordered() == [Order.FOLLOW]
    desk.at(2.0, Mode.READY)
    assert desk.order("follow").done


def test_a_stop_precedes_queued_orders():
    desk = Desk()
    desk.draw()
    desk.at(2.0, Mode.READY)
    for _ in range(20):
        desk.order("follow")
    desk.order("stop", GROUND)
    order, _by = desk.operator.asked()
    assert order is Order.OBSERVE
    assert desk.operator.asked() is None
