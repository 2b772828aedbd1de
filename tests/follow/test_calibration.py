"""A lens from a file: files of OpenCV and ROS keep their meaning, and a bad file is refused in one sentence."""

import math
from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from follow.camera.calibration import Fit, as_opencv_yaml, fitted, parse_calibration, read_calibration
from follow.cli.program import main
from follow.config import CameraConfig
from follow.geometry import Intrinsics, LensModel, project, radial, rays
from sim.clip import write

RATIONAL = Intrinsics(640, 360, 300.0, 302.0, 322.0, 177.0, (0.5, 0.2, 0.001, -0.001, 0.01, 0.9, 0.4, 0.05))
FISHEYE = Intrinsics(640, 360, 250.0, 251.0, 318.0, 181.0, (-0.02, 0.01, -0.004, 0.001), LensModel.FISHEYE)
BARREL = Intrinsics(640, 360, 400.0, 410.0, 322.0, 177.0, (-0.25, 0.08, 0.001, -0.002, 0.01))
FOLDING = Intrinsics(640, 360, 300.0, 300.0, 320.0, 180.0, (-0.35, 0.05, 0.0, 0.0))
FIT = Fit(0.1, 20, "checkerboard 9x6")

ROS_FILE = """\
image_width: 640
image_height: 480
camera_name: forward
camera_matrix:
  rows: 3
  cols: 3
  data: [430.5, 0.0, 305.25, 0.0, 431.75, 243.5, 0.0, 0.0, 1.0]
distortion_model: plumb_bob
distortion_coefficients:
  rows: 1
  cols: 5
  data: [-0.36, 0.11, 0.001, 0.0005, 0.0]
projection_matrix:
  rows: 3
  cols: 4
  data: [393.6, 0.0, 322.7, 0.0, 0.0, 393.6, 241.0, 0.0, 0.0, 0.0, 1.0, 0.0]
"""
ROS_MESSAGE = """\
header:
  stamp:
    sec: 12
  frame_id: ''
height: 480
width: 640
distortion_model: equidistant
d:
- -0.01
- 0.002
- 0.0
- 0.0
k: [300.0, 0.0, 320.0, 0.0, 300.0, 240.0, 0.0, 0.0, 1.0]
binning_x: 2
binning_y: 2
roi:
  x_offset: 0
  y_offset: 60
  height: 360
  width: 640
  do_rectify: false
---
header:
"""


def opencv_pixels(lens, points):
    """OpenCV's own projection; its pixel 0 is centred on 0."""
    matrix = np.array([[lens.fx, 0, lens.cx - 0.5], [0, lens.fy, lens.cy - 0.5], [0, 0, 1]])
    none, k = np.zeros(3), np.array(lens.distortion)
    if lens.model is LensModel.FISHEYE:
        return cv2.fisheye.projectPoints(points[:, None], none, none, matrix, k)[0][:, 0] + 0.5
    return cv2.projectPoints(points, none, none, matrix, k)[0][:, 0] + 0.5


@pytest.mark.parametrize("lens", [BARREL, RATIONAL, FISHEYE], ids=["barrel", "rational", "fisheye"])
def test_each_model_projects_as_opencv_does_and_can_be_undone_over_the_whole_image(lens):
    points = np.random.default_rng(1).uniform((-3, -2, 3), (3, 2, 9), (200, 3))
    np.testing.assert_allclose(project(lens, np.eye(3), np.zeros(3), points)[0], opencv_pixels(lens, points), atol=1e-9)
    pixels = np.stack(np.meshgrid(np.linspace(0, 640, 41), np.linspace(0, 360, 25)), axis=-1).reshape(-1, 2)
    back, _ = project(lens, np.eye(3), np.zeros(3), 7 * rays(lens, pixels))
    np.testing.assert_allclose(back, pixels, atol=1e-6)


