"""Trackers by name: settings, fingerprints, and OpenCV's own with the refinement behind them."""

import os
from pathlib import Path

import cv2
import numpy as np
import pytest

import tests.support.rendered_benchmarks as rendered
from racf.box import Box
from racf.evaluate.peers import NETWORKS
from racf.evaluate.trackers import OPENCV, TrackerSpec, builders_of, opencv_has


def walk(name: str, frames: int = 12) -> list[Box]:
    cv2.setRNGSeed(0)  # as the runner does
    truth = rendered.path_of_target(frames) - [1, 1, 0, 0]
    tracker = TrackerSpec.parse(name).build()
    tracker.init(rendered.picture(*truth[0]), Box(*truth[0]))
    return [tracker.update(rendered.picture(*box)).box for box in truth[1:]]


@pytest.mark.parametrize("name", sorted(set(OPENCV) - set(NETWORKS)))
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


MODELS = Path(os.environ.get("RACF_DATA", Path(__file__).parents[3] / "shared" / "data")) / "models"
NANO = [MODELS / f"nanotrack_v2_{part}.onnx" for part in ("backbone", "head")]


@pytest.mark.skipif(not NANO[0].is_file(), reason=f"NanoTrack's networks are missing: {MODELS}")
def test_nano_follows_the_target_with_its_networks_and_says_how_sure_it_is(capfd):
    spec = TrackerSpec.parse(f"nano,backbone={NANO[0]},neckhead={NANO[1]}")
    assert spec.label == "nano"
    truth = rendered.path_of_target(5) - [1, 1, 0, 0]
    tracker = spec.build()
    tracker.init(rendered.picture(*truth[0]), Box(*truth[0]))
    track = [tracker.update(rendered.picture(*box)) for box in truth[1:]][-1]
    assert track.box.iou(Box(*truth[-1])) > 0.3
    assert 0 < track.confidence <= 1
    assert spec.fingerprint() == TrackerSpec.parse(f"nano,neckhead={NANO[1]},backbone={NANO[0]}").fingerprint()


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("nano", "nano needs its network: nano,backbone=FILE,neckhead=FILE"),
        ("vit,net=nowhere.onnx", "vit: net must be a file, and nowhere.onnx is not one"),
        ("vit,file=x", r"only the settings net=FILE, refine \(true or false\), not file=x"),
    ],
)
def test_a_network_that_is_not_there_is_named(text, sentence):
    with pytest.raises(ValueError, match=sentence):
        TrackerSpec.parse(text).check()


def test_mil_finds_the_same_boxes_again_in_the_same_process():
    assert walk("mil") == walk("mil")


@pytest.mark.parametrize(
    ("start", "told"),
    [
        (Box(30, 30, 3, 3), "OpenCV's mil needs a target of at least 5 pixels on each side, not 30,30,3,3"),
        (Box(-1e12, 0, 2e12, 10), "OpenCV's mil cannot start on -1e"),
        (Box(-30, -30, 40, 40), "OpenCV's mil cannot start on -30,-30,40,40: .*posSamples"),
    ],
)
def test_a_start_that_opencv_refuses_or_never_ends_is_a_value_error(start, told):
    with pytest.raises(ValueError, match=told):
        TrackerSpec.parse("mil").build().init(rendered.picture(*rendered.path_of_target(2)[0]), start)


def test_an_image_that_opencv_would_crash_on_is_a_value_error():
    tracker, first = TrackerSpec.parse("mil").build(), rendered.picture(20, 20, 20, 20)
    with pytest.raises(ValueError, match="init before update"):
        tracker.update(first)
    tracker.init(first, Box(20, 20, 20, 20))
    with pytest.raises(ValueError, match="must keep the first one's shape"):
        tracker.update(first[:-8])


def test_a_tracker_that_opencv_lacks_is_named_when_it_is_built():
    lacking = [name for name in ("csrt", "kcf") if not opencv_has(name)]
    if not lacking:
        pytest.skip("this OpenCV has every tracker")
    with pytest.raises(ValueError, match=f"has no {lacking[0]} tracker: in a clone `make bench-env`"):
        TrackerSpec.parse(lacking[0]).build()


def test_a_tracker_that_opencv_lacks_is_named_before_anything_runs(monkeypatch):
    monkeypatch.delattr(cv2, "TrackerMIL_create")
    with pytest.raises(ValueError, match="has no mil tracker"):
        builders_of(["racf", "mil"])


def test_a_fingerprint_tells_apart_whatever_could_change_the_boxes():
    names = ["racf", "racf-", "racf--", "bacf", "arcf-hc", "racf,robust", "racf,residue=0.5", "mil", "mil,refine"]
    prints = [TrackerSpec.parse(name).fingerprint() for name in names]
    assert len(set(prints)) == len(names)
    assert prints == [TrackerSpec.parse(name).fingerprint() for name in names]
    # The same parameters by another way are the same tracker.
    assert TrackerSpec.parse("racf-,refine").fingerprint() == prints[0]


@pytest.mark.parametrize("text", ["racf,speed=3", "racf,residue=high", "mil,residue=1", "siamese"])
def test_an_unknown_tracker_or_setting_is_named(text):
    with pytest.raises(ValueError, match=text.partition(",")[2].partition("=")[0] or text):
        TrackerSpec.parse(text).check()
