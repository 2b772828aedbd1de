import math
from dataclasses import replace

import numpy as np
import pytest

from follow.control.footage import FootageTarget
from follow.control.joint_filter import Motion, predicted
from follow.control.pose_history import PoseHistory
from follow.control.target import Target, TargetConfig
from follow.geometry import Intrinsics, camera_to_ned, project
from follow.messages import NEVER, VehicleState
from racf.box import Box
from racf.track import Track

CAMERA = Intrinsics.from_fov(640, 360, math.radians(80))
DOWN = math.radians(30)
DT = 1 / 30
SIZE = 1.2  # metres, square


def hovering(t_s, **changes):
    state = VehicleState(t_s=t_s, attitude_t_s=t_s, position_t_s=t_s, heartbeat_t_s=t_s, down_m=-8.0)
    return replace(state, **changes)


def box_of(place, state, size=SIZE):
    """The box of a perfect tracker on a billboard of that size at `place` (north, east) on flat ground."""
    rotation = camera_to_ned(DOWN, state.roll_rad, state.pitch_rad, state.yaw_rad)
    centre = np.array([[place[0], place[1], -size / 2]])
    pixels, depth = project(CAMERA, rotation, (state.north_m, state.east_m, state.down_m), centre)
    side = size * CAMERA.fx / depth[0]
    return Box.around(*pixels[0], side, side)


def seen(box, found=True):
    return Track(box, box, psr=20.0, apce=50.0, confidence=0.9, found=found)


def watch(target, path, states, delay=0):
    """Feed the target frames `delay` rounds old; the last estimate."""
    for i, state in enumerate(states):
        old = i - delay
        track = seen(box_of(path(old * DT), states[old])) if old >= 0 else None
        estimate = target.update(track, state, old * DT)
    return estimate


def test_a_standing_target_is_found_where_it_stands():
    target = Target(CAMERA, DOWN)
    states = [hovering(i * DT, yaw_rad=0.3) for i in range(60)]
    estimate = watch(target, lambda t: (11.0, 4.0), states)
    assert estimate.range_m == pytest.approx(math.hypot(11, 4), rel=0.02)
    assert estimate.azimuth_rad == pytest.approx(math.atan2(4, 11) - 0.3, abs=0.01)
    assert estimate.north_m_s == pytest.approx(0, abs=0.1)


def test_roll_and_pitch_do_not_move_the_estimate():
    rng = np.random.default_rng(2)
    target = Target(CAMERA, DOWN)
    states = [hovering(i * DT, roll_rad=r, pitch_rad=p) for i, (r, p) in enumerate(rng.uniform(-0.15, 0.15, (90, 2)))]
    estimate = watch(target, lambda t: (12.0, 1.0), states)
    assert estimate.range_m == pytest.approx(math.hypot(12, 1), rel=0.02)
    assert math.hypot(estimate.north_m_s, estimate.east_m_s) < 0.15


def test_a_walkers_velocity_is_estimated():
    target = Target(CAMERA, DOWN)
    estimate = watch(target, lambda t: (10 + 1.0 * t, 1.5 * t), [hovering(i * DT) for i in range(90)])
    assert (estimate.north_m_s, estimate.east_m_s) == pytest.approx((1.0, 1.5), abs=0.15)


def watched_from(height_m, size, config=TargetConfig(), **changes):  # noqa: B008 - it is frozen
    """The target and its estimate after 3 s of hovering before one that stands 12 m away."""
    target = Target(CAMERA, DOWN, config)
    for i in range(90):
        state = hovering(i * DT, down_m=-height_m)
        told = replace(state, **{name: value(state) for name, value in changes.items()})
        estimate = target.update(seen(box_of((12.0, 0.0), state, size)), told, i * DT)
    return target, estimate


@pytest.mark.parametrize("size", [0.8, 1.7])
def test_the_true_size_is_estimated_from_the_ground_at_the_start(size):
    target, estimate = watched_from(10.0, size)
    assert target.filter.size_m == pytest.approx(size, rel=0.1)
    assert estimate.range_m == pytest.approx(12.0, rel=0.1)
    assert not estimate.contradiction


