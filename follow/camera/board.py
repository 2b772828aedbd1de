"""A calibration board in an image: its corners, the image's sharpness, and which views to keep."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import Enum
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from follow.geometry import Array

SEARCH_WIDTH = 1000  # pixels: a larger image is first searched at this width, which is faster if there is no board
FEWEST_CORNERS = 8  # of a ChArUco board that is partly hidden: a view has 6 unknowns
PATCH_PX = 7  # around a corner, to both sides, for its sharpness
WIDEST_EDGE_PX = 4.5  # dark to light at a corner; a sharp image has 1.5 to 3, OpenCV's guide asks for less than 3
EDGE_OF_SQUARE = 0.35  # an edge may be at most this fraction of a square: far boards have small squares
MARKER_FRACTION = 0.75  # side of a marker over that of its square, the usual one


class Pattern(str, Enum):
    """What is printed on the board."""

    CHECKERBOARD = "checkerboard"
    CHARUCO = "charuco"


@dataclass(frozen=True, slots=True)
class BoardView:
    """Corners of one image: (N, 3) metres on the board, (N, 2) pixels (pixel 0 centred on 0), and the edges' width."""

    index: int
    points: NDArray[np.float32]
    pixels: NDArray[np.float32]
    edge_px: float
    outline: Array = field(default_factory=lambda: np.zeros((4, 2)))  # where the board's outer corners are, pixels

    @property
    def keystone(self) -> float:
        """|ln| of the larger ratio of opposite sides: 0 for a board that faces the camera."""
        sides = np.linalg.norm(np.roll(self.outline, -1, axis=0) - self.outline, axis=1)
        return max(abs(math.log(sides[0] / sides[2])), abs(math.log(sides[1] / sides[3])))


class Board:
    """A checkerboard of `columns` x `rows` inner corners, or a ChArUco board of that many squares.

    Raises ValueError for a board that has no such pattern, or a dictionary that OpenCV does not have.
    """

    def __init__(
        self,
        pattern: Pattern,
        columns: int,
        rows: int,
        square_m: float = 0.025,
        dictionary: str = "DICT_4X4_50",
        marker_fraction: float = MARKER_FRACTION,
    ) -> None:
        if min(columns, rows) < 3 or max(columns, rows) > 50:
            raise ValueError(f"a board has 3 to 50 columns and rows, not {columns}x{rows}")
        if not 0 < square_m < math.inf:
            raise ValueError(f"a board's square has a positive side, not {square_m:g} m")
        self.pattern, self.columns, self.rows, self.square_m = pattern, columns, rows, square_m
        self.charuco: Any = None
        if pattern is Pattern.CHARUCO:
            number = getattr(cv2.aruco, dictionary, None) if dictionary.startswith("DICT_") else None
            if number is None:
                raise ValueError(
                    f"OpenCV has no dictionary {dictionary!r}; it has DICT_4X4_50, DICT_5X5_100 and others"
                )
            words = cv2.aruco.getPredefinedDictionary(number)
            if columns * rows // 2 > len(words.bytesList):
                raise ValueError(f"{dictionary} has too few markers for a board of {columns}x{rows} squares")
            side_m = square_m * marker_fraction
            self.charuco = cv2.aruco.CharucoBoard((columns, rows), square_m, side_m, words)
            self._detector = cv2.aruco.CharucoDetector(self.charuco)
            self.points = np.asarray(self.charuco.getChessboardCorners(), np.float32)
            inner = columns - 1, rows - 1
        else:
            grid = np.mgrid[0:columns, 0:rows].T.reshape(-1, 2) * square_m
            self.points = np.concatenate([grid, np.zeros((len(grid), 1))], axis=1).astype(np.float32)
            inner = columns, rows
        low, high = self.points[:, :2].min(axis=0), self.points[:, :2].max(axis=0)
        self._corners = np.array([low, (high[0], low[1]), high, (low[0], high[1])], np.float64)
        self._inner = inner

    def __str__(self) -> str:
        return f"{self.pattern.value} {self.columns}x{self.rows}"

    def find(self, image: NDArray[np.uint8], index: int = 0) -> BoardView | None:
        """The board in a BGR or grey image; None if it is not there, or not whole (a ChArUco board may be partly)."""
        grey = np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), np.uint8) if image.ndim == 3 else image
        found = self._find_charuco(grey) if self.charuco is not None else self._find_checkerboard(grey)
        if found is None:
            return None
        points, pixels = found
        across: Any = cv2.findHomography(points[:, :2], pixels)[0]  # None for degenerate points
        if across is None:
            return None
        outline = cv2.perspectiveTransform(self._corners[None], across)[0]
        return BoardView(index, points, pixels, edge_width(grey, pixels), np.asarray(outline, np.float64))

    def square_px(self, view: BoardView) -> float:
        """Side of a square in the image, pixels, from the outline's area."""
        area = abs(float(cv2.contourArea(view.outline.astype(np.float32))))
        return math.sqrt(area / ((self._inner[0] - 1) * (self._inner[1] - 1)))

    def is_sharp(self, view: BoardView) -> bool:
        """Whether the corners' edges are narrow enough to be placed within a fraction of a pixel."""
        return view.edge_px <= min(WIDEST_EDGE_PX, max(EDGE_OF_SQUARE * self.square_px(view), 2.5))

    def _find_checkerboard(self, grey: NDArray[np.uint8]) -> tuple[NDArray[np.float32], NDArray[np.float32]] | None:
        size, how = (self.columns, self.rows), cv2.CALIB_CB_NORMALIZE_IMAGE
        if grey.shape[1] > SEARCH_WIDTH:
            small = cv2.resize(grey, None, fx=SEARCH_WIDTH / grey.shape[1], fy=SEARCH_WIDTH / grey.shape[1])
            if not cv2.findChessboardCornersSB(small, size, flags=how)[0]:
                return None
        found, pixels = cv2.findChessboardCornersSB(grey, size, flags=how | cv2.CALIB_CB_ACCURACY)
        return (self.points, np.asarray(pixels, np.float32).reshape(-1, 2)) if found else None

    def _find_charuco(self, grey: NDArray[np.uint8]) -> tuple[NDArray[np.float32], NDArray[np.float32]] | None:
        found: tuple[Any, ...] = self._detector.detectBoard(grey)
        pixels, numbers = found[:2]
        if numbers is None or len(numbers) < FEWEST_CORNERS:
            return None
        points = self.points[np.asarray(numbers, np.int64).ravel()]
        if np.linalg.matrix_rank(points[:, :2] - points[0, :2]) < 2:
            return None  # corners of one row do not determine the board's pose
        return points, np.asarray(pixels, np.float32).reshape(-1, 2)


