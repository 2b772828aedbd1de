"""Background motion: measured on images of known motion, and compared with the prediction."""

import math
from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from follow.control.image_motion import FEWEST, ImageMotionMeter, corners, goes_along, shrunk_grey, solve
from follow.geometry import Intrinsics, camera_to_ned, ground_points, rays
from follow.messages import Frame, ImageMotion, VehicleState
from follow.safety.consistency import Consistency, box_gain, whole_gain
from racf.box import Box
from racf.track import Track

LENS = Intrinsics.from_fov(320, 180, math.radians(80.0))
DOWN_RAD = math.radians(30.0)
FPS = 30.0
TEXTURE = cv2.GaussianBlur(np.random.default_rng(0).integers(0, 255, (1600, 1600), np.uint8), (0, 0), 2.5)
M_PER_TEXEL = 0.05


def state(t_s, north=0.0, height=8.0, yaw=0.0, pitch=0.0, north_m_s=0.0, yaw_rate=0.0):
    """A vehicle state whose every group is fresh at `t_s`."""
    return VehicleState(
        t_s,
        attitude_t_s=t_s,
        pitch_rad=pitch,
        yaw_rad=yaw,
        yaw_rate_rad_s=yaw_rate,
        position_t_s=t_s,
        north_m=north,
        down_m=-height,
        north_m_s=north_m_s,
        heartbeat_t_s=t_s,
    )


def image_of(s: VehicleState, lens: Intrinsics = LENS, down_rad: float = DOWN_RAD, ground_down_m: float = 0.0):
    """The textured flat ground as the camera sees it: each pixel's ray is met with the ground."""
    rotation = camera_to_ned(down_rad, s.roll_rad, s.pitch_rad, s.yaw_rad)
    columns, rows = np.meshgrid(np.arange(lens.width) + 0.5, np.arange(lens.height) + 0.5)
    pixels = np.stack([columns.ravel(), rows.ravel()], axis=1)
    at = ground_points(lens, rotation, (s.north_m, s.east_m, s.down_m), pixels, ground_down_m)[:, :2]
    texels = np.clip(
        np.nan_to_num(np.stack([800 + at[:, 1] / M_PER_TEXEL, 800 - at[:, 0] / M_PER_TEXEL]), nan=-9), -9, 1700
    )
    map_x, map_y = texels.reshape(2, lens.height, lens.width).astype(np.float32)
    return cv2.remap(TEXTURE, map_x, map_y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=200)


def flown(motion, seconds=1.2, see=image_of, box=None, heard=lambda s: s, **meter):
    """The measurements of a flight: `motion(t)` gives the keywords of `state`, `see(state)` the image, `heard(state)`
    the telemetry."""
    measure = ImageMotionMeter(LENS, DOWN_RAD, **meter)
    found = []
    for n in range(round(seconds * FPS)):
        t_s = n / FPS
        s = state(t_s, **motion(t_s))
        at = box(t_s) if box else None
        track = Track(at, at, 20.0, 1.0, 1.0) if at else None
        if (one := measure.update(Frame(see(s), t_s, n), track, heard(s))) is not None:
            found.append(one)
    return found


def fit(motions: list[ImageMotion]):
    return solve(
        *(sum(getattr(m, name) for m in motions) for name in ("rr_px2", "rt_px2", "tt_px2", "mr_px2", "mt_px2"))
    )


def turning(t_s):
    return {"yaw": 0.4 * t_s, "yaw_rate": 0.4, "pitch": 0.03 * math.sin(7 * t_s)}


def flying(t_s):
    return {**turning(t_s), "north": 3.0 * t_s, "north_m_s": 3.0}


def test_a_sound_camera_has_gain_one_for_rotation_and_for_translation():
    a, b = fit(flown(flying))
    assert (a, b) == pytest.approx((1.0, 1.0), abs=0.05)


@pytest.mark.parametrize("lower_m", [-3.0, 4.0])
def test_the_translation_gain_is_the_assumed_over_the_true_height(lower_m):
    a, b = fit(flown(flying, see=lambda s: image_of(s, ground_down_m=lower_m)))
    assert a == pytest.approx(1.0, abs=0.06)
    assert b == pytest.approx(8.0 / (8.0 + lower_m), rel=0.1)


