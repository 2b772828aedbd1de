"""`--detector`: a detector network from the user's ONNX file."""

from contextlib import ExitStack
from pathlib import Path

from follow.control.detecting import DelayedDetector, DetectorProcess
from follow.control.detector import Detector
from follow.control.selector import Snap
from racf.commandline import UsageError, plain


def check_detector(path: Path | None) -> Detector | None:
    """The detector of a file, None without one.  Raises UsageError for a file that cannot be used."""
    try:
        return None if path is None else Detector(path)
    except OSError as error:
        raise UsageError(f"--detector {plain(error)}") from None
    except ValueError as error:
        raise UsageError(f"--detector: {error}") from None


def simulated_detector(path: Path | None) -> DelayedDetector | None:
    """The detector of a simulated flight, None without one.  Raises UsageError for a file that cannot be used."""
    detector = check_detector(path)
    return None if detector is None else DelayedDetector(detector.find)


def open_detector(path: Path | None, sides: ExitStack) -> tuple[DetectorProcess | None, Snap]:
    """The detector of a flight in real time, None without one, and the function that finds an object at a click."""
    if path is None:
        return None, lambda _image, _x, _y: None
    process = sides.enter_context(DetectorProcess(path))
    return process, process.snap
