"""Faults of lens, sensor and encoder: distortion, motion blur, exposure, noise, compression."""

import math
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from follow.geometry import Intrinsics, LensModel, distort, undistort
from racf.box import Box
from sim.scene.drawing import View
from sim.scene.ground import Image
from sim.scene.rendering import Seen


@dataclass(frozen=True, slots=True)
class Optics:
    """The faults of one camera.  Defaults: a small action camera by day."""

    shutter_s: float = 1 / 400
    noise: float = 2.0  # standard deviation in grey levels
    light: float = 1.0  # brightness of the image
    swing: float = 0.0  # fraction by which automatic exposure goes up and down
    swing_s: float = 6.0  # period of that
    jpeg_quality: int | None = None  # None: raw images


NOISE_SIZE = (480, 800)  # rows and columns of noise from which each image takes a random piece


class Lens:
    """Bends an ideal image; with no distortion it does nothing."""

    def __init__(self, camera: Intrinsics) -> None:
        self.camera = camera
        self.bent = camera.is_bent
        self.ideal = camera
        if not self.bent:
            return
        columns, rows = np.meshgrid(np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5)
        across, down = (columns.ravel() - camera.cx) / camera.fx, (rows.ravel() - camera.cy) / camera.fy
        seen = np.stack([across, down], axis=1).astype(np.float64)
        flat = undistort(camera, seen) * (camera.fx, camera.fy) + (camera.cx, camera.cy)
        # The ideal image must cover the whole view of the lens, and a row more for the interpolation.
        beyond = np.maximum(-flat.min(axis=0), flat.max(axis=0) - (camera.width, camera.height))
        x, y = np.ceil(np.maximum(beyond, 0) + 1).astype(int).tolist()
        self.ideal = replace(
            camera,
            width=camera.width + 2 * x,
            height=camera.height + 2 * y,
            cx=camera.cx + x,
            cy=camera.cy + y,
            distortion=(),
            model=LensModel.PINHOLE,
        )
        self._from_x = (flat[:, 0] + x - 0.5).reshape(rows.shape).astype(np.float32)
        self._from_y = (flat[:, 1] + y - 0.5).reshape(rows.shape).astype(np.float32)

    def bend(self, image: Image) -> Image:
        """The image distorted by the lens; BGR from BGRA."""
        bent = cv2.remap(image, self._from_x, self._from_y, cv2.INTER_LINEAR) if self.bent else image
        return np.asarray(cv2.cvtColor(bent, cv2.COLOR_BGRA2BGR), np.uint8)

    def bend_box(self, seen: Seen) -> Seen:
        """The box about the bent outline of a box."""
        if not self.bent or seen.box is None:
            return seen
        b, i, c = seen.box, self.ideal, self.camera
        side = np.linspace(0, 1, 5)
        x = np.concatenate([b.x + side * b.w, b.x + side * b.w, np.full(5, b.x), np.full(5, b.x + b.w)])
        y = np.concatenate([np.full(5, b.y), np.full(5, b.y + b.h), b.y + side * b.h, b.y + side * b.h])
        points = distort(c, np.stack([(x - i.cx) / i.fx, (y - i.cy) / i.fy], axis=1)) * (c.fx, c.fy) + (c.cx, c.cy)
        low, high = points.min(axis=0), points.max(axis=0)
        return Seen(Box(float(low[0]), float(low[1]), *(high - low).tolist()), seen.visible)


class Sensor:
    """Blur, brightness, noise and compression, from a seed."""

    def __init__(self, optics: Optics, light: float, seed: int) -> None:
        self.optics, self.light = optics, light * optics.light
        self._seed = seed
        sample = np.random.default_rng([seed, 5]).normal(0.0, max(optics.noise, 1e-6), (*NOISE_SIZE, 3))
        # Two tiles because pixels are unsigned: the positive and the negative part of the noise.
        self._more, self._less = (np.clip(np.rint(part), 0, 255).astype(np.uint8) for part in (sample, -sample))

    def expose(self, image: Image, smear: tuple[float, float], t_s: float, index: int) -> Image:
        """The image number `index`, taken at `t_s` while its content moved by `smear` pixels."""
        o = self.optics
        if max(abs(smear[0]), abs(smear[1])) > 0.7:
            image = np.asarray(cv2.filter2D(image, -1, streak(smear)), np.uint8)
        light = self.light * (1.0 + o.swing * math.sin(2 * math.pi * t_s / o.swing_s))
        if light != 1.0:
            image = np.asarray(cv2.convertScaleAbs(image, alpha=light), np.uint8)
        if o.noise > 0:
            rows, columns = image.shape[:2]
            random = np.random.default_rng([self._seed, 5, index])  # by index: any image can be drawn again
            y, x = random.integers(0, (NOISE_SIZE[0] - rows, NOISE_SIZE[1] - columns)).tolist()
            piece = slice(y, y + rows), slice(x, x + columns)
            lighter = cv2.add(image, self._more[piece])
            image = np.asarray(cv2.subtract(lighter, self._less[piece], lighter), np.uint8)
        if o.jpeg_quality is not None:
            code = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, o.jpeg_quality])[1]
            image = np.asarray(cv2.imdecode(code, cv2.IMREAD_COLOR), np.uint8)
        return image


def streak(smear: tuple[float, float]) -> NDArray[np.float32]:
    """The kernel that blurs along a line of that many pixels."""
    reach = math.ceil(max(abs(smear[0]), abs(smear[1])) / 2)
    kernel = np.zeros((2 * reach + 1, 2 * reach + 1), np.float32)
    count = 8 * reach + 1
    for part in np.linspace(-0.5, 0.5, count):
        x, y = reach + part * smear[0], reach + part * smear[1]
        kernel[round(y), round(x)] += 1.0 / count
    return kernel


def smear(before: View, now: View, ground_m: float = 0.0) -> tuple[float, float]:
    """How far the ground in the image's middle moves between two views, pixels; still when it shows the sky.

    `ground_m` is the height of that ground, as if it were level.
    """
    c = now.camera
    ray = now.rotation @ np.array([0.0, 0.0, 1.0])
    point = now.position + ray * ((-now.position[2] - ground_m) / ray[2] if ray[2] > 0.05 else 100.0)
    pixels, depth = before.project(point[None])
    if depth[0] < 0.1:
        return 0.0, 0.0
    longest = 40.0  # pixels; beyond that nothing can be recognised
    x, y = c.cx - float(pixels[0, 0]), c.cy - float(pixels[0, 1])
    return max(-longest, min(longest, x)), max(-longest, min(longest, y))
