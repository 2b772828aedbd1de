"""A target that turns: its velocity is estimated while it is visible, and the search follows the turn.

The reference is the course itself, computed from its turn rate without the filter, the prediction and the search.
"""

import cmath
import itertools
import math

import numpy as np
import pytest

from follow.control.joint_filter import TREND_KEPT, corrected
from follow.control.regain import LOOK_REACH_M, LOOKS, looked_for, next_look
from follow.control.target import Target
from racf.track import Track
from tests.follow.test_target import CAMERA, DOWN, DT, box_of, hovering

TURN_S = 1.2  # it turns for this long before it is lost
STRAIGHT_S = 3.0
NOISE = 0.3  # of the errors that the filter expects: RACF's boxes err by less (docs/estimate.md)
cases = list(itertools.product((1.4, 2.5, 4.0), (0.9, 1.4), (-1, 1), range(3)))


def course(speed, rate, side, on_s=0.0):
    """Positions (complex: north + i east) every DT: straight, a turn, and `on_s` more of it, fading as who turns back.

    The turn goes on for a second's worth: it fades as exp(-t / 1 s), so that nobody goes in circles.
    """
    heading, place, places = 0.0, complex(14.0, -3.0 * side), []
    for i in range(round((STRAIGHT_S + TURN_S + on_s) / DT)):
        t_s = i * DT
        turning = rate if STRAIGHT_S <= t_s < STRAIGHT_S + TURN_S else 0.0
        if t_s >= STRAIGHT_S + TURN_S:
            turning = rate * math.exp(-(t_s - STRAIGHT_S - TURN_S))
        heading += side * turning * DT
        place += speed * DT * cmath.exp(1j * (heading + side * 1.2))
        places.append(place)
    return places


def shown(places, seed, psr=20.0):
    """A target to which all of the course was shown, with noise."""
    random, target = np.random.default_rng(seed), Target(CAMERA, DOWN)
    for i, place in enumerate(places):
        state = hovering(i * DT)
        box = box_of((place.real, place.imag), state)
        right, down, larger = random.normal(0.0, NOISE * target.config.noise)
        box = box.moved(right * CAMERA.fx, down * CAMERA.fy).scaled(math.exp(larger))
        estimate = target.update(Track(box, box, psr=psr, apce=50.0, confidence=0.9, found=True), state, i * DT)
    return target, estimate


def velocity_of(places):
    return (places[-1] - places[-2]) / DT


@pytest.mark.parametrize(("speed", "rate", "side", "seed"), cases)
def test_the_velocity_covariance_of_a_turning_target_is_consistent(speed, rate, side, seed):
    """No box of the turn is surprising by itself: only several together show it."""
    places = course(speed, rate, side)
    _, estimate = shown(places, seed)
    true = velocity_of(places)
    error = np.array([estimate.north_m_s - true.real, estimate.east_m_s - true.imag])
    nn, ne, ee = estimate.velocity_covariance
    assert error @ np.linalg.solve([[nn, ne], [ne, ee]], error) <= 11.8  # 3 standard deviations in two dimensions


def test_white_noise_alone_is_seldom_taken_for_a_turn():
    """The faded sum of whitened innovations has variance 1 / (1 - k^2) in each part."""
    random = np.random.default_rng(1)
    trend, together2 = np.zeros(3), []
    for _ in range(3000):
        trend = TREND_KEPT * trend + random.normal(0.0, 1.0, 3)
        together2.append((1 - TREND_KEPT**2) * float(trend @ trend))
    assert np.mean(together2[100:]) == pytest.approx(3.0, rel=0.2)


def lost_after(target, unseen_s):
    """The filter that long after the last box."""
    assert target.filter is not None
    return target.carried(target.filter.t_s + unseen_s)


