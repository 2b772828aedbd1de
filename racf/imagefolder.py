"""Folders of images: which files count, in which order, and where numbers are missing.  `follow` also uses this."""

import re
from collections.abc import Iterable, Sequence
from itertools import pairwise
from pathlib import Path
from statistics import median_low

IMAGE_SUFFIXES = frozenset({".bmp", ".jpeg", ".jpg", ".png", ".tif", ".tiff", ".webp"})


def image_paths(folder: Path) -> list[Path]:
    """The image files of a folder in natural order, without hidden ones."""
    return sorted((p for p in visible(folder.iterdir()) if p.suffix.lower() in IMAGE_SUFFIXES), key=natural)


def visible(paths: Iterable[Path]) -> list[Path]:
    """The paths whose names do not begin with a dot: macOS leaves a `._NAME.jpg` beside each NAME.jpg it copies."""
    return [path for path in paths if not path.name.startswith(".")]


def natural(path: Path) -> tuple[tuple[int, str], ...]:
    """Sort key that puts 2.jpg before 10.jpg."""
    return tuple((int(part), "") if part.isdigit() else (-1, part) for part in re.split(r"([0-9]+)", path.name))


def positions(paths: Sequence[Path], longest_gap: int | None = None) -> list[int]:
    """The index of each image in its sequence, from 0; a missing number leaves a gap.

    Paths are in natural order.  The last number in each name counts if most numbers are one apart and no gap is longer
    than `longest_gap`; otherwise only the order counts, without gaps.
    """
    ends = [re.search(r"([0-9]{1,18})$", path.stem) for path in paths]
    numbers = [int(end.group(1)) for end in ends if end]
    steps = [after - before for before, after in pairwise(numbers)]
    rising = all(step >= 1 and (longest_gap is None or step <= longest_gap) for step in steps)
    if len(numbers) == len(paths) and rising and (not steps or median_low(steps) == 1):
        return [number - numbers[0] for number in numbers]
    return list(range(len(paths)))
