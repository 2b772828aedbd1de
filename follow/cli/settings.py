"""Settings in a file: the tree of `Config` as TOML, a table for each branch.

Each layer of settings overrides those before it: defaults, scenario, kind of target, file, command line.  An invalid
file gives one line that names the file, the setting, the rule and the value.
"""

import json
import re
import reprlib
import sys
from collections.abc import Collection, Iterator, Mapping
from dataclasses import fields, is_dataclass, replace
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar, cast

from follow.cli.described import sentences
from follow.config import Config
from racf.commandline import UsageError
from racf.nearest import MOST, close, question

if sys.version_info >= (3, 11):
    import tomllib
else:  # the type checker assumes 3.10, also on a later Python, where tomli is not installed
    import tomli as tomllib  # pyright: ignore[reportMissingImports]

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

BranchT = TypeVar("BranchT", bound="DataclassInstance")

Table = Mapping[str, object]
"""Settings as in a TOML file: a table for each branch."""

SYNONYMS = {"max": "maximum", "most": "maximum", "min": "minimum", "least": "minimum", "altitude": "height"}
"""A word that a person may type -> the one that the settings' descriptions use."""

DERIVED = "derived"
"""The table of a recorded file with the values derived from the flight's camera or scene; reading skips it, because
another camera or scene gives other values."""


def layered(*layers: tuple[str, Table]) -> Config:
    """The defaults, overridden by each layer in turn; a layer is its name and its table.

    Raises UsageError, which names the layer, for a setting that does not exist or may not have that value.
    """
    config = Config()
    for source, table in layers:
        config = _branch(config, table, source, "")
    return config


def file_layer(path: Path) -> tuple[str, Table]:
    """The settings in a file, as a layer.  Raises UsageError."""
    return f"settings {str(path)!r}", {key: value for key, value in _table(path).items() if key != DERIVED}


def read_settings(path: Path) -> Config:
    """The defaults, overridden by the settings in a file.  Raises UsageError."""
    return layered(file_layer(path))


def _table(path: Path) -> Table:
    try:
        if path.exists() and not path.is_file():  # a folder, or a device that may never end
            raise UsageError(f"settings {str(path)!r} is not a regular file")
        text = path.read_bytes().decode("utf-8-sig")  # with or without the byte order mark that Windows' editors write
    except OSError as error:
        raise UsageError(f"settings {str(path)!r} cannot be read: {error.strerror}") from None
    except UnicodeDecodeError as error:
        wrong = error.object[error.start]
        raise UsageError(f"settings {str(path)!r} must be UTF-8, not byte {wrong:#04x} at {error.start}") from None
    return read_table(text, f"settings {str(path)!r}")


def read_table(text: str, name: str) -> Table:
    """The tables of a TOML text that `name` names in messages.  Raises UsageError."""
    try:
        return tomllib.loads(text)
    except (ValueError, RecursionError) as error:
        raise UsageError(f"{name} must be TOML: {one_line(error)}") from None


def one_line(error: Exception) -> str:
    """An error's text without line breaks."""
    return " ".join(str(error).split())


def _branch(default: BranchT, table: object, source: str, name: str) -> BranchT:
    """The branch with the table's values."""
    if not isinstance(table, dict):
        raise UsageError(f"{source}: {name} must be a table, not {reprlib.repr(table)}")
    known = {f.name: getattr(default, f.name) for f in fields(default)}
    values: dict[str, object] = {}
    for key, value in cast(Mapping[str, object], table).items():
        path = f"{name}.{key}" if name else key
        if key not in known:
            raise UsageError(f"{source}: there is no setting {path!r}; {_nearest(key, default)}")
        values[key] = _value(known[key], value, source, path)
    try:
        return replace(default, **values)
    except ValueError as error:
        raise UsageError(f"{source}: {f'{name}: ' * bool(name)}{error}") from None


def _nearest(key: str, branch: "DataclassInstance") -> str:
    """A hint about a wrong name: a setting that resembles it or means the same, its right table; else all names."""
    known = {f.name: getattr(branch, f.name) for f in fields(branch)}
    for table, inner in known.items():
        if is_dataclass(inner) and key in (f.name for f in fields(inner)):
            return f"{key!r} belongs under [{table}]"
    return question(close(key, known) or _meant(key, branch)) or f"there are {', '.join(known)}"


def _meant(key: str, branch: "DataclassInstance") -> list[str]:
    """The settings whose descriptions, then names, hold the most words of `key`: ceiling_m for max_altitude_m."""
    return _most(_words_held(key, branch))


def _words_held(key: str, branch: "DataclassInstance") -> dict[str, tuple[int, int]]:
    """Setting -> the numbers of words of `key` that its description and its name hold."""
    words = {SYNONYMS.get(word, word) for word in key.lower().split("_") if len(word) > 2}
    held = {name: words & set(re.findall(r"[a-z]+", text.lower())) for name, text in sentences(type(branch)).items()}
    return {name: (len(found), len(words & set(name.split("_")))) for name, found in held.items()}


