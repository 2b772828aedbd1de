"""Pixels <-> bearings <-> the ground, for a camera fixed to a body that rolls, pitches and yaws.

Camera axes: x right, y down in the image, z along the optical axis.  Body axes are FRD, the world is NED.  A pixel's
coordinate is its left (upper) edge: pixel 0 covers [0, 1).  For a calibration in OpenCV's convention (pixel 0 centred
on 0) add 0.5 to `cx` and `cy`.
"""

import functools
import math
from dataclasses import dataclass
from enum import Enum

import numpy as np
from numpy.typing import ArrayLike, NDArray
from typing_extensions import Self

Array = NDArray[np.float64]

UNDISTORT_STEPS = 30
"""Newton steps that undo the distortion at most; 4 do for an action camera, 10 for a fisheye at 85 degrees."""

LEAST_SLOPE = 0.02
"""Slope of the radial distortion below which a polynomial is about to fold over; atan's is 0.02 at 82 degrees."""

STEEPEST_RAY = math.radians(89.0)
"""From the optical axis, of a fisheye: rays are points on the plane at unit depth, so 90 degrees is out of reach."""


class LensModel(str, Enum):
    """What the distortion's coefficients mean, as in OpenCV."""

    PINHOLE = "pinhole"
    FISHEYE = "fisheye"


COEFFICIENTS = {LensModel.PINHOLE: (0, 4, 5, 8), LensModel.FISHEYE: (0, 4)}
"""How many coefficients a model may have."""


@dataclass(frozen=True, slots=True)
class Intrinsics:
    """Pixels of focal length and centre, and OpenCV's distortion.

    Pinhole: k1, k2, p1, p2, then k3 (Brown-Conrady), then k4, k5, k6 (rational).  Fisheye: k1 to k4, the equidistant
    projection times a polynomial of the angle.  Raises ValueError for an image without area, a focal length that is
    not positive, or coefficients that are not such a set of finite numbers.
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    distortion: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0, 0.0)
    model: LensModel = LensModel.PINHOLE

    def __post_init__(self) -> None:
        if self.width <= 0 or self.height <= 0:
            raise ValueError(f"an image needs a positive width and height, not {self.width}x{self.height}")
        if not (self.fx > 0 and self.fy > 0 and math.isfinite(self.fx * self.fy)):
            raise ValueError(f"a focal length is a positive number of pixels, not {self.fx:g}, {self.fy:g}")
        if not math.isfinite(self.cx + self.cy):
            raise ValueError(f"an image's centre is two finite numbers of pixels, not {self.cx:g}, {self.cy:g}")
        if self.model is LensModel.FISHEYE and len(self.distortion) == 5 and not any(self.distortion):
            object.__setattr__(self, "distortion", ())  # the default, which is a pinhole's
        if len(self.distortion) not in COEFFICIENTS[self.model] or not all(map(math.isfinite, self.distortion)):
            counts = " or ".join(map(str, COEFFICIENTS[self.model]))
            raise ValueError(
                f"a {self.model.value} lens has {counts} finite distortion coefficients, not {self.distortion}"
            )

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
    def is_bent(self) -> bool:
        """Whether straight lines are bent: a fisheye's always are."""
        return self.model is LensModel.FISHEYE or any(self.distortion)

    @property
    def horizontal_fov_rad(self) -> float:
        """The angle between the rays through the left and the right edge, in the optical axis's row."""
        left, right = rays(self, [(0.0, self.cy), (float(self.width), self.cy)])
        return math.atan2(-float(left[0]), float(left[2])) + math.atan2(float(right[0]), float(right[2]))


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


@dataclass(frozen=True, slots=True)
class Radial:
    """Radial distortion of t, the distance from the axis on the plane z = 1 or, of a fisheye, the angle: t (n/d)(t²).

    `above` and `below` are the coefficients of n and d from t² on.  Where the curve would fold over, from `end` on, it
    goes on straight: so each point in front of the camera has one pixel, and each pixel one ray.
    """

    above: tuple[float, ...]
    below: tuple[float, ...] = ()
    end: float = math.inf

    def at(self, t: Array) -> tuple[Array, Array]:
        """Distorted over ideal t, and the derivative of the distorted t, both (N,)."""
        u = np.minimum(t, self.end)
        q = u * u
        n, dn = polynomial(self.above, q)
        d, dd = polynomial(self.below, q)
        scale = n / d
        slope = scale + 2 * q * (dn - scale * dd) / d
        # Beyond the end: the value there, and the slope there for the rest of the way.
        rest = np.where(t > u, (t - u) / np.maximum(t, 1e-12), 0.0)
        return scale * (1 - rest) + slope * rest, slope


def polynomial(coefficients: tuple[float, ...], q: Array) -> tuple[Array, Array]:
    """1 + c0 q + c1 q² + ... and its derivative, (N,) each."""
    value, derivative = np.zeros_like(q), np.zeros_like(q)
    for c in reversed(coefficients):
        derivative = derivative * q + value
        value = value * q + c
    return 1 + value * q, value + derivative * q


