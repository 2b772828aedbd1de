"""Confidence, occlusion, re-detection and priors, on which the application relies, on rendered images."""

import dataclasses
from copy import copy, deepcopy

import cv2
import numpy as np
import pytest

from racf import Box, Racf, preset
from racf.confidence import Confidence, Verdict, ramp
from racf.refine import Refinement

ROWS, COLS, SIDE = 240, 400, 36
GROUND = cv2.GaussianBlur(np.random.default_rng(7).integers(0, 256, (ROWS, COLS, 3), dtype=np.uint8), (0, 0), 4)
GROUND = cv2.normalize(GROUND, None, 60, 190, cv2.NORM_MINMAX)
TARGET = cv2.resize(np.random.default_rng(8).integers(0, 256, (5, 5, 3), dtype=np.uint8), (SIDE, SIDE), interpolation=0)
WALL = cv2.GaussianBlur(np.random.default_rng(9).integers(0, 256, (ROWS, 90, 3), dtype=np.uint8), (0, 0), 1)
ROBUST = preset("racf,robust")


def image(x: int, y: int, wall_at: int | None = None) -> np.ndarray:
    """The target with its top-left corner at (x, y), in front of the ground, behind a wall 90 pixels wide."""
    image = GROUND.copy()
    image[y : y + SIDE, x : x + SIDE] = TARGET
    if wall_at is not None:
        image[:, wall_at : wall_at + 90] = WALL
    return image


def box(x: int, y: int) -> Box:
    return Box(x, y, SIDE, SIDE)


def settled(params=ROBUST) -> Racf:
    tracker = Racf(params)
    tracker.init(image(40, 100), box(40, 100))
    for k in range(1, 9):
        tracker.update(image(40 + 3 * k, 100))
    return tracker


def test_a_target_in_plain_view_is_found_with_confidence():
    tracker = settled()
    track = tracker.update(image(67, 100))
    assert track.found
    assert track.confidence > 0.8


def test_an_occluded_target_is_not_found_and_is_found_again_behind_the_wall():
    tracker, tracks = settled(), []
    for k in range(9, 75):
        tracks.append((k, tracker.update(image(40 + 3 * k, 100, wall_at=120))))
    hidden = [track for k, track in tracks if 40 + 3 * k >= 120 and 40 + 3 * k + SIDE <= 210]
    assert hidden
    assert not any(track.found for track in hidden)
    assert max(track.confidence for track in hidden) < 0.7
    k, last = tracks[-1]
    assert last.found
    assert last.box.iou(box(40 + 3 * k, 100)) > 0.7


class Segments:
    """A segmentation that always sees a little more or less than the target, as GrabCut does where a shadow lies."""

    def __init__(self, wider: float) -> None:
        self.wider = wider

    def refine(self, _: np.ndarray, box: Box) -> Refinement:
        nothing = np.zeros((2, 2), np.uint8)
        return Refinement(Box.around(box.centre_x, box.centre_y, self.wider * box.w, box.h), None, nothing, box)


def widened(tracker: Racf, first: float, wider: float) -> float:
    """The aspect after twelve images over the first box's, `first`."""
    tracker.init(image(40, 100), Box.around(58, 118, first * SIDE, SIDE))
    tracker._refiner = Segments(wider)
    for _ in range(12):
        track = tracker.update(image(40, 100))
    return track.box.w / track.box.h / first


@pytest.mark.parametrize("first", [1.0, 0.6])
def test_a_robust_trackers_box_does_not_become_wider_and_wider_or_narrower(first):
    tracker = Racf(dataclasses.replace(ROBUST, strict_aspect=1.25, predict_scale=False))
    assert widened(tracker, first, 1.1) == pytest.approx(1.25)
    assert widened(tracker, 0.8 * first, 1.1) == pytest.approx(1.25)  # of a new target, its own first box counts
    assert widened(tracker, first, 0.9) == pytest.approx(1 / 1.25)
    assert widened(Racf(dataclasses.replace(ROBUST, strict_aspect=1.0, predict_scale=False)), first, 1.1) == 1.0
    assert widened(Racf(dataclasses.replace(ROBUST, strict_refine=False, predict_scale=False)), first, 1.1) > 1.6


