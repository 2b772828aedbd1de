"""What a tracker's name on the command line means.

`racf`, `racf-`, `racf--`, `bacf` and `arcf-hc` are presets of racf.params; `csrt`, `kcf`, `mil` are OpenCV's, where
the installed OpenCV has them.  Settings may follow the name: `racf,robust`, `bacf,refine,admm_iterations=3`.
"""

import ctypes
import hashlib
import math
import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from typing_extensions import Self

import racf
from racf.box import Box
from racf.evaluate.runner import Tracker
from racf.params import PRESETS, Params, preset, split_settings
from racf.refine import Refined
from racf.track import Track

OPENCV = {"csrt": "TrackerCSRT_create", "kcf": "TrackerKCF_create", "mil": "TrackerMIL_create"}
PEERS = ("csrt", "kcf")  # those that a drone's computer could run instead of ours


@dataclass(frozen=True, slots=True)
class TrackerSpec:
    """A tracker by name, its settings as text, and the label of its row in tables."""

    label: str
    name: str
    settings: tuple[tuple[str, str], ...] = ()

    @classmethod
    def parse(cls, text: str) -> Self:
        """Read `name[,key=value...]`."""
        return cls(text, *split_settings(text))

    def check(self) -> None:
        """Raise ValueError for a name or a setting that is not known."""
        if self.name not in PRESETS and self.name not in OPENCV:
            raise ValueError(f"tracker {self.name!r} is not known; known are {', '.join([*PRESETS, *OPENCV])}")
        _ = self._opencv_settings() if self.name in OPENCV else self.params()

    def with_settings(self, settings: list[str]) -> Self:
        """The same with more settings, each `key=value`, or `key` alone for true."""
        return replace(self, settings=(*self.settings, *split_settings(",".join([self.name, *settings]))[1]))

    def build(self) -> Tracker:
        """A fresh tracker."""
        if self.name in OPENCV:
            return Peer(self.name, **self._opencv_settings())
        return racf.Racf(self.params())

    def params(self) -> Params:
        """The parameters of one of ours; raises ValueError for a name or a setting that is not known."""
        return preset(self.name).with_settings(dict(self.settings))

    def fingerprint(self) -> str:
        """Changes whenever the boxes could: a digest of parameters, versions and the tracker's source."""
        what = f"{self.name} {self._opencv_settings()}" if self.name in OPENCV else repr(self.params())
        parts = (what, version("follow-me"), cv2.__version__, np.__version__, _source_digest())
        return hashlib.sha256("\n".join(parts).encode()).hexdigest()[:16]

    def _opencv_settings(self) -> dict[str, bool]:
        for key, value in self.settings:
            if key != "refine" or value not in {"true", "false"}:
                raise ValueError(f"OpenCV's {self.name} has only the setting refine (true or false), not {key}={value}")
        return {"refine": dict(self.settings).get("refine") == "true"}


def _source_digest() -> str:
    """Digest of the tracker's own files (not of this package, which only runs it)."""
    digest = hashlib.sha256()
    for path in sorted(Path(racf.__file__).parent.glob("*.py")):
        if path.name not in {"cli.py", "commandline.py"}:
            digest.update(path.read_bytes())
    return digest.hexdigest()


# MIL draws its features with C's rand(), whose state is the process's: else a result depends on what ran before.
_C = ctypes.CDLL("ucrtbase" if sys.platform == "win32" else None)


class Peer:
    """One of OpenCV's trackers, as it comes, with or without the scale refinement behind it.

    Raises ValueError where the installed OpenCV does not have it.  Its boxes are whole pixels; a frame in which it
    finds nothing keeps the last box.
    """

    def __init__(self, name: str, *, refine: bool = False) -> None:
        make = _opencv_maker(name)
        if make is None:
            raise ValueError(f"OpenCV {cv2.__version__} here has no {name} tracker; `make bench` builds one that has")
        self._tracker = Refined(make()) if refine else make()
        self._box = Box(0, 0, 1, 1)

    def init(self, image: NDArray[np.uint8], box: Box) -> Track:
        """Start on `box`, rounded to whole pixels; MIL with the same random features each time."""
        _C.srand(0)
        self._tracker.init(image, (round(box.x), round(box.y), round(box.w), round(box.h)))
        self._box = box
        return self._track(True)

    def update(self, image: NDArray[np.uint8]) -> Track:
        """Find the target in the next picture."""
        found, (x, y, w, h) = self._tracker.update(image)
        if found and w > 0 and h > 0:
            self._box = Box(float(x), float(y), float(w), float(h))
        return self._track(bool(found))

    def _track(self, found: bool) -> Track:
        return Track(self._box, self._box, psr=math.nan, apce=math.nan, confidence=float(found), found=found)


def opencv_has(name: str) -> bool:
    """Whether the installed OpenCV brings this tracker (csrt and kcf come with opencv-contrib only)."""
    return _opencv_maker(name) is not None


def _opencv_maker(name: str) -> Callable[[], Any] | None:
    legacy = getattr(cv2, "legacy", None)
    return getattr(cv2, OPENCV[name], None) or getattr(legacy, OPENCV[name], None)