def test_a_turning_camera_turned_upside_down_has_gain_minus_one():
    motions = flown(turning, see=lambda s: np.ascontiguousarray(image_of(s)[::-1, ::-1]))
    assert whole_gain(motions).value == pytest.approx(-1.0, abs=0.15)
    assert "does not move with the vehicle" in judged(motions)


@pytest.mark.parametrize(("fov_deg", "above"), [(130.0, False), (45.0, True)])
def test_another_lens_than_the_settings_say_is_contradicted(fov_deg, above):
    lens = Intrinsics.from_fov(320, 180, math.radians(fov_deg))
    motions = flown(turning, 3.2, see=lambda s: image_of(s, lens))
    assert (whole_gain(motions).value > 1.0) is above
    assert "field of view" in judged(motions)


def judged(motions):
    watch = Consistency()
    return [watch.update(m, m.t_s) for m in motions][-1]


@pytest.mark.parametrize("motion", [turning, flying])
def test_a_sound_camera_is_never_contradicted(motion):
    watch = Consistency()
    assert not any(watch.update(m, m.t_s) for m in flown(motion, 3.0))


@pytest.mark.parametrize("fault", ["noise", "clock", "two buffers"])
def test_a_frozen_image_is_contradicted_within_a_second_although_its_bytes_change(fault):
    random, held = np.random.default_rng(1), [image_of(state(0.0)), image_of(state(1 / FPS, **flying(1 / FPS)))]
    count = iter(range(10_000))

    def see(s):
        n = next(count)
        if fault == "two buffers":
            return held[n % 2]
        image = held[0].copy()
        if fault == "clock":
            image[4:20, 4:100] = random.integers(0, 255, (16, 96))
            return image
        return np.clip(image + random.normal(0, 4, image.shape), 0, 255).astype(np.uint8)

    motions = flown(flying, 1.0, see=see)
    assert "does not move with the vehicle" in judged(motions)


def test_a_vehicle_that_hovers_still_is_never_contradicted():
    frozen = image_of(state(0.0))
    motions = flown(lambda _t: {"pitch": 0.0}, 2.0, see=lambda _s: frozen)
    assert motions
    assert judged(motions) == ""


def wobbling(t_s):
    return {"pitch": 0.05 * math.sin(9 * t_s), "north": 3.0 * t_s, "north_m_s": 3.0}


def test_a_box_that_rides_on_the_vehicle_is_contradicted_and_one_in_the_world_is_not():
    def in_the_world(t_s):
        return Box.around(160 + 4 * t_s, 90 + LENS.fy * 0.05 * math.sin(9 * t_s), 12, 30)

    riding = flown(wobbling, 3.0, box=lambda _t: Box.around(160, 90, 12, 30))
    sound = flown(wobbling, 3.0, box=in_the_world)
    assert abs(box_gain(riding).value) < 0.1
    assert "rides on the vehicle" in judged(riding)
    assert box_gain(sound).value == pytest.approx(1.0, abs=0.15)
    assert judged(sound) == ""


def test_an_old_contradiction_is_forgotten_when_nothing_is_measured():
    held = image_of(state(0.0))
    motions = flown(flying, 1.2, see=lambda _s: held)
    watch = Consistency()
    for m in motions:
        watch.update(m, m.t_s)
    assert watch.update(None, motions[-1].t_s + 0.3)
    assert not watch.update(None, motions[-1].t_s + 2.0)


def test_an_image_without_corners_measures_nothing():
    grey = np.full((360, 640), 128, np.uint8)
    assert flown(flying, 1.0, see=lambda _s: grey) == []


@pytest.mark.parametrize("times", [1, 2, 4])
def test_corners_keep_away_from_the_box_whatever_the_size_of_the_image(times):
    colour = np.repeat(image_of(state(0.0))[:, :, None], 3, axis=2)
    image, scale = shrunk_grey(cv2.resize(colour, None, fx=times, fy=times))
    assert (image.shape, scale) == ((180, 320), times)
    found = corners(image, Box(100.0 * times, 50.0 * times, 50.0 * times, 60.0 * times), scale)
    assert len(found) >= FEWEST
    x, y = found[:, 0].T
    assert not np.any((x > 87) & (x < 163) & (y > 34) & (y < 126))


