"""A target chosen in flight: the search for it lasts as long as for a lost one, and nothing is flown blindly."""

import math
from dataclasses import replace

import pytest

from follow.messages import HOVER, NEVER, Estimate, Instruction, OtherSighting, Setpoint
from tests.support.gate_rig import DT, LIMITS, engaged, fly, flying, obeyed, seen

NOBODY = Estimate(0.0, 0.0, 0.4, 1e3, 1e3)


def after_choice(seconds, found_after_s=None):
    """Decisions after somebody else was chosen; the servo asks for 3 m/s all the time."""
    safety, t_s = engaged()
    decisions, instruction = [], Instruction(aimed=True)
    for i in range(1, round(seconds / DT) + 1):
        now = t_s + i * DT
        found = found_after_s is not None and i * DT >= found_after_s
        estimate = seen(now) if found else replace(NOBODY, t_s=now)
        state = flying(now, **obeyed(safety))
        decisions.append(safety.allow(Setpoint(3.0), estimate, state, now, instruction))
        instruction = Instruction()
    return decisions


@pytest.mark.parametrize("found_after_s", [2 * DT, 0.2, 0.5, 3.0, 6.0])
def test_following_begins_as_soon_as_the_chosen_person_is_found(found_after_s):
    decisions = after_choice(found_after_s + 1.0, found_after_s)
    assert decisions[-1].mode == "follow"
    assert "hold" not in {decision.mode.value for decision in decisions}
    assert decisions[-1].setpoint.forward_m_s > 0.5


def test_until_the_choice_is_found_it_brakes_and_gives_up_as_for_a_lost_target():
    decisions = after_choice(LIMITS.give_up_after_s + 1.0)
    modes = [decision.mode.value for decision in decisions]
    assert list(dict.fromkeys(modes)) == ["follow", "coast", "search", "hold"]
    assert modes.index("search") == pytest.approx(LIMITS.search_after_s / DT, abs=2)
    assert modes.index("hold") == pytest.approx(LIMITS.give_up_after_s / DT, abs=2)
    assert all("inf" not in str(decision.reason) for decision in decisions)
    assert max(abs(decision.setpoint.forward_m_s) for decision in decisions) == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("lost_s", [5.0, 19.0, 40.0])
@pytest.mark.parametrize("range_m", [2.0, 6.0, 30.0])
def test_the_vehicle_does_not_retreat_from_a_target_of_unknown_position(lost_s, range_m):
    """In SEARCH and HOLD it hovers; a target that is seen keeps its distance at once."""
    safety, t_s = engaged()
    for i in range(1, round(lost_s / DT)):
        now = t_s + i * DT
        guess = replace(seen(now), range_m=range_m, range_std_m=20.0, range_near_m=0.0, seen_t_s=t_s)
        decision = safety.allow(HOVER, guess, flying(now, **obeyed(safety)), now)
        late = i * DT > LIMITS.search_after_s + 3.0
        assert not late or abs(decision.setpoint.forward_m_s) + abs(decision.setpoint.down_m_s) < 1e-9
    near = replace(seen(now), range_m=2.0, range_near_m=1.5, depression_rad=1.4, ground_below_m=3.0, ground_std_m=0.1)
    for _ in range(30):
        now += DT
        decision = safety.allow(HOVER, replace(near, t_s=now, seen_t_s=now), flying(now, **obeyed(safety)), now)
    assert decision.setpoint.forward_m_s < -0.5
    assert decision.setpoint.down_m_s < -0.5


@pytest.mark.parametrize("range_m", [2.0, 3.0])
@pytest.mark.parametrize("lost_s", [1.0, 6.0])
def test_the_stand_off_to_somebody_found_while_the_target_is_lost_is_kept(range_m, lost_s):
    """The other person stands in front of the vehicle, in COAST and in SEARCH; the target is predicted far away."""
    safety, t_s = engaged()
    for i in range(1, round((lost_s + 1.5) / DT)):
        now = t_s + i * DT
        other = OtherSighting(0.0, range_m, 2.0) if i * DT > lost_s else None
        guess = replace(seen(now), range_m=30.0, seen_t_s=t_s, other=other)
        decision = safety.allow(Setpoint(3.0), guess, flying(now, **obeyed(safety)), now)
    assert decision.setpoint.forward_m_s < -0.2  # from 3 m/s forward, in 1.5 s
    assert decision.setpoint.down_m_s < -0.2
    assert any("another person" in note for note in decision.notes)


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("field", ["azimuth_rad", "range_m", "below_m"])
def test_a_sighting_that_is_not_finite_is_ignored(field, value):
    safety, t_s = engaged()
    for i in range(1, 200):
        now = t_s + i * DT
        guess = replace(seen(now), seen_t_s=t_s, other=replace(OtherSighting(0.0, 8.0, 2.0), **{field: value}))
        decision = safety.allow(Setpoint(3.0), guess, flying(now, **obeyed(safety)), now)
        assert decision.setpoint.is_finite()
    assert decision.setpoint.forward_m_s == pytest.approx(0.0, abs=1e-9)


def test_the_vehicle_does_not_descend_to_an_unseen_target():
    safety, t_s = engaged()
    for decision in fly(safety, t_s, 6.0, Setpoint(0.0, 0.0, 2.0), seen_t_s=t_s)[30:]:
        assert decision.setpoint.down_m_s < 0.05
    assert decision.setpoint.down_m_s == pytest.approx(0.0, abs=1e-9)


def test_without_a_choice_an_estimate_without_a_target_is_given_up_at_once():
    safety, t_s = engaged()
    state = flying(t_s + DT, **obeyed(safety))
    decision = safety.allow(HOVER, replace(NOBODY, t_s=t_s + DT), state, t_s + DT)
    assert NOBODY.seen_t_s == NEVER
    assert decision.mode == "hold"