@pytest.mark.parametrize("size", [0.5, 3.0])
def test_a_size_that_the_ground_contradicts_is_reported_and_the_nearer_range_counts(size):
    _, estimate = watched_from(10.0, size)
    assert "set target.size_m" in estimate.contradiction
    assert estimate.range_near_m < 12.0
    _, told = watched_from(10.0, size, TargetConfig(size_m=size))
    assert not told.contradiction


@pytest.mark.parametrize("error_m", [-20.0, -8.0, 8.0, 20.0])
def test_a_wrong_height_of_the_local_origin_contradicts_the_size_unless_home_gives_it(error_m):
    def wrong(state):
        return state.down_m - error_m

    _, estimate = watched_from(6.0, 1.05, down_m=wrong)
    assert estimate.contradiction
    assert estimate.range_near_m < 12.0
    for told in ({"home_down_m": lambda _: -error_m}, {"above_home_m": lambda s: -s.down_m}):
        times = {f"{name.rsplit('_', 2 if 'above' not in name else 1)[0]}_t_s": lambda s: s.t_s for name in told}
        _, estimate = watched_from(6.0, 1.05, down_m=wrong, **told, **times)
        assert not estimate.contradiction
        assert estimate.range_m == pytest.approx(12.0, rel=0.1)
        assert estimate.ground_below_m == pytest.approx(6.0, abs=1.0)


def test_a_rangefinder_corrects_an_unknown_size():
    _, estimate = watched_from(
        6.0, 1.6, TargetConfig(size_m=1.0, size_relative_std=0.5),
        down_m=lambda s: s.down_m - 60.0, above_ground_m=lambda s: -s.down_m, above_ground_t_s=lambda s: s.t_s,
        home_t_s=lambda s: s.t_s, home_down_m=lambda _: -60.0,
    )  # fmt: skip
    assert estimate.size_m == pytest.approx(1.6, rel=0.1)
    assert estimate.size_std_m < 0.25


@pytest.mark.parametrize("jump", [(5.0, 0.0, 0.0), (0.0, -4.0, 0.0), (0.0, 0.0, -4.0), (3.0, 3.0, 5.0)])
def test_a_reset_of_the_vehicles_position_moves_the_target_with_it(jump):
    target = Target(CAMERA, DOWN)
    for i in range(120):
        state = hovering(i * DT)
        told = state
        if i >= 60:
            told = replace(state, north_m=jump[0], east_m=jump[1], down_m=state.down_m + jump[2])
        estimate = target.update(seen(box_of((12.0, 0.0), state, 1.05)), told, i * DT)
        assert estimate.seen_t_s == i * DT
    assert estimate.range_m == pytest.approx(12.0, rel=0.1)
    assert math.hypot(estimate.north_m_s, estimate.east_m_s) < 0.1
    assert estimate.ground_below_m == pytest.approx(8.0, abs=0.5)


def test_a_small_step_is_a_reset_only_if_the_autopilot_counts_one():
    motion = PoseHistory()
    motion.add(hovering(0.0))
    assert motion.jump(hovering(0.02, north_m=0.8), 1.5) is None
    np.testing.assert_allclose(motion.jump(hovering(0.02, north_m=0.8, resets=1), 1.5), (0.8, 0.0, 0.0))
    assert motion.jump(hovering(0.02, north_m=0.16, north_m_s=8.0), 1.5) is None


def test_delay_compensation_removes_the_lag_of_old_images():
    def path(t):
        return 12.0, 2.0 * t

    states = [hovering(i * DT, yaw_rad=-0.2 * i * DT) for i in range(120)]
    t_end = 119 * DT
    truth = math.atan2(2.0 * t_end, 12.0) - states[-1].yaw_rad
    errors = {}
    for compensate in (True, False):
        target = Target(CAMERA, DOWN, TargetConfig(compensate=compensate))
        errors[compensate] = abs(watch(target, path, states, delay=9).azimuth_rad - truth)
    assert errors[True] < 0.02 < errors[False] / 2


