"""A lens from views of a board, by OpenCV's calibration, with its uncertainty."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from typing import Any

import cv2
import numpy as np

from follow.camera.board import BoardView
from follow.camera.calibration import require_one_to_one
from follow.geometry import Array, Intrinsics, LensModel, rays

FEWEST_VIEWS = 8  # six parameters a view, and nine of the lens; OpenCV's guide asks for ten or more
TILTED = 0.06  # keystone of a board tilted by some 15 degrees that takes a third of the view
FEWEST_TILTED = 4  # without tilt a longer lens and a farther board look the same
CELLS = (8, 5)  # of the image, for its coverage
LEAST_COVERAGE = 0.4  # outside the observed corners the distortion is an extrapolation
GOOD_COVERAGE = 0.7
GROUPS = 4  # jackknife: each is left out once, and the change of the lens is its uncertainty
FOCAL_STD = 0.02  # largest relative deviation of a usable calibration
OUTLIER = 3.0  # times the median error of a view: the image was blurred or the board bent
ROUNDS = 3  # of removing outliers


class LensKind(str, Enum):
    """Which of OpenCV's models is fitted: Brown-Conrady (5 coefficients) or fisheye (4).

    Its rational model is not: the same views with a quarter left out gave focal lengths that differed by 19 %.
    """

    PINHOLE = "pinhole"
    FISHEYE = "fisheye"


@dataclass(frozen=True, slots=True)
class LensFit:
    """A lens with its reprojection error (rms, pixels), the views used, and the residuals (N, 2) of each view.

    `focal_std` is relative, `edge_std_rad` the uncertainty of the rays through the image's corners.
    """

    lens: Intrinsics
    rms_px: float
    views: tuple[BoardView, ...]
    residuals: tuple[Array, ...]
    coverage: float
    focal_std: float
    edge_std_rad: float


class CalibrationError(ValueError):
    """The views do not determine the lens; the message says why and what to do."""


def fit_lens(views: Sequence[BoardView], size: tuple[int, int], kind: LensKind) -> LensFit:
    """The lens of `size` (width, height) images.  Raises CalibrationError for views that do not determine it."""
    require_views(views, size)
    kept = without_outliers(views, size, kind)
    lens, residuals = solved(kept, size, kind)
    require_views(kept, size)
    others = [solved([v for n, v in enumerate(kept) if n % GROUPS != g], size, kind)[0] for g in range(GROUPS)]
    focal = np.array([other.fx for other in others])
    spread = math.sqrt((GROUPS - 1) / GROUPS)  # of a jackknife's sums of squares
    focal_std = spread * float(np.linalg.norm(focal - focal.mean())) / lens.fx
    if not focal_std <= FOCAL_STD:
        raise CalibrationError(
            f"the focal length is known only within {100 * focal_std:.1f} %: tilt the board more, to all sides, and "
            "bring it nearer"
        )
    try:
        require_one_to_one(lens)
    except ValueError as error:
        raise CalibrationError(str(error)) from None
    corners = [(0.0, 0.0), (lens.width, 0.0), (0.0, lens.height), (lens.width, lens.height)]
    off = np.stack([np.linalg.norm(rays(other, corners) - rays(lens, corners), axis=1) for other in others])
    edge_std_rad = spread * float(np.max(np.linalg.norm(off, axis=0)))
    covered = coverage(kept, size)
    return LensFit(lens, rms_px(residuals), tuple(kept), tuple(residuals), covered, focal_std, edge_std_rad)


def rms_px(residuals: Sequence[Array]) -> float:
    """Root mean square of the corners' distances, pixels."""
    return math.sqrt(float(np.mean(np.concatenate([np.sum(part**2, axis=1) for part in residuals]))))


def without_outliers(views: Sequence[BoardView], size: tuple[int, int], kind: LensKind) -> list[BoardView]:
    """The views without those that fit far worse than the others: they are blurred, or the board was bent."""
    kept = list(views)
    for _ in range(ROUNDS):
        errors = [rms_px([part]) for part in solved(kept, size, kind)[1]]
        better = [view for view, e in zip(kept, errors, strict=True) if e <= OUTLIER * float(np.median(errors))]
        if len(better) == len(kept) or len(better) < FEWEST_VIEWS:
            break
        kept = better
    return kept


