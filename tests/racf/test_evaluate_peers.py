"""Trackers by name: settings, fingerprints, and OpenCV's own with the refinement behind them."""

import cv2
import numpy as np
import pytest

import tests.support.rendered_benchmarks as rendered
from racf.box import Box
from racf.evaluate.trackers import OPENCV, TrackerSpec, opencv_has


def walk(name: str, frames: int = 12) -> list[Box]:
    cv2.setRNGSeed(0)  # as the runner does
    truth = rendered.path_of_target(frames) - [1, 1, 0, 0]
    tracker = TrackerSpec.parse(name).build()
    tracker.init(rendered.picture(*truth[0]), Box(*truth[0]))
    return [tracker.update(rendered.picture(*box)).box for box in truth[1:]]


@pytest.mark.parametrize("name", OPENCV)
def test_opencvs_trackers_stay_on_the_target_and_refinement_does_not_make_them_worse(name):
    if not opencv_has(name):
        pytest.skip(f"this OpenCV has no {name}: it comes with opencv-contrib")
    truth = [Box(*wanted) for wanted in rendered.path_of_target(12)[1:] - [1, 1, 0, 0]]
    plain, refined = (
        np.array([box.iou(wanted) for box, wanted in zip(walk(text), truth, strict=True)])
        for text in (name, f"{name},refine")
    )
    assert plain.min() > 0
    assert refined.mean() > plain.mean() - 0.02


def test_mil_finds_the_same_boxes_again_in_the_same_process():
    assert walk("mil") == walk("mil")


def test_what_opencv_lacks_is_said_when_it_is_built():
    lacking = [name for name in OPENCV if not opencv_has(name)]
    if not lacking:
        pytest.skip("this OpenCV has every tracker")
    with pytest.raises(ValueError, match=f"has no {lacking[0]} tracker; `make bench`"):
        TrackerSpec.parse(lacking[0]).build()


def test_a_fingerprint_tells_apart_whatever_could_change_the_boxes():
    names = ["racf", "racf-", "racf--", "bacf", "arcf-hc", "racf,robust", "racf,residue=0.5", "mil", "mil,refine"]
    prints = [TrackerSpec.parse(name).fingerprint() for name in names]
    assert len(set(prints)) == len(names)
    assert prints == [TrackerSpec.parse(name).fingerprint() for name in names]
    # The same parameters by another way are the same tracker.
    assert TrackerSpec.parse("racf-,refine").fingerprint() == prints[0]


@pytest.mark.parametrize("text", ["racf,speed=3", "racf,residue=high", "mil,residue=1", "siamese"])
def test_a_tracker_or_setting_nobody_knows_is_named(text):
    with pytest.raises(ValueError, match=text.partition(",")[2].partition("=")[0] or text):
        TrackerSpec.parse(text).check()
