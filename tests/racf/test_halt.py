"""A target whose box halts at low confidence: when and where its motion is extrapolated, and when not."""

import cv2
import numpy as np
import pytest

from racf import Box, Racf
from racf.flow import Flow
from racf.halt import LONGEST, NOW, Halt

SIDE = 40.0


def halted(
    speed: tuple[float, float] = (2.0, -1.0),
    then: tuple[float, float] = (0.0, 0.0),
    pan: tuple[float, float] | None = (3.0, 0.5),
    confidence: float = 0.7,
    frames: int = 30,
) -> tuple[Halt, Box]:
    """A target that moved by `speed` px a frame over ground that moves by `pan`, and by `then` for the last frames."""
    halt, box = Halt(), Box.around(100, 100, SIDE, SIDE)
    for k in range(frames + NOW):
        moving, (dx, dy) = k < frames, pan or (0.0, 0.0)
        over = speed if moving else then
        after = box.moved(over[0] + dx, over[1] + dy)
        halt.goes_on(pan, SIDE)
        halt.seen(box, after, pan, 1.0 if moving else confidence)
        box = after
    return halt, box


def test_a_halted_target_is_predicted_at_its_ground_speed_before_the_halt():
    halt, box = halted()
    ahead = halt.moved(box)
    assert (ahead.centre_x - box.centre_x, ahead.centre_y - box.centre_y) == pytest.approx((NOW * 2.0, -NOW * 1.0))
    for _ in range(10):
        halt.goes_on((-4.0, 1.0), SIDE)
        halt.unseen()
    further = halt.moved(box)
    assert (further.centre_x - ahead.centre_x, further.centre_y - ahead.centre_y) == pytest.approx((-20.0, 0.0))
    assert halt.step() == pytest.approx((-2.0, 0.0))
    assert (further.w, further.h) == (box.w, box.h)


def test_the_prediction_keeps_the_present_size():
    halt, box = halted()
    before = halt.moved(box)
    halt.goes_on(None, 2 * SIDE)  # the camera came nearer; the ground is not seen and counts as moving as before
    assert halt.moved(box).centre_x - before.centre_x == pytest.approx(4.0 + 3.0)


@pytest.mark.parametrize(
    "how",
    [
        {"confidence": 0.95},  # who stands still is seen as well as before
        {"then": (1.5, -0.75)},  # it became slower
        {"then": (0.0, 2.0)},  # it turned off
        {"speed": (0.5, 0.3)},  # it stood all the time
        {"pan": None},  # nobody knows how the ground moved
        {"frames": 15},  # nor, for long enough, how it moved itself
    ],
)
def test_a_target_that_did_not_halt_at_low_confidence_is_expected_where_it_is_seen(how):
    halt, box = halted(**how)
    assert halt.moved(box) == box
    assert halt.step() is None


@pytest.mark.parametrize(("unknown", "halts"), [({4, 9, 14, 19}, True), ({0, 4, 9, 14, 19}, False)])
def test_the_motion_must_be_known_in_four_fifths_of_the_frames_before_a_halt(unknown, halts):
    halt, box = Halt(), Box.around(100, 100, SIDE, SIDE)
    for k in range(20 + NOW):
        after = box.moved(2.0, 0.0) if k < 20 else box
        halt.seen(box, after, None if k in unknown else (0.0, 0.0), 1.0 if k < 20 else 0.7)
        box = after
    assert (halt.step() is not None) == halts


def test_a_box_that_moves_on_at_low_confidence_may_be_on_the_occluder():
    halt, box = halted()
    for _ in range(2 * NOW):
        halt.goes_on((0.0, 0.0), SIDE)
        after = box.moved(2.0, -1.0)
        halt.seen(box, after, (0.0, 0.0), 0.8)
        box = after
    assert halt.step() is not None


