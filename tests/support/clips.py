"""Clips for tests, written by PyAV: every frame shows its number, so that the reference is in the image itself."""

from collections.abc import Iterable, Sequence
from fractions import Fraction
from pathlib import Path

import av
import numpy as np

BITS = 12  # blocks of the number, most frames 4095
TICKS_S = 90_000


def numbered(n: int, size: tuple[int, int] = (192, 120)) -> np.ndarray:
    """A BGR image of (width, height) whose upper quarter shows `n` in blocks, least bit left; noise below."""
    w, h = size
    image = np.random.default_rng(n).integers(90, 150, (h // 8, w // 8, 3), np.uint8).repeat(8, 0).repeat(8, 1)
    image = np.pad(image, ((0, h - image.shape[0]), (0, w - image.shape[1]), (0, 0)), mode="edge")
    lit = np.array([n >> bit & 1 for bit in range(BITS)]).repeat(w // BITS)
    image[: h // 4] = 40
    image[: h // 4, : len(lit)][:, lit == 1] = 215
    return image


def number_in(image: np.ndarray) -> int:
    """The number that an image shows."""
    h, w = image.shape[:2]
    block = w // BITS
    rows = image[h // 16 : h * 3 // 16, : BITS * block].astype(float).mean(axis=(0, 2)).reshape(BITS, block)
    return int((rows[:, block // 4 : -block // 4 or None].mean(1) > 127) @ (1 << np.arange(BITS)))


def encode(
    path: Path | str,
    images: Iterable[np.ndarray],
    codec: str = "libx264",
    pix_fmt: str = "yuv420p",
    stamps_s: Sequence[float] | None = None,
    rate: int = 30,
    format_: str | None = None,
    options: dict[str, str] | None = None,
    codec_options: dict[str, str] | None = None,
) -> Path:
    """Write images to a file; `stamps_s` gives each its time, else they come at the constant rate."""
    with av.open(str(path), "w", format=format_, options=options or {}) as container:
        stream = container.add_stream(codec, rate=rate, options=codec_options or {})
        stream.pix_fmt = pix_fmt
        stream.codec_context.time_base = Fraction(1, TICKS_S if stamps_s is not None else rate)
        for n, image in enumerate(images):
            if n == 0:
                stream.height, stream.width = image.shape[:2]
            frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(image), format="bgr24")
            if pix_fmt not in ("bgr24", "yuv420p"):
                frame = frame.reformat(format=pix_fmt)
            if stamps_s is None:
                frame.pts, frame.time_base = n, Fraction(1, rate)
            else:
                frame.pts, frame.time_base = round(stamps_s[n] * TICKS_S), Fraction(1, TICKS_S)
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))
    return Path(path)


def clip(path: Path | str, count: int = 20, size: tuple[int, int] = (192, 120), **how) -> Path:
    """A clip of `count` numbered frames."""
    return encode(path, (numbered(n, size) for n in range(count)), **how)