def test_a_first_response_sharper_than_all_that_follow_does_not_make_the_rest_look_lost():
    confidence = Confidence(ROBUST)
    verdicts = [confidence.judge(psr, value) for psr, value in [(15.5, 1.0), *[(8.4, 0.5)] * 60]]
    assert set(verdicts) == {Verdict.CLEAR}
    assert confidence.judge(3.0, 0.2) is Verdict.LOST


SKY = np.linspace(120, 220, 300)[:, None, None] + np.zeros((300, 400, 3))
ROW, COLUMN = (np.arange(n, dtype=float).reshape(shape) for n, shape in ((300, (-1, 1, 1)), (400, (1, -1, 1))))
FEATURELESS = {
    "black": 0 * SKY,
    "white": 0 * SKY + 255,
    "sky": SKY,
    "lit from one side": 100 + 0.1 * COLUMN + 0 * SKY,
    "a vignette": 200 - 0.2 * np.hypot(ROW - 150, COLUMN - 200) + 0 * SKY,
    "upright stripes": 128 + 60 * np.sign(np.sin(COLUMN * 2 * np.pi / 16)) + 0 * SKY,
    "level stripes": 128 + 60 * np.sign(np.sin(ROW * 2 * np.pi / 16)) + 0 * SKY,
    "a horizon": 128 + 50 * np.sign(ROW - 135) + 0 * SKY,
    "a kerb": 128 + 50 * np.sign(COLUMN - 190) + 0 * SKY,
}


def without_features(kind: str, random: np.random.Generator) -> np.ndarray:
    """A frame of noise, or of something that looks the same at another place, under a camera's noise."""
    if kind == "noise":
        return random.integers(0, 256, SKY.shape, dtype=np.uint8)
    if kind == "a hot pixel":
        image = (0 * SKY + 90).astype(np.uint8)
        image[140, 200] = 255
        return image
    image = np.clip(FEATURELESS[kind.removesuffix(" as JPEG")] + random.normal(0, 2, SKY.shape), 0, 255)
    image = image.astype(np.uint8)
    return cv2.imdecode(cv2.imencode(".jpg", image, [1, 30])[1], 1) if kind.endswith("JPEG") else image


@pytest.mark.parametrize("preset", ["racf", "racf,robust"])
@pytest.mark.parametrize("side", [12, 40, 100])
@pytest.mark.parametrize("kind", ["noise", "a hot pixel", "sky as JPEG", *FEATURELESS])
def test_a_first_box_without_features_is_not_called_found_within_five_frames(kind, side, preset):
    random = np.random.default_rng(3)
    tracker = Racf(preset)
    first = tracker.init(without_features(kind, random), Box(180, 120, side, side))
    assert not first.found
    assert first.confidence < ROBUST.regain_above
    tracks = [tracker.update(without_features(kind, random)) for _ in range(12)]
    assert not any(track.found for track in tracks[4:])
    assert max(track.confidence for track in tracks[4:]) < ROBUST.regain_above


@pytest.mark.parametrize("grey", [True, False])
@pytest.mark.parametrize("side", [12, 24, 60])
@pytest.mark.parametrize("darker", [12, 60])
def test_something_darker_than_the_sky_is_called_found(darker, side, grey):
    random = np.random.default_rng(3)
    tracker = Racf("racf,robust")
    for k in range(13):
        image = SKY + random.normal(0, 1, SKY.shape)
        image[120 : 120 + side, 180 + k : 180 + k + side] -= darker
        image = np.clip(image, 0, 255).astype(np.uint8)
        image = np.ascontiguousarray(image[:, :, 0]) if grey else image
        track = tracker.update(image) if k else tracker.init(image, Box(180, 120, side, side))
        assert track.found
    assert track.box.iou(Box(192, 120, side, side)) > 0.5