def test_a_track_that_was_not_found_is_ignored():
    target = Target(CAMERA, DOWN)
    state = hovering(0.0)
    before = target.update(seen(box_of((12.0, 0.0), state)), state, 0.0)
    later = target.update(seen(box_of((30.0, 20.0), state), found=False), hovering(DT), DT)
    assert later.azimuth_rad == pytest.approx(before.azimuth_rad)
    assert later.seen_t_s == 0.0


def test_the_prior_box_is_where_the_target_will_appear():
    target = Target(CAMERA, DOWN)
    states = [hovering(i * DT, yaw_rad=0.1 * i * DT) for i in range(90)]

    def path(t):
        return 12.0 + t, 0.5 * t

    watch(target, path, states)
    t_s = 90 * DT
    state = hovering(t_s, yaw_rad=0.1 * t_s)
    prior = target.predict(state, t_s)
    assert prior is not None
    assert prior.iou(box_of(path(t_s), state)) > 0.85


def test_before_the_first_box_there_is_no_prior_and_nothing_seen():
    target = Target(CAMERA, DOWN)
    assert target.predict(hovering(0.0), 0.0) is None
    assert target.update(None, hovering(0.0), NEVER).seen_t_s == NEVER


def test_uncertainty_grows_while_the_target_is_unseen():
    target = Target(CAMERA, DOWN)
    near = watch(target, lambda t: (12.0, 0.0), [hovering(i * DT) for i in range(30)])
    later = target.update(None, hovering(6.0), 29 * DT)
    assert later.range_std_m > 2 * near.range_std_m
    assert later.range_near_m < near.range_near_m / 1.3


def test_a_pose_between_two_messages_is_interpolated_and_yaw_along_the_shorter_arc():
    motion = PoseHistory()
    motion.add(hovering(0.0, yaw_rad=3.1, north_m=1.0))
    motion.add(hovering(1.0, yaw_rad=-3.1, north_m=2.0))
    pose = motion.at(0.5)
    assert abs(pose.yaw_rad) == pytest.approx(math.pi, abs=1e-6)
    assert pose.north_m == pytest.approx(1.5)


def test_beyond_the_newest_message_the_pose_is_extrapolated_for_a_moment_only():
    motion = PoseHistory()
    motion.add(hovering(0.0, north_m_s=2.0, yaw_rate_rad_s=1.0))
    assert motion.at(0.1).north_m == pytest.approx(0.2)
    assert motion.at(0.1).yaw_rad == pytest.approx(0.1)
    assert motion.at(99.0) == replace(motion.at(0.3), t_s=99.0)


def test_after_a_loss_one_box_is_not_enough():
    target = Target(CAMERA, DOWN)
    watch(target, lambda t: (12.0, 0.0), [hovering(i * DT) for i in range(60)])
    seen_at = []
    for i in range(90, 96):  # unseen for 1 s: 3 frames are enough
        state = hovering(i * DT)
        seen_at.append(target.update(seen(box_of((12.0, 0.0), state)), state, i * DT).seen_t_s)
    assert seen_at[0] == seen_at[1] == 59 * DT
    assert seen_at[2] == 92 * DT


def test_after_a_long_loss_more_frames_are_needed():
    target = Target(CAMERA, DOWN)
    watch(target, lambda t: (12.0, 0.0), [hovering(i * DT) for i in range(60)])
    for i in range(600, 640):  # unseen for 18 s: it takes 0.9 s of frames
        state = hovering(i * DT)
        estimate = target.update(seen(box_of((12.0, 0.0), state)), state, i * DT)
        assert (estimate.seen_t_s > 59 * DT) == (i >= 628)


@pytest.mark.parametrize("lost_s", [2.0, 6.0, 12.0, 18.0])
@pytest.mark.parametrize("place", [(10.0, 15.0), (-2.0, -13.0), (25.0, 18.0)])
def test_somebody_else_of_the_same_size_far_from_the_lost_targets_path_is_not_accepted(lost_s, place):
    target = Target(CAMERA, DOWN)
    watch(target, lambda t: (12.0 + 3.0 * t, 0.0), [hovering(i * DT, north_m=3.0 * i * DT) for i in range(60)])
    last = 59 * DT
    other = (12.0 + 3.0 * last + place[0], place[1])
    yaw = math.atan2(other[1], other[0] - 3.0 * last + 6.0)
    for i in range(60):
        t_s = last + lost_s + i * DT
        state = hovering(t_s, north_m=3.0 * last - 6.0, yaw_rad=yaw)
        estimate = target.update(seen(box_of(other, state)), state, t_s)
    assert estimate.seen_t_s == last


