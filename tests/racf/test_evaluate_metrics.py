"""The metrics against a slow literal implementation, and properties that need none."""

import math

import numpy as np
import pytest

from racf.evaluate.metrics import Convention, filled, interval_of_mean, mean_score, overlaps, score

FRAMES = 40


def truth() -> np.ndarray:
    """A target of 30x20 that walks across the image, far from its border."""
    step = np.arange(FRAMES, dtype=float)
    return np.stack([100 + 3 * step, 80 + 2 * step, np.full(FRAMES, 30.0), np.full(FRAMES, 20.0)], axis=1)


def wild(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Boxes and annotations with everything that occurs: absent targets, borders, lost boxes."""
    rng = np.random.default_rng(seed)
    annotation = truth() + rng.uniform(-5, 5, (FRAMES, 4))
    boxes = annotation + rng.normal(0, 8, (FRAMES, 4))
    annotation[rng.choice(np.arange(1, FRAMES), 4, replace=False)] = np.nan
    annotation[rng.choice(np.arange(1, FRAMES), 4, replace=False), 0] = -2.0
    annotation[5, 2] = 0.0
    boxes[rng.choice(FRAMES, 3, replace=False)] = np.nan
    boxes[7, 3] = 0.0
    return boxes, annotation


def referee(boxes, annotation, strict):
    """The toolkits' rules, a frame at a time and in their own pixel convention; precision at 20 px and AUC."""
    previous, errors, shares = annotation[0], [], []
    for number, (box, wanted) in enumerate(zip(boxes, annotation, strict=True)):
        tracked = wanted if number == 0 else box
        if any(math.isnan(v) for v in tracked) or tracked[2] <= 0 or tracked[3] <= 0:
            tracked = previous
        previous = tracked
        absent = any(math.isnan(v) for v in wanted) or wanted[2] <= 0 or wanted[3] <= 0
        if strict and absent:
            continue
        if absent or (not strict and (wanted[0] <= 0 or wanted[1] <= 0)):
            errors.append(-1.0)
            shares.append(-1.0)
            continue
        centres = [(b[0] + (b[2] - 1) / 2, b[1] + (b[3] - 1) / 2) for b in (tracked, wanted)]
        errors.append(math.dist(*centres))
        right, low = (min(b[i] + b[i + 2] - 1 for b in (tracked, wanted)) for i in (0, 1))
        across = max(0.0, right - max(tracked[0], wanted[0]) + 1)
        down = max(0.0, low - max(tracked[1], wanted[1]) + 1)
        share = across * down / (tracked[2] * tracked[3] + wanted[2] * wanted[3] - across * down)
        shares.append(min(share, 1.0))  # the toolkits leave it to rounding whether equal boxes overlap by more than 1
    precision = 100 * sum(e <= 20 for e in errors) / len(errors)
    success = [100 * sum(s > k * 0.05 for s in shares) / len(shares) for k in range(21)]
    return precision, sum(success) / 21


@pytest.mark.parametrize("seed", range(20))
@pytest.mark.parametrize("convention", list(Convention))
def test_scores_equal_a_literal_implementation_of_the_rules(seed, convention):
    boxes, annotation = wild(seed)
    judged = score(boxes, annotation, convention)
    precision, auc = referee(boxes, annotation, strict=convention is Convention.STRICT)
    assert judged.precision_20px == pytest.approx(precision, abs=1e-9)
    assert judged.auc == pytest.approx(auc, abs=1e-9)


@pytest.mark.parametrize("convention", list(Convention))
def test_perfect_boxes_have_full_precision_and_miss_only_the_threshold_that_none_can_exceed(convention):
    judged = score(truth(), truth(), convention)
    assert judged.precision_20px == 100.0
    assert judged.auc == pytest.approx(100.0 * 20 / 21)  # an overlap of 1 is not greater than 1


@pytest.mark.parametrize("pixels", [0, 5, 10, 19, 20, 21, 40])
def test_boxes_off_by_a_known_shift_have_the_precision_and_overlap_that_follow_from_it(pixels):
    judged = score(truth() + np.array([pixels, 0, 0, 0]), truth())
    assert judged.precision_20px == pytest.approx(100.0 if pixels <= 20 else 100.0 / FRAMES)
    overlap = max(30 - pixels, 0) / (30 + min(pixels, 30))
    at_half = 100.0 if overlap > 0.5 else 100.0 / FRAMES  # the first frame is given
    assert judged.success[10] == pytest.approx(at_half)


def test_the_order_of_the_frames_after_the_first_does_not_matter_while_all_boxes_are_usable():
    boxes = truth() + np.random.default_rng(1).normal(0, 8, (FRAMES, 4)) * [1, 1, 0, 0]
    order = np.concatenate([[0], 1 + np.random.default_rng(2).permutation(FRAMES - 1)])
    assert score(boxes[order], truth()[order]).auc == pytest.approx(score(boxes, truth()).auc)


def test_absent_targets_are_hits_and_misses_for_the_toolkits_and_not_counted_by_the_strict_rules():
    annotation = truth()
    annotation[10:20] = np.nan
    boxes = truth() + 100.0
    toolkit, strict = (score(boxes, annotation, c) for c in Convention)
    assert toolkit.precision_20px == pytest.approx(100.0 * 11 / 40)
    assert strict.precision_20px == pytest.approx(100.0 * 1 / 30)


def test_a_lost_box_repeats_the_last_one():
    boxes = truth()
    boxes[3] = np.nan
    boxes[4, 2] = 0
    assert np.array_equal(filled(boxes)[3:5], np.stack([boxes[2], boxes[2]]))


def test_the_mean_counts_sequences_alike_however_long():
    good, bad = score(truth()[:5], truth()[:5]), score(truth() + 500, truth())
    assert mean_score([good, bad]).precision_20px == pytest.approx((100 + 100 / FRAMES) / 2)


def test_the_interval_holds_the_mean_and_shrinks_with_more_sequences():
    values = list(np.random.default_rng(0).uniform(0, 100, 100))
    few, many = interval_of_mean(values[:10]), interval_of_mean(values)
    assert few[0] < np.mean(values[:10]) < few[1]
    assert many[1] - many[0] < few[1] - few[0]
    assert interval_of_mean(values) == many
    # Theory for many sequences: 1.96 standard errors to each side.
    assert many[1] - many[0] == pytest.approx(2 * 1.96 * np.std(values) / 10, rel=0.1)


def test_a_box_for_each_annotation_or_none_is_judged():
    with pytest.raises(ValueError, match=r"\(39, 4\) boxes, \(40, 4\)"):
        score(truth()[1:], truth())
    with pytest.raises(ValueError, match="no frame with a target"):
        score(truth(), np.full((FRAMES, 4), np.nan), Convention.STRICT)


def test_no_overlap_is_greater_than_1_however_the_sums_are_rounded():
    boxes = np.random.default_rng(0).uniform(1, 300, (2000, 4)).round(3)
    assert overlaps(boxes, boxes).max() == 1.0
    assert score(boxes, boxes).success[-1] == 0.0
