"""A camera's calibration in a file: OpenCV's FileStorage YAML and ROS's camera_info, as a file or as a message.

In both a pixel's centre has an integer coordinate; here its left edge has, so the principal point moves by 0.5.
"""

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, cast

import cv2
import numpy as np

from follow.geometry import COEFFICIENTS, Intrinsics, LensModel, radial, undistort

LONGEST_FILE = 1_000_000  # bytes; a camera_info has two thousand
ASPECT_TOLERANCE = 0.01  # 1366x768 counts as 16:9, 4:3 does not as 3:2
HEADER = "%YAML:1.0\n---\n"
MODELS = {
    "plumb_bob": LensModel.PINHOLE,
    "rational_polynomial": LensModel.PINHOLE,
    "pinhole": LensModel.PINHOLE,
    "": LensModel.PINHOLE,
    "equidistant": LensModel.FISHEYE,
    "fisheye": LensModel.FISHEYE,
}
"""Names of `distortion_model`, from ROS and from OpenCV's two sets of functions; without a name it is a pinhole."""

NAMES = {
    "matrix": ("cameramatrix", "k"),
    "distortion": ("distortioncoefficients", "distcoeffs", "distcoefs", "d"),
    "width": ("imagewidth", "width"),
    "height": ("imageheight", "height"),
    "size": ("cameraresolution", "imagesize", "resolution"),
    "model": ("distortionmodel", "lensmodel"),
    "fisheye": ("fisheyemodel", "fisheye"),
    "binning_x": ("binningx",),
    "binning_y": ("binningy",),
    "roi": ("roi",),
}
"""Value -> the keys under which programs write it, in lower case and without underscores."""

LABELS = {"matrix": "camera_matrix", "distortion": "distortion_coefficients", "size": "image size"}
ROI = ("xoffset", "yoffset", "width", "height")


def read_calibration(path: Path) -> Intrinsics:
    """The lens in a file, for images of the size that was calibrated.

    Raises ValueError, naming the file, if it cannot be read, is incomplete, or describes a lens whose distortion is not
    one-to-one within the image.
    """
    if not path.is_file():
        raise ValueError(f"camera.calibration {str(path)!r} is not a regular file")
    try:
        data = path.read_bytes()[: LONGEST_FILE + 1]
    except OSError as error:
        raise ValueError(f"camera.calibration {str(path)!r} cannot be read: {error.strerror}") from None
    try:
        return parse_calibration(data)
    except ValueError as error:
        raise ValueError(f"camera.calibration {str(path)!r}: {error}") from None


def parse_calibration(data: bytes) -> Intrinsics:
    """The lens in a file's bytes.  Raises ValueError."""
    if len(data) > LONGEST_FILE:
        raise ValueError(f"a calibration has at most {LONGEST_FILE} bytes")
    held = _document(data)
    width, height = (_number(held, name) for name in ("width", "height"))
    if math.isnan(width) and len(size := _numbers(held, "size")) == 2:
        width, height = size
    if math.isnan(width) or math.isnan(height):
        raise ValueError("it must hold the size of the calibrated images, image_width and image_height")
    if not (1 <= width <= 1e5 and 1 <= height <= 1e5):
        raise ValueError(f"the calibrated images must be 1 to 100000 pixels wide and high, not {width:g}x{height:g}")
    matrix = _numbers(held, "matrix")
    if len(matrix) != 9:
        raise ValueError(f"it must hold a camera_matrix of 9 numbers, not of {len(matrix)}")
    if matrix[1] or matrix[3] or (matrix[6], matrix[7], matrix[8]) != (0.0, 0.0, 1.0):
        raise ValueError("its camera_matrix must be fx 0 cx, 0 fy cy, 0 0 1: skew is not supported")
    model = _model(held)
    coefficients = _coefficients(_numbers(held, "distortion"), model)
    fx, fy, cx, cy = matrix[0], matrix[4], matrix[2] + 0.5, matrix[5] + 0.5
    lens = Intrinsics(round(width), round(height), fx, fy, cx, cy, coefficients, model)
    require_one_to_one(lens)
    return _read_out(lens, held)


