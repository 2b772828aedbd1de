"""The study's synthetic occlusions: the piece touches, hides and leaves at its frames; outcomes are told apart."""

import dataclasses
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

import tests.support.rendered_benchmarks as rendered
from racf.box import Box
from racf.evaluate.benchmarks import Sequence, read_benchmark
from racf.evaluate.images import read_frame
from racf.track import Track
from tools.studies import occlusions
from tools.studies.occlusions import AFTER, LEAD, drawn, hidden, truth_of, watch

FRAMES = 95


@pytest.fixture(scope="module")
def walk(tmp_path_factory) -> Sequence:
    data, steps = tmp_path_factory.mktemp("data"), np.arange(FRAMES)
    truth = np.stack([31 + steps // 2, 41 + steps // 4, np.full(FRAMES, 24), np.full(FRAMES, 20)], axis=1).astype(float)
    rendered.write_frames(data / "walk", "{:06d}.png", truth)
    rendered.write_truth(data / "walk" / "groundtruth_rect.txt", truth)
    (sequence,) = read_benchmark("folder", data)
    return sequence


def apart(one: Box, other: Box) -> bool:
    return one.intersection(other) <= 1e-6


def test_the_piece_touches_after_the_lead_hides_the_middle_and_has_left_at_the_end(walk):
    boxes = truth_of(walk)
    events = list(drawn(walk, 0))
    assert events
    for event in events:
        assert len(event.frames) == LEAD + event.crossing + AFTER
        target = boxes[event.first : event.first + len(event.frames)]
        # What the piece and the target do to one another depends on their distance; the target keeps its first size.
        w, h = target[0, 2:]
        for k in (0, LEAD, LEAD + event.crossing, len(event.frames) - 1):
            x, y = event.centre(k, np.array([0.0, 0.0, w, h]))
            assert apart(Box.around(x, y, *event.piece[2:]), Box(0, 0, w, h))
        middle = (
            event.centre(LEAD, np.array([0.0, 0.0, w, h])),
            event.centre(LEAD + event.crossing, np.array([0.0, 0.0, w, h])),
        )
        assert np.mean(middle, axis=0) == pytest.approx((w / 2, h / 2))
        x, y = event.centre(LEAD, np.array([0.0, 0.0, w, h]))
        nearer = Box.around(w / 2 + 0.97 * (x - w / 2), h / 2 + 0.97 * (y - h / 2), *event.piece[2:])
        assert not apart(nearer, Box(0, 0, w, h))


def test_pieces_are_the_sequences_own_background_and_the_same_each_time(walk):
    events = list(drawn(walk, 0))
    assert events == list(drawn(walk, 0))
    assert events != list(drawn(walk, 1))
    rows, cols = rendered.picture(0, 0, 9, 9).shape[:2]
    for event in events:
        x, y, w, h = event.piece
        assert x >= 0
        assert y >= 0
        assert x + w <= cols
        assert y + h <= rows
        assert apart(Box(*event.piece), Box(*truth_of(walk)[event.first].tolist()))


@pytest.mark.parametrize(("centre", "seen"), [((10, 10), 24), ((0, 10), 12), ((-9, 10), 0), ((39.6, 10), 12)])
def test_a_piece_is_drawn_as_far_as_it_is_inside(centre, seen):
    image, piece = np.zeros((30, 40, 3), np.uint8), np.full((4, 6, 3), 7, np.uint8)
    assert np.count_nonzero(hidden(image, piece, centre)[..., 0]) == seen
    assert set(np.unique(image)) <= {0, 7}


@dataclass(frozen=True, slots=True)
class Known:
    """A tracker that answers given boxes."""

    boxes: tuple[Box, ...]
    found: bool = True
    label: str = "known"

    def build(self) -> Any:
        return _Answers(self)

    def fingerprint(self) -> str:
        return self.label


class _Answers:
    def __init__(self, known: Known) -> None:
        self.known, self.frame = known, 0

    def init(self, image: np.ndarray, box: Box) -> Track:
        return Track(box, box, psr=0.0, apce=0.0, confidence=1.0)

    def update(self, image: np.ndarray) -> Track:
        self.frame += 1
        box = self.known.boxes[self.frame]
        return Track(box, box, psr=9.0, apce=0.0, confidence=1.0, found=self.known.found)


def test_a_tracker_that_stays_keeps_the_target_and_one_that_follows_the_piece_is_false(walk):
    truth = {walk.name: truth_of(walk)}
    event = next(iter(drawn(walk, 0)))
    target = truth[walk.name][event.first : event.first + len(event.frames)]
    stays = tuple(Box(*row) for row in target.tolist())
    goes = tuple(Box.around(*event.centre(k, row), *event.piece[2:]) for k, row in enumerate(target))
    goes = stays[: LEAD + event.crossing // 2] + goes[LEAD + event.crossing // 2 :]
    kept, false, lost = (watch(event, known, truth) for known in (Known(stays), Known(goes), Known(goes, found=False)))
    assert (kept.end, kept.false) == ("kept", 0)
    assert false.end == "false"
    assert false.false >= AFTER
    assert (lost.end, lost.false) == ("lost", 0)
    assert kept.frames == event.crossing + AFTER


def test_a_tracker_is_shown_the_piece_at_the_place_of_each_frames_target(walk, monkeypatch):
    truth, seen = {walk.name: truth_of(walk)}, list[np.ndarray]()
    event = next(iter(drawn(walk, 0)))
    target = truth[walk.name][event.first : event.first + len(event.frames)]

    def see(answers: _Answers, image: np.ndarray) -> Track:
        seen.append(image)
        return answers.init(image, Box(*target[0].tolist()))

    monkeypatch.setattr(_Answers, "update", see)
    watch(event, Known(()), truth)
    x, y, w, h = event.piece
    first = read_frame(event.frames[0])[y : y + h, x : x + w]
    for k, image in zip(range(1, len(event.frames)), seen[-len(event.frames) + 1 :], strict=True):
        shown = hidden(read_frame(event.frames[k]), first, event.centre(k, target[k]))
        np.testing.assert_array_equal(image, shown)
    middle = LEAD + event.crossing // 2
    assert (seen[-len(event.frames) + middle] != read_frame(event.frames[middle])).any()


def test_the_end_of_an_event_follows_from_found_and_overlap():
    ends = [occlusions._end(*case) for case in ((0.31, True), (0.3, True), (0.0, True), (0.9, False))]
    assert ends == ["kept", "between", "false", "lost"]


def test_a_difference_is_that_of_the_shares_and_its_interval_is_over_sequences(walk):
    events = list(drawn(walk, 0))
    of = [dataclasses.replace(event, sequence=f"{k % 4}") for k, event in enumerate(events * 4)]
    of = {dataclasses.replace(event, first=k): k % 4 for k, event in enumerate(of)}
    ours = {event: occlusions.Judged(10, 4 if group else 0, "kept") for event, group in of.items()}
    theirs = {event: occlusions.Judged(10, 1, "kept") for event in of}
    value, low, high = occlusions.differences(ours, theirs, "false frames")
    groups = np.bincount(list(of.values()), minlength=4)
    assert value == pytest.approx(40 * groups[1:].sum() / groups.sum() - 10)
    assert -10 <= low < value < high <= 30
    assert low < 10  # one of four is another: an interval of quarters reaches far


def test_differences_are_paired_by_event_and_shares_add_up(walk):
    events = list(drawn(walk, 0))
    judged = {event: occlusions.Judged(10, k % 3, occlusions.OUTCOMES[k % 4]) for k, event in enumerate(events)}
    assert sum(occlusions.ends(list(judged.values()), outcome) for outcome in occlusions.OUTCOMES) == pytest.approx(100)
    for name in occlusions.MEASURES:
        assert occlusions.differences(judged, judged, name) == (0.0, 0.0, 0.0)
