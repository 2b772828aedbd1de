"""`follow calibrate`: from a drawn board, of which the lens is known, to the file, and a flight with that file."""

import math
from dataclasses import replace

import cv2
import numpy as np
import pytest

from follow.camera.board import Board, BoardView, Pattern, diverse
from follow.camera.calibration import read_calibration
from follow.camera.lens_fit import CalibrationError, LensKind, fit_lens
from follow.cli.program import main
from follow.cli.sim import FlightSpec, simulate
from follow.config import CameraConfig, Config
from follow.geometry import Intrinsics, LensModel, distort, project
from follow.messages import Autopilot
from follow.operator.terminal import Terminal
from sim.scenarios import SCENARIOS
from sim.scene.board import BoardCamera, BoardPose, held, rotated

SCENE = SCENARIOS["lens"].camera_settings(Autopilot.PX4).intrinsics
FISHEYE = Intrinsics(640, 360, 270.0, 270.0, 322.0, 178.0, (-0.02, 0.005, -0.002, 0.0), LensModel.FISHEYE)
SIZE = 640, 360
CHECKERBOARD, CHARUCO = Board(Pattern.CHECKERBOARD, 9, 6), Board(Pattern.CHARUCO, 9, 6)


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """The file that `follow calibrate` makes from drawn images of a board, seen through the scene's own lens."""
    folder = tmp_path_factory.mktemp("board")
    camera = BoardCamera(CHARUCO, SCENE)
    for n, pose in enumerate(held(CHARUCO, SCENE, 28)):
        cv2.imwrite(str(folder / f"{n:03}.png"), camera.draw(pose, n))
    path = folder / "made" / "camera.yaml"
    assert main(["calibrate", str(folder), "--pattern", "charuco", "--board", "9x6", "--out", str(path)]) == 0
    return path


def seen(board: Board, lens: Intrinsics, poses, noise_px: float = 0.05) -> list[BoardView]:
    """Views without drawing: the corners projected, with noise, as OpenCV counts pixels."""
    random, flat = np.random.default_rng(1), board.points - board.points.mean(axis=0)
    views = []
    for n, pose in enumerate(poses):
        pixels = project(lens, np.eye(3), np.zeros(3), flat @ pose.rotation.T + pose.middle_m)[0]
        pixels += random.normal(-0.5, noise_px, pixels.shape)
        across, _ = cv2.findHomography(board.points[:, :2], pixels)
        low, high = board.points[:, :2].min(axis=0), board.points[:, :2].max(axis=0)
        outline = np.array([low, (high[0], low[1]), high, (low[0], high[1])], np.float64)
        outline = cv2.perspectiveTransform(outline[None], across)[0]
        views.append(BoardView(n, board.points, pixels.astype(np.float32), 2.0, outline))
    return views


def bent(lens: Intrinsics) -> np.ndarray:
    """How far the lens shifts points of the field, on the plane at unit depth: coefficients alone are not unique."""
    x, y = np.meshgrid(np.linspace(-1, 1, 21), np.linspace(-0.55, 0.55, 13))
    field = np.stack([x.ravel(), y.ravel()], axis=1)
    return distort(lens, field) - field


def require_same(lens: Intrinsics, true: Intrinsics) -> None:
    """Focal length within 0.5 %, distortion within 2 % of the greatest."""
    assert (lens.fx, lens.fy) == pytest.approx((true.fx, true.fy), rel=0.005)
    assert np.abs(bent(lens) - bent(true)).max() <= 0.02 * np.abs(bent(true)).max()


def test_the_file_made_of_a_drawn_board_is_the_lens_it_was_drawn_with(made, capsys):
    require_same(read_calibration(made), SCENE)
    assert made.with_suffix(".png").stat().st_size > 10_000


def test_the_lens_scene_flies_with_the_file_made_of_a_drawn_board(made, tmp_path, monkeypatch):
    monkeypatch.setitem(SCENARIOS, "lens", replace(SCENARIOS["lens"], duration_s=8.0))
    scenario = SCENARIOS["lens"]
    camera = CameraConfig(fov_deg=math.degrees(scenario.fov_rad), calibration=str(made))
    config = Config()
    config = replace(config, camera=camera, servo=replace(config.servo, standoff_m=scenario.standoff_m))
    flight = FlightSpec("lens", 0, Autopilot.PX4, "racf", config, tmp_path)
    flown = simulate(flight, Terminal(), bar=False)
    figures, finished = flown.figures, flown.finished
    assert finished
    assert figures["in_view"] == 1.0
    assert figures["standoff_rms"] < 0.25
    assert "camera.yaml" in (tmp_path / "settings.toml").read_text()


@pytest.mark.parametrize(("lens", "kind"), [(SCENE, LensKind.PINHOLE), (FISHEYE, LensKind.FISHEYE)])
def test_each_model_is_fitted(lens, kind):
    views = seen(CHECKERBOARD, lens, held(CHECKERBOARD, lens, 30, part=0.4))
    fit = fit_lens(views, SIZE, kind)
    require_same(fit.lens, lens)
    assert fit.rms_px == pytest.approx(0.05 * math.sqrt(2), rel=0.15)  # the noise that was put in
    assert abs(fit.lens.fx / lens.fx - 1) < 4 * max(fit.focal_std, 2e-4)


