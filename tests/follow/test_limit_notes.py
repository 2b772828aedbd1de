"""The notes of the limits: each names the one setting that acts, and only in the rounds in which it acts."""

import dataclasses
import re
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from follow.messages import Setpoint
from follow.safety.distance import STEADY_S, Sighting, Worst
from follow.safety.envelope import HELD, Surroundings, limit_velocity
from follow.safety.limits import Limits
from tests.support.gate_rig import LIMITS, flying

VERTICAL = tuple(HELD)[tuple(HELD).index("climb") :]
FAR = Worst(0.0, 40.0, 10.0, 0.0)
BELOW_US = Sighting(1.0, 0.0, 0.0, 0.0, -2.0, -12.0, -STEADY_S)


def vertical(down_m_s, height_m=12.0, target=FAR, limits=LIMITS, **around):
    """The downward speed that is permitted, and the notes of the limits that changed it."""
    state = flying(0.5, down_m=-height_m)
    surroundings = Surroundings(target, (0.0, 0.0), **around)
    velocity, notes = limit_velocity(Setpoint(down_m_s=down_m_s), 8.0, surroundings, state, limits)
    return velocity[2], tuple(note for note in notes if note in {HELD[name] for name in VERTICAL})


def test_each_note_names_at_most_one_setting_and_one_that_exists():
    known = {field.name for field in dataclasses.fields(Limits)}
    for text in HELD.values():
        named = re.findall(r"limits\.(\w+)", text)
        assert set(named) <= known
        assert len(named) == 1 or "no setting" in text or "last sighting" in text
        assert "," not in text  # it separates the columns of ticks.csv


def test_what_is_permitted_has_no_note():
    assert vertical(0.5) == (0.5, ())
    assert vertical(-0.5) == (-0.5, ())


@pytest.mark.parametrize(
    ("name", "down_m_s", "case"),
    [
        ("climb", 3.0, {}),
        ("climb", -3.0, {}),
        ("approach", 1.0, {"target": replace(FAR, approach_m_s=1.4)}),
        ("head", 1.0, {"target": replace(FAR, spare_m=0.1)}),
        ("head", 0.0, {"target": replace(FAR, spare_m=-1.0)}),
        ("head", 1.0, {"target": replace(FAR, range_m=0.5, above_m=4.1)}),
        ("another's approach", 1.0, {"another": replace(FAR, approach_m_s=1.4)}),
        ("another's head", 0.0, {"another": Worst(0.0, 2.0, 2.0, 1.4)}),
        ("below", 0.0, {"height_m": 4.0, "last_seen": replace(BELOW_US, base_down_m=-4.0)}),
        ("unseen climb", -1.0, {"height_m": 17.0, "last_seen": BELOW_US}),
        ("ceiling", -1.0, {"height_m": 99.9}),
        ("ceiling", 0.0, {"height_m": 101.0}),
        ("above target", -1.0, {"target": replace(FAR, above_m=24.9)}),
        ("floor", 1.0, {"height_m": 2.1}),
        ("floor", 0.0, {"height_m": 1.5}),
    ],
)
def test_the_note_names_the_limit_that_acts_on_the_climb(name, down_m_s, case):
    permitted, notes = vertical(down_m_s, **case)
    assert permitted != down_m_s
    assert notes == (HELD[name],)


def test_of_two_limits_only_the_stricter_is_noted():
    """The target approaches below a vehicle at its floor; a climb ends at the lower of two borders."""
    coming = replace(FAR, approach_m_s=1.4)
    assert vertical(1.0, height_m=2.3, target=coming)[1] == (HELD["approach"],)
    assert vertical(1.0, height_m=1.9, target=coming)[1] == (HELD["floor"],)
    high = replace(FAR, above_m=24.5)
    assert vertical(-1.0, height_m=99.9, target=high)[1] == (HELD["ceiling"],)
    assert vertical(-1.0, height_m=99.5, target=replace(high, above_m=24.9))[1] == (HELD["above target"],)


ANYTHING = st.builds(
    Worst, st.just(0.0), st.floats(0, 50), st.floats(0, 30), st.floats(-8, 8), st.floats(-3, 10), st.floats(-1, 1)
)


@given(st.floats(-9, 9), st.floats(0, 110), ANYTHING, st.none() | ANYTHING, st.none() | st.just(BELOW_US))
def test_the_climb_is_noted_once_if_a_limit_changed_it(down_m_s, height_m, target, another, last_seen):
    permitted, notes = vertical(down_m_s, height_m, target, another=another, last_seen=last_seen)
    assert len(notes) <= 1
    assert notes or permitted == down_m_s


@given(st.floats(-2, 2), st.floats(3, 98), ANYTHING)
def test_floor_and_ceiling_are_not_named_far_from_both(down_m_s, height_m, target):
    """At the permitted speed of climb both are out of reach for the time that braking takes."""
    near = min(height_m - LIMITS.floor_m, LIMITS.ceiling_m - height_m) < LIMITS.climb_m_s * 2.5
    _, notes = vertical(down_m_s, height_m, target)
    assert near or not {HELD["floor"], HELD["ceiling"]} & set(notes)
