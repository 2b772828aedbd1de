"""Crowns of trees, drawn once from a seed and blended into images at any size."""

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.uint8]

SIZE = 192  # texels of the largest copy
COPIES = 5  # each half as large as the one before
REACH = 0.46  # a crown's radius as a fraction of its copy's side


@dataclass(frozen=True, slots=True, eq=False)
class Sprite:
    """Copies of a crown: colour times cover in BGR, and 255 - cover in the channel that images leave unused."""

    copies: tuple[Image, ...]

    def blend(self, image: Image, x: float, y: float, radius: float) -> None:
        """Draw the crown about (x, y) with that radius, in pixels."""
        placed = self._placed(image.shape[1], image.shape[0], x, y, radius)
        if placed is None:
            return
        level, matrix, (x0, y0, x1, y1) = placed
        size, flags = (x1 - x0, y1 - y0), cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        crown = cv2.warpAffine(self.copies[level], matrix, size, None, flags, cv2.BORDER_CONSTANT, (0, 0, 0, 255))
        rest = cv2.cvtColor(cv2.extractChannel(crown, 3), cv2.COLOR_GRAY2BGRA)
        region = image[y0:y1, x0:x1]
        cv2.multiply(region, rest, region, 1 / 255)
        cv2.add(region, crown, region)

    def cover(self, mask: Image, x: float, y: float, radius: float, value: int) -> None:
        """Set a mask where the crown hides more than half of what is behind it."""
        placed = self._placed(mask.shape[1], mask.shape[0], x, y, radius)
        if placed is None:
            return
        level, matrix, (x0, y0, x1, y1) = placed
        flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        rest = cv2.extractChannel(self.copies[level], 3)
        shown = cv2.warpAffine(rest, matrix, (x1 - x0, y1 - y0), None, flags, cv2.BORDER_CONSTANT, (255,))
        mask[y0:y1, x0:x1][shown < 128] = value

    def _placed(
        self, width: int, height: int, x: float, y: float, radius: float
    ) -> tuple[int, NDArray[np.float64], tuple[int, int, int, int]] | None:
        """Which copy, the affine map from the region to it, and the region of the image."""
        x0, x1 = max(math.floor(x - radius) - 1, 0), min(math.ceil(x + radius) + 1, width)
        y0, y1 = max(math.floor(y - radius) - 1, 0), min(math.ceil(y + radius) + 1, height)
        if x0 >= x1 or y0 >= y1 or radius < 0.5:
            return None
        level = min(max(math.floor(math.log2(REACH * SIZE / radius)), 0), COPIES - 1)
        side = SIZE >> level
        scale = REACH * side / radius
        matrix = np.array(
            [[scale, 0, side / 2 + (x0 + 0.5 - x) * scale - 0.5], [0, scale, side / 2 + (y0 + 0.5 - y) * scale - 0.5]]
        )
        return level, matrix, (x0, y0, x1, y1)


def sprites(seed: int, count: int = 6) -> tuple[Sprite, ...]:
    """Crowns as heaps of leaf clusters, lighter on top."""
    random = np.random.default_rng([seed, 4])
    return tuple(crown(random) for _ in range(count))


def crown(random: np.random.Generator) -> Sprite:
    """One crown."""
    image = np.zeros((SIZE, SIZE, 3), np.uint8)
    cover = np.zeros((SIZE, SIZE), np.uint8)
    base = np.array([45, 88, 66]) * random.uniform(0.8, 1.25, 3)
    clusters = random.normal(0, 0.42, (170, 2))
    clusters = clusters[np.hypot(clusters[:, 0], clusters[:, 1]) < 0.82]
    for x, y in clusters[np.argsort(-clusters[:, 1])]:  # low clusters first, the lit top drawn over them
        light = 0.78 - 0.38 * y - 0.1 * x + random.uniform(-0.14, 0.14)
        b, g, r = np.clip(base * light * 1.25, 0, 255).tolist()
        centre = round(SIZE / 2 + REACH * SIZE * x), round(SIZE / 2 + REACH * SIZE * y)
        size = round(SIZE * random.uniform(0.035, 0.085))
        cv2.circle(image, centre, size, (b, g, r), -1, cv2.LINE_AA)
        cv2.circle(cover, centre, size, (255,), -1, cv2.LINE_AA)
    grain = random.normal(0, 14, (SIZE, SIZE, 1))
    image = np.clip(image + cv2.GaussianBlur(grain, (0, 0), 0.8)[..., None], 0, 255).astype(np.uint8)
    cover3 = cv2.merge([cover] * 3)
    colour = cv2.multiply(image, cover3, scale=1 / 255)
    return Sprite(copies(cv2.merge([*cv2.split(colour), cv2.bitwise_not(cover)])))


def copies(image: cv2.typing.MatLike) -> tuple[Image, ...]:
    """The image and its smaller copies."""
    out = [np.asarray(image, np.uint8)]
    while len(out) < COPIES:
        half = cv2.resize(out[-1], None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
        out.append(np.asarray(half, np.uint8))
    return tuple(out)
