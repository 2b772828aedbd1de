"""Changes of mode as lines for the operator, and the line about a flight that ended early."""

import pytest

from follow.messages import HOVER, NEVER, Cause, Decision, Estimate, Mode, Reason, Tick, VehicleState
from follow.operator.mode_changes import LOOSE, ModeChanges
from racf.box import Box
from racf.track import Track

UNSEEN = Estimate(NEVER, 0.0, 0.0, 1.0, 0.0)
BEGUN = [(Mode.READY, Reason(Cause.READY)), (Mode.FOLLOW, Reason(Cause.BEGAN)), (Mode.FOLLOW, Reason(Cause.BEGAN))]

WAITS = Reason(Cause.ORDER_WAITS, "the key f")


def reported(rounds: list[tuple[Mode, Reason]]) -> tuple[list[str], str]:
    lines: list[str] = []
    changes = ModeChanges(lines.append)
    for n, (mode, reason) in enumerate(rounds):
        state = VehicleState(100.0 + n / 2, mode="OFFBOARD")
        changes.see(Tick(None, None, state, UNSEEN, HOVER, Decision(None, mode, (), reason)))
    return lines, changes.early_end()


def test_every_change_is_one_line_with_the_time_since_the_first_round():
    lost = (Mode.COAST, Reason(Cause.NOT_SEEN, seconds=0.258))
    lines, early = reported([*BEGUN, lost, lost])
    assert lines == [
        "0.0 s: ready (FOLLOW can be ordered), vehicle in OFFBOARD",
        "0.5 s: follow (FOLLOW began), vehicle in OFFBOARD",
        "1.5 s: coast (target not seen for 0.26 s), vehicle in OFFBOARD",
    ]
    assert early == ""


@pytest.mark.parametrize("unseen_s", [0.2501, 0.2582, 4.071, 20.96])
def test_a_target_is_not_said_to_be_unseen_for_longer_than_it_was(unseen_s):
    """To a hundredth of a second: a limit of 0.25 s that was just passed is not 0.3 s."""
    said = str(Reason(Cause.NOT_SEEN, seconds=unseen_s))
    assert float(said.split()[-2]) == pytest.approx(unseen_s, abs=0.005)


@pytest.mark.parametrize(
    ("rounds", "early"),
    [
        ([*BEGUN, (Mode.ENDED, Reason(Cause.LANDED))], "following ended early, at 1.5 s: the vehicle is on the ground"),
        ([(Mode.OBSERVE, Reason(Cause.NO_HEADING))] * 2, "FOLLOW never began: the heading is invalid"),
        ([*BEGUN, (Mode.ENDED, Reason(Cause.LANDED)), *BEGUN], ""),
        (
            [(Mode.ENGAGE, WAITS), (Mode.ENDED, Reason(Cause.REFUSED, "no GPS"))],
            "FOLLOW never began: the autopilot refused: no GPS",
        ),
        ([], ""),
    ],
)
def test_a_flight_that_sends_nothing_at_its_end_reports_since_when_and_why(rounds, early):
    assert reported(rounds)[1] == early


def test_an_order_that_was_never_given_names_the_reason_that_lasted_longest_and_the_last_one():
    red = [(Mode.OBSERVE, Reason(Cause.NOT_READY, f"COM_LOW_BAT_ACT is red ({n} of 5)")) for n in range(20)]
    silent = [(Mode.OBSERVE, Reason(Cause.NOT_READY, "nothing heard from the vehicle for 3 s"))] * 3
    early = reported([*red, *silent])[1]
    assert early == (
        "FOLLOW never began: COM_LOW_BAT_ACT is red, for 10 s; at the end: nothing heard from the vehicle for 3 s"
    )
    assert reported(silent)[1] == "FOLLOW never began: nothing heard from the vehicle for 3 s"


@pytest.mark.parametrize(("before", "word"), [(BEGUN, "following ended"), ([(Mode.ENGAGE, WAITS)], "ended")])
def test_only_what_had_begun_is_said_to_be_following_that_ended(before, word):
    lines, _ = reported([*before, (Mode.ENDED, Reason(Cause.OBSERVE_ORDERED, "the key o"))])
    assert lines[-1].split(" s: ")[1] == f"{word} (OBSERVE ordered by the key o), vehicle in OFFBOARD"


def test_a_flickering_refusal_with_new_figures_is_reported_every_ten_seconds_at_most():
    texts = ["the image does not move with the vehicle (0.0 of {} px): frozen", "the image does not turn ({} of 5 px)"]
    rounds = [(Mode.OBSERVE, Reason(Cause.NOT_READY, texts[n % 2].format(n))) for n in range(60)]  # half a second each
    lines, _ = reported(rounds)
    assert [line.split(" ")[0] for line in lines] == ["0.0", "0.5", "10.0", "10.5", "20.0", "20.5"]


def test_the_flickering_reasons_of_a_queued_order_are_reported_once_each_and_again_for_each_order():
    words = "the key f; waits 3 s for: the image does not {} ({} of 5 px)"
    waits = [(Mode.OBSERVE, Reason(Cause.ORDER_WAITS, words.format(("move", "turn")[n % 2], n))) for n in range(6)]
    void = (Mode.OBSERVE, Reason(Cause.ORDER_VOID, "the image does not turn"))
    lines, _ = reported([*waits, void, *waits])
    assert [line.split(" ")[0] for line in lines] == ["0.0", "0.5", "3.0", "3.5", "4.0"]


def test_a_tracker_that_restarted_on_the_moving_part_of_its_box_is_reported():
    lines: list[str] = []
    changes, box = ModeChanges(lines.append), Box(100.0, 100.0, 40.0, 60.0)
    for restarted in (False, True, False):
        track = Track(box, box, psr=20.0, apce=50.0, confidence=1.0, found=True, restarted=restarted)
        decision = Decision(None, Mode.READY, (), Reason(Cause.READY))
        changes.see(Tick(None, track, VehicleState(100.0, mode="OFFBOARD"), UNSEEN, HOVER, decision))
    assert [line for line in lines if "loose" in line] == [f"0.0 s: {LOOSE}"]
