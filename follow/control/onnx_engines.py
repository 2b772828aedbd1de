"""The engines that run an ONNX network: OpenCV, always installed, or ONNX Runtime, from the extra `detector`."""

# pyright: reportMissingImports=false
# The extra may be missing where types are checked.

from collections.abc import Callable
from importlib.util import find_spec
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float32]
Run = Callable[[Floats], Floats]
"""From an image of (1, 3, rows, columns) to the network's first output.  Raises ValueError if the network fails."""


def with_opencv(model: bytes) -> Run:
    """The network run by OpenCV.  Raises ValueError if it cannot read it."""
    try:
        network = cv2.dnn.readNetFromONNX(np.frombuffer(model, np.uint8))
    except cv2.error as error:
        raise ValueError(in_one_line(error)) from None

    def run(blob: Floats) -> Floats:
        try:
            network.setInput(blob)
            return np.asarray(network.forward(), np.float32)
        except cv2.error as error:
            raise ValueError(in_one_line(error)) from None

    return run


def has_onnx_runtime() -> bool:
    """Whether ONNX Runtime is installed."""
    return find_spec("onnxruntime") is not None


def with_onnx_runtime(model: bytes) -> Run:
    """The network run by ONNX Runtime, on as many cores as OpenCV may use.  Raises ValueError if it cannot read it."""
    import onnxruntime  # noqa: PLC0415 - the extra `detector`

    options: Any = onnxruntime.SessionOptions()
    options.intra_op_num_threads = max(cv2.getNumThreads(), 1)
    options.log_severity_level = 3  # errors
    try:
        session: Any = onnxruntime.InferenceSession(model, options, providers=["CPUExecutionProvider"])
    except Exception as error:  # noqa: BLE001 - its errors have no common class but this
        raise ValueError(in_one_line(error)) from None
    name = session.get_inputs()[0].name

    def run(blob: Floats) -> Floats:
        try:
            return np.asarray(session.run(None, {name: blob})[0], np.float32)
        except Exception as error:  # noqa: BLE001 - as above
            raise ValueError(in_one_line(error)) from None

    return run


def in_one_line(error: Exception) -> str:
    """An error's text without its line breaks."""
    return " ".join(str(error).split())
