import math

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from follow.geometry import (
    Intrinsics,
    bearing,
    body_to_ned,
    camera_to_ned,
    ground_points,
    heading_to_ned,
    ned_to_heading,
    pixel,
    project,
    rays,
    wrap,
)

CAMERA = Intrinsics.from_fov(640, 360, math.radians(80))
LENS = Intrinsics(640, 360, 400.0, 410.0, 322.0, 177.0, (-0.25, 0.08, 0.001, -0.002, 0.01))
LEVEL = camera_to_ned(math.radians(25), 0.0, 0.0, 0.0)

angles = st.floats(-0.5, 0.5)
yaws = st.floats(-10, 10)


def test_projection_equals_opencvs():
    rng = np.random.default_rng(1)
    points = rng.uniform((-3, -2, 4), (3, 2, 20), (50, 3))
    ours, depth = project(LENS, np.eye(3), np.zeros(3), points)
    matrix = np.array([[LENS.fx, 0, LENS.cx], [0, LENS.fy, LENS.cy], [0, 0, 1]])
    theirs, _ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), matrix, np.array(LENS.distortion))
    np.testing.assert_allclose(ours, theirs[:, 0], atol=1e-9)
    np.testing.assert_allclose(depth, points[:, 2])


@given(angles, angles, yaws)
def test_rotation_equals_three_elementary_ones(roll, pitch, yaw):
    def about(axis, angle):
        return cv2.Rodrigues(np.eye(3)[axis] * angle)[0]

    np.testing.assert_allclose(
        body_to_ned(roll, pitch, yaw), about(2, yaw) @ about(1, pitch) @ about(0, roll), atol=1e-9
    )


@given(st.floats(5, 635), st.floats(5, 355), angles, angles, yaws)
def test_a_pixels_bearing_appears_at_the_pixel(x, y, roll, pitch, yaw):
    rotation = camera_to_ned(0.4, roll, pitch, yaw)
    found = pixel(CAMERA, rotation, *bearing(CAMERA, rotation, x, y))
    assert found == pytest.approx((x, y), abs=1e-6)


@given(st.floats(20, 620), st.floats(20, 340))
def test_undistort_inverts_distort(x, y):
    ray = rays(LENS, [(x, y)])
    np.testing.assert_allclose(project(LENS, np.eye(3), np.zeros(3), 7 * ray)[0], [(x, y)], atol=1e-4)


@given(angles, angles, st.floats(-0.8, 0.8), st.floats(0.3, 1.2))
def test_bearing_does_not_depend_on_roll_and_pitch(roll, pitch, azimuth, depression):
    rotation = camera_to_ned(0.4, roll, pitch, 0.0)
    place = pixel(CAMERA, rotation, azimuth, depression)
    if place is not None:
        assert bearing(CAMERA, rotation, *place) == pytest.approx((azimuth, depression), abs=1e-9)


def test_right_in_the_image_is_right_of_the_heading_and_low_is_down():
    centre = bearing(CAMERA, LEVEL, 320, 180)
    assert centre == pytest.approx((0, math.radians(25)))
    assert bearing(CAMERA, LEVEL, 400, 180)[0] > 0
    assert bearing(CAMERA, LEVEL, 320, 300)[1] > centre[1]


@given(st.floats(0, 640), st.floats(0, 360), angles, yaws, st.floats(2, 100))
def test_ground_points_lie_on_the_ground_and_project_back(x, y, roll, yaw, height):
    rotation = camera_to_ned(0.9, roll, 0.0, yaw)
    place = np.array([3.0, -7.0, -height])
    ground = ground_points(CAMERA, rotation, place, [(x, y)])
    if np.isfinite(ground).all():
        assert ground[0, 2] == pytest.approx(0, abs=1e-6)
        np.testing.assert_allclose(project(CAMERA, rotation, place, ground)[0], [(x, y)], atol=1e-5)


def test_a_ray_into_the_sky_has_no_ground_point():
    above = ground_points(CAMERA, camera_to_ned(-0.5, 0.0, 0.0, 0.0), (0, 0, -10), [(320, 10)])
    assert np.isnan(above).all()


def test_a_point_behind_the_camera_has_no_pixel():
    pixels, depth = project(CAMERA, LEVEL, np.zeros(3), [(-10.0, 0.0, 0.0)])
    assert depth[0] < 0
    assert np.isnan(pixels).all()


@given(st.floats(-100, 100))
def test_wrapping_keeps_the_direction(angle):
    assert -math.pi <= wrap(angle) < math.pi
    assert math.cos(wrap(angle)) == pytest.approx(math.cos(angle), abs=1e-9)


@given(st.floats(0.2, 2.8))
def test_field_of_view_is_the_given_one(fov):
    assert Intrinsics.from_fov(640, 360, fov).horizontal_fov_rad == pytest.approx(fov)


@pytest.mark.parametrize("bad", [0.0, -1.0, math.pi, math.nan])
def test_an_impossible_field_of_view_is_refused(bad):
    with pytest.raises(ValueError, match="field of view"):
        Intrinsics.from_fov(640, 360, bad)


def test_an_image_without_area_or_focal_length_is_refused():
    with pytest.raises(ValueError, match="positive width"):
        Intrinsics(0, 360, 1, 1, 0, 0)
    with pytest.raises(ValueError, match="focal length"):
        Intrinsics(640, 360, -1, 1, 0, 0)


@given(st.floats(-50, 50), st.floats(-50, 50), yaws)
def test_a_level_vector_turned_into_ned_and_back_is_itself_and_agrees_with_the_body_rotation(forward, right, heading):
    north, east = heading_to_ned(forward, right, heading)
    assert ned_to_heading(north, east, heading) == pytest.approx((forward, right), abs=1e-9)
    np.testing.assert_allclose(body_to_ned(0.0, 0.0, heading) @ (forward, right, 0.0), (north, east, 0.0), atol=1e-9)


def test_heading_east_forward_is_east_and_right_is_south():
    assert heading_to_ned(1.0, 0.0, math.pi / 2) == pytest.approx((0.0, 1.0))
    assert heading_to_ned(0.0, 1.0, math.pi / 2) == pytest.approx((-1.0, 0.0))
