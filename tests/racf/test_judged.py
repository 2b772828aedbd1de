"""A tracker that always reports 0.9 is trusted only where our filter sees the target as well."""

import dataclasses

import cv2
import numpy as np
import pytest

from racf.box import Box
from racf.evaluate.trackers import TrackerSpec
from racf.judged import JudgedBoxes
from racf.track import Track
from tests.racf.test_robust import GROUND, SIDE, TARGET, box, image


class AlwaysSure:
    """Answers the boxes it is given, one after the other, with a confidence of 0.9; counts its starts."""

    def __init__(self, boxes: list[Box]) -> None:
        self.boxes, self.starts = list(boxes), list[Box]()

    def init(self, image: np.ndarray, box: Box) -> Track:
        self.starts.append(box)
        return self.track(box)

    def update(self, image: np.ndarray) -> Track:
        return self.track(self.boxes.pop(0))

    def track(self, box: Box) -> Track:
        return Track(box, box, psr=np.nan, apce=np.nan, confidence=0.9)


def walk(frames: int) -> list[Box]:
    return [box(40 + 3 * k, 100) for k in range(1, frames + 1)]


def test_boxes_on_the_target_are_passed_on_unchanged():
    judged = JudgedBoxes(AlwaysSure(walk(30)))
    judged.init(image(40, 100), box(40, 100))
    tracks = [judged.update(image(40 + 3 * k, 100)) for k in range(1, 31)]
    assert all(track.found for track in tracks)
    assert [track.box for track in tracks] == walk(30)
    assert min(track.confidence for track in tracks) > 0.6


@pytest.mark.parametrize("where", [Box(300, 150, 36, 36), Box(-20, -20, 36, 36), Box(395, 236, 900, 0.5)])
def test_a_box_that_jumps_to_the_ground_is_not_found_even_at_full_confidence(where):
    judged = JudgedBoxes(AlwaysSure([*walk(10), *[where] * 5]))
    judged.init(image(40, 100), box(40, 100))
    for k in range(1, 11):
        judged.update(image(40 + 3 * k, 100))
    gone = [judged.update(GROUND) for _ in range(5)]
    assert not any(track.found for track in gone)
    assert max(track.confidence for track in gone) < 0.5


def test_a_box_that_stays_behind_while_the_target_walks_on_is_taken_back_to_it():
    frozen = AlwaysSure([*walk(10), *[box(70, 100)] * 60])
    judged = JudgedBoxes(frozen)
    judged.init(image(40, 100), box(40, 100))
    tracks = [judged.update(image(40 + 3 * k, 100)) for k in range(1, 40)]
    for k, track in enumerate(tracks, start=1):
        assert not track.found or track.box.iou(box(40 + 3 * k, 100)) > 0.2
    assert len(frozen.starts) > 1
    assert frozen.starts[1].x > 70  # where the target is, not where the tracker looked


@pytest.mark.parametrize("speed", [0.5, 1, 2, 4])
def test_a_box_that_slides_onto_the_neighbour_does_not_take_ours_along(speed):
    """Both look alike and stand side by side: learning at the box would slowly learn the neighbour."""
    crowd, last = image(100, 100), 40
    crowd[100 : 100 + SIDE, 100 + last : 100 + last + SIDE] = np.roll(TARGET, (3, 5), (0, 1))
    sliding = AlwaysSure([Box(100 + min(speed * k, last), 100, SIDE, SIDE) for k in range(1, 161)])
    judged = JudgedBoxes(sliding)
    judged.init(crowd, box(100, 100))
    tracks = [judged.update(crowd) for _ in range(160)]
    assert tracks[0].found
    assert all(not track.found or track.box.iou(box(100, 100)) > 0.2 for track in tracks)
    assert len(sliding.starts) > 1
    assert all(start.iou(box(100, 100)) > 0.8 for start in sliding.starts)


def test_the_size_is_that_of_the_other_tracker():
    sizes = [Box.around(118, 118, 36 + 0.5 * k, 36 - 0.2 * k) for k in range(1, 21)]
    judged = JudgedBoxes(AlwaysSure(sizes))
    judged.init(image(100, 100), box(100, 100))
    tracks = [judged.update(image(100, 100)) for _ in range(20)]
    assert [track.box for track in tracks] == sizes
    assert tracks[-1].search.w == pytest.approx(5 * (46 * 32) ** 0.5, rel=0.03)


@pytest.mark.parametrize(
    "wrong",
    [Box.around(118, 118, 20, 20), Box.around(118, 118, 64, 64), box(100, 100).scaled(0.6), Box(100, 100, 20, 20)],
)
def test_a_size_that_is_wrong_for_a_frame_does_not_lose_the_target(wrong):
    boxes = [*[box(100, 100)] * 19, wrong, *[box(100, 100)] * 30]
    judged = JudgedBoxes(AlwaysSure(boxes))
    judged.init(image(100, 100), box(100, 100))
    tracks = [judged.update(image(100, 100)) for _ in boxes]
    assert all(track.found and track.box.iou(box(100, 100)) > 0.9 for track in tracks[25:])


