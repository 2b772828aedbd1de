"""The measurements of the ground's height: their effect on the estimate and its bounds."""

import math

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from follow.control.ground import GroundSources, GroundTrust, Parallax, ground_word, grounded, mean_parallax
from follow.control.joint_filter import Motion, Sight, height_row, started, with_size
from follow.control.pose_history import Pose
from follow.messages import VehicleState

SIZE_M, SIZE_STD, MIDDLE, TRUST = 1.2, 0.3, 0.75, GroundTrust()
NOISE = np.array([0.007, 0.007, 0.06])
POSE = Pose(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, -8.0, 0.0, 0.0, 0.0)


def first(range_m=12.0):
    """The filter after the first box, from 8 m above the start."""
    away = np.array([range_m, 0.0, 8.0 - MIDDLE * SIZE_M])
    slant = float(np.linalg.norm(away))
    sight = Sight(away / slant, math.log(SIZE_M / slant))
    return started(0.0, POSE.position_ned, sight, np.zeros(2), 3.0, SIZE_M, SIZE_STD, NOISE, Motion())


@given(st.lists(st.tuples(st.booleans(), st.floats(0.0, 80.0) | st.floats(4.0, 17.0)), min_size=1, max_size=3))
def test_the_size_is_a_bounded_constant_for_any_measurements(words):
    f, sources = first(), GroundSources()
    for i, (ranged, height_m) in enumerate(word for word in words for _ in range(30)):
        told = {"above_ground_t_s": float(i), "above_ground_m": height_m} if ranged else {}
        if not ranged:
            sources.parallax.append(Parallax(float(i), height_m - 8.0, 0.3))
        state = VehicleState(t_s=float(i), down_m=-8.0, **told)
        f = sources.correct(f, POSE, state, (SIZE_M, SIZE_STD, MIDDLE), TRUST)
        assert abs(math.log(f.size_m / SIZE_M)) <= TRUST.contradiction_sigmas * math.hypot(SIZE_STD, 0.15)


@given(st.floats(0.4, 1.8), st.floats(0.05, 3.0))
def test_a_height_moves_the_estimate_towards_it(ratio, std_m):
    f = first()
    word = ground_word(f, POSE.position_ned, MIDDLE, 8.0 * ratio - 8.0, std_m)
    after = grounded(f, POSE.position_ned, np.zeros(2), MIDDLE, word)
    height, _ = height_row(after, POSE.position_ned, MIDDLE)
    assert min(word.by_size_m, word.height_m) - 1e-6 <= height <= max(word.by_size_m, word.height_m) + 1e-6
    assert abs(height - word.by_size_m) > 0.0 or abs(word.height_m - word.by_size_m) < 1e-6


@given(st.floats(0.05, 3.0))
def test_a_height_as_expected_makes_it_more_certain_and_never_more_than_kalmans_update_would(std_m):
    f, here, still = first(), POSE.position_ned, np.zeros(2)
    expected, row = height_row(f, here, MIDDLE)
    after = grounded(f, here, still, MIDDLE, ground_word(f, here, MIDDLE, expected - 8.0, std_m))
    before, now = (float(row @ with_size(g, here, still) @ row) for g in (f, after))
    assert before * std_m**2 / (before + std_m**2) - 1e-9 <= now < before
    assert np.linalg.eigvalsh(after.covariance)[0] > -1e-9
    assert np.all(np.diag(after.covariance) <= np.diag(f.covariance) + 1e-12)


@given(
    st.lists(st.tuples(st.floats(-3.0, 3.0), st.floats(0.2, 2.0)), min_size=1, max_size=8),
    st.floats(0.0, 0.9),
)
def test_the_mean_of_parallaxes_is_least_squares_and_never_better_than_their_common_error(words, shared):
    seen = [Parallax(0.0, down, std, shared * std) for down, std in words]
    down_m, std_m = mean_parallax(seen)
    own = np.array([std * math.sqrt(1 - shared**2) for _, std in words])
    fitted, *_ = np.linalg.lstsq((1 / own)[:, None], np.array([down for down, _ in words]) / own, rcond=None)
    assert abs(down_m - float(fitted[0])) < 1e-6
    assert std_m >= shared * min(std for _, std in words) - 1e-9
    assert std_m <= max(std for _, std in words) + 1e-9
    if shared == 0.0:
        assert abs(std_m - 1 / math.sqrt(float(np.sum(own**-2)))) < 1e-9


def test_the_start_counts_once_because_its_error_is_one_and_the_same():
    f, sources, state = first(), GroundSources(), VehicleState(t_s=0.0, down_m=-8.0)
    variances = []
    for _ in range(20):
        f = sources.correct(f, POSE, state, (SIZE_M, SIZE_STD, MIDDLE), TRUST)
        variances.append(f.size_var)
    assert variances[0] < SIZE_STD**2
    assert set(variances) == {variances[0]}


@given(st.floats(-16.0, 16.0))
def test_the_range_that_counts_is_the_nearer_one_of_sources_that_contradict_each_other(off_m):
    f, sources = first(), GroundSources()
    state = VehicleState(t_s=0.0, down_m=-8.0, above_ground_t_s=0.0, above_ground_m=max(8.0 + off_m, 0.0))
    sources.correct(f, POSE, state, (SIZE_M, SIZE_STD, MIDDLE), TRUST)
    expected, _ = height_row(f, POSE.position_ned, MIDDLE)
    if sources.contradiction:
        assert sources.near_ratio <= max(state.above_ground_m / expected, 0.3) + 1e-6
        assert sources.near_ratio <= 1.0
    else:
        assert sources.near_ratio == 1.0
        assert abs(math.log(max(state.above_ground_m, 0.1) / expected)) < 1.0
