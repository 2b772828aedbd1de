"""Checks of the arguments of `racf.evaluate.evaluate`: a UsageError in one sentence before anything runs."""

import operator
import os
from collections.abc import Iterable
from pathlib import Path
from typing import cast

from racf.errors import UsageError
from racf.evaluate import studies


def whole(name: str, value: object) -> int:
    """A whole number from 0 on, of Python or numpy.  Raises UsageError."""
    try:
        number = operator.index(value)  # pyright: ignore[reportArgumentType] - TypeError if it is not whole
    except TypeError:
        number = -1
    if number < 0 or isinstance(value, bool):
        raise UsageError(f"{name} is a whole number of at least 0, not {value!r}")
    return number


def images_of(value: object, out: Path | None) -> int:
    """The number of sequences to draw on; above 0 it needs `out`.  Raises UsageError."""
    images = whole("images", value)
    if images and out is None:
        raise UsageError("images need out, the folder to draw into")
    return images


def texts(name: str, given: object) -> tuple[str, ...]:
    """One text or several.  Raises UsageError."""
    several = (given,) if isinstance(given, str) else given
    found = tuple(cast("Iterable[object]", several)) if isinstance(several, Iterable) else (several,)
    if wrong := [text for text in found if not isinstance(text, str)]:
        raise UsageError(f"{name} is one text or several, not {wrong[0]!r}")
    return cast("tuple[str, ...]", found)


def directory(name: str, given: object) -> Path:
    """A path.  Raises UsageError."""
    if not isinstance(given, str | os.PathLike):
        raise UsageError(f"{name} is the path of a folder, not {given!r}")
    return Path(cast("str | os.PathLike[str]", given))


def table_number(given: object) -> int | None:
    """The number of one of the paper's tables, or None.  Raises UsageError."""
    if given is None or (isinstance(given, int) and not isinstance(given, bool) and 2 <= given <= 5):
        return given
    raise UsageError(f"table is 2, 3, 4 or 5, not {given!r}")


def sweep_of(given: object) -> studies.Sweep:
    """The values that tables 3 and 4 vary; None: the paper's.  Raises UsageError."""
    if given is None or isinstance(given, studies.Sweep):
        return given or studies.Sweep()
    raise UsageError(f"sweep is a racf.evaluate.studies.Sweep, not {given!r}")


def address(name: str, given: object) -> str | None:
    """A text, or None.  Raises UsageError."""
    if given is None or isinstance(given, str):
        return given
    raise UsageError(f"{name} is a text, not {given!r}")