@pytest.mark.parametrize("lower_m", [-3.0, 0.0, 4.0])
def test_parallax_measures_the_height_above_the_ground_around_the_feet(lower_m):
    motions = flown(flying, 2.0, see=lambda s: image_of(s, ground_down_m=lower_m), box=lambda _t: Box(150, 60, 12, 40))
    told = [m for m in motions if math.isfinite(m.height_std_m)]
    assert len(told) >= len(motions) / 2
    for m in told:
        assert abs(m.height_m - (8.0 + lower_m)) < 3 * m.height_std_m
        assert m.height_std_m < 0.35 * m.height_m


@given(st.floats(0.65, 1.35), st.floats(-math.pi, math.pi), st.floats(0.8, 4.0), st.floats(0.0, 0.2))
def test_a_shadow_moves_with_its_target_and_the_ground_beside_it_does_not(ratio, angle, speed, noise):
    """`ratio`: of the ground's motion to the expected one; `speed`: of the target over the ground, in that motion."""
    t = np.array([[0.0, 10.0]] * 4)
    went = t[0] + 10.0 * speed * np.array([math.sin(angle), math.cos(angle)])
    wobble = 10.0 * noise * np.array([[1.0, 0.0], [0.0, -1.0], [-0.7, 0.7], [0.0, 0.0]])
    assert np.all(goes_along(went + wobble, t, went))
    assert not np.any(goes_along(ratio * t, t, went))
    assert not np.any(goes_along(ratio * t, t, t[0]))  # a target that stands


@pytest.mark.parametrize("again_s", [2.0, 9.0])
def test_no_height_is_measured_over_a_gap_in_the_telemetry(again_s):
    """Positions are missing from 1 s on while the vehicle flies on: its unknown motion would look like a low height."""

    def heard(s):
        old = state(1.0, **flying(1.0))
        places = {name: getattr(old, name) for name in ("position_t_s", "north_m", "down_m", "north_m_s")}
        return replace(s, **places) if 1.0 < s.t_s < again_s else s

    motions = flown(flying, 3.0, box=lambda _t: Box(150, 60, 12, 40), heard=heard)
    told = [m for m in motions if math.isfinite(m.height_std_m)]
    assert told
    assert any(m.from_t_s > 1.0 and m.t_s < again_s for m in motions), "the image is judged all the same"
    assert not any(m.t_s > 1.0 and m.from_t_s < again_s for m in told)
    assert all(abs(m.height_m - 8.0) < 3 * m.height_std_m for m in told)


def stepped(s: VehicleState, edge_m: float, step_m: float, beyond_m: float = 1e3):
    """The ground, and on it a block `step_m` high from `edge_m` to `beyond_m` north: a wall with a roof.

    Of each pixel's ray the nearest of three is seen: the ground, the roof where the block is, and the wall's face
    toward the vehicle, whose texture is that of the ground turned up.
    """
    rotation = camera_to_ned(DOWN_RAD, s.roll_rad, s.pitch_rad, s.yaw_rad)
    columns, rows = np.meshgrid(np.arange(LENS.width) + 0.5, np.arange(LENS.height) + 0.5)
    ray = rays(LENS, np.stack([columns.ravel(), rows.ravel()], axis=1)) @ rotation.T
    with np.errstate(divide="ignore", invalid="ignore"):
        fall = np.where(ray[:, 2] > 0.0, ray[:, 2], np.nan)
        ground, roof = -s.down_m / fall, (-s.down_m - step_m) / fall
        wall = (edge_m - s.north_m) / ray[:, 0]
        over, up = s.north_m + roof * ray[:, 0], -s.down_m - wall * ray[:, 2]
    roof = np.where((over > edge_m) & (over < beyond_m) & (roof > 0), roof, np.nan)
    wall = np.where((up > 0) & (up < step_m) & (wall > 0), wall, np.nan)
    seen = np.fmin(np.fmin(ground, roof), wall)
    at = s.north_m + seen * ray[:, 0] + np.where(seen == wall, up, 0.0), s.east_m + seen * ray[:, 1]
    texels = np.clip(np.nan_to_num([800 + at[1] / M_PER_TEXEL, 800 - at[0] / M_PER_TEXEL], nan=-9), -9, 1700)
    map_x, map_y = texels.reshape(2, LENS.height, LENS.width).astype(np.float32)
    return cv2.remap(TEXTURE, map_x, map_y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=200)


