"""Pixels <-> bearings <-> the ground, for a camera fixed to a body that rolls, pitches and yaws.

Camera axes: x right, y down in the image, z along the optical axis.  Body axes are FRD, the world is NED.  A pixel's
coordinate is its left (upper) edge: pixel 0 covers [0, 1).  For a calibration in OpenCV's convention (pixel 0 centred
on 0) add 0.5 to `cx` and `cy`.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from typing_extensions import Self

Array = NDArray[np.float64]

UNDISTORT_STEPS = 20
"""Fixed-point iterations that undo the distortion; each gains about a digit for an action camera."""


@dataclass(frozen=True, slots=True)
class Intrinsics:
    """A pinhole with Brown-Conrady distortion: pixels of focal length and centre, then k1, k2, p1, p2, k3.

    Raises ValueError for an image without area or a focal length that is not positive.
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    distortion: tuple[float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        if self.width <= 0 or self.height <= 0:
            raise ValueError(f"an image needs a positive width and height, not {self.width}x{self.height}")
        if not (self.fx > 0 and self.fy > 0 and math.isfinite(self.fx * self.fy)):
            raise ValueError(f"a focal length is a positive number of pixels, not {self.fx:g}, {self.fy:g}")

    @classmethod
    def from_fov(cls, width: int, height: int, horizontal_fov_rad: float) -> Self:
        """Make a centred camera with square pixels and this angle from the left edge to the right one."""
        if not 0 < horizontal_fov_rad < math.pi:
            raise ValueError(
                f"a pinhole's horizontal field of view lies between 0 and 180 degrees, "
                f"not {math.degrees(horizontal_fov_rad):g}"
            )
        focal = width / 2 / math.tan(horizontal_fov_rad / 2)
        return cls(width, height, focal, focal, width / 2, height / 2)

    @property
    def horizontal_fov_rad(self) -> float:
        """The angle between the left and the right edge (without distortion)."""
        return math.atan(self.cx / self.fx) + math.atan((self.width - self.cx) / self.fx)


def body_to_ned(roll_rad: float, pitch_rad: float, yaw_rad: float) -> Array:
    """(3, 3) rotation from body FRD to local NED, Rz(yaw) Ry(pitch) Rx(roll) (aerospace order)."""
    cr, sr = math.cos(roll_rad), math.sin(roll_rad)
    cp, sp = math.cos(pitch_rad), math.sin(pitch_rad)
    cy, sy = math.cos(yaw_rad), math.sin(yaw_rad)
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )


def heading_to_ned(forward: float, right: float, heading_rad: float) -> tuple[float, float]:
    """(north, east) of a level vector given as forward and right of a heading (radians clockwise from north).

    The one place with this rotation; it is orthogonal, so `ned_to_heading` undoes it.  The same sum turns a vector from
    a line of sight at `heading_rad` off the nose to the vehicle's own forward and right.
    """
    c, s = math.cos(heading_rad), math.sin(heading_rad)
    return c * forward - s * right, s * forward + c * right


def ned_to_heading(north: float, east: float, heading_rad: float) -> tuple[float, float]:
    """(forward, right) of a heading (radians clockwise from north) of a level vector given as north and east."""
    return heading_to_ned(north, east, -heading_rad)


def camera_to_body(down_rad: float) -> Array:
    """(3, 3) rotation from camera to body axes; the optical axis looks `down_rad` below the body's nose."""
    c, s = math.cos(down_rad), math.sin(down_rad)
    return np.array([[0.0, -s, c], [1.0, 0.0, 0.0], [0.0, c, s]])


def camera_to_ned(down_rad: float, roll_rad: float, pitch_rad: float, yaw_rad: float) -> Array:
    """(3, 3) rotation from camera axes to NED; with yaw 0, to axes levelled but aligned with the heading."""
    return body_to_ned(roll_rad, pitch_rad, yaw_rad) @ camera_to_body(down_rad)