@given(st.floats(0.0, math.tau), st.floats(1.0, 80.0))
def test_a_point_far_outside_the_view_is_never_drawn_inside_it(around, off_axis_deg):
    """A polynomial that folds over brings what is at the side back into the image; a lens does not."""
    off = math.radians(off_axis_deg)
    ray = np.array([[math.sin(off) * math.cos(around), math.sin(off) * math.sin(around), math.cos(off)]])
    pixel = project(FOLDING, np.eye(3), np.zeros(3), ray)[0][0]
    nearer = project(FOLDING, np.eye(3), np.zeros(3), ray - (0, 0, -0.05))[0][0]
    centre = FOLDING.cx, FOLDING.cy
    assert np.linalg.norm(pixel - centre) > np.linalg.norm(nearer - centre)


def test_the_field_of_view_is_that_of_the_rays_through_the_edges():
    assert math.degrees(FISHEYE.horizontal_fov_rad) > math.degrees(replace(BARREL, fx=250.0).horizontal_fov_rad)
    straight = replace(BARREL, distortion=(0.0,) * 5)
    assert BARREL.horizontal_fov_rad > straight.horizontal_fov_rad  # a barrel shows more than its focal length says
    half = replace(FISHEYE, distortion=(), cx=320.0)
    assert half.horizontal_fov_rad == pytest.approx(2 * 320 / 250.0)  # equidistant: angle = pixels / focal length


@pytest.mark.parametrize("lens", [BARREL, RATIONAL, FISHEYE], ids=["barrel", "rational", "fisheye"])
def test_what_we_write_we_and_opencv_read(lens, tmp_path):
    path = tmp_path / "camera.yaml"
    path.write_text(as_opencv_yaml(lens, FIT))
    assert read_calibration(path) == lens
    storage = cv2.FileStorage(str(path), cv2.FileStorage_READ)
    matrix = storage.getNode("camera_matrix").mat()
    np.testing.assert_allclose(matrix, [[lens.fx, 0, lens.cx - 0.5], [0, lens.fy, lens.cy - 0.5], [0, 0, 1]])
    np.testing.assert_allclose(storage.getNode("distortion_coefficients").mat().ravel(), lens.distortion)


def test_opencvs_own_matrices_are_read():
    storage = cv2.FileStorage("c.yml", cv2.FileStorage_WRITE | cv2.FileStorage_MEMORY)
    storage.write("image_width", 640)
    storage.write("image_height", 360)
    storage.write("Camera_Matrix", np.array([[400.0, 0, 319.5], [0, 400.0, 179.5], [0, 0, 1]]))
    storage.write("Distortion_Coefficients", np.array([-0.2, 0.03, 0.0, 0.0, 0.0]))
    lens = parse_calibration(storage.releaseAndGetString().encode())
    assert lens == Intrinsics(640, 360, 400.0, 400.0, 320.0, 180.0, (-0.2, 0.03, 0.0, 0.0, 0.0))


def test_a_file_and_a_message_of_ros_are_read():
    lens = parse_calibration(ROS_FILE.encode())
    assert lens == Intrinsics(640, 480, 430.5, 431.75, 305.75, 244.0, (-0.36, 0.11, 0.001, 0.0005, 0.0))
    # Frames of the 640x360 region of interest, two by two pixels made one
    lens = parse_calibration(ROS_MESSAGE.encode())
    assert lens == Intrinsics(320, 180, 150.0, 150.0, 160.25, 90.25, (-0.01, 0.002, 0.0, 0.0), LensModel.FISHEYE)


def test_a_scaled_lens_has_the_same_rays_and_another_aspect_ratio_is_refused():
    double = fitted(RATIONAL, 1280, 720)
    pixels = np.array([(0.0, 0.0), (100.5, 300.25), (640.0, 360.0)])
    np.testing.assert_allclose(rays(double, 2 * pixels), rays(RATIONAL, pixels), atol=1e-12)
    with pytest.raises(ValueError, match="640x360 images, and frames of 640x480 have another aspect ratio"):
        fitted(RATIONAL, 640, 480)