@pytest.mark.parametrize("step_m", [2.5, 5.0])
@pytest.mark.parametrize("edge_m", [8.0, 11.0, 14.0, 17.0])
@pytest.mark.parametrize("thick_m", [0.3, 1e3])
def test_corners_on_a_wall_or_at_a_roofs_edge_give_no_height(step_m, edge_m, thick_m):
    """The vehicle flies 6 m towards a block; the feet are 11 m ahead.  What is told is a height over one plane.

    That plane is the ground, or the roof where it is large enough to stand on.
    """
    see = lambda s: stepped(s, edge_m, step_m, edge_m + thick_m)  # noqa: E731
    motions = flown(flying, 2.0, see=see, box=lambda _t: Box(150, 60, 12, 40))
    planes = (8.0, 8.0 - step_m) if thick_m > 1.0 else (8.0,)
    for m in motions:
        if math.isfinite(m.height_std_m):
            assert min(abs(m.height_m - plane) for plane in planes) < 1.5 * m.height_std_m


def test_a_vehicle_that_hovers_exactly_still_gets_no_height():
    motions = flown(lambda _t: {}, 1.0, box=lambda _t: Box(150, 60, 12, 40))
    assert motions
    assert all(math.isinf(m.height_std_m) for m in motions)


def test_a_vehicle_that_only_turns_gets_no_height():
    assert all(math.isinf(m.height_std_m) for m in flown(turning, 1.0, box=lambda _t: Box(150, 60, 12, 40)))


def test_intervals_with_a_gap_between_them_are_no_evidence_about_the_box():
    one = ImageMotion(0.0, 0.2, 20, 1.0, 0.0, 0.0, 1.0, 0.0, 1.0, (0.0, 0.0), (0.0, 0.0))
    later = replace(one, from_t_s=2.0, t_s=2.2, box_expected_px=(0.0, 50.0))
    assert box_gain([one, later]) is None
    assert box_gain([one, replace(later, from_t_s=0.2, t_s=0.4)]).value == 0.0


def hovering(t_s):
    """Wobble and drift of a simulated quadrotor in Hold."""
    return {
        "pitch": 0.015 * math.sin(9 * t_s) + 0.02 * math.sin(4 * t_s),
        "north": 0.02 * math.sin(2 * t_s),
        "north_m_s": 0.04 * math.cos(2 * t_s),
    }


@pytest.mark.parametrize("late_s", [-0.05, 0.05])
def test_a_hover_gives_no_height_although_the_times_of_its_frames_are_wrong(late_s):
    """What rotation does not explain is then larger than the translation, and points along it by chance."""

    def see(s):
        return image_of(state(s.t_s, **hovering(s.t_s - late_s)))

    motions = flown(hovering, 6.0, see=see, box=lambda _t: Box(150, 60, 12, 40))
    assert len(motions) > 20
    assert [m.height_m for m in motions if math.isfinite(m.height_std_m)] == []


@pytest.mark.parametrize("gap", [(-1.0, 0.3), (0.3, 0.8)])
def test_an_interval_whose_attitude_is_not_known_is_dropped(gap):
    """Before the first message, or while the loop stood still: interpolation over it misses the wobble."""
    measure = ImageMotionMeter(LENS, DOWN_RAD)
    found, known = [], state(gap[1] + 1 / FPS, **hovering(gap[1] + 1 / FPS)) if gap[0] < 0 else state(0.0)
    for n in range(60):
        t_s = n / FPS
        s = state(t_s, **hovering(t_s))
        if not gap[0] < t_s <= gap[1]:
            known = s
        found.append(measure.update(Frame(image_of(s), t_s, n), None, replace(known, t_s=t_s)))
    told = [m for m in found if m is not None]
    assert len(told) >= 3
    assert not any(gap[0] < t < gap[1] for m in told for t in (m.from_t_s, m.t_s))
