"""The texts of the page: the state describes the present, and the line below it tells what to do."""

import math
from dataclasses import replace

import pytest

from follow.messages import STARTED, Cause, Decision, Estimate, Mode, Order, Reason
from follow.operator.page.desk import SELECT, TO_SELECT, explanation, headline
from follow.safety.checks import UNSEEN
from follow.safety.gate import too_near
from follow.safety.limits import Limits
from follow.selection import AS_SET, HOVER_HERE, TrackingState
from tests.support.page_rig import PageRig

STOPPED = Reason(Cause.OBSERVE_ORDERED, "page 1")


def read(mode, reason, tracking=TrackingState.ACTIVE, wanted=AS_SET.mode, *, is_new=False):
    words, _tone = headline(mode, wanted, tracking, is_new=is_new)
    return words, explanation(words, Decision(None, mode, (), reason))


@pytest.mark.parametrize("reason", [STARTED, Reason(Cause.NOT_READY, UNSEEN), Reason(Cause.NOT_SEEN)])
def test_without_a_target_the_page_says_how_to_select_one(reason):
    assert read(Mode.OBSERVE, reason, TrackingState.IDLE) == (SELECT, TO_SELECT)


def test_other_reasons_against_follow_are_shown_before_a_target_is_selected():
    reason = Reason(Cause.NOT_READY, "the vehicle is not armed")
    assert read(Mode.OBSERVE, reason, TrackingState.IDLE) == (SELECT, "the vehicle is not armed")


def test_while_the_target_is_not_seen_yet_the_page_says_to_wait():
    assert read(Mode.OBSERVE, Reason(Cause.NOT_READY, UNSEEN)) == (
        "NOT READY",
        "target not seen: wait, or draw the box again",
    )


def test_a_stop_says_by_whom_in_the_words_of_the_button():
    assert read(Mode.ENDED, STOPPED) == ("STOPPED", "stopped by page 1")
    assert read(Mode.ENDED, STOPPED, TrackingState.IDLE, is_new=True)[0] == "STOPPED"


def test_a_vehicle_that_holds_says_how_to_go_on():
    words, why = read(Mode.FOLLOW, Reason(Cause.BEGAN), wanted=HOVER_HERE)
    assert words == "HOLDS"
    assert "FOLLOW" in why
    assert "STOP" in why


def test_a_target_that_is_selected_after_a_stop_is_tracked_not_stopped(tmp_path):
    with PageRig(tmp_path / "now") as rig, rig.window() as window:
        rig.has_target, rig.mode, rig.reason = True, Mode.FOLLOW, Reason(Cause.BEGAN)
        window.until(lambda w: w.status.get("state") == "FOLLOWING" and w.images)
        rig.mode, rig.reason = Mode.ENDED, STOPPED
        window.until(lambda w: w.status["state"] == "STOPPED")
        for _ in range(40):
            rig.round()
        window.until(lambda w: len(w.images) > 4)
        assert window.status["state"] == "STOPPED", "time alone changes nothing"
        window.send(do="select", frame=window.images[-1][0]["frame"], box=[0.4, 0.3, 0.1, 0.2])
        assert window.replied() == [True, "target selected"]
        window.until(lambda w: w.status["state"] == "TRACKING")
        assert "FOLLOW flies to the target" in window.status["why"]
        rig.heeds = Order.OBSERVE
        window.until(lambda w: w.status["state"] == "STOPPED")
        rig.heeds, rig.mode = None, Mode.FOLLOW
        window.until(lambda w: w.status["state"] == "FOLLOWING")
        rig.mode = Mode.ENDED
        window.until(lambda w: w.status["state"] == "STOPPED")


def test_the_refusal_of_follow_distinguishes_a_near_target_from_one_of_unknown_range():
    near, limits = Estimate(0.0, 0.0, 0.3, 2.0, 0.5, seen_t_s=0.0), Limits()
    assert "fly back" in too_near(near, limits)
    for uncertain in (
        replace(near, range_m=12.0),
        replace(near, range_m=1.0, depression_rad=math.atan(6.0)),  # 6 m above it
        replace(near, range_m=math.nan),
    ):
        assert too_near(uncertain, limits).endswith("wait")