@pytest.mark.parametrize("belief", [0.0, 0.25, 1.0])
def test_a_doubtful_response_moves_the_box_from_the_prediction_in_proportion_to_confidence(belief, monkeypatch):
    tracker, expected = settled(), box(60, 100)
    match = tracker._filter.locate(GROUND, expected)
    ratio = ROBUST.lost_below + belief * (ROBUST.learn_above - ROBUST.lost_below)
    monkeypatch.setattr(tracker._confidence, "ratio", lambda psr, value: ratio)
    weighed = tracker._weighed(expected, match, Verdict.DOUBTFUL)
    assert weighed.centre_x - expected.centre_x == pytest.approx(belief * (match.box.centre_x - expected.centre_x))
    assert weighed.centre_y - expected.centre_y == pytest.approx(belief * (match.box.centre_y - expected.centre_y))
    assert tracker._weighed(expected, match, Verdict.CLEAR) == match.box


@pytest.mark.parametrize(("low", "high"), [(0.6, 1.0), (0.5, 0.6), (1.0, 1.0), (0.7, 0.6), (0.0, 0.0)])
def test_a_ramp_goes_from_none_to_all_whatever_its_ends(low, high):
    values = [ramp(confidence, low, high) for confidence in np.linspace(0, 1, 101).tolist()]
    assert values == sorted(values)
    assert set(values) <= {0.0, 1.0} or low < high
    assert ramp(high, low, high) == 1.0
    assert all(0 <= value <= 1 for value in values)


def test_a_gate_that_only_full_confidence_passes_still_tracks():
    assert settled(dataclasses.replace(ROBUST, learn_above=1.0)).update(image(67, 100)).found


def test_nothing_is_learned_while_the_target_is_hidden():
    tracker = settled()
    learned = deepcopy(tracker._filter._solver.learned)
    for _ in range(5):
        tracker.update(image(67, 100, wall_at=40))
    np.testing.assert_equal(tracker._filter._solver.learned.filter, learned.filter)


@pytest.mark.parametrize("belief", [0.5, 0.75])
def test_the_learning_step_is_proportional_to_confidence(belief, monkeypatch):
    def learned(believed: float) -> np.ndarray:
        tracker = settled()
        before = tracker._filter._model_f.copy()
        ratio = ROBUST.learn_share_from + believed * (1 - ROBUST.learn_share_from)
        monkeypatch.setattr(tracker._confidence, "ratio", lambda psr, value: ratio)
        assert tracker.update(image(67, 100)).found
        return tracker._filter._model_f - before

    whole = learned(1.0)
    assert np.abs(whole).max() > 0
    np.testing.assert_allclose(learned(belief), belief * whole, atol=1e-4 * np.abs(whole).max())