def test_the_target_itself_is_accepted_again_where_it_went_or_where_it_stayed():
    for path in (lambda t: (12.0 + 3.0 * t, 0.0), lambda t: (12.0 + 3.0 * min(t, 2.0), 0.0)):
        target = Target(CAMERA, DOWN)
        states = [hovering(i * DT, north_m=path(i * DT)[0] - 12.0) for i in range(300)]
        for i, state in enumerate(states):
            hidden = 60 <= i < 180
            track = seen(box_of(path(i * DT), state), found=not hidden)
            estimate = target.update(track, state, i * DT)
        assert estimate.seen_t_s == states[-1].t_s


@pytest.mark.parametrize("change", ["elsewhere", "much larger", "much smaller"])
def test_a_box_where_the_target_cannot_be_is_rejected(change):
    target = Target(CAMERA, DOWN)
    states = [hovering(i * DT) for i in range(61)]
    watch(target, lambda t: (12.0, 0.0), states[:60])
    true = box_of((12.0, 0.0), states[60])
    wrong = {"elsewhere": true.moved(200, 0), "much larger": true.scaled(2.5), "much smaller": true.scaled(0.4)}
    assert target.update(seen(wrong[change]), states[60], 60 * DT).seen_t_s == 59 * DT


def test_the_predicted_velocity_of_an_unseen_target_decays():
    target = Target(CAMERA, DOWN)
    watch(target, lambda t: (12.0 + 1.5 * t, 0.0), [hovering(i * DT) for i in range(90)])
    at = [target.update(None, hovering(3.0 + s), 89 * DT).range_m for s in (0.0, 2.0, 60.0, 120.0)]
    assert at[1] - at[0] == pytest.approx(2.0 * 1.5, rel=0.15)
    assert at[3] - at[0] < 1.5 * 13.0
    assert at[3] == pytest.approx(at[2], abs=0.1)


def test_after_a_loss_a_blurred_box_is_rejected():
    target = Target(CAMERA, DOWN)
    watch(target, lambda t: (12.0, 0.0), [hovering(i * DT) for i in range(60)])
    for i in range(100, 130):
        state = hovering(i * DT)
        estimate = target.update(replace(seen(box_of((12.0, 0.0), state)), psr=8.0), state, i * DT)
    assert estimate.seen_t_s == 59 * DT


def test_a_first_response_sharper_than_all_that_follow_does_not_make_the_rest_look_lost():
    target = Target(CAMERA, DOWN)
    for i, psr in enumerate([0.0, 20.0, *[9.0] * 40]):  # the box given at the start has no response
        state = hovering(i * DT)
        estimate = target.update(replace(seen(box_of((12.0, 0.0), state)), psr=psr), state, i * DT)
        assert estimate.seen_t_s == i * DT
    state = hovering(42 * DT)
    blurred = replace(seen(box_of((12.0, 0.0), state)), psr=4.0)
    assert target.update(blurred, state, 42 * DT).seen_t_s == 41 * DT


def test_uncertainty_after_a_wait_does_not_depend_on_the_number_of_predictions():
    once, often = Target(CAMERA, DOWN), Target(CAMERA, DOWN)
    for target in (once, often):
        watch(target, lambda t: (12.0, 0.0), [hovering(i * DT) for i in range(30)])
    f, step = once.filter, 1 / 3
    for i in range(1, 7):
        f = predicted(f, once.filter.t_s + i * step, Motion())
    one = predicted(often.filter, f.t_s, Motion())
    level = np.ix_((0, 1, 3, 4), (0, 1, 3, 4))
    np.testing.assert_allclose(f.covariance[level], one.covariance[level], rtol=1e-9)
    np.testing.assert_allclose(f.covariance[2, 2], one.covariance[2, 2], rtol=0.2)


