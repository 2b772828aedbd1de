"""OpenCV's own trackers, with or without the scale refinement behind them.

name   settings                        comes with
csrt   refine                          opencv-contrib (`make bench` builds an environment that has it)
kcf    refine                          opencv-contrib
mil    refine                          every OpenCV
nano   backbone=FILE, neckhead=FILE, refine   every OpenCV; the two ONNX files are NanoTrack v2's
vit    net=FILE, refine                every OpenCV; the ONNX file is VitTrack's
"""

import ctypes
import hashlib
import math
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from racf.box import Box
from racf.refine import Refined
from racf.track import Track
from racf.tracker import checked_next

OPENCV = {"csrt": "TrackerCSRT", "kcf": "TrackerKCF", "mil": "TrackerMIL", "nano": "TrackerNano", "vit": "TrackerVit"}
NETWORKS = {
    "nano": ("backbone", "neckhead"),
    "vit": ("net",),
}  # the files that a tracker needs, by OpenCV's parameter names
PEERS = ("csrt", "kcf")  # those that a drone's computer could run instead of ours

MIL_LEAST_PX = 5  # on a smaller target MIL never ends: it draws random features until one fits
# MIL draws its features with C's rand(), whose state is global: without a seed they depend on earlier calls.
_C = ctypes.CDLL("ucrtbase" if sys.platform == "win32" else None)


class Peer:
    """One of OpenCV's trackers.  `files` holds the paths of `NETWORKS`.

    Its boxes are whole pixels; in a frame in which it finds nothing it keeps the last box.  Raises ValueError if the
    installed OpenCV does not have it or cannot read its files.
    """

    def __init__(self, name: str, *, refine: bool = False, files: Mapping[str, str] | None = None) -> None:
        make = require_opencv(name)
        try:
            tracker = make(_opencv_parameters(name, files)) if files else make()
        except cv2.error as error:
            raise ValueError(f"OpenCV cannot build {name} from {files}: {' '.join(str(error).split())}") from None
        self._tracker = Refined(tracker) if refine else tracker
        self._score: Callable[[], float] | None = getattr(tracker, "getTrackingScore", None)
        self._name, self._box = name, Box(0, 0, 1, 1)
        self._frame_shape: tuple[int, ...] | None = None
        self._files = ", ".join(f"{key} is {path}" for key, path in (files or {}).items())

    def init(self, image: NDArray[np.uint8], box: Box) -> Track:
        """Start on `box`, rounded to whole pixels; MIL draws the same random features each time.

        Raises ValueError if OpenCV refuses the image or the box.
        """
        least = MIL_LEAST_PX if self._name == "mil" else 0
        if min(round(box.w), round(box.h)) < least:
            raise ValueError(f"OpenCV's mil needs a target of at least {least} pixels on each side, not {box}")
        _C.srand(0)
        try:
            self._tracker.init(image, (round(box.x), round(box.y), round(box.w), round(box.h)))
        except cv2.error as error:
            hint = f"; check its files: {self._files}" if self._files else ""
            raise ValueError(
                f"OpenCV's {self._name} cannot start on {box}{hint}: {' '.join(str(error).split())}"
            ) from None
        self._box, self._frame_shape = box, image.shape
        return self._track(True)

    def update(self, image: NDArray[np.uint8]) -> Track:
        """Find the target in the next image.

        Raises ValueError if the image differs from the first one in shape or type, or before `init`.
        """
        image = checked_next(image, self._frame_shape, None)
        found, (x, y, w, h) = self._tracker.update(image)
        if found and w > 0 and h > 0:
            self._box = Box(float(x), float(y), float(w), float(h))
        return self._track(bool(found), self._score() if self._score else None)

    def _track(self, found: bool, score: float | None = None) -> Track:
        confidence = float(found) if score is None else min(max(float(score), 0.0), 1.0)
        return Track(self._box, self._box, psr=math.nan, apce=math.nan, confidence=confidence, found=found)


def opencv_has(name: str) -> bool:
    """Whether the installed OpenCV has this tracker."""
    return _opencv_maker(name) is not None


def require_opencv(name: str) -> Callable[..., Any]:
    """The function that builds this tracker; raises ValueError if the installed OpenCV does not have it."""
    make = _opencv_maker(name)
    if make is None:
        raise ValueError(
            f"OpenCV {cv2.__version__} here has no {name} tracker: in a clone `make bench-env` builds one that has, "
            "and .venv-bench/bin/racf or .venv-bench/bin/follow uses it; elsewhere "
            "opencv-contrib-python-headless in the place of opencv-python-headless"
        )
    return make


def peer_settings(name: str, settings: Mapping[str, str]) -> tuple[bool, dict[str, str]]:
    """Whether to refine, and the network files; raises ValueError for another setting or a missing file."""
    files, wanted = dict[str, str](), NETWORKS.get(name, ())
    for key, value in settings.items():
        if key in wanted:
            files[key] = value
        elif key != "refine" or value not in {"true", "false"}:
            known = ", ".join([*(f"{file}=FILE" for file in wanted), "refine (true or false)"])
            raise ValueError(f"OpenCV's {name} has only the settings {known}, not {key}={value}")
    for key in wanted:
        if key not in files:
            raise ValueError(f"OpenCV's {name} needs its network: {name},{','.join(f'{file}=FILE' for file in wanted)}")
        if not Path(files[key]).is_file():
            raise ValueError(f"OpenCV's {name}: {key} must be a file, and {files[key]} is not one")
    return settings.get("refine") == "true", files


def digest_of(files: Mapping[str, str]) -> str:
    """Digest of the content of network files."""
    digest = hashlib.sha256()
    for key in sorted(files):
        digest.update(Path(files[key]).read_bytes())
    return digest.hexdigest()


def _opencv_maker(name: str) -> Callable[..., Any] | None:
    legacy = getattr(cv2, "legacy", None)
    return getattr(cv2, f"{OPENCV[name]}_create", None) or getattr(legacy, f"{OPENCV[name]}_create", None)


def _opencv_parameters(name: str, files: Mapping[str, str]) -> Any:
    parameters = getattr(cv2, f"{OPENCV[name]}_Params")()
    for key, path in files.items():
        setattr(parameters, key, path)
    return parameters