@pytest.mark.parametrize(
    ("before", "after", "words"),
    [
        ("image_width: 640\n", "", "image_width and image_height"),
        ("image_width: 640", "image_width: -3", "1 to 100000 pixels"),
        (", 0.0, 1.0]", ", 0.0]", "camera_matrix of 9 numbers, not of 8"),
        ("430.5, 0.0", "430.5, 1.0", "skew"),
        ("430.5", "-430.5", "focal length"),
        ("430.5", ".nan", "camera_matrix must hold finite numbers"),
        ("-0.36, 0.11, ", "", "distortion coefficients, not 3"),
        ("-0.36", "-2.0", "folds over"),
        ("plumb_bob", "mei", "distortion_model must be"),
        ("camera_matrix:", "camera_matrix", "must be YAML"),
    ],
)
def test_a_bad_file_is_refused_in_one_sentence_that_names_it(before, after, words, tmp_path, capsys):
    assert before in ROS_FILE
    path = tmp_path / "lens.yaml"
    path.write_text(ROS_FILE.replace(before, after, 1))
    with pytest.raises(ValueError, match=words):
        read_calibration(path)
    assert main(["sim", "lens", "--camera.calibration", str(path), "--out", str(tmp_path / "out")]) == 2
    said = capsys.readouterr().err.strip()
    assert said.count("\n") == 0
    assert str(path) in said
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("data", [b"", b"\0\1\2", b"\xff\xfe{", b"- 1\n- 2\n", b"[", b"a: [1, 2\n", b"x" * 2_000_000])
def test_what_is_no_calibration_is_refused(data):
    with pytest.raises(ValueError, match=r"\w"):
        parse_calibration(data)


def test_a_missing_file_and_frames_of_another_shape_are_wrong_use(tmp_path, capsys):
    missing = tmp_path / "none.yaml"
    assert main(["sim", "lens", "--camera.calibration", str(missing)]) == 2
    assert "is not a regular file" in capsys.readouterr().err
    path = tmp_path / "lens.yaml"
    path.write_text(ROS_FILE)
    assert main(["sim", "lens", "--camera.calibration", str(path), "--out", str(tmp_path / "out")]) == 2
    assert "another aspect ratio" in capsys.readouterr().err


def test_a_window_over_footage_of_a_bent_lens_is_refused_and_moves_no_recording(tmp_path, capsys):
    path, out = tmp_path / "lens.yaml", tmp_path / "out"
    path.write_text(as_opencv_yaml(BARREL, FIT))
    write(tmp_path / "clip.mp4", 3)
    words = ["replay", str(tmp_path / "clip.mp4"), "--truth", str(tmp_path / "clip.txt"), "--out", str(out)]
    assert main([*words, "--ptz", "--camera.calibration", str(path)]) == 2
    assert "undistort the footage first" in capsys.readouterr().err
    assert not out.exists()


def test_the_settings_lens_is_the_calibrations_at_the_frames_size(tmp_path):
    path = tmp_path / "lens.yaml"
    path.write_text(as_opencv_yaml(BARREL, FIT))
    assert CameraConfig(calibration=str(path)).intrinsics(1280, 720) == fitted(BARREL, 1280, 720)


def test_where_a_polynomial_ends_is_where_its_slope_does():
    """r(1 - 0.35 r² + 0.05 r⁴) has its greatest value where 1 - 1.05 r² + 0.25 r⁴ = 0."""
    top = math.sqrt((1.05 - math.sqrt(1.05**2 - 1.0)) / 0.5)
    assert radial(LensModel.PINHOLE, FOLDING.distortion).end == pytest.approx(top, abs=0.03)
    assert math.isinf(radial(LensModel.PINHOLE, (-0.18, 0.03, 0.0, 0.0, 0.0)).end)