@functools.lru_cache(maxsize=64)
def radial(model: LensModel, distortion: tuple[float, ...]) -> Radial:
    """The radial part of a lens, with its end."""
    k = (*distortion, *(0.0,) * (8 - len(distortion)))
    curve = Radial(k[:4]) if model is LensModel.FISHEYE else Radial((k[0], k[1], k[4]), k[5:8])
    t = np.linspace(0.0, math.pi if model is LensModel.FISHEYE else 10.0, 10001)
    with np.errstate(all="ignore"):
        scale, slope = curve.at(t)
        sound = (scale > 0) & (slope > LEAST_SLOPE) & (polynomial(curve.below, t * t)[0] > 0)
    folds = np.flatnonzero(~sound)
    return Radial(curve.above, curve.below, float(t[max(folds[0] - 1, 1)])) if len(folds) else curve


def bend(camera: Intrinsics, ideal: Array) -> tuple[Array, Array]:
    """Map (N, 2) ideal points on the plane z = 1 to distorted ones; with the (N, 2, 2) derivatives."""
    curve = radial(camera.model, camera.distortion)
    r = np.maximum(np.hypot(ideal[:, 0], ideal[:, 1]), 1e-12)
    if camera.model is LensModel.FISHEYE:
        angle = np.arctan(r)
        scale, slope = curve.at(angle)
        scale, slope = scale * angle / r, slope / (1 + r * r)
    else:
        scale, slope = curve.at(r)
    along = (slope - scale) / (r * r)
    jacobian = scale[:, None, None] * np.eye(2) + along[:, None, None] * ideal[:, :, None] * ideal[:, None, :]
    bent = scale[:, None] * ideal
    p1, p2 = (0.0, 0.0) if camera.model is LensModel.FISHEYE else (*camera.distortion[2:4], 0.0, 0.0)[:2]
    if p1 or p2:
        within = np.minimum(1.0, curve.end / r)  # the tangential part grows no more beyond the end
        x, y = ideal[:, 0] * within, ideal[:, 1] * within
        bent = bent + np.stack(
            [2 * p1 * x * y + p2 * (3 * x * x + y * y), p1 * (x * x + 3 * y * y) + 2 * p2 * x * y], axis=1
        )
        across = 2 * (p1 * x + p2 * y)
        rows = [2 * p1 * y + 6 * p2 * x, across, across, 6 * p1 * y + 2 * p2 * x]
        jacobian = jacobian + (np.stack(rows, axis=1) * (within == 1.0)[:, None]).reshape(-1, 2, 2)
    return bent, jacobian


def distort(camera: Intrinsics, ideal: Array) -> Array:
    """Map (N, 2) ideal points on the plane z = 1 to distorted ones (OpenCV's pinhole or fisheye model)."""
    return bend(camera, ideal)[0] if camera.is_bent else ideal


def undistort(camera: Intrinsics, seen: Array) -> Array:
    """Map (N, 2) distorted points on the plane z = 1 to ideal ones, by Newton's method; NaN stays NaN.

    A fisheye's ray is at most STEEPEST_RAY from the axis.
    """
    if camera.model is LensModel.FISHEYE:
        return _undistort_fisheye(camera, seen)
    ideal = seen
    if any(camera.distortion):
        for _ in range(UNDISTORT_STEPS):
            bent, j = bend(camera, ideal)
            x, y = (seen - bent).T
            det = np.maximum(j[:, 0, 0] * j[:, 1, 1] - j[:, 0, 1] * j[:, 1, 0], LEAST_SLOPE**2)
            step = np.stack([j[:, 1, 1] * x - j[:, 0, 1] * y, j[:, 0, 0] * y - j[:, 1, 0] * x], axis=1) / det[:, None]
            length = np.linalg.norm(step, axis=1, keepdims=True)
            step *= np.minimum(1.0, (1.0 + np.linalg.norm(ideal, axis=1, keepdims=True)) / np.maximum(length, 1e-12))
            ideal = ideal + step
            if not (np.abs(step) > 1e-12).any():
                break
    return ideal


def _undistort_fisheye(camera: Intrinsics, seen: Array) -> Array:
    curve = radial(camera.model, camera.distortion)
    bent = np.maximum(np.hypot(seen[:, 0], seen[:, 1]), 1e-12)
    angle = bent
    for _ in range(UNDISTORT_STEPS):
        scale, slope = curve.at(angle)
        step = (bent - scale * angle) / np.maximum(slope, LEAST_SLOPE)
        angle = np.clip(angle + step, 0.0, math.pi)
        if not (np.abs(step) > 1e-12).any():
            break
    return seen * (np.tan(np.minimum(angle, STEEPEST_RAY)) / bent)[:, None]


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