def looked_near(target, places, unseen_s):
    """Whether one of the looks of a whole cycle comes so near to where it is that the tracker finds it."""
    f, true = lost_after(target, unseen_s), np.array([places[-1].real, places[-1].imag])
    looks = [looked_for(f, target.seen_ned, look) for look in range(2 * LOOKS)]
    return min(float(np.linalg.norm(place[:2] - true)) for place in looks) <= LOOK_REACH_M


@pytest.mark.parametrize("unseen_s", [1.0, 2.0, 3.0])
def test_a_target_lost_in_a_turn_is_searched_along_the_turn(unseen_s):
    """The search covers two standard deviations: of 36 courses at most two may lead beyond."""
    found, found_straight = [], []
    for speed, rate, side, seed in cases:
        places = course(speed, rate, side, on_s=unseen_s)
        target, _ = shown(places[: round((STRAIGHT_S + TURN_S) / DT)], seed)
        found.append(looked_near(target, places, unseen_s))
        target.turning.seen.clear()  # as if nothing were known of the turn
        found_straight.append(looked_near(target, places, unseen_s))
    assert found.count(False) <= 2
    assert found_straight.count(False) > 4 * found.count(False)


def test_on_average_the_curved_prediction_is_nearer_than_the_straight_one():
    bent, straight = [], []
    for speed, rate, side, seed in cases:
        places = course(speed, rate, side, on_s=2.0)
        target, _ = shown(places[: round((STRAIGHT_S + TURN_S) / DT)], seed)
        true = places[-1]
        mean = lost_after(target, 2.0).mean
        bent.append(abs(complex(mean[0], mean[1]) - true))
        target.turning.seen.clear()
        mean = lost_after(target, 2.0).mean
        straight.append(abs(complex(mean[0], mean[1]) - true))
    assert np.mean(bent) < 0.7 * np.mean(straight)


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("speed", [0.0, 0.3, 1.4, 3.0])
def test_a_straight_target_is_predicted_straight(speed, seed):
    places = course(speed, 0.0, 1)
    target, _ = shown(places, seed)
    assert target.filter is not None
    f = lost_after(target, 3.0)
    before = target.filter.mean
    straight = before[:2] + 3.0 * before[3:5]
    std = math.sqrt(float(np.linalg.eigvalsh(f.covariance[:2, :2])[-1]))
    assert float(np.linalg.norm(f.mean[:2] - straight)) <= 0.5 * std


def test_only_places_in_the_image_are_searched_while_there_are_any():
    target, _ = shown(course(2.5, 0.9, 1), 0)
    f = lost_after(target, 2.0)
    right = [looked_for(f, target.seen_ned, look) for look in range(2 * LOOKS)]
    half = float(np.median([place[1] for place in right]))
    looks, places = 0, []
    for _ in range(2 * LOOKS):
        looks, place = next_look(f, target.seen_ned, looks, lambda place: place[1] > half)
        places.append(place)
    assert all(place[1] > half for place in places)
    looks, place = next_look(f, target.seen_ned, 7, lambda _place: False)
    assert looks == 8
    assert place == pytest.approx(f.mean[:3])


@pytest.mark.parametrize("ahead", [1.0, -1.0])
def test_a_box_of_weak_response_changes_the_velocity_less(ahead):
    """It is drawn to the trunk that covers the target; the response has fallen by then."""
    changes = []
    for psr in (20.0, 14.0, 8.0):
        target, before = shown(course(1.4, 0.0, 1), 0)
        for i in range(6):
            t_s = before.t_s + (i + 1) * DT
            state = hovering(t_s)
            place = target.filter.mean[:2] + 0.15 * ahead * np.array([0.0, 1.0])
            box = box_of((float(place[0]), float(place[1])), state)
            target.filter = target.carried(t_s)
            sight = target.sight(box, target.pose(state, t_s))
            noise = target.noise(box, psr)
            assert noise[0] >= target.config.noise[0]
            target.filter = corrected(target.filter, target.pose(state, t_s).position_ned, sight, noise)
        changes.append(abs(float(target.filter.mean[4]) - before.east_m_s))
    assert changes[0] > changes[1] > changes[2]