def edge_width(grey: NDArray[np.uint8], pixels: NDArray[np.float32]) -> float:
    """Median over corners of contrast / steepest slope, pixels: the width of an edge, in its worst direction."""
    widths: list[float] = []
    for x, y in pixels[:: max(1, len(pixels) // 24)]:
        column, row = round(float(x)), round(float(y))
        patch = grey[max(row - PATCH_PX, 0) : row + PATCH_PX + 1, max(column - PATCH_PX, 0) : column + PATCH_PX + 1]
        if min(patch.shape) < PATCH_PX:
            continue
        low, high = np.percentile(patch, (10, 90))
        slopes = np.abs(cv2.Scharr(patch, cv2.CV_32F, 1, 0)) / 32, np.abs(cv2.Scharr(patch, cv2.CV_32F, 0, 1)) / 32
        diagonal = np.abs(np.stack([slopes[0], slopes[1]]))
        steepest = min(float(np.percentile(part, 97)) for part in diagonal)
        if high - low > 10:
            widths.append(float(high - low) / max(steepest, 1e-3))
    return float(np.median(widths)) if widths else math.inf


def diverse(views: Sequence[BoardView], size: tuple[int, int], most: int) -> list[BoardView]:
    """At most `most` views with the most different poses, by farthest-point sampling from the sharpest one."""
    if len(views) <= most:
        return list(views)
    outlines = np.stack([(view.outline / size).ravel() for view in views])
    kept = [int(np.argmin([view.edge_px for view in views]))]
    away = np.linalg.norm(outlines - outlines[kept[0]], axis=1)
    while len(kept) < most:
        kept.append(int(np.argmax(away)))
        away = np.minimum(away, np.linalg.norm(outlines - outlines[kept[-1]], axis=1))
    return [views[n] for n in sorted(kept)]
