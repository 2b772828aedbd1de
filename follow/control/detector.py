"""A detector that a person brings as an ONNX file: a click becomes the box of the object at that place.

OpenCV runs it, or else ONNX Runtime if that is installed.  It reads three shapes of output, as exported without
non-maximum suppression:

- YOLOX: (1, cells, 5 + classes), offsets and log sizes in cells of 8, 16 and 32 pixels, objectness, class scores;
- YOLOv8 and later: (1, 4 + classes, cells), centre and size in input pixels, class scores;
- SSD: (1, 1, boxes, 7), image, class, score, and the corners as fractions of the input.

Detectors miss small targets, so for a click the network gets a window around it, enlarged to its input.  A whole image
is searched in squares of its shorter side.
"""

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from follow.control.onnx_engines import Run, has_onnx_runtime, with_onnx_runtime, with_opencv
from follow.selection import Detection
from racf.box import Box

UInt8 = NDArray[np.uint8]
Floats = NDArray[np.float32]

WINDOW = 0.6  # side of the window in image heights: as large as those of follow.control.click
LEAST_SCORE = 0.25  # the usual threshold for showing a box in the three families
SAME_IOU = 0.5  # two boxes with a larger overlap are of one object: usual in the three families
COVERED = 0.7  # a cut-off box that another box covers by this fraction of its area is a part of that object
MOST = 32  # objects in an image: a person cannot choose among more
CONSIDERED = 1000  # likeliest boxes kept per square: the cost of suppression grows with the square of their number
MARGIN = 0.2  # a click this fraction of a box's size outside it still counts: a finger misses a small target
STRIDES = (8, 16, 32)  # of YOLOX
USUAL_SIZE = 640  # of a network that takes any size
GREY = 114  # what YOLOX and YOLOv8 pad with
SSD_FIELDS = 7
NOT_ONNX = "it is not an ONNX file: export your network as one, see docs/detector.md"
BYTES, VARINT, FIXED64, FIXED32 = 2, 0, 1, 5  # wire types of Protocol Buffers


class Detector:
    """A network in an ONNX file.  Raises ValueError for a network that cannot be used."""

    def __init__(self, path: Path) -> None:
        data = path.read_bytes()
        try:
            self._size = input_size(data) or USUAL_SIZE
            self._run, output = started(data, np.full((1, 3, self._size, self._size), GREY, np.float32))
            self._kind = kind_of(output, self._size)
        except ValueError as error:
            raise ValueError(f"the detector {path} cannot be used: {error}") from None

    def find(self, image: UInt8) -> tuple[Detection, ...]:
        """The objects in an image of (rows, columns[, 3]), BGR or grey, each once, likeliest first, at most `MOST`.

        Raises ValueError if the network fails.
        """
        colour = in_colour(image)
        rows, columns = colour.shape[:2]
        whole: list[Detection] = []
        cut_off: list[Detection] = []  # by the border of a square: the next square may show the whole object
        for left, top, side in squares(rows, columns):
            for found in self._look(colour, left, top, side):
                (whole if is_inside(found.box, left, top, side, rows, columns) else cut_off).append(found)
        kept = distinct(whole)[: 4 * MOST]
        parts = [d for d in distinct(cut_off)[: 4 * MOST] if all(covered(d.box, k.box) < COVERED for k in kept)]
        return tuple(sorted(kept + parts, key=lambda d: -d.score)[:MOST])

    def snap(self, image: UInt8, x: float, y: float) -> Box | None:
        """The box of the likeliest object at a pixel of an image of (rows, columns[, 3]) in BGR; None without one.

        Raises ValueError if the network fails.
        """
        side = max(round(WINDOW * image.shape[0]), 16)
        found = self._look(in_colour(image), round(x - side / 2), round(y - side / 2), side)
        there = [d for d in found if holds(d.box.scaled(1 + 2 * MARGIN), x, y)]
        return max(there, key=lambda d: d.score).box if there else None

    def _look(self, image: UInt8, left: int, top: int, side: int) -> list[Detection]:
        """The objects in a square of a colour image, in the image's pixels; the same one may appear several times."""
        window, scale = cut(image, left, top, side), self._size / side
        how = cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR
        square = np.asarray(cv2.resize(window, (self._size, self._size), interpolation=how), np.uint8)
        found = ((d.box.zoomed(1 / scale), d.score) for d in self.detect(square))
        return [Detection(Box(box.x + left, box.y + top, box.w, box.h), score) for box, score in found]

    def detect(self, square: UInt8) -> list[Detection]:
        """Every object in a square BGR image of the input's size; the same object may appear several times.

        Raises ValueError if the network fails.
        """
        factor = 1.0 / 255.0 if self._kind == "YOLOv8" else 1.0
        blob = cv2.dnn.blobFromImage(square, factor, swapRB=factor != 1.0)  # YOLOX takes BGR, YOLOv8 RGB
        output = self._run(np.asarray(blob, np.float32))
        if kind_of(output, self._size) != self._kind:
            raise ValueError(f"its output, of {self._kind} at first, has now the shape {output.shape}")
        if self._kind == "SSD":
            corners, scores = output.reshape(-1, SSD_FIELDS)[:, 3:] * self._size, output.reshape(-1, SSD_FIELDS)[:, 2]
            boxes = np.column_stack([corners[:, :2], corners[:, 2:] - corners[:, :2]])
        else:
            rows = output[0].T if self._kind == "YOLOv8" else output[0]
            centres, scores = yolov8(rows) if self._kind == "YOLOv8" else yolox(rows, self._size)
            boxes = np.column_stack([centres[:, :2] - centres[:, 2:] / 2, centres[:, 2:]])
        good = (np.abs(boxes) <= 2 * self._size).all(axis=1) & (boxes[:, 2:] > 0).all(axis=1)  # NaN is neither
        good &= (scores >= LEAST_SCORE) & (scores <= 1.001)  # rounding of a half-precision network
        order = np.argsort(-scores[good], kind="stable")[:CONSIDERED]
        pairs = zip(boxes[good][order], scores[good][order], strict=True)
        return [Detection(Box(*map(float, box)), float(score)) for box, score in pairs]