def test_a_checkerboard_in_an_image_is_found_within_a_fraction_of_a_pixel_and_a_blurred_one_is_known():
    camera = BoardCamera(CHECKERBOARD, SCENE)
    pose = next(iter(held(CHECKERBOARD, SCENE, 1)))
    view = CHECKERBOARD.find(camera.draw(pose))
    assert view is not None
    flat = CHECKERBOARD.points - CHECKERBOARD.points.mean(axis=0)
    true = project(SCENE, np.eye(3), np.zeros(3), flat @ pose.rotation.T + pose.middle_m)[0] - 0.5
    nearest = np.linalg.norm(view.pixels[:, None] - true[None], axis=2).min(axis=1)  # it may be found upside down
    assert np.median(nearest) < 0.25
    assert CHECKERBOARD.is_sharp(view)
    blurred = CHARUCO.find(BoardCamera(CHARUCO, SCENE).draw(pose, 0, (6.0, 2.0)))
    assert blurred is None or not CHARUCO.is_sharp(blurred)
    assert CHECKERBOARD.find(np.full((360, 640, 3), 128, np.uint8)) is None


def test_views_that_do_not_determine_the_lens_are_refused_with_the_reason():
    few = seen(CHECKERBOARD, SCENE, held(CHECKERBOARD, SCENE, 5))
    with pytest.raises(CalibrationError, match="5 usable views of the board"):
        fit_lens(few, SIZE, LensKind.PINHOLE)
    spots = [(x, y) for x in (-0.5, -0.2, 0.2, 0.5) for y in (-0.25, 0.0, 0.25)]
    flat = [BoardPose(np.eye(3), 0.5 * np.array([x, y, 1.0])) for x, y in spots]
    with pytest.raises(CalibrationError, match="0 of 12 views show the board tilted"):
        fit_lens(seen(CHECKERBOARD, replace(SCENE, distortion=()), flat), SIZE, LensKind.PINHOLE)
    turns = np.random.default_rng(0).uniform(-0.5, 0.5, (12, 2))
    middle = [BoardPose(rotated(float(a), float(b), 0.0), np.array([0.0, 0.0, 0.6])) for a, b in turns]
    with pytest.raises(CalibrationError, match="of the image, at least 40 % are needed"):
        fit_lens(seen(CHECKERBOARD, SCENE, middle), SIZE, LensKind.PINHOLE)


def test_a_view_that_does_not_fit_is_left_out():
    views = seen(CHECKERBOARD, SCENE, held(CHECKERBOARD, SCENE, 24))
    off = np.random.default_rng(2).normal(0, 2.0, views[7].pixels.shape).astype(np.float32)
    views[7] = replace(views[7], pixels=views[7].pixels + off)
    fit = fit_lens(views, SIZE, LensKind.PINHOLE)
    assert {view.index for view in fit.views} == set(range(24)) - {7}
    require_same(fit.lens, SCENE)


def test_the_views_that_are_kept_differ():
    views = seen(CHECKERBOARD, SCENE, held(CHECKERBOARD, SCENE, 12))
    copies = [replace(view, index=100 + n) for n, view in enumerate(views[:1] * 50)]
    kept = diverse([*copies, *views], SIZE, 12)
    assert sum(view.index >= 100 for view in kept) <= 1


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--board", "9by6"], "COLUMNSxROWS"),
        (["--board", "2x6"], "3 to 50 columns"),
        (["--pattern", "charuco", "--dictionary", "DICT_X"], "no dictionary"),
        (["--pattern", "charuco", "--board", "30x30"], "too few markers"),
        (["--square-m", "0"], "positive side"),
        (["--marker-fraction", "2"], "between 0 and 1"),
        (["--out", "x.png"], "not ending in .png"),
        (["--out", "x.PNG"], "not ending in .png"),
        (["--out", "/dev/null/x.yaml"], "a file that can be written"),
    ],
)
def test_a_board_that_cannot_be_is_wrong_use(words, said, tmp_path, capsys):
    assert main(["calibrate", str(tmp_path), *words]) == 2
    assert said in capsys.readouterr().err


def test_a_live_source_is_wrong_use_and_a_folder_without_a_board_fails(tmp_path, capsys):
    assert main(["calibrate", "rtsp://127.0.0.1/x"]) == 2
    assert "not the live source" in capsys.readouterr().err
    cv2.imwrite(str(tmp_path / "1.png"), np.full((90, 160, 3), 128, np.uint8))
    assert main(["calibrate", str(tmp_path), "--out", str(tmp_path / "c.yaml")]) == 1
    err = capsys.readouterr().err
    assert "9x6 for 10x7 squares" in err
    assert "0 usable views" in err
    assert not (tmp_path / "c.yaml").exists()
