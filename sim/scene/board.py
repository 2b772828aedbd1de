"""A calibration board held in front of a camera with a known lens, for tests of `follow calibrate`."""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from follow.camera.board import Board
from follow.geometry import Array, Intrinsics, project, rays
from sim.scene.ground import Image
from sim.scene.optics import Optics, Sensor

FINER = 2  # rays per pixel along each axis: edges are as soft as a sensor's pixels make them
TEXTURE_PX = 48  # of the board's texture per square
MARGIN = 1.0  # squares of white around the board
INDOORS = Optics(noise=2.0, shutter_s=1 / 100)


@dataclass(frozen=True, slots=True)
class BoardPose:
    """The board's pose: (3, 3) rotation from board to camera axes, (3,) position of its middle, metres."""

    rotation: Array
    middle_m: Array


class BoardCamera:
    """Draws the board by casting rays through the lens, then through the sensor with its blur and noise."""

    def __init__(self, board: Board, lens: Intrinsics, optics: Optics = INDOORS, seed: int = 0) -> None:
        self.board, self.lens = board, lens
        fine = replace(
            lens,
            width=lens.width * FINER,
            height=lens.height * FINER,
            fx=lens.fx * FINER,
            fy=lens.fy * FINER,
            cx=lens.cx * FINER,
            cy=lens.cy * FINER,
        )
        columns, rows = np.meshgrid(np.arange(fine.width) + 0.5, np.arange(fine.height) + 0.5)
        self._rays = rays(fine, np.stack([columns.ravel(), rows.ravel()], axis=1))
        self._shape = fine.height, fine.width
        self._texture, self._origin_px = texture(board)
        self._sensor = Sensor(optics, 1.0, seed)

    def draw(self, pose: BoardPose, index: int = 0, smear: tuple[float, float] = (0.0, 0.0)) -> Image:
        """The BGR image of the board in that pose, its content moved by `smear` pixels during the exposure."""
        normal = pose.rotation[:, 2]
        fall = self._rays @ normal
        with np.errstate(divide="ignore", invalid="ignore"):
            length = (pose.middle_m @ normal) / fall
        met = (length > 0) & np.isfinite(length)
        on_board = (self._rays * np.where(met, length, 0.0)[:, None] - pose.middle_m) @ pose.rotation[:, :2]
        half = self.board.points[:, :2].mean(axis=0)
        place = (on_board + half) / self.board.square_m * TEXTURE_PX + self._origin_px - 0.5
        place[~met] = -1e4
        x, y = (np.clip(part, -1e4, 1e4).reshape(self._shape).astype(np.float32) for part in place.T)
        fine = cv2.remap(self._texture, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=(96,))
        grey = cv2.resize(fine, (self.lens.width, self.lens.height), interpolation=cv2.INTER_AREA)
        image = np.asarray(cv2.cvtColor(grey, cv2.COLOR_GRAY2BGR), np.uint8)
        return self._sensor.expose(image, smear, 0.0, index)


def texture(board: Board) -> tuple[NDArray[np.uint8], Array]:
    """The board as a grey image with a white margin, and where in it the board's point (0, 0) is, pixels."""
    pad = round(MARGIN * TEXTURE_PX)
    if board.charuco is not None:
        size = board.columns * TEXTURE_PX, board.rows * TEXTURE_PX
        inside = np.asarray(board.charuco.generateImage(size, marginSize=0), np.uint8)
        corner = np.array([pad, pad], np.float64)
    else:
        squares = np.indices((board.rows + 1, board.columns + 1)).sum(axis=0) % 2
        inside = np.kron(40 + 190 * squares, np.ones((TEXTURE_PX, TEXTURE_PX))).astype(np.uint8)
        corner = np.array([pad + TEXTURE_PX, pad + TEXTURE_PX], np.float64)
    return np.asarray(np.pad(inside, pad, constant_values=230), np.uint8), corner


def held(
    board: Board, lens: Intrinsics, count: int, seed: int = 0, tilt_rad: float = math.radians(35.0), part: float = 0.45
) -> Iterator[BoardPose]:
    """Poses of a board that somebody shows everywhere in the image, near and far, tilted to all sides.

    `part` is about the part of the image's width that the board fills at its nearest.  A checkerboard stays completely
    in the image.
    """
    random = np.random.default_rng([seed, 11])
    spots = [(x, y) for y in (0.15, 0.5, 0.85) for x in (0.12, 0.37, 0.63, 0.88)]
    for n in range(count):
        turn = random.uniform(-tilt_rad, tilt_rad, 2)
        spin, near = random.uniform(-0.3, 0.3), random.uniform(0.5, 1.0) * part
        tilt = rotated(float(turn[0]), float(turn[1]), 0.0) @ rotated(0.0, 0.0, spin)
        spot = np.array(spots[n % len(spots)]) + random.uniform(-0.05, 0.05, 2)
        pose = posed(board, lens, spot, tilt, near)
        while board.charuco is None and not is_whole(board, lens, pose):
            spot = 0.9 * spot + 0.05
            pose = posed(board, lens, spot, tilt, near)
        yield pose


def rotated(x_rad: float, y_rad: float, z_rad: float) -> Array:
    """(3, 3) rotation by a vector: about it, by its length."""
    return np.asarray(cv2.Rodrigues(np.array([x_rad, y_rad, z_rad], np.float64))[0], np.float64)


def posed(board: Board, lens: Intrinsics, spot: Array, tilt: Array, near: float) -> BoardPose:
    """The board with its middle at a spot of the image (fractions), tilted against the ray to there."""
    ray = rays(lens, [spot * (lens.width, lens.height)])[0]
    angle = math.acos(min(float(ray[2]), 1.0)) / max(math.hypot(ray[0], ray[1]), 1e-9)
    facing = rotated(-ray[1] * angle, ray[0] * angle, 0.0)
    extent = float(np.ptp(board.points[:, 0])) + 2 * board.square_m
    distance = extent / 2 / math.tan(near * lens.horizontal_fov_rad / 2)
    return BoardPose(facing @ tilt, ray * distance)


def is_whole(board: Board, lens: Intrinsics, pose: BoardPose) -> bool:
    """Whether each inner corner, and half a square around it, is in the image."""
    flat = board.points - board.points.mean(axis=0)
    reach = 1.0 + board.square_m / np.abs(flat).max(axis=0, initial=board.square_m)
    pixels, depth = project(lens, np.eye(3), np.zeros(3), flat * reach @ pose.rotation.T + pose.middle_m)
    return bool((depth > 0).all() and (pixels > 3).all() and (pixels < (lens.width - 3, lens.height - 3)).all())
