"""A target that vanishes right after the first frame is not found in the background."""

import cv2
import numpy as np
import pytest

from racf import Box, Racf
from racf.judged import JudgedBoxes
from racf.track import Track
from tests.racf.test_robust import GROUND, box, image


def texture(seed: int, sigma: float = 3.0) -> np.ndarray:
    """A scene of soft blobs of all colours."""
    noise = np.random.default_rng(seed).integers(0, 256, GROUND.shape, dtype=np.uint8)
    return cv2.normalize(cv2.GaussianBlur(noise, (0, 0), sigma), None, 0, 255, cv2.NORM_MINMAX)


@pytest.mark.parametrize("seed", range(3))
def test_a_target_that_is_gone_in_the_second_image_is_not_found_in_the_background(seed):
    scene = texture(seed, 4.0)
    first = scene.copy()
    first[100:136, 100:136] = image(100, 100)[100:136, 100:136]
    tracker = Racf("racf,robust")
    tracker.init(first, box(100, 100))
    tracks = [tracker.update(scene) for _ in range(60)]
    assert not any(track.found for track in tracks)
    assert max(track.confidence for track in tracks) < 0.7


def test_a_new_scene_in_each_image_is_no_target():
    tracker = Racf("racf,robust")
    tracker.init(image(100, 100), box(100, 100))
    assert not any(tracker.update(texture(seed)).found for seed in range(40))


def test_a_target_that_is_hidden_in_the_second_image_is_found_where_it_comes_back():
    tracker = Racf("racf,robust")
    tracker.init(image(100, 100), box(100, 100))
    assert not any(tracker.update(GROUND).found for _ in range(5))
    tracks = [tracker.update(image(100, 100)) for _ in range(5)]
    assert tracks[-1].found
    assert tracks[-1].box.iou(box(100, 100)) > 0.8


class Elsewhere:
    """A tracker that answers one box, sure of it, whatever it is started on."""

    def __init__(self, answer: Box) -> None:
        self.answer = answer

    def init(self, image: np.ndarray, box: Box) -> Track:
        return Track(box, box, psr=np.nan, apce=np.nan, confidence=0.9)

    def update(self, image: np.ndarray) -> Track:
        return Track(self.answer, self.answer, psr=np.nan, apce=np.nan, confidence=0.9)


@pytest.mark.parametrize("answer", [Box(300, 150, 36, 36), Box(1e300, 0, 1, 1), Box(-1e18, -1e18, 1e18, 1e18)])
def test_a_tracker_that_is_elsewhere_from_its_first_box_is_not_trusted(answer):
    judged = JudgedBoxes(Elsewhere(answer))
    judged.init(image(100, 100), box(100, 100))
    for _ in range(20):
        track = judged.update(image(100, 100))
        assert not track.found or track.box.iou(box(100, 100)) > 0.8