def test_follow_judges_opencvs_trackers_and_not_ours():
    assert isinstance(TrackerSpec.parse("mil").flown().build(), JudgedBoxes)
    assert not isinstance(TrackerSpec.parse("mil").build(), JudgedBoxes)
    assert isinstance(TrackerSpec.parse("mil,judged=false").flown().build(), JudgedBoxes)
    assert TrackerSpec.parse("racf,robust").flown() == TrackerSpec.parse("racf,robust")
    prints = [
        TrackerSpec.parse(name).fingerprint() for name in ("mil", "mil,judged", "mil,refine", "mil,judged,refine")
    ]
    assert len(set(prints)) == 4
    with pytest.raises(ValueError, match="judged is true or false, not 'maybe'"):
        TrackerSpec.parse("mil,judged=maybe").check()


class Failing(AlwaysSure):
    """Raises what it has instead of a box, in `update` and, from the second start on, in `init`."""

    def init(self, image: np.ndarray, box: Box) -> Track:
        super().init(image, box)
        if len(self.starts) > 1:
            raise RuntimeError("no second start")
        return self.track(box)

    def update(self, image: np.ndarray) -> Track:
        answer = self.boxes.pop(0)
        if isinstance(answer, Exception):
            raise answer
        return self.track(answer)


@pytest.mark.parametrize(
    "failure", [ValueError("nan"), cv2.error("assertion"), RuntimeError("out of memory"), None, (1, 2, 3, 4)]
)
def test_a_tracker_that_fails_has_found_nothing_and_our_filter_still_holds_the_target(failure, caplog):
    judged = JudgedBoxes(Failing([*walk(10), *[failure] * 40]))
    judged.init(image(40, 100), box(40, 100))
    tracks = [judged.update(image(40 + 3 * k, 100)) for k in range(1, 31)]
    assert tracks[-1].found
    assert tracks[-1].box.iou(box(130, 100)) > 0.5
    assert not any(judged.update(GROUND).found for _ in range(10))
    assert len(caplog.records) == 1
    assert "Failing failed and counts as having found nothing" in caplog.text


GREY = image(40, 100)[..., 0].copy()


@pytest.mark.parametrize(
    ("first", "then", "told"),
    [
        (None, GROUND, "must be given a target with init before update"),
        (GREY, GROUND, r"images must keep the first one's shape \(240, 400\), not \(240, 400, 3\)"),
        (GROUND, GROUND[:100], "images must keep the first one's shape"),
        (GROUND, GROUND.astype(float), "an image has the type uint8, not float64"),
        (GROUND, None, "an image is a numpy array, not NoneType"),
    ],
)
def test_an_invalid_image_is_refused_as_by_our_own_tracker(first, then, told):
    judged = JudgedBoxes(AlwaysSure(walk(3)))
    if first is not None:
        judged.init(first, box(40, 100))
    with pytest.raises(ValueError, match=told):
        judged.update(then)


@pytest.mark.parametrize("start", [(40, 100, 36, 36), Box(1000, 1000, 36, 36), Box(40, 100, 1, 36)])
def test_a_box_that_cannot_start_a_tracker_starts_neither(start):
    tracker = AlwaysSure([])
    with pytest.raises(ValueError, match="target"):
        JudgedBoxes(tracker).init(GROUND, start)
    assert not tracker.starts


class Refusing(AlwaysSure):
    """Refuses to start, as OpenCV's MIL does on four pixels; an update of that one then ends the process."""

    def init(self, image: np.ndarray, box: Box) -> Track:
        raise ValueError(f"cannot start on {box}")


def test_a_tracker_that_refuses_to_start_leaves_no_target_behind():
    tracker = Refusing(walk(3))
    judged = JudgedBoxes(tracker)
    with pytest.raises(ValueError, match="cannot start on 40,100,36,36"):
        judged.init(image(40, 100), box(40, 100))
    with pytest.raises(ValueError, match="must be given a target with init before update"):
        judged.update(image(43, 100))
    assert tracker.boxes == walk(3)  # it was not asked


class Honest(AlwaysSure):
    """Says that it has found nothing, and answers its last box, as OpenCV's KCF does."""

    def update(self, image: np.ndarray) -> Track:
        return dataclasses.replace(self.track(self.starts[-1]), found=False)


def test_while_the_tracker_reports_not_found_our_filter_tracks_alone(caplog):
    judged = JudgedBoxes(Honest([]))
    judged.init(image(40, 100), box(40, 100))
    tracks = [judged.update(image(40 + 3 * k, 100)) for k in range(1, 31)]
    assert all(track.found and track.box.iou(box(40 + 3 * k, 100)) > 0.5 for k, track in enumerate(tracks, start=1))
    assert not caplog.records


def test_the_stages_include_the_time_of_the_other_tracker():
    judged = JudgedBoxes(AlwaysSure(walk(1)))
    judged.init(image(40, 100), box(40, 100))
    stages = judged.update(image(43, 100)).stage_ms
    assert stages["other tracker"] >= 0
    assert stages["localise"] > 0
