"""Settings in a file: the tree of `Config` as TOML, a table for each branch.

What the file does not name keeps its default; what the command line names stands above the file.  Every way in which
a file may be wrong ends in one line that names the file, the setting, the rule and the value.
"""

import json
import reprlib
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import fields, is_dataclass, replace
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar, cast

from follow.config import Config
from racf.commandline import UsageError

if sys.version_info >= (3, 11):
    import tomllib
else:  # the checker judges for 3.10, also where it runs on a later Python that has no need of tomli
    import tomli as tomllib  # pyright: ignore[reportMissingImports]

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

BranchT = TypeVar("BranchT", bound="DataclassInstance")

OPTION = "--settings"


def settings_of(argv: Sequence[str]) -> Config:
    """The settings that the command line's file holds, or the defaults when it names none.  Raises UsageError."""
    path = _file(argv)
    return Config() if path is None else read_settings(path)


def _file(argv: Sequence[str]) -> Path | None:
    name: str | None = None
    for word, following in zip(argv, [*argv, None][1:], strict=True):
        if word == OPTION:
            name = following  # None: the command line's own parser says what is missing
        elif word.startswith(f"{OPTION}="):
            name = word.partition("=")[2]
    return None if name is None else Path(name)


def named(argv: Sequence[str]) -> frozenset[str]:
    """The settings that the command line gives, itself or by its file, as "branch.name".  Raises UsageError."""
    typed = {word[2:].partition("=")[0].replace("-", "_") for word in argv if word.startswith("--")}
    path = _file(argv)
    held = {} if path is None else _table(path)
    filed = {f"{branch}.{key}" for branch, values in held.items() if isinstance(values, dict) for key in values}
    return frozenset(name for name in typed | filed if "." in name)


def read_settings(path: Path) -> Config:
    """The settings in a file.  Raises UsageError."""
    return _branch(Config(), _table(path), f"settings {str(path)!r}", "")


def _table(path: Path) -> Mapping[str, object]:
    try:
        if path.exists() and not path.is_file():  # a folder, or a device that may never end
            raise UsageError(f"settings {str(path)!r} must be a file, and this is none")
        text = path.read_bytes().decode()
    except OSError as error:
        raise UsageError(f"settings {str(path)!r} cannot be read: {error.strerror}") from None
    except UnicodeDecodeError as error:
        wrong = error.object[error.start]
        raise UsageError(f"settings {str(path)!r} must be UTF-8, not byte {wrong:#04x} at {error.start}") from None
    try:
        return tomllib.loads(text)
    except (ValueError, RecursionError) as error:
        raise UsageError(f"settings {str(path)!r} must be TOML: {one_line(error)}") from None


def one_line(error: Exception) -> str:
    """What an error says, without line breaks."""
    return " ".join(str(error).split())


def _branch(default: BranchT, table: object, source: str, name: str) -> BranchT:
    """The branch with what the table sets."""
    if not isinstance(table, dict):
        raise UsageError(f"{source}: {name} must be a table, not {reprlib.repr(table)}")
    known = {f.name: getattr(default, f.name) for f in fields(default)}
    values: dict[str, object] = {}
    for key, value in cast(Mapping[str, object], table).items():
        path = f"{name}.{key}" if name else key
        if key not in known:
            raise UsageError(f"{source}: there is no setting {path!r}; there are {', '.join(known)}")
        values[key] = _value(known[key], value, source, path)
    try:
        return replace(default, **values)
    except ValueError as error:
        raise UsageError(f"{source}: {name}: {error}") from None


def _value(default: object, value: object, source: str, name: str) -> object:
    """One setting, of the type that its default has."""
    if is_dataclass(default) and not isinstance(default, type):
        return _branch(default, value, source, name)
    if isinstance(default, bool):
        wanted, fits = "true or false", isinstance(value, bool)
    elif isinstance(default, int):
        wanted, fits = "a whole number", isinstance(value, int) and not isinstance(value, bool)
    elif isinstance(default, float):
        wanted = "a number"
        if isinstance(value, int | float) and not isinstance(value, bool):
            try:
                return float(value)
            except OverflowError:  # an integer of 400 digits
                wanted = "a number below 1e308"
        fits = False
    elif isinstance(default, Enum):
        known = {str(choice.value): choice for choice in type(default)}
        if isinstance(value, str) and value in known:
            return known[value]
        wanted, fits = f"one of {', '.join(map(repr, known))}", False
    else:
        raise TypeError(f"setting {name} is of a type that no file holds: {type(default).__name__}")
    if not fits:
        raise UsageError(f"{source}: {name} must be {wanted}, not {reprlib.repr(value)}")
    return value


def as_toml(config: Config) -> str:
    """The settings as a file that `read_settings` reads."""
    return "\n".join(_lines(config, ""))[1:] + "\n"


def _lines(branch: "DataclassInstance", name: str) -> Iterator[str]:
    values = {f.name: getattr(branch, f.name) for f in fields(branch)}
    leaves = {key: value for key, value in values.items() if not is_dataclass(value)}
    if leaves:
        yield f"\n[{name}]"
    for key, value in leaves.items():
        yield f"{key} = {_literal(value)}"
    for key, value in values.items():
        if key not in leaves:
            yield from _lines(value, f"{name}.{key}" if name else key)


def _literal(value: object) -> str:
    if isinstance(value, Enum):
        return json.dumps(value.value)
    if isinstance(value, bool):
        return str(value).lower()
    return repr(float(value)) if isinstance(value, float) else repr(value)  # float(): numpy's repr bears its type
