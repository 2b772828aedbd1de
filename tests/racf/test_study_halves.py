"""The two-fold study: nothing is judged on a sequence that chose it, and every start begins on a target."""

import numpy as np
import pytest

from racf.evaluate.benchmarks import Sequence
from tools.studies.halves import HALVES, INNER, difference, inner_starts, over, two_fold

EVERY = [*HALVES["A"], *HALVES["B"]]


def test_the_halves_share_no_sequence_and_are_of_one_size() -> None:
    assert len(set(EVERY)) == len(EVERY) == 20
    assert len(HALVES["A"]) == len(HALVES["B"])


def test_sequences_cut_out_of_one_video_are_on_one_side() -> None:
    assert {"car16_1", "car16_2"} <= set(HALVES["A"])


def test_a_choice_is_judged_only_by_the_other_half() -> None:
    """A candidate that is best on one half and worst on the other must not profit from where it is best."""
    steady = dict.fromkeys(EVERY, (50.0, 50.0))
    fits_a = {name: (90.0, 90.0) if name in HALVES["A"] else (10.0, 10.0) for name in EVERY}
    folds, reported = two_fold({"steady": steady, "fits A": fits_a})
    assert [(fold.chosen_on, fold.label, fold.reported_on) for fold in folds] == [
        ("A", "fits A", "B"),
        ("B", "steady", "A"),
    ]
    assert over(reported, HALVES["B"]) == (10.0, 10.0)
    assert over(reported, HALVES["A"]) == (50.0, 50.0)


def test_a_paired_difference_does_not_feel_how_hard_sequences_are() -> None:
    rng = np.random.default_rng(0)
    hard = dict(zip(EVERY, rng.uniform(0, 90, (20, 2)).tolist(), strict=True))
    better = {name: (p + 3.0, a + 2.0) for name, (p, a) in hard.items()}
    apart = difference(better, hard, EVERY)
    assert apart.precision == pytest.approx((3.0, 3.0, 3.0))
    assert apart.auc == pytest.approx((2.0, 2.0, 2.0))


def test_inner_starts_begin_where_the_target_is_annotated() -> None:
    truth = np.tile([10.0, 10.0, 20.0, 20.0], (30, 1))
    truth[8:14] = np.nan
    truth[20] = 0.0
    sequence = Sequence("walk", "made", truth, attributes=())
    parts = list(inner_starts(sequence))
    assert [len(part.truth) for part in parts] == [30 - 14, 30 - 21]
    assert len({part.name for part in parts} | {sequence.name}) == 1 + len(INNER)