def distort(camera: Intrinsics, ideal: Array) -> Array:
    """Map (N, 2) ideal points on the plane z = 1 to distorted ones (Brown-Conrady)."""
    k1, k2, p1, p2, k3 = camera.distortion
    x, y = ideal[:, 0], ideal[:, 1]
    r2 = x * x + y * y
    radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    return np.stack(
        [
            x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x),
            y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y,
        ],
        axis=1,
    )


def undistort(camera: Intrinsics, seen: Array) -> Array:
    """Map (N, 2) distorted points on the plane z = 1 to ideal ones: x = seen - (distort(x) - x), iterated."""
    ideal = seen
    if any(camera.distortion):
        for _ in range(UNDISTORT_STEPS):
            ideal = seen - (distort(camera, ideal) - ideal)
    return ideal


def rays(camera: Intrinsics, pixels: ArrayLike) -> Array:
    """(N, 3) unit vectors in camera axes through the (N, 2) pixels."""
    p = np.asarray(pixels, np.float64)
    seen = (p - (camera.cx, camera.cy)) / (camera.fx, camera.fy)
    ray = np.concatenate([undistort(camera, seen), np.ones((len(p), 1))], axis=1)
    return ray / np.linalg.norm(ray, axis=1, keepdims=True)


def project(camera: Intrinsics, rotation: Array, camera_ned: ArrayLike, points_ned: ArrayLike) -> tuple[Array, Array]:
    """(N, 2) pixels and (N,) depths in metres of the (N, 3) points; behind the camera depth <= 0 and the pixel is NaN.

    `rotation` is camera_to_ned and `camera_ned` the (3,) position of the lens.
    """
    points = (np.asarray(points_ned, np.float64) - np.asarray(camera_ned, np.float64)) @ rotation
    depth = points[:, 2]
    ideal = np.full((len(points), 2), np.nan)
    front = depth > 1e-9
    ideal[front] = points[front, :2] / depth[front, None]
    return distort(camera, ideal) * (camera.fx, camera.fy) + (camera.cx, camera.cy), depth


def ground_points(
    camera: Intrinsics, rotation: Array, camera_ned: ArrayLike, pixels: ArrayLike, ground_down_m: float = 0.0
) -> Array:
    """(N, 3) NED points where the pixels' rays meet the plane `down = ground_down_m`; NaN for rays that never do."""
    position = np.asarray(camera_ned, np.float64)
    ray = rays(camera, pixels) @ rotation.T
    fall = ground_down_m - position[2]
    met = ray[:, 2] * np.sign(fall) > 1e-9
    length = np.full(len(ray), np.nan)
    length[met] = fall / ray[met, 2]
    return position + ray * length[:, None]


def bearing(camera: Intrinsics, rotation: Array, x: float, y: float) -> tuple[float, float]:
    """Azimuth (clockwise) and depression (below the horizon) of a pixel, radians.

    The azimuth counts from north, or from the heading when `rotation` was made with yaw 0.
    """
    north, east, down = rotation @ rays(camera, [(x, y)])[0]
    return math.atan2(east, north), math.atan2(down, math.hypot(north, east))


def direction(azimuth_rad: float, depression_rad: float) -> Array:
    """(3,) unit vector with that azimuth and depression."""
    level = math.cos(depression_rad)
    return np.array([level * math.cos(azimuth_rad), level * math.sin(azimuth_rad), math.sin(depression_rad)])


def pixel(camera: Intrinsics, rotation: Array, azimuth_rad: float, depression_rad: float) -> tuple[float, float] | None:
    """Return the pixel of a bearing (perhaps outside the image), None behind the camera."""
    points, depth = project(camera, rotation, np.zeros(3), direction(azimuth_rad, depression_rad)[None])
    return (float(points[0, 0]), float(points[0, 1])) if depth[0] > 1e-9 else None


def wrap(angle_rad: float) -> float:
    """The same angle in [-pi, pi)."""
    return (angle_rad + math.pi) % (2 * math.pi) - math.pi
