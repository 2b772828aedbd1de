"""A short clip drawn by code: a striped walker on patterned ground under a camera that drifts, with its true boxes.

python -m sim.clip clip.mp4      writes the video, and clip.txt with a box a frame: x,y,w,h, 1-based as in benchmarks
"""

import math
import sys
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from racf.box import Box
from racf.video_writer import VideoWriter

FPS = 30.0
WALKER = (22, 48)  # pixels wide and high: what a person of 1.8 m fills from 15 m with a 70 degree lens at 640x360


def clip(frames: int, size: tuple[int, int] = (640, 360), seed: int = 1) -> Iterator[tuple[NDArray[np.uint8], Box]]:
    """Yield `frames` BGR images (height, width, 3) of the given (width, height), each with the walker's true box."""
    w, h = size
    rng = np.random.default_rng(seed)
    margin = 80
    ground = _ground(rng, w + 2 * margin, h + 2 * margin)
    figure = _walker(rng)
    for n in range(frames):
        t = n / FPS
        # The camera drifts in a slow figure of eight; the walker strolls back and forth and nears a little.
        pan_x = margin + 50 * math.sin(0.5 * t)
        pan_y = margin + 25 * math.sin(1.0 * t)
        scale = 1 + 0.25 * math.sin(0.3 * t)
        centre_x = w / 2 + 0.3 * w * math.sin(0.4 * t)
        centre_y = 0.6 * h + 0.1 * h * math.sin(0.7 * t)
        still = np.array([[1, 0, -pan_x], [0, 1, -pan_y]], np.float32)
        image = cv2.warpAffine(ground, still, (w, h), borderMode=cv2.BORDER_REFLECT)
        box = Box.around(centre_x, centre_y, WALKER[0] * scale, WALKER[1] * scale)
        put = np.array([[scale, 0, box.x], [0, scale, box.y]], np.float32)
        # 0.5: warpAffine counts pixel centres as whole numbers, our boxes count edges.
        put[:, 2] += 0.5 * scale - 0.5
        cv2.warpAffine(figure, put, (w, h), dst=image, borderMode=cv2.BORDER_TRANSPARENT)
        noise = rng.normal(0, 3, image.shape)
        yield np.clip(image + noise, 0, 255).astype(np.uint8), box


def write(path: Path, frames: int = 300, seed: int = 1) -> Path:
    """Write the clip as a video and its true boxes beside it; returns the boxes' file.  Raises VideoError."""
    boxes = path.with_suffix(".txt")
    rows: list[str] = []
    with VideoWriter(path, FPS) as video:
        for image, box in clip(frames, seed=seed):
            video.put(image)
            rows.append(f"{box.x + 1:.3f},{box.y + 1:.3f},{box.w:.3f},{box.h:.3f}\n")
    boxes.write_text("".join(rows))
    return boxes


def _ground(rng: np.random.Generator, w: int, h: int) -> NDArray[np.uint8]:
    """Grass with two scales of mottle, some darker tufts and a path."""
    fine = cv2.GaussianBlur(rng.normal(0, 60, (h, w)), (0, 0), 1.5)
    coarse = cv2.GaussianBlur(rng.normal(0, 900, (h, w)), (0, 0), 18)
    ground = np.stack([70 + fine, 120 + fine + coarse, 95 + fine + 0.6 * coarse], axis=2)
    image = np.clip(ground, 0, 255).astype(np.uint8)
    for x, y, r in zip(rng.integers(0, w, 60), rng.integers(0, h, 60), rng.integers(3, 12, 60), strict=True):
        cv2.circle(image, (int(x), int(y)), int(r), (40, 85, 60), -1, cv2.LINE_AA)
    cv2.line(image, (0, int(0.75 * h)), (w, int(0.55 * h)), (120, 150, 165), 26, cv2.LINE_AA)
    return image


def _walker(rng: np.random.Generator) -> NDArray[np.uint8]:
    """Head, striped jacket, trousers: fills its box."""
    w, h = WALKER
    figure = np.empty((h, w, 3), np.uint8)
    figure[: h // 5] = (120, 150, 200)
    figure[h // 5 : 3 * h // 5] = (40, 40, 190)
    figure[h // 5 : 3 * h // 5 : 6] = (220, 220, 230)
    figure[3 * h // 5 :] = (110, 60, 40)
    figure[3 * h // 5 :, w // 2 - 1 : w // 2 + 2] = (30, 20, 20)
    return np.clip(figure + rng.normal(0, 6, figure.shape), 0, 255).astype(np.uint8)


if __name__ == "__main__":
    write(Path(sys.argv[1] if len(sys.argv) > 1 else "out/clip.mp4"))
