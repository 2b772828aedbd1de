"""While the target is lost, a detector's boxes are search positions; tracker and estimate decide which one is accepted.

The reference is the scene: people on flat ground, a detector that sees them all 0.3 s late, and a tracker that finds
whoever is within a box's width of where it looks.
"""

import math
from dataclasses import replace

import numpy as np
import pytest

from follow.control.candidates import OFFERED
from follow.control.detecting import DELAY_S, PERIOD_S, DelayedDetector
from follow.control.target import Target
from follow.messages import Frame
from follow.selection import Detection, Detections
from tests.follow.test_regain import OTHERS, SEEN_S, STAMPS, cannot_be
from tests.follow.test_target import CAMERA, DOWN, DT, box_of, hovering, seen, watch

YAW_RATE_RAD_S = 0.5
FOUND_S = DELAY_S + 2 * PERIOD_S + 0.3  # the detector's answer, the next one, and enough frames to confirm


class Scene:
    """A target that was seen for SEEN_S from 12 m, at (0, 0) last, walking north; the vehicle hovers and turns."""

    def __init__(self, speed, yaw_rate_rad_s=0.0, towards=(0.0, 0.0)):
        self.target, self.yaw_rate_rad_s = Target(CAMERA, DOWN), yaw_rate_rad_s
        self.yaw_rad = math.atan2(towards[1], towards[0] + 12.0)
        states = [hovering(i * DT - SEEN_S, north_m=-12.0) for i in range(round(SEEN_S / DT))]
        states = [replace(state, **dict.fromkeys(STAMPS, i * DT)) for i, state in enumerate(states)]
        watch(self.target, lambda t: (speed * (t - SEEN_S), 0.0), states)
        self.lost_s = states[-1].t_s
        self.boxes = {}
        self.looked = []

    def state(self, t_s):
        turned = self.yaw_rate_rad_s * math.sin(2.0 * (t_s - self.lost_s))
        return hovering(t_s, north_m=-12.0, yaw_rad=self.yaw_rad + turned)

    def find(self, image):
        return tuple(Detection(box, 0.9) for box in self.boxes[int(image[0, 0])])

    def taken_after(self, people, hidden_s, seconds, detector=None):
        """Show `people`, functions of the time, from `hidden_s` after the loss on; when one is taken, s, or None."""
        box = self.target.box
        for i in range(1, round((hidden_s + seconds) / DT)):
            t_s = self.lost_s + i * DT
            state = self.state(t_s)
            there = [box_of(person(i * DT), state) for person in people] if i * DT >= hidden_s else []
            there = [b for b in there if 0 <= b.centre_x < CAMERA.width and 0 <= b.centre_y < CAMERA.height]
            self.boxes[i] = there
            found = detector.update(Frame(np.full((1, 1), i, np.int64), t_s, i), t_s) if detector is not None else None
            prior = self.target.predict(state, t_s, found)
            look = prior or box
            self.looked.append(look)
            near = [b for b in there if math.hypot(b.centre_x - look.centre_x, b.centre_y - look.centre_y) < b.w]
            box = near[0] if near else look
            estimate = self.target.update(seen(box, found=bool(near)), state, t_s)
            if estimate.seen_t_s == t_s:
                return i * DT - hidden_s
        return None


@pytest.mark.parametrize("hidden_s", [1.0, 2.0, 4.0])
@pytest.mark.parametrize("aside_m", [-4.0, -3.0, 3.0, 4.0])
@pytest.mark.parametrize("yaw_rate_rad_s", [0.0, YAW_RATE_RAD_S])
def test_a_target_that_turned_aside_is_found_with_the_next_detections(hidden_s, aside_m, yaw_rate_rad_s):
    def person(_t):
        return 0.7 * hidden_s, aside_m

    scene = Scene(1.4, yaw_rate_rad_s)
    taken_s = scene.taken_after([person], hidden_s, 6.0, DelayedDetector(scene.find))
    assert taken_s is not None
    assert taken_s <= FOUND_S + 0.05 * hidden_s