def require_one_to_one(lens: Intrinsics) -> None:
    """Raise ValueError for a distortion that folds over within the image: two directions would share a pixel."""
    across, down = np.linspace(0, lens.width, 33), np.linspace(0, lens.height, 33)
    edge = np.concatenate(
        [np.stack([across, np.full(33, y)], axis=1) for y in (0.0, float(lens.height))]
        + [np.stack([np.full(33, x), down], axis=1) for x in (0.0, float(lens.width))]
    )
    curve = radial(lens.model, lens.distortion)
    reached = undistort(lens, (edge - (lens.cx, lens.cy)) / (lens.fx, lens.fy))
    t = np.hypot(reached[:, 0], reached[:, 1])
    if lens.model is LensModel.FISHEYE:
        t = np.arctan(t)
    beyond = t > curve.end
    if beyond.any():
        worst = float(np.min(np.hypot(*(edge[beyond] - (lens.cx, lens.cy)).T)))
        raise ValueError(
            f"its distortion folds over {worst:.0f} pixels from the centre, within the image: calibrate with the board "
            "also in the corners, or with another lens model"
        )


def fitted(lens: Intrinsics, width: int, height: int) -> Intrinsics:
    """The same lens for frames of another size, scaled.  Raises ValueError for another aspect ratio."""
    if (width, height) == (lens.width, lens.height):
        return lens
    x, y = width / lens.width, height / lens.height
    if abs(x / y - 1) > ASPECT_TOLERANCE:
        raise ValueError(
            f"the calibration is of {lens.width}x{lens.height} images, and frames of {width}x{height} have another "
            "aspect ratio, which is another crop of the sensor: calibrate in the mode that is flown"
        )
    return replace(lens, width=width, height=height, fx=lens.fx * x, fy=lens.fy * y, cx=lens.cx * x, cy=lens.cy * y)


def described(lens: Intrinsics) -> str:
    """A lens for a person to read."""
    name = {LensModel.PINHOLE: {8: "rational pinhole"}.get(len(lens.distortion), "pinhole")}.get(lens.model, "fisheye")
    wide = math.degrees(lens.horizontal_fov_rad)
    return (
        f"{name}, {lens.width}x{lens.height}, focal length {lens.fx:.1f} pixels, {wide:.1f} degrees from edge to edge"
    )


@dataclass(frozen=True, slots=True)
class Fit:
    """How a calibration was made: kept in its file for a person."""

    reprojection_px: float
    frames: int
    board: str


def as_opencv_yaml(lens: Intrinsics, fit: Fit) -> str:
    """The file that `read_calibration`, OpenCV's FileStorage and its samples read."""
    matrix = [lens.fx, 0.0, lens.cx - 0.5, 0.0, lens.fy, lens.cy - 0.5, 0.0, 0.0, 1.0]
    name = {LensModel.FISHEYE: "equidistant"}.get(
        lens.model, "rational_polynomial" if len(lens.distortion) == 8 else "plumb_bob"
    )
    lines = [
        f'distortion_model: "{name}"',
        f"image_width: {lens.width}",
        f"image_height: {lens.height}",
        f"camera_matrix: {_matrix(3, 3, matrix)}",
        f"distortion_coefficients: {_matrix(len(lens.distortion), 1, lens.distortion)}",
        f"avg_reprojection_error: {fit.reprojection_px!r}",
        f"nframes: {fit.frames}",
        f'board: "{fit.board}"',
    ]
    return HEADER + "\n".join(lines) + "\n"


def _matrix(rows: int, columns: int, values: Sequence[float]) -> str:
    data = ", ".join(repr(float(v)) for v in values)
    return f"!!opencv-matrix\n   rows: {rows}\n   cols: {columns}\n   dt: d\n   data: [ {data} ]"


def _document(data: bytes) -> Mapping[str, object]:
    """The first YAML document: names in lower case without underscores -> OpenCV's nodes."""
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise ValueError(f"it must be UTF-8, not byte {data[error.start]:#04x} at {error.start}") from None
    if "\0" in text:
        raise ValueError("it must be YAML, not a binary file")
    try:
        storage = cv2.FileStorage(_for_opencv(text), cv2.FileStorage_READ | cv2.FileStorage_MEMORY)
        held = _plain(storage.root())  # nodes are valid only while their storage lives
    except (cv2.error, SystemError) as error:
        found = re.search(r"'\((\d+)\): (.*)'", " ".join(str(error.__cause__ or error).split()))
        why = f", but OpenCV says {found[2]!r}" if found else ""
        raise ValueError(
            f"it must be YAML as OpenCV or ROS write it{why}; `follow calibrate` makes such a file"
        ) from None
    if not isinstance(held, dict):
        raise ValueError("it must be YAML with a name before each value")
    return cast(dict[str, object], held)


