"""Selecting in flight: a late box is moved onto the target, and an impossible selection is refused with a reason."""

from concurrent.futures import Future
from functools import partial

import numpy as np
import pytest

from follow.camera.recent import RecentFrames
from follow.control.click import box_at
from follow.control.selector import CATCH_UP, Selector, meant
from follow.messages import Frame
from follow.selection import Cleared, Selection
from racf.box import Box
from racf.track import Track

SIZE = 640, 360
RATE_HZ = 30.0
SIDE = 24


def image_with(x, y, noise=None):
    """A textured meadow with a bright square whose corner is at (x, y)."""
    generator = np.random.default_rng(7)
    image = generator.integers(60, 90, (SIZE[1] // 4, SIZE[0] // 4, 3)).astype(np.uint8).repeat(4, 0).repeat(4, 1)
    image[round(y) : round(y) + SIDE, round(x) : round(x) + SIDE] = (40, 60, 230)
    return image


class Film:
    """The square moves 5 pixels a frame to the right."""

    size = SIZE

    def __init__(self, count):
        self.count = count

    def frames(self):
        for index in range(self.count):
            yield Frame(image_with(50 + 5 * index, 100), index / RATE_HZ, index)

    def __enter__(self):
        return self

    def __exit__(self, *error):
        pass


class Follower:
    """Finds the square exactly within 20 pixels of where it was; counts what it was given."""

    def __init__(self):
        self.box, self.starts, self.tracked = None, [], 0

    def init(self, image, box):
        self.starts.append(box)
        self.box = box
        return Track(box, box, 30.0, 100.0, 1.0)

    def track(self, image, _prior):
        self.tracked += 1
        rows, columns = np.nonzero(image[:, :, 2] > 200)
        found = Box(float(columns.min()), float(rows.min()), SIDE, SIDE)
        near = abs(found.x - self.box.x) < 20
        self.box = found if near else self.box
        return Track(self.box, self.box, 30.0, 100.0, 1.0, found=near)


def flown(count, late_frames, at=30, box=None):
    """The tracks of a film in which a box of `late_frames` ago is selected at round `at`."""
    recent, follower, begun = RecentFrames(Film(count)), Follower(), []
    selector = Selector(follower.init, follower.track, recent, lambda: begun.append(True), box)
    tracks = []
    for frame in recent.frames():
        if frame.index == at:
            drawn = frame.index - late_frames
            share = (50 + 5 * drawn) / SIZE[0], 100 / SIZE[1], SIDE / SIZE[0], SIDE / SIZE[1]
            assert selector.choose(Selection(*share, drawn / RATE_HZ, "a test")) == ""
        tracks.append(selector.update(frame.image))
    return tracks, follower, begun


@pytest.mark.parametrize("late", [0, 1, 9, 18, 30])
def test_a_box_drawn_late_is_on_the_target_when_it_has_caught_up(late):
    tracks, follower, begun = flown(80, late)
    assert all(track is None for track in tracks[:30])
    rounds = next(n for n, track in enumerate(tracks[30:]) if track is not None and track.found)
    assert rounds <= late / (CATCH_UP - 1) + 2
    for index in range(30 + rounds, 80):
        assert tracks[index].found
        assert tracks[index].box.x == 50 + 5 * index
    assert begun, "the estimate of the old target must be forgotten"
    (start,) = follower.starts
    assert start.x == pytest.approx(50 + 5 * (30 - late))


def test_no_round_tracks_more_than_its_share_of_frames():
    recent, follower = RecentFrames(Film(80)), Follower()
    selector = Selector(follower.init, follower.track, recent, lambda: None)
    for frame in recent.frames():
        if frame.index == 40:
            selector.choose(Selection((50 + 50) / SIZE[0], 100 / SIZE[1], 0.0375, 0.0667, 10 / RATE_HZ, "a test"))
        before = follower.tracked
        selector.update(frame.image)
        assert follower.tracked - before <= CATCH_UP


def test_a_stop_leaves_no_target_and_the_next_selection_starts_again():
    recent, follower = RecentFrames(Film(20)), Follower()
    selector = Selector(follower.init, follower.track, recent, lambda: None, Box(50, 100, SIDE, SIDE))
    seen = []
    for frame in recent.frames():
        if frame.index == 10:
            assert selector.choose(Cleared("a test")) == ""
        seen.append(selector.update(frame.image))
    assert all(track is not None and track.found for track in seen[:10])
    assert all(track is None for track in seen[10:])
    assert not selector.has_target


@pytest.mark.parametrize(
    ("selection", "why"),
    [
        (Selection(0.1, 0.3, 0.003, 0.05, 1.6, "a test"), "under 6 pixels"),
        (Selection(0.99, 0.3, 0.2, 0.2, 1.6, "a test"), "outside the image"),
        (Selection(0.1, 0.3, 0.1, 0.1, -3.0, "a test"), "late"),
        (Selection(0.9, 0.9, 0.05, 0.05, 1.6, "a test"), "nothing to hold on to"),
        (Selection(0.95, 0.95, 0.0, 0.0, 1.6, "a test"), "nothing stands out"),
    ],
)
def test_an_impossible_selection_is_refused_with_a_reason(selection, why):
    class Sky(Film):
        def frames(self):
            for frame in super().frames():
                frame.image[200:] = 128
                yield frame

    recent, follower = RecentFrames(Sky(60)), Follower()
    selector = Selector(follower.init, follower.track, recent, lambda: None)
    for _ in recent.frames():
        pass
    assert why in selector.choose(selection)
    assert not selector.has_target


class Later:
    """An executor whose work begins and ends on command."""

    def __init__(self):
        self.waiting, self.begun = [], []

    def submit(self, function, *arguments):
        self.waiting.append((Future(), partial(function, *arguments)))
        return self.waiting[-1][0]

    def begin(self):
        self.begun += [(future, work) for future, work in self.waiting if future.set_running_or_notify_cancel()]
        self.waiting.clear()

    def finish(self):
        self.begin()
        for future, work in self.begun:
            future.set_result(work())


@pytest.mark.parametrize("is_grey", [True, False])
@pytest.mark.parametrize("is_kerb", [True, False])
def test_edges_without_corners_are_refused_because_the_place_along_them_is_ambiguous(is_kerb, is_grey):
    image = np.clip(np.random.default_rng(0).normal(130, 2, (360, 360, 3)), 0, 255).astype(np.uint8)
    image[180:] -= 70
    image[165:195, 40:52] = 20  # somebody before it
    image = np.ascontiguousarray(image.swapaxes(0, 1) if is_kerb else image)
    image = image[:, :, 0] if is_grey else image

    def drawn(along, across, length, width):
        shares = (across, along, width, length) if is_kerb else (along, across, length, width)
        return meant(Selection(*shares, 0.0, "a test"), image)

    assert drawn(0.5, 0.45, 0.2, 0.1) == "nothing to hold on to: choose a target with edges"
    assert isinstance(drawn(0.1, 0.45, 0.05, 0.1), Box)


def test_of_queued_taps_only_the_newest_is_processed():
    recent, follower, later = RecentFrames(Film(60)), Follower(), Later()
    selector = Selector(follower.init, follower.track, recent, lambda: None, looks=later)
    for _ in recent.frames():
        pass
    for _ in range(50):
        assert selector.choose(Selection(0.5, 0.5, 0.0, 0.0, 1.6, "a test")) == ""
    later.begin()
    assert len(later.begun) == 1
    assert selector.choose(Selection(0.5, 0.5, 0.0, 0.0, 1.6, "a test")) == ""
    selector.choose(Cleared("a test"))
    later.begin()
    assert len(later.begun) == 1, "and none after the target was cleared"


@pytest.mark.parametrize("has_begun", [True, False])
def test_a_box_that_is_drawn_while_a_tap_is_processed_is_kept(has_begun):
    recent, follower, later = RecentFrames(Film(60)), Follower(), Later()
    selector = Selector(follower.init, follower.track, recent, lambda: None, looks=later)
    heard = []
    selector.decided = heard.append
    for _ in recent.frames():
        pass
    assert selector.choose(Selection(0.95, 0.95, 0.0, 0.0, 1.6, "a test")) == ""
    assert selector.is_looking
    if has_begun:
        later.begin()
    assert selector.choose(Selection(0.1, 0.3, 0.1, 0.1, 1.6, "a test")) == ""
    later.finish()
    selector.update(recent.kept[-1].image)
    assert heard == []
    assert not selector.is_looking
    assert selector.has_target


def test_before_the_first_image_nothing_can_be_selected():
    selector = Selector(None, None, RecentFrames(Film(0)), lambda: None)
    assert "no image yet" in selector.choose(Selection(0.5, 0.5, 0.1, 0.1, 0.0, "a test"))


@pytest.mark.parametrize("side", [12, 24, 60])
def test_a_click_gets_the_box_of_what_stands_out_there(side):
    image = np.random.default_rng(3).integers(60, 90, (360, 640, 3)).astype(np.uint8)
    image[150 : 150 + 2 * side, 300 : 300 + side] = (40, 60, 230)
    box = box_at(image, 300 + 0.4 * side, 150 + 1.1 * side)
    assert box is not None
    assert box.iou(Box(300, 150, side, 2 * side)) > 0.75


def test_recent_frames_are_bounded_by_time_and_by_bytes():
    recent = RecentFrames(Film(200), seconds=1.0)
    for _ in recent.frames():
        pass
    assert recent.kept[-1].index == 199
    assert recent.kept[-1].t_s - recent.kept[0].t_s <= 1.0
    assert len(recent.kept) == 31
    few = RecentFrames(Film(200), most_bytes=10 * 640 * 360 * 3)
    for _ in few.frames():
        pass
    assert len(few.kept) == 10


def test_a_tap_on_a_small_spot_of_the_ground_selects_nothing():
    image = np.full((360, 640, 3), 90, np.uint8)
    image[180:184, 300:304] = (40, 60, 230)
    assert box_at(image, 302, 182) is not None, "it stands out"
    assert meant(Selection(302 / 640, 182 / 360, 0.0, 0.0, 0.0, "a test"), image) == (
        "nothing stands out there: draw a box"
    )
    image[180:188, 300:304] = (40, 60, 230)  # a person 8 pixels high
    assert not isinstance(meant(Selection(302 / 640, 184 / 360, 0.0, 0.0, 0.0, "a test"), image), str)