def test_a_target_that_moved_back_and_forth_did_not_move():
    halt, box = Halt(), Box.around(100, 100, SIDE, SIDE)
    for k in range(30):
        after = box.moved(3.0 if k // 10 % 2 else -3.0, 0.0) if k < 30 - NOW else box
        halt.seen(box, after, (0.0, 0.0), 0.7)
        box = after
    assert halt.step() is None


@pytest.mark.parametrize("forgets", ["found again", "moves on", "too long ago", "told to"])
def test_the_motion_is_forgotten_when(forgets):
    halt, box = halted()
    if forgets == "found again":
        halt.found(0.8)
    elif forgets == "told to":
        halt.forget()
    elif forgets == "moves on":
        for _ in range(2 * NOW):
            halt.goes_on((0.0, 0.0), SIDE)
            after = box.moved(2.0, -1.0)
            halt.seen(box, after, (0.0, 0.0), 1.0)
            box = after
    else:
        for _ in range(LONGEST + 2):
            assert halt.step() is not None
            halt.goes_on((0.0, 0.0), SIDE)
            halt.unseen()
    assert halt.step() is None
    assert halt.moved(box) == box


def test_a_halt_may_be_real_so_the_target_is_also_expected_where_it_stood():
    halt, box = halted()
    for _ in range(LONGEST - 5):  # it stands, seen in doubt
        halt.goes_on((1.0, 0.0), SIDE)
        after = box.moved(1.0, 0.0)
        halt.seen(box, after, (1.0, 0.0), 0.8)
        box = after
    for _ in range(20):
        halt.goes_on((1.0, 0.0), SIDE)
        halt.unseen()
    expected, stood = halt.places(halt.moved(box))
    assert expected == halt.moved(box)
    assert (stood.centre_x, stood.centre_y) == pytest.approx((box.centre_x + 20.0, box.centre_y))
    halt.found(1.0)
    assert halt.places(expected) == (expected,)


GROUND = cv2.GaussianBlur(np.random.default_rng(7).integers(0, 256, (300, 900, 3), dtype=np.uint8), (0, 0), 3)


@pytest.mark.parametrize("pan", [0, 2, -3])
@pytest.mark.parametrize("w", [12, 30, 90])
def test_the_flow_around_a_target_is_that_of_the_ground(pan, w):
    flow, wide = Flow(), cv2.normalize(GROUND, None, 40, 210, cv2.NORM_MINMAX)
    first, second = wide[:, 300:700].copy(), wide[:, 300 - pan : 700 - pan].copy()
    target = cv2.normalize(GROUND[:w, :w], None, 0, 255, cv2.NORM_MINMAX)
    first[100 : 100 + w, 150 : 150 + w] = second[103 : 103 + w, 152 : 152 + w] = target
    assert flow.ground() is None
    flow.remember(first, Box(150, 100, w, w))
    assert flow.ground() is None
    flow.look(second, 2, 3)
    assert flow.ground() == pytest.approx((pan, 0), abs=0.15)


def test_ground_without_features_or_with_more_than_one_motion_is_unknown():
    flow, random = Flow(), np.random.default_rng(3)
    grey = np.full((200, 200), 90, np.uint8)
    flow.remember(grey, Box(80, 80, 40, 40))
    flow.look(random.integers(0, 256, (200, 200), dtype=np.uint8), 0, 0)
    assert flow.ground() is None
    wide = cv2.normalize(GROUND, None, 40, 210, cv2.NORM_MINMAX)
    first, second = wide[:200, 300:500].copy(), wide[:200, 300:500].copy()
    second[:100], second[100:] = wide[:100, 302:502], wide[100:200, 298:498]  # parted in the middle
    flow.remember(first, Box(80, 80, 40, 40))
    flow.look(second, 0, 0)
    assert len(flow.around()[0]) >= 20
    assert flow.ground() is None


def hidden_by_what_looks_like_it(pan_px: float) -> list[tuple[np.ndarray, Box]]:
    """A target goes 2 px a frame over ground that moves; from frame 40 a faded copy stands in for it, from 54 nothing.

    The box is where the target is in truth.
    """
    side, shown = 40, []
    random = np.random.default_rng(8)
    target = cv2.resize(random.integers(0, 256, (6, 6, 3), dtype=np.uint8), (side, side), interpolation=cv2.INTER_CUBIC)
    for k in range(90):
        image, at = cv2.normalize(GROUND, None, 40, 210, cv2.NORM_MINMAX), 300 + 2 * k
        if k < 54:
            stands, share = min(at, 380), 1.0 if k < 40 else 0.25
            place = image[120 : 120 + side, stands : stands + side]
            place[:] = share * target + (1 - share) * place
        left = 200 - round(pan_px * k)
        shown.append((image[:, left : left + 420].copy(), Box(at - left, 120, side, side)))
    return shown


@pytest.mark.parametrize("pan_px", [0.0, -1.5, 1.5])
def test_a_target_lost_after_a_doubtful_halt_is_expected_where_it_would_have_moved(pan_px):
    shown, tracker = hidden_by_what_looks_like_it(pan_px), Racf("racf-,robust")
    tracker.init(*shown[0])
    tracks = [tracker.update(image) for image, _ in shown[1:]]
    assert all(track.found for track in tracks[:50])
    lost = [(track.box, box) for track, (_, box) in zip(tracks, shown[1:], strict=True) if not track.found]
    assert len(lost) > 20
    for box, truth in lost[1:]:
        assert abs(box.centre_x - truth.centre_x) < 0.5 * box.w
        assert abs(box.centre_y - truth.centre_y) < 0.2 * box.h


def test_a_prior_of_the_caller_overrides_the_prediction():
    shown, tracker = hidden_by_what_looks_like_it(0.0), Racf("racf-,robust")
    tracker.init(*shown[0])
    expected = Box.around(380, 140, 40, 40)
    for image, _ in shown[1:60]:
        tracker.update(image)
    for image, _ in shown[60:]:
        track = tracker.update(image, expected)
        assert not track.found
        assert (track.box.centre_x, track.box.centre_y) == pytest.approx((380, 140))


@pytest.mark.parametrize("hidden", [8, 25])
def test_a_target_that_really_halted_is_found_where_it_stands_as_soon_as_it_is_seen(hidden):
    """A shadow falls on it as it halts, then something passes in front of it."""
    side, random = 40, np.random.default_rng(8)
    target = cv2.resize(random.integers(0, 256, (6, 6, 3), dtype=np.uint8), (side, side), interpolation=cv2.INTER_CUBIC)
    passer = cv2.resize(random.integers(0, 256, (5, 5, 3), dtype=np.uint8), (70, 90), interpolation=cv2.INTER_CUBIC)
    tracker, seen = Racf("racf-,robust"), []
    for k in range(60 + hidden + 12):
        image, at = cv2.normalize(GROUND, None, 40, 210, cv2.NORM_MINMAX), 300 + 3 * min(k, 40)
        place = image[120 : 120 + side, at : at + side]
        shade = 0.25 if 40 <= k < 52 else 1.0
        place[:] = shade * target + (1 - shade) * place
        if 60 <= k < 60 + hidden:
            image[95:185, at - 15 : at + 55] = passer
        shown = image[:, 200:620].copy()
        seen.append(tracker.init(shown, Box(at - 200, 120, side, side)) if k == 0 else tracker.update(shown))
    assert tracker._halt.step() is None
    assert not any(track.found for track in seen[62 : 60 + hidden])
    assert all(track.found for track in seen[60 + hidden + 3 :])
    assert abs(seen[-1].box.centre_x - (300 + 120 + 20 - 200)) < 3