@pytest.mark.parametrize("seed", range(4))
def test_a_target_that_turns_in_plain_view_is_kept(seed):
    """A textured disc turns by 1.5 degrees a frame (45 degrees/s at 30 frames/s) and drifts over the ground."""
    random = np.random.default_rng(seed)
    texture = cv2.resize(random.integers(0, 256, (6, 6, 3), dtype=np.uint8), (SIDE, SIDE), interpolation=2)
    disc = cv2.circle(np.zeros((SIDE, SIDE, 1), np.uint8), (SIDE // 2, SIDE // 2), SIDE // 2 - 1, 1, -1)
    tracker = Racf(ROBUST)
    for k in range(160):
        x, y = 150 + k // 4, 100 + k // 8
        turn = cv2.getRotationMatrix2D((SIDE / 2, SIDE / 2), 1.5 * max(k - 20, 0), 1)
        scene = GROUND.astype(np.int16)
        turned = cv2.warpAffine(texture, turn, (SIDE, SIDE), borderMode=cv2.BORDER_REFLECT)
        np.copyto(scene[y : y + SIDE, x : x + SIDE], turned, where=disc > 0)
        scene = np.clip(scene + random.normal(0, 2, scene.shape), 0, 255).astype(np.uint8)
        track = tracker.update(scene) if k else tracker.init(scene, box(x, y))
        assert track.found
        assert track.box.iou(box(x, y)) > 0.5


@pytest.mark.parametrize("seed", range(4))
def test_an_occluder_that_slowly_hides_a_target_is_not_taken_for_it(seed):
    """A wall passes over a standing target, 1.7 % of its side in each frame."""
    wall = np.random.default_rng(seed).integers(0, 256, WALL.shape, dtype=np.uint8)
    wall = cv2.GaussianBlur(wall, (0, 0), 1 + seed)
    tracker, there = Racf(ROBUST), box(200, 100)
    tracker.init(image(200, 100), there)
    for _ in range(25):
        tracker.update(image(200, 100))
    for left in np.arange(105, 300, 0.6).round().astype(int):
        scene = image(200, 100)
        scene[:, left : left + 90] = wall
        track = tracker.update(scene)
        assert not track.found or track.box.iou(there) > 0
    assert track.found
    assert track.box.iou(there) > 0.7


def test_a_target_that_reappears_elsewhere_is_found_again():
    tracker = settled()
    for _ in range(10):
        track = tracker.update(GROUND)
        assert not track.found
    for _ in range(14 + ROBUST.redetect_agree):
        track = tracker.update(image(200, 60))
    assert track.found
    assert track.box.iou(box(200, 60)) > 0.7


def test_a_target_that_reappears_where_it_is_expected_is_found_at_once():
    tracker = settled()
    for _ in range(10):
        last = tracker.update(GROUND)
    x, y = round(last.box.x), round(last.box.y)
    assert tracker.update(image(x + SIDE // 2, y + SIDE // 4)).found


def test_a_look_alike_that_appears_first_is_not_taken_if_the_target_appears_during_the_comparison():
    noise = np.random.default_rng(4).integers(0, 256, TARGET.shape, dtype=np.uint8)
    other = cv2.addWeighted(TARGET, 0.75, cv2.resize(noise[::7, ::7], (SIDE, SIDE), interpolation=0), 0.25, 0)
    alone, both = GROUND.copy(), image(150, 160)
    for scene in (alone, both):
        scene[30 : 30 + SIDE, 150 : 150 + SIDE] = other
    trackers = [settled(), settled()]
    for tracker in trackers:
        for _ in range(10):
            assert not tracker.update(GROUND).found
        while not tracker._redetection._rivals:
            tracker.update(alone)
    for _ in range(ROBUST.redetect_agree - 1):
        left, right = (tracker.update(scene) for tracker, scene in zip(trackers, (alone, both), strict=True))
    assert left.found
    assert left.box.iou(box(150, 30)) > 0.7  # nothing better came
    assert right.found
    assert right.box.iou(box(150, 160)) > 0.7


def test_a_target_just_lost_is_not_at_once_accepted_far_away():
    tracker = settled()
    far = [tracker.update(image(200, 60)).found for _ in range(40)]
    assert not any(far[: ROBUST.redetect_patience - 1])
    assert far[-1]


def test_an_empty_scene_is_never_taken_for_the_target():
    tracker = settled()
    assert not any(tracker.update(GROUND).found for _ in range(40))


def test_without_re_detection_a_target_elsewhere_stays_lost():
    tracker = settled(dataclasses.replace(ROBUST, redetect=False))
    for _ in range(3):
        tracker.update(GROUND)
    assert not any(tracker.update(image(330, 190)).found for _ in range(14))


@pytest.mark.parametrize("params", [preset("racf"), ROBUST])
@pytest.mark.parametrize("scene", [image(67, 100), image(300, 60), GROUND, 0 * GROUND])
@pytest.mark.parametrize(("prior", "copies"), [(None, deepcopy), (box(300, 60), deepcopy), (None, copy)])
def test_a_copy_of_a_tracker_returns_the_same_boxes(params, scene, prior, copies):
    tracker = settled(params)
    copied = copies(tracker)
    own, its = (one.update(scene, prior) for one in (tracker, copied))
    assert (its.box, its.psr, its.confidence, its.found) == (own.box, own.psr, own.confidence, own.found)
    np.testing.assert_array_equal(its.response, own.response)


@pytest.mark.parametrize("params", [preset("racf"), ROBUST])
def test_a_prior_moves_the_search(params):
    tracker = Racf(params)
    tracker.init(image(40, 100), box(40, 100))
    track = tracker.update(image(260, 100), prior=box(250, 100))
    assert track.search.centre_x == pytest.approx(250 + SIDE / 2)
    assert track.box.iou(box(260, 100)) > 0.7