def _for_opencv(text: str) -> str:
    """The first document in OpenCV's subset of YAML: lists indented, no empty values, no comment lines."""
    lines = [line.rstrip() for line in text.splitlines() if line.strip() and not line.lstrip().startswith("#")]
    while lines and lines[0].startswith(("%YAML", "---")):
        lines.pop(0)
    end = next((n for n, line in enumerate(lines) if line in ("---", "...")), len(lines))
    lines = [re.sub(r"^( *)- ", r"\1  - ", line) for line in lines[:end]]
    depth = [len(line) - len(line.lstrip()) for line in lines] + [0]
    kept = [line for n, line in enumerate(lines) if not (line.endswith(":") and depth[n + 1] <= depth[n])]
    return HEADER + "\n".join(kept) + "\n"


def _plain(node: Any) -> object:
    """A node of OpenCV's as dicts (names in lower case without underscores), lists, numbers and texts."""
    if node.isMap():
        return {name.lower().replace("_", ""): _plain(node.getNode(name)) for name in node.keys()}  # noqa: SIM118
    if node.isSeq():
        return [_plain(node.at(n)) for n in range(node.size())]
    if node.isInt() or node.isReal():
        return float(node.real())
    return str(node.string()) if node.isString() else None


def _node(held: Mapping[str, object], what: str) -> object:
    return next((held[name] for name in NAMES[what] if name in held), None)


def _numbers(held: Mapping[str, object], what: str) -> list[float]:
    """A list or matrix of numbers; empty if it is missing.  Raises ValueError for one that holds anything else."""
    node = _node(held, what)
    if isinstance(node, dict):
        node = cast(dict[str, object], node).get("data")
    if node is None:
        return []
    if not isinstance(node, list):
        raise ValueError(f"its {LABELS[what]} must be a list of numbers")
    values = [part for part in cast(list[object], node) if isinstance(part, float) and math.isfinite(part)]
    if len(values) != len(cast(list[object], node)):
        raise ValueError(f"its {LABELS[what]} must hold finite numbers only")
    return values


def _number(held: Mapping[str, object], what: str) -> float:
    """A number; NaN if it is missing."""
    node = _node(held, what)
    return node if isinstance(node, float) else math.nan


def _model(held: Mapping[str, object]) -> LensModel:
    node, fisheye = _node(held, "model"), _number(held, "fisheye")
    name = node if isinstance(node, str) else ""
    if name not in MODELS:
        raise ValueError(f"its distortion_model must be {', '.join(filter(None, MODELS))}, not {name!r}")
    return LensModel.FISHEYE if not name and fisheye == 1 else MODELS[name]


def _coefficients(given: Sequence[float], model: LensModel) -> tuple[float, ...]:
    """The coefficients without OpenCV's thin-prism and tilt terms, which must be zero."""
    if len(given) in (12, 14) and model is LensModel.PINHOLE:
        if any(given[8:]):
            raise ValueError("its distortion has thin-prism or tilt terms: calibrate with at most 8 coefficients")
        given = given[:8]
    if len(given) not in COEFFICIENTS[model]:
        counts = " or ".join(map(str, COEFFICIENTS[model]))
        raise ValueError(f"a {model.value} lens has {counts} distortion coefficients, not {len(given)}")
    return tuple(given)


def _read_out(lens: Intrinsics, held: Mapping[str, object]) -> Intrinsics:
    """The lens for a ROS camera's images: cropped to the region of interest, then binned."""
    roi = _node(held, "roi")
    if isinstance(roi, dict):
        table = cast(dict[str, object], roi)
        x, y, w, h = (n if isinstance(n := table.get(key), float) else 0.0 for key in ROI)
        if w > 0 and h > 0:
            if not (x >= 0 and y >= 0 and x + w <= lens.width and y + h <= lens.height):
                raise ValueError(f"its roi must lie within the {lens.width}x{lens.height} image")
            lens = replace(lens, width=round(w), height=round(h), cx=lens.cx - x, cy=lens.cy - y)
    bins = [n if (n := _number(held, name)) > 1 else 1.0 for name in ("binning_x", "binning_y")]
    width, height = (max(1, int(size / n)) for size, n in zip((lens.width, lens.height), bins, strict=True))
    x, y = 1 / bins[0], 1 / bins[1]
    return replace(lens, width=width, height=height, fx=lens.fx * x, fy=lens.fy * y, cx=lens.cx * x, cy=lens.cy * y)
