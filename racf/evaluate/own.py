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
import os
import sys
import uuid
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from racf.box import Box
from racf.track import Track

Factory = Callable[[], Any]
PROTOCOL = "init(image, box) and update(image), which gives the box"


class OwnTracker:
    """A tracker of yours, with its answers turned into Tracks."""

    def __init__(self, tracker: Any, label: str) -> None:
        for method in ("init", "update"):
            if not callable(getattr(tracker, method, None)):
                raise ValueError(f"tracker {label}: it needs two methods, {PROTOCOL}; {method} is missing")
        self._tracker, self._label = tracker, label
        self._box = Box(0, 0, 1, 1)

    def init(self, image: NDArray[np.uint8], box: Box) -> Track:
        """Start on `box`."""
        self._tracker.init(image, box)
        self._box = box
        return self._track(found=True)

    def update(self, image: NDArray[np.uint8]) -> Track:
        """Its answer to the next image; the last box again if it gives None.  Raises ValueError for any other thing."""
        answer = self._tracker.update(image)
        if isinstance(answer, Track):
            self._box = answer.box
            return answer
        if answer is None:
            return self._track(found=False)
        try:
            self._box = answer if isinstance(answer, Box) else Box(*answer)
        except (TypeError, ValueError) as error:
            raise ValueError(
                f"tracker {self._label}: update gives a racf.Box, x, y, w, h, a racf.Track or None, "
                f"not {answer!r}: {error}"
            ) from None
        return self._track(found=True)

    def _track(self, *, found: bool) -> Track:
        return Track(self._box, self._box, psr=np.nan, apce=np.nan, confidence=float(found), found=found)


@dataclass(frozen=True)
class OwnSpec:
    """A class of yours (or a function that builds a tracker) and the label of its row.

    A later run reuses results only if the source code of the class can be read and is unchanged.
    """

    label: str
    factory: Factory
    _once: str = field(default_factory=lambda: uuid.uuid4().hex, compare=False)

    def build(self) -> OwnTracker:
        """A fresh tracker."""
        return OwnTracker(self.factory(), self.label)

    def fingerprint(self) -> str:
        """Digest of the class's source code; never the same twice if that cannot be read."""
        return hashlib.sha256(f"{self.label}\n{source_of(self.factory) or self._once}".encode()).hexdigest()[:16]

    @property
    def travels(self) -> bool:
        """Whether other processes can import it: not from a notebook, a prompt or inside a function."""
        module, name = getattr(self.factory, "__module__", "__main__"), getattr(self.factory, "__qualname__", "<")
        return module != "__main__" and "<" not in name


def load(name: str) -> Callable[..., Any]:
    """The class or function `module:Name`; raises ValueError that says what is missing."""
    module_name, _, attribute = name.partition(":")
    if os.getcwd() not in sys.path:
        sys.path.insert(0, os.getcwd())
    try:
        module = importlib.import_module(module_name)
    except (ImportError, ValueError) as error:
        raise ValueError(f"tracker {name!r}: module {module_name!r} cannot be imported: {error}") from None
    found = getattr(module, attribute, None)
    if not callable(found):
        raise ValueError(f"tracker {name!r}: {module.__name__} has no class {attribute!r}; write module:Class")
    return found


def build(name: str, settings: Mapping[str, str]) -> OwnTracker:
    """`module:Class` with its settings as keyword arguments; raises ValueError if it does not take them."""
    try:
        return OwnTracker(load(name)(**{key: _value(text) for key, text in settings.items()}), name)
    except TypeError as error:
        raise ValueError(f"tracker {name!r} cannot be built: {error}") from None


def source_of(thing: Any) -> str | None:
    """The text of the file in which a class or function stands, or of itself if there is no file."""
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
