"""Your own tracker in the evaluation: a class with two methods, named `module:Class` or passed to `evaluate`.

    class MyTracker:
        def init(self, image, box): ...    # image: (rows, columns, 3) uint8, BGR; box: a racf.Box in 0-based pixels
        def update(self, image): ...       # returns the target's box in the next image: a racf.Box or (x, y, w, h),
                                           # None if it was not found, or a racf.Track

`racf eval ROOT --tracker mymodule:MyTracker,size=3` builds a new `MyTracker(size=3)` for each sequence; the module is
also looked for in the current folder.
"""

import ast
import hashlib
import importlib
import inspect
import math
import numbers
import os
import sys
import traceback
import uuid
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from racf.box import Box
from racf.errors import TrackerError
from racf.evaluate.boxfiles import FARTHEST_PX
from racf.track import Track

Factory = Callable[[], Any]
PROTOCOL = "init(image, box) and update(image), which gives the box"


class OwnTracker:
    """A tracker of yours; turns its return values into Tracks and its exceptions into TrackerErrors."""

    def __init__(self, tracker: Any, label: str) -> None:
        for method in ("init", "update"):
            if not callable(getattr(tracker, method, None)):
                raise ValueError(f"tracker {label}: it needs two methods, {PROTOCOL}; {method} is missing")
        self._tracker, self._label = tracker, label
        self._box = Box(0, 0, 1, 1)
        self._frame = 0

    def init(self, image: NDArray[np.uint8], box: Box) -> Track:
        """Start on `box`.  Raises TrackerError if your `init` raises."""
        self._frame = 0
        try:
            self._tracker.init(image, box)
        except Exception as error:  # whatever your `init` raises
            raise self._failed("init", error) from error
        self._box = box
        return self._track(found=True)

    def update(self, image: NDArray[np.uint8]) -> Track:
        """Its result for the next image; the last box again if your `update` returns None.

        Raises TrackerError if your `update` raises, or returns anything but a box, a Track or None.
        """
        self._frame += 1
        try:
            answer = self._tracker.update(image)
        except Exception as error:  # whatever your `update` raises
            raise self._failed("update", error) from error
        if isinstance(answer, Track):
            if wrong := _wrong_in(answer):
                raise TrackerError(
                    f"tracker {self._label}: in the racf.Track that update gives {self._when()}, {wrong}"
                )
            self._box = answer.box
            return answer
        if answer is None:
            return self._track(found=False)
        try:
            self._box = _bounded(answer if isinstance(answer, Box) else Box(*answer))
        except (TypeError, ValueError) as error:
            raise TrackerError(
                f"tracker {self._label}: update gives a racf.Box, x, y, w, h, a racf.Track or None, "
                f"not {answer!r} {self._when()}: {error}"
            ) from None
        return self._track(found=True)

    def _failed(self, method: str, error: Exception) -> TrackerError:
        """The TrackerError for an exception in one of its methods; it names the last line of the tracker's own file."""
        own = getattr(sys.modules.get(type(self._tracker).__module__), "__file__", None)
        passed = traceback.extract_tb(error.__traceback__)
        place = next((step for step in reversed(passed) if step.filename == own), passed[-1])
        text = f"{said(error)} ({Path(place.filename).name}, line {place.lineno})"
        return TrackerError(f"tracker {self._label}: {method} failed {self._when()}: {text}")

    def _when(self) -> str:
        return f"in frame {self._frame} after the start" if self._frame else "in the first frame"

    def _track(self, *, found: bool) -> Track:
        return Track(self._box, self._box, psr=np.nan, apce=np.nan, confidence=float(found), found=found)


def _bounded(box: Box) -> Box:
    """The box; raises ValueError for one beyond the limits of a box file."""
    if max(abs(box.x), abs(box.y), box.w, box.h) > FARTHEST_PX:
        raise ValueError(f"a box lies within {FARTHEST_PX:g} pixels, not {box}")
    return box


def _wrong_in(track: Track) -> str:
    """What is wrong with a Track of your tracker; "" if nothing.  PSR and APCE may be NaN."""
    box = cast("object", track.box)
    if not isinstance(box, Box):
        return f"the box is a racf.Box, not {box!r}"
    try:
        _bounded(box)
    except ValueError as error:
        return str(error)
    for name in ("psr", "apce", "confidence"):
        if not isinstance(value := getattr(track, name), numbers.Real):
            return f"{name} is a number, not {value!r}"
    for stage, ms in track.stage_ms.items():
        if not isinstance(cast("object", ms), numbers.Real) or not math.isfinite(ms):
            return f"the milliseconds of stage {stage!r} are a finite number, not {ms!r}"
    return ""


@dataclass(frozen=True)
class OwnSpec:
    """A class of yours (or a function that builds a tracker) and the label of its row.

    A later evaluation reuses results only if the source code of the class can be read and is unchanged.
    """

    label: str
    factory: Factory
    _once: str = field(default_factory=lambda: uuid.uuid4().hex, compare=False)

    def build(self) -> OwnTracker:
        """A fresh tracker; raises ValueError if the class does not give one."""
        try:
            made = self.factory()
        except Exception as error:  # whatever your class raises while it is built
            raise ValueError(f"tracker {self.label} cannot be built: {said(error)}") from error
        return OwnTracker(made, self.label)

    def fingerprint(self) -> str:
        """Digest of the class's source code; never the same twice if that cannot be read."""
        return hashlib.sha256(f"{self.label}\n{source_of(self.factory) or self._once}".encode()).hexdigest()[:16]

    @property
    def travels(self) -> bool:
        """Whether other processes can import it: not from a notebook, a prompt or inside a function."""
        module, name = getattr(self.factory, "__module__", "__main__"), getattr(self.factory, "__qualname__", "<")
        return module != "__main__" and "<" not in name


def load(name: str) -> Callable[..., Any]:
    """The class or function `module:Name`; the ValueError for a wrong name says what is missing."""
    module_name, _, attribute = name.partition(":")
    if os.getcwd() not in sys.path:
        sys.path.insert(0, os.getcwd())
    try:
        module = importlib.import_module(module_name)
    except Exception as error:  # whatever a module of yours does while it is imported
        raise ValueError(f"tracker {name!r}: module {module_name!r} cannot be imported: {said(error)}") from error
    found = getattr(module, attribute, None)
    if not callable(found):
        raise ValueError(f"tracker {name!r}: {module.__name__} has no class {attribute!r}; write module:Class")
    return found


def build(name: str, settings: Mapping[str, str]) -> OwnTracker:
    """`module:Class` with its settings as keyword arguments; raises ValueError if that gives no tracker."""
    factory = load(name)
    return OwnSpec(name, lambda: factory(**{key: _value(text) for key, text in settings.items()})).build()


def said(error: BaseException) -> str:
    """An exception of foreign code in one line: its class and its message."""
    return " ".join(f"{type(error).__name__}: {error}".split())


def source_of(thing: Any) -> str | None:
    """The text of the file that defines a class or function, or its own source if there is no file."""
    try:
        file = inspect.getsourcefile(thing)
        return Path(file).read_text() if file and Path(file).is_file() else inspect.getsource(thing)
    except (OSError, TypeError):
        return None


def _value(text: str) -> Any:
    """A number, a bool or the text itself."""
    if text in {"true", "false"}:
        return text == "true"
    try:
        return ast.literal_eval(text)
    except (ValueError, SyntaxError):
        return text
