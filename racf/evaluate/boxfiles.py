"""Files of boxes: the text of benchmarks and trackers, and the MATLAB files of the toolkits.

A text file has a line for each frame: four numbers separated by comma, blanks or tab, `NaN` for no box.
"""

import re
import struct
import zlib
from pathlib import Path
from typing import Any, cast

import numpy as np

from racf.evaluate.metrics import Boxes

FARTHEST_PX = 1e6  # a limit of plausibility: only infinity and broken exponents are beyond it, no tracker's box is
_APART = re.compile(r"[,;\s]+")
# What scipy raises on a broken MATLAB file, depending on the wrong byte; it cannot read version 7.3.
_BROKEN = (
    ArithmeticError,
    AttributeError,
    EOFError,
    LookupError,
    MemoryError,
    NotImplementedError,
    TypeError,
    ValueError,
    struct.error,
    zlib.error,
)


def read_boxes(path: Path) -> Boxes:
    """Boxes of a `.txt` (or `.csv`) or `.mat` file, (frames, 4), as written; raises ValueError naming file and line."""
    return _read_mat(path) if path.suffix == ".mat" else _read_text(path)


def write_boxes(path: Path, boxes: Boxes) -> None:
    """Write a line `x,y,w,h` for each frame, to a thousandth of a pixel."""
    np.savetxt(path, boxes, fmt="%.3f", delimiter=",")


def read_numbers(path: Path) -> list[list[float]]:
    """The numbers of each line that has any; raises ValueError naming file and line."""
    rows: list[list[float]] = []
    try:
        lines = path.read_text(encoding="utf-8-sig").splitlines()
    except UnicodeDecodeError as error:
        raise ValueError(f"{path} is not text in UTF-8 (byte {error.start + 1}): write it as plain text") from None
    for number, line in enumerate(lines, start=1):
        words = [word for word in _APART.split(line.strip()) if word]
        try:
            row = [float(word) for word in words]
        except ValueError:
            raise ValueError(f"{path}, line {number}: not numbers: {line.strip()!r}") from None
        if row:
            rows.append(row)
    return rows


def _read_text(path: Path) -> Boxes:
    rows = read_numbers(path)
    if not rows:
        raise ValueError(f"{path}: a file of boxes has a line for each frame; this one is empty")
    for number, row in enumerate(rows, start=1):
        if len(row) != 4:
            raise ValueError(f"{path}, row {number}: a box has four numbers x, y, w, h, not {len(row)}")
        if any(abs(value) > FARTHEST_PX for value in row):
            most = max(row, key=abs)
            raise ValueError(f"{path}, row {number}: a box lies within {FARTHEST_PX:g} pixels, {most:g} does not")
    return np.asarray(rows, dtype=np.float64)


def _read_mat(path: Path) -> Boxes:
    """`results{1}.res` of the toolkits, or a matrix `res` or `results` of four columns."""
    from scipy.io import loadmat  # noqa: PLC0415 - only for MATLAB files
    from scipy.io.matlab import MatReadError  # noqa: PLC0415

    try:
        content = cast("dict[str, Any]", loadmat(path, squeeze_me=True, struct_as_record=False))
    except (MatReadError, *_BROKEN) as error:
        raise ValueError(f"{path} is not a MATLAB file that can be read: {type(error).__name__}") from None
    found = content.get("results", content.get("res"))
    while isinstance(found, np.ndarray) and found.dtype == object:  # a cell of runs: the first is the one-pass run
        found = found.flat[0] if found.size else None
    boxes = np.asarray(getattr(found, "res", found))
    if boxes.ndim != 2 or boxes.shape[1] not in {4, 5} or not np.issubdtype(boxes.dtype, np.number):
        raise ValueError(f"{path}: neither results{{1}}.res nor a matrix of four columns is in this file")
    return boxes[:, -4:].astype(np.float64)  # VisDrone's toolkit puts the frame's number first