def require_views(views: Sequence[BoardView], size: tuple[int, int]) -> None:
    """Raise CalibrationError for too few views, too little tilt, or a board that was held in one part of the image."""
    if len(views) < FEWEST_VIEWS:
        raise CalibrationError(
            f"{len(views)} usable views of the board, at least {FEWEST_VIEWS} are needed: show it longer, in "
            "more places"
        )
    tilted = sum(view.keystone > TILTED for view in views)
    if tilted < FEWEST_TILTED:
        raise CalibrationError(
            f"{tilted} of {len(views)} views show the board tilted, at least {FEWEST_TILTED} must: tilt it by 20 to 40 "
            "degrees to each side; without tilt the focal length cannot be told from the distance"
        )
    covered = coverage(views, size)
    if covered < LEAST_COVERAGE:
        raise CalibrationError(
            f"the board was seen in {100 * covered:.0f} % of the image, at least {100 * LEAST_COVERAGE:.0f} % are "
            "needed: move it through the whole image, also into the corners"
        )


def coverage(views: Sequence[BoardView], size: tuple[int, int]) -> float:
    """Fraction of the image's cells in which a corner was seen."""
    pixels = np.concatenate([view.pixels for view in views])
    cells = np.clip((pixels / size * CELLS).astype(int), 0, (CELLS[0] - 1, CELLS[1] - 1))
    return len(np.unique(cells, axis=0)) / (CELLS[0] * CELLS[1])


def solved(views: Sequence[BoardView], size: tuple[int, int], kind: LensKind) -> tuple[Intrinsics, list[Array]]:
    """The lens by OpenCV, and each view's (N, 2) residuals in pixels.  Raises CalibrationError if it finds none."""
    points, pixels = [view.points for view in views], [view.pixels for view in views]
    try:
        if kind is LensKind.FISHEYE:
            matrix, distortion, turns, places = _solved_fisheye(points, pixels, size)
        else:
            empty = np.zeros((0, 0))
            solution: Any = cv2.calibrateCamera(points, pixels, size, empty, empty)
            matrix, distortion, turns, places = solution[1:5]
    except cv2.error as error:
        raise CalibrationError(f"OpenCV finds no {kind.value} lens for these views: {error.err}") from None
    k = np.asarray(distortion).ravel()[: {LensKind.PINHOLE: 5, LensKind.FISHEYE: 4}[kind]]
    residuals: list[Array] = []
    for view, turn, place in zip(views, turns, places, strict=True):
        if kind is LensKind.FISHEYE:
            there, _ = cv2.fisheye.projectPoints(view.points[:, None].astype(np.float64), turn, place, matrix, k)
        else:
            there, _ = cv2.projectPoints(view.points, turn, place, matrix, k)
        residuals.append(np.asarray(view.pixels - there.reshape(-1, 2), np.float64))
    m = np.asarray(matrix, np.float64)
    model = LensModel.FISHEYE if kind is LensKind.FISHEYE else LensModel.PINHOLE
    try:
        centre = float(m[0, 2]) + 0.5, float(m[1, 2]) + 0.5
        coefficients = tuple(float(c) for c in k)
        return Intrinsics(*size, float(m[0, 0]), float(m[1, 1]), *centre, coefficients, model), residuals
    except ValueError as error:
        raise CalibrationError(f"OpenCV's {kind.value} fit of these views is not a lens: {error}") from None


def _solved_fisheye(
    points: Sequence[np.ndarray], pixels: Sequence[np.ndarray], size: tuple[int, int]
) -> tuple[Any, ...]:
    """(matrix, coefficients, rotations, places) by OpenCV, from the focal length of an equidistant 120-degree lens."""
    guess = size[0] / math.radians(120.0)
    matrix = np.array([[guess, 0, size[0] / 2 - 0.5], [0, guess, size[1] / 2 - 0.5], [0, 0, 1]])
    fisheye: Any = cv2.fisheye
    names = "CALIB_RECOMPUTE_EXTRINSIC", "CALIB_FIX_SKEW", "CALIB_USE_INTRINSIC_GUESS"
    flags = sum(getattr(fisheye, name, None) or getattr(cv2, name) for name in names)  # OpenCV 4, or 5
    stop = cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 100, 1e-8
    return fisheye.calibrate(
        [part[None].astype(np.float64) for part in points],
        [part[None].astype(np.float64) for part in pixels],
        size,
        matrix,
        np.zeros(4),
        flags=flags,
        criteria=stop,
    )[1:5]