def test_a_sharp_response_is_accepted_although_it_was_far_sharper_before():
    target = Target(CAMERA, DOWN)
    for i in range(60):
        state = hovering(i * DT)
        psr = 40.0 if i < 40 else 15.0
        estimate = target.update(replace(seen(box_of((12.0, 0.0), state)), psr=psr), state, i * DT)
    assert estimate.seen_t_s == pytest.approx(59 * DT)


@pytest.mark.parametrize(("size", "place"), [(0.4, (12.0, 0.0)), (6.0, (30.0, 0.0))])
def test_footage_may_show_a_target_of_any_size(size, place):
    target = FootageTarget(Target(CAMERA, DOWN), moves_view=False)
    for i in range(60):
        state = hovering(i * DT)
        estimate = target.update(seen(box_of(place, state, size)), state, i * DT)
    assert not estimate.contradiction
    assert estimate.range_m == pytest.approx(place[0], rel=0.1)


def test_a_lost_target_is_searched_along_its_path_and_each_candidate_until_it_is_judged():
    """The attitude of a frame comes one frame late, so that a box is judged after the next search was chosen."""
    target = Target(CAMERA, DOWN)
    watch(target, lambda t: (12.0, 0.0), [hovering(i * DT) for i in range(60)])
    aside = box_of((12.0, 3.0), hovering(0.0))  # 3 m beside where it was seen last
    hits = []
    for i in range(90, 240):
        state = hovering(i * DT, attitude_t_s=(i - 1) * DT)
        prior = target.predict(state, i * DT)
        near = (
            prior is not None and math.hypot(prior.centre_x - aside.centre_x, prior.centre_y - aside.centre_y) < aside.h
        )
        looked_at_it = near or (prior is None and hits[-1])  # a tracker searches about as far as the target is high
        hits.append(looked_at_it)
        estimate = target.update(seen(aside, found=looked_at_it), state, i * DT)
        if estimate.seen_t_s > 60 * DT:
            break
    assert any(hits)
    assert estimate.seen_t_s > 90 * DT


def test_a_box_that_the_border_cuts_hardly_moves_the_range():
    def ranged(row):
        target = Target(CAMERA, DOWN)
        watch(target, lambda t: (12.0, 0.0), [hovering(i * DT) for i in range(60)])
        whole = box_of((12.0, 0.0), hovering(60 * DT))
        smaller = Box.around(whole.centre_x, whole.centre_y, 0.85 * whole.w, 0.85 * whole.h)
        shift = row - smaller.y - smaller.h
        turned = hovering(60 * DT, pitch_rad=math.atan(shift / CAMERA.fy))
        for i in range(60, 75):
            state = replace(turned, t_s=i * DT, attitude_t_s=i * DT, position_t_s=i * DT, heartbeat_t_s=i * DT)
            moved = box_of((12.0, 0.0), state)
            cut = Box.around(moved.centre_x, moved.centre_y, smaller.w, smaller.h)
            estimate = target.update(seen(cut), state, i * DT)
        return estimate.range_m

    assert abs(ranged(CAMERA.height + 12) - 12.0) < 0.6 * abs(ranged(CAMERA.height - 30) - 12.0)


def test_a_restart_of_the_tracker_discards_everything_from_the_first_box():
    place, target = (11.0, 4.0), Target(CAMERA, DOWN)
    states = [hovering(i * DT) for i in range(40)]
    for state in states[:20]:
        loose = target.update(seen(box_of(place, state).scaled(2.0)), state, state.t_s)
    assert loose.range_m < 0.9 * math.hypot(*place)
    for number, state in enumerate(states[20:]):
        track = replace(seen(box_of(place, state)), restarted=number == 0, psr=20.0 if number else 0.0)
        estimate = target.update(track, state, state.t_s)
        if not number:
            fresh = Target(CAMERA, DOWN).update(track, state, state.t_s)
            assert estimate.range_m == pytest.approx(fresh.range_m)
    assert estimate.seen_t_s == states[-1].t_s
    assert estimate.range_m == pytest.approx(math.hypot(*place), rel=0.02)