def _most(held: Mapping[str, tuple[int, int]]) -> list[str]:
    """The names with the largest numbers, unless all are 0."""
    most = max(held.values(), default=(0, 0))
    return [name for name, count in held.items() if count == most > (0, 0)]


def near_options(option: str) -> str:
    """`did you mean --limits.ceiling-m?` for an option that is no setting: by its spelling, else by its meaning.

    Without a known branch (`--max-altitude-m`) every branch is searched; "" if too many settings fit.
    """
    *before, key = option.partition("=")[0].lstrip("-").replace("-", "_").split(".")
    config = Config()
    branches = {f.name: getattr(config, f.name) for f in fields(config)}
    searched = {name: branch for name, branch in branches.items() if name in before} or branches
    known: dict[str, str] = {}  # option -> name of the setting
    held: dict[str, tuple[int, int]] = {}
    for name, branch in searched.items():
        words = _words_held(key, branch)
        leaves = [f.name for f in fields(branch) if not is_dataclass(getattr(branch, f.name))]
        known |= {_option(name, leaf): leaf for leaf in leaves}
        held |= {_option(name, leaf): words[leaf] for leaf in leaves}
    near = close(key, known.values())
    found = [option for name in near for option, leaf in known.items() if leaf == name] or _most(held)
    return question(found) if near or len(found) <= MOST else ""


def _option(branch: str, name: str) -> str:
    """The option of a setting."""
    return f"--{branch}.{name}".replace("_", "-")


def _value(default: object, value: object, source: str, name: str) -> object:
    """One setting, of the type that its default has."""
    if is_dataclass(default) and not isinstance(default, type):
        return _branch(default, value, source, name)
    if isinstance(default, bool):
        wanted, fits = "true or false", isinstance(value, bool)
    elif isinstance(default, int):
        wanted, fits = "a whole number", isinstance(value, int) and not isinstance(value, bool)
    elif isinstance(default, float) or default is None:  # a derived setting is None until someone gives it
        wanted = "a number"
        if isinstance(value, int | float) and not isinstance(value, bool):
            try:
                return float(value)
            except OverflowError:  # an integer of 400 digits
                wanted = "a number below 1e308"
        fits = False
    elif isinstance(default, str) and not isinstance(default, Enum):
        wanted, fits = "a text", isinstance(value, str)
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


def as_toml(config: Config, resolved: Config | None = None, scene: Collection[str] = ()) -> str:
    """The settings as a file that `read_settings` reads; a derived setting that was not set is left out.

    `resolved` are the same settings with each derived one filled in: those that were not set follow in tables
    `[derived.BRANCH]`, which document the flight, and which `read_settings` skips.  So do those that `scene` names
    (`camera.fov_deg`): they come from a drawn scene, and a real camera or target has others.
    """
    lines = [*_lines(config, "", scene)]
    if resolved is not None:
        lines += _lines(config, "", scene, resolved)
    return "\n".join(lines)[1:] + "\n"


def scene_values(path: Path) -> dict[str, object]:
    """The values in this file that came from a drawn scene, by dotted name; reading skips them.  Raises UsageError."""
    derived, default = _table(path).get(DERIVED), Config()
    tables = cast("Mapping[str, object]", derived) if isinstance(derived, dict) else {}
    return {
        f"{branch}.{name}": value
        for branch, table in tables.items()
        if isinstance(table, dict)
        for name, value in cast("Mapping[str, object]", table).items()
        if getattr(getattr(default, branch, None), name, None) is not None  # else it is derived from the camera
    }


def _lines(
    branch: "DataclassInstance", name: str, scene: Collection[str], resolved: "DataclassInstance | None" = None
) -> Iterator[str]:
    """A branch as tables, without None and the settings in `scene`; with `resolved` only those, with its values."""
    values = {f.name: getattr(branch, f.name) for f in fields(branch)}
    inner = {key: value for key, value in values.items() if is_dataclass(value) and not isinstance(value, type)}
    leaves = {key: value for key, value in values.items() if key not in inner}
    left_out = {key for key, value in leaves.items() if value is None or f"{name}.{key}" in scene}
    if resolved is None:
        written = {key: value for key, value in leaves.items() if key not in left_out}
    else:
        written = {key: getattr(resolved, key) for key in leaves if key in left_out}
    if written:
        yield f"\n[{name if resolved is None else f'{DERIVED}.{name}'}]"
    for key, value in written.items():
        yield f"{key} = {literal(value)}"
    for key, value in inner.items():
        inner_name = f"{name}.{key}" if name else key
        yield from _lines(value, inner_name, scene, resolved and getattr(resolved, key))


def literal(value: object) -> str:
    """A value as TOML writes it."""
    if isinstance(value, Enum):
        return json.dumps(value.value)
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False)
    return repr(float(value)) if isinstance(value, float) else repr(value)  # float(): numpy's repr includes its type