def started(model: bytes, blank: Floats) -> tuple[Run, Floats]:
    """The network loaded by OpenCV or, if that fails, by ONNX Runtime, and its output for a blank image.

    Raises ValueError if neither can run it.
    """
    try:
        run = with_opencv(model)
        return run, run(blank)
    except ValueError as error:
        if not has_onnx_runtime():
            raise ValueError(
                f"OpenCV cannot run it ({str(error)[:200]}); ONNX Runtime may: pip install '.[detector]' in the clone"
            ) from None
    run = with_onnx_runtime(model)
    return run, run(blank)


def kind_of(output: Floats, size: int) -> str:
    """The family of a network by its output.  Raises ValueError for any other shape."""
    shape, cells = output.shape, sum((size // stride) ** 2 for stride in STRIDES)
    if len(shape) == 4 and shape[:2] == (1, 1) and shape[3] == SSD_FIELDS:
        return "SSD"
    if len(shape) == 3 and shape[0] == 1 and shape[2] == cells and shape[1] > 4:
        return "YOLOv8"
    if len(shape) == 3 and shape[0] == 1 and shape[1] == cells and shape[2] > 5:
        return "YOLOX"
    wanted = f"(1, {cells}, 5 + classes) as YOLOX, (1, 4 + classes, {cells}) as YOLOv8, or (1, 1, boxes, 7) as SSD"
    raise ValueError(f"for {size}x{size} pixels its output has the shape {shape}, not {wanted}")


def yolov8(rows: Floats) -> tuple[Floats, Floats]:
    """Centre x, centre y, width, height in input pixels, and the best class score, of YOLOv8's cells."""
    return rows[:, :4], rows[:, 4:].max(axis=1)


def yolox(rows: Floats, size: int) -> tuple[Floats, Floats]:
    """The same of YOLOX's cells: offsets from the cell's corner and log sizes, both in strides."""
    corners, strides = [], []
    for stride in STRIDES:
        down, across = np.mgrid[: size // stride, : size // stride]
        corners.append(np.column_stack([across.ravel(), down.ravel()]))
        strides.append(np.full((across.size, 1), stride))
    stride = np.concatenate(strides)
    centres = (rows[:, :2] + np.concatenate(corners)) * stride
    sizes = np.exp(np.clip(rows[:, 2:4], -20.0, 20.0)) * stride
    return np.column_stack([centres, sizes]).astype(np.float32), rows[:, 4] * rows[:, 5:].max(axis=1)


def squares(rows: int, columns: int) -> list[tuple[int, int, int]]:
    """Left, top and side of squares of an image's shorter side that cover it, evenly spread along the longer one."""
    side, length = min(rows, columns), max(rows, columns)
    count = -(-length // side)
    starts = [round(k * (length - side) / max(count - 1, 1)) for k in range(count)]
    return [(start, 0, side) if columns >= rows else (0, start, side) for start in starts]


def is_inside(box: Box, left: int, top: int, side: int, rows: int, columns: int) -> bool:
    """Whether a box is clear of the square's borders, except those that are also the image's."""
    near = side / 50
    return (
        (left <= 0 or box.x > left + near)
        and (top <= 0 or box.y > top + near)
        and (left + side >= columns or box.x + box.w < left + side - near)
        and (top + side >= rows or box.y + box.h < top + side - near)
    )


def distinct(found: list[Detection]) -> list[Detection]:
    """Each object once, by its likeliest box (non-maximum suppression)."""
    if not found:
        return []
    corners = [(d.box.x, d.box.y, d.box.w, d.box.h) for d in found]
    kept = cv2.dnn.NMSBoxes(corners, [d.score for d in found], LEAST_SCORE, SAME_IOU)
    return [found[int(k)] for k in np.asarray(kept).ravel()]


def covered(part: Box, whole: Box) -> float:
    """Fraction of a box's area that another one covers."""
    return part.intersection(whole) / part.area


def in_colour(image: UInt8) -> UInt8:
    """The image with three channels."""
    return image if image.ndim == 3 else np.asarray(cv2.cvtColor(image, cv2.COLOR_GRAY2BGR), np.uint8)


def cut(image: UInt8, left: int, top: int, side: int) -> UInt8:
    """A square of the image, padded with grey outside it."""
    window = np.full((side, side, 3), GREY, np.uint8)
    rows, columns = image.shape[:2]
    x0, y0, x1, y1 = max(left, 0), max(top, 0), min(left + side, columns), min(top + side, rows)
    if x1 > x0 and y1 > y0:
        window[y0 - top : y1 - top, x0 - left : x1 - left] = image[y0:y1, x0:x1]
    return window


def holds(box: Box, x: float, y: float) -> bool:
    """Whether a pixel lies in a box."""
    return box.x <= x <= box.x + box.w and box.y <= y <= box.y + box.h


def input_size(model: bytes) -> int:
    """Side of the square input that an ONNX model declares, 0 if it takes any; ValueError if it is not square.

    ModelProto.graph (7), GraphProto.input (11), ValueInfoProto.type (2), TypeProto.tensor_type (1), its shape (2), the
    dimensions (1), dim_value (1): https://github.com/onnx/onnx/blob/main/onnx/onnx.proto3.
    """
    found = [model]
    for number in (7, 11, 2, 1, 2):
        found = [part for message in found for part in parts(message, number)][:1]  # the first input
    sides = [next(iter(numbers(dimension, 1)), 0) for shape in found for dimension in parts(shape, 1)]
    if len(sides) != 4:
        raise ValueError("it is not an ONNX network with one image as its first input: see docs/detector.md")
    if sides[2] != sides[3]:
        raise ValueError(f"its input is {sides[3]}x{sides[2]} pixels, not square")
    return sides[2]


def parts(message: bytes, number: int) -> list[bytes]:
    """The fields of that number that hold bytes.  Raises ValueError if `message` is not a Protocol Buffers message."""
    return [value for n, value in fields(message) if n == number and isinstance(value, bytes)]


def numbers(message: bytes, number: int) -> list[int]:
    """The fields of that number that hold an integer."""
    return [value for n, value in fields(message) if n == number and isinstance(value, int)]


def fields(message: bytes) -> list[tuple[int, bytes | int]]:
    """Number and value of each field of a message."""
    found: list[tuple[int, bytes | int]] = []
    at = 0
    while at < len(message):
        key, at = varint(message, at)
        number, kind = key >> 3, key & 7
        if kind == VARINT:
            value, at = varint(message, at)
            found.append((number, value))
            continue
        length = {FIXED64: 8, FIXED32: 4}.get(kind, 0)
        if kind == BYTES:
            length, at = varint(message, at)
        if kind not in (BYTES, FIXED64, FIXED32) or at + length > len(message):
            raise ValueError(NOT_ONNX)
        found.append((number, message[at : at + length]))
        at += length
    return found


def varint(message: bytes, at: int) -> tuple[int, int]:
    """A Protocol Buffers varint (seven bits a byte) and the offset after it."""
    value = shift = 0
    while at < len(message) and shift < 64:
        byte = message[at]
        value |= (byte & 127) << shift
        at, shift = at + 1, shift + 7
        if byte < 128:
            return value, at
    raise ValueError(NOT_ONNX)