def test_on_average_the_target_is_found_sooner_than_without_a_detector():
    def total(with_detector):
        times = []
        for hidden_s in (1.0, 2.0, 4.0):
            for aside_m in (-4.0, -3.0, 3.0, 4.0):
                scene = Scene(1.4)
                detector = DelayedDetector(scene.find) if with_detector else None
                taken_s = scene.taken_after([lambda _t, a=aside_m, h=hidden_s: (0.7 * h, a)], hidden_s, 6.0, detector)
                times.append(6.0 if taken_s is None else taken_s)
        return sum(times)

    assert total(with_detector=True) < 0.7 * total(with_detector=False)


@pytest.mark.parametrize(("hidden_s", "speed", "place"), OTHERS[::3])
def test_a_candidate_that_cannot_be_the_target_is_never_accepted(hidden_s, speed, place):
    if not cannot_be(place, speed, min(hidden_s + 4.0, 12.0)):
        pytest.skip("the target may have gone there")
    scene = Scene(speed, towards=place)
    assert scene.taken_after([lambda _t: place], hidden_s, 4.0, DelayedDetector(scene.find)) is None


def test_the_target_is_found_among_others():
    scene = Scene(1.4)
    others = [lambda _t, e=e: (9.0, e) for e in (-9.0, 8.0, 10.0)]
    assert scene.taken_after([*others, lambda _t: (3.0, 3.0)], 3.0, 3.0, DelayedDetector(scene.find)) is not None
    assert scene.target.filter.mean[:2] == pytest.approx((3.0, 3.0), abs=1.5)


def test_a_candidate_is_searched_at_its_present_place_in_a_turning_image():
    scene = Scene(0.0)
    place, t_s = (1.0, 4.0), scene.lost_s + 1.0
    then, now = hovering(t_s - 0.3, north_m=-12.0), hovering(t_s, north_m=-12.0, yaw_rad=0.25)
    found = Detections(then.t_s, 1, (Detection(box_of(place, then), 0.9),))
    scene.target.predict(then, then.t_s)
    looks = [scene.target.predict(now, t_s, found) for _ in range(2)]
    true = box_of(place, now)
    near = min(looks, key=lambda box: abs(box.centre_x - true.centre_x))
    assert (near.centre_x, near.centre_y) == pytest.approx((true.centre_x, true.centre_y), abs=0.2 * true.w)
    assert near.w == pytest.approx(true.w, rel=0.1)
    assert abs(box_of(place, then).centre_x - true.centre_x) > 2 * true.w


def test_each_candidate_is_searched_once_and_the_predicted_place_in_every_second_frame():
    scene, t_s = Scene(0.0), 0.0
    t_s = scene.lost_s + 1.0
    state = hovering(t_s, north_m=-12.0)
    boxes = [box_of((2.0, east), state) for east in (-6.0, -4.0, -2.0, 2.0, 4.0, 6.0)]
    found = Detections(t_s - 0.2, 1, tuple(Detection(box, 0.9) for box in boxes))
    looks = [scene.target.predict(state, t_s, found) for _ in range(4 * OFFERED)]
    at = [sum(abs(look.centre_x - box.centre_x) < 1.0 for look in looks) for box in boxes]
    assert sum(at) >= OFFERED
    assert at[2] >= 1
    assert at[3] >= 1
    expected = [look.centre_x for look in looks if abs(look.centre_x - CAMERA.cx) < 3.0]
    assert len(expected) >= 2 * OFFERED


def test_what_was_seen_before_the_loss_and_no_detector_at_all_change_nothing():
    def looks(found):
        scene = Scene(1.4)
        state = scene.state(scene.lost_s + 1.0)
        box = box_of((1.0, 5.0), state)
        early = Detections(scene.lost_s, 0, (Detection(box, 0.9),)) if found else None
        return [scene.target.predict(state, state.t_s, early) for _ in range(8)]

    assert looks(found=True) == looks(found=False)
