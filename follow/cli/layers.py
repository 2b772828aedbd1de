"""The command line with its settings: defaults < scenario < kind of target < file < command line.

The command line is parsed twice.  The first pass only finds the options that name a layer: a scenario, a kind of
target, a file.  These layers are combined and become the defaults of the second pass.  Both passes use copies of the
commands and settings that accept every value, because a value that is invalid with the defaults may be valid with a
file; values are checked when the real command is made.
"""

import contextlib
import functools
import io
import itertools
import re
from collections.abc import Iterable, Sequence
from dataclasses import MISSING, field, fields, is_dataclass, make_dataclass, replace
from enum import Enum
from pathlib import Path
from typing import Annotated, Any, Union, cast, get_args, get_type_hints

import tyro

from follow.cli import described
from follow.cli.commands import (
    CalibrateCommand,
    Command,
    DoctorCommand,
    InspectCommand,
    ReflyCommand,
    ReplayCommand,
    ReportCommand,
    RunCommand,
    SimCommand,
)
from follow.cli.settings import Table, file_layer, layered, near_options, read_table
from follow.config import PRESETS, Config, TargetKind
from follow.recording.exact import read_setup
from follow.recording.folder import CALIBRATION, flight_folder
from racf.commandline import UsageError, parse
from racf.nearest import hint

PROG = "follow"
ABOUT = "Keep a target in view: with PX4, ArduPilot, footage or a simulated flight."
SCENE = "scene:"
HELP = ("-h", "--help")
HELP_ALL = "--help-all"
MORE = "{} {} --help-all lists also the settings, as --limits.speed-m-s."
NO_OPTION = re.compile(r"there is no option (-.*); --help lists the options")  # by racf.commandline
ARG: Any = type(tyro.conf.arg())
MARKERS = (tyro.conf.EnumChoicesFromValues,)  # px4, not PX4, is what is typed
NAMES: dict[str, type[Any]] = {
    "replay": ReplayCommand,
    "sim": SimCommand,
    "run": RunCommand,
    "doctor": DoctorCommand,
    "inspect": InspectCommand,
    "refly": ReflyCommand,
    "report": ReportCommand,
    "calibrate": CalibrateCommand,
}
METAVARS: dict[Any, str] = {bool: "", int: "INT", float: "FLOAT"}


def read(words: Sequence[str], scenario: str | None = None) -> Command:
    """The command of a command line, with its settings; `scenario` overrides the one that it names.

    Raises UsageError, SystemExit(0) after `--help`, which leaves the settings out, and `--help-all`.
    """
    if "--out=" in words or ("--out", "") in itertools.pairwise(words):
        raise UsageError("--out must be the name of a folder, not empty")
    is_short = any(word in HELP for word in words) and words[0] in NAMES
    words = ["--help" if word == HELP_ALL else word for word in words]
    known = _commands(below(words, scenario), is_short=is_short)
    try:
        parsed = parse(known, words, prog=PROG, description=ABOUT, config=MARKERS)
    except UsageError as error:
        raise _with_settings(error, words) from None
    kind = next(kind for kind in NAMES.values() if isinstance(parsed, _open(kind)))
    try:
        return _judged(kind, parsed)
    except ValueError as error:
        raise UsageError(str(error)) from None


def _with_settings(error: UsageError, words: Sequence[str]) -> UsageError:
    """The error about an option without a near one, with the settings that resemble it or mean the same."""
    found = NO_OPTION.fullmatch(str(error))
    kind = NAMES.get(words[0]) if words else None
    if found is None or kind is None or "config" not in (f.name for f in fields(kind)):
        return error
    where = f"{PROG} {words[0]} {HELP_ALL if '.' in found[1] else HELP[1]} lists the options"
    near = next(filter(None, map(near_options, found[1].split(" or "))), where)
    return UsageError(f"there is no option {found[1]}; {near}")


def with_view(words: Sequence[str]) -> list[str]:
    """The words with `here` added after a `--view` without a viewer."""
    full: list[str] = []
    for word, following in itertools.zip_longest(words, words[1:], fillvalue=""):
        names_viewer = following in ("here", "web") or "://" in following
        full += [word, "here"] if word == "--view" and not names_viewer else [word]
    return full


def settings_of(words: Sequence[str], scenario: str) -> Config:
    """The settings of the command line for a scenario.  Raises UsageError."""
    command = read(words, scenario)
    assert isinstance(command, ReplayCommand | SimCommand | RunCommand)
    return command.config


def without_scene(words: Sequence[str]) -> Any:
    """The settings of the command line without those that its scenario suggests, not checked.  Raises UsageError."""
    known = _commands(below(words, suggests=False))
    return cast(Any, parse(known, words, prog=PROG, description=ABOUT, config=MARKERS)).config


def from_scene(scenario: str, flown: Config, bare: Any) -> frozenset[str]:
    """The dotted names of the settings that come from a scenario: without it (`bare`) they have other values."""
    return frozenset(
        f"{branch}.{name}"
        for branch, table in _suggested(scenario).items()
        for name in cast("Table", table)
        if getattr(getattr(flown, branch), name) != getattr(getattr(bare, branch), name)
    )


def no_scenario(name: str, known: Iterable[str]) -> UsageError:
    """The error for a scenario that does not exist: one sentence, whichever option named it."""
    return UsageError(f"there is no scenario {name!r}; {hint(name, known, '`follow sim --list` prints their names')}")


def below(words: Sequence[str], scenario: str | None = None, *, suggests: bool = True) -> Config:
    """The settings of all layers below the command line; `suggests` includes the scenario's.  Raises UsageError."""
    first = _glance([word for word in words if word not in HELP])  # the help shows the defaults of the layers
    layers: list[tuple[str, Table]] = []
    if isinstance(first, _open(ReflyCommand)) and not any(word in HELP for word in words):
        layers.append(flown_with(flight_folder(first.flight)))
    if suggests and (name := scenario or _scenario(first)):
        layers.append((f"scenario {name}", _suggested(name)))
    kind: TargetKind | None = getattr(first, "for_", None)
    if kind is not None:
        layers.append((f"--for {kind.value}", PRESETS[kind]))
    if (path := getattr(first, "settings", None)) is not None:
        layers.append(file_layer(path))
    return layered(*layers)


def flown_with(flight: Path) -> tuple[str, Table]:
    """The settings of a recorded flight, as a layer.  Raises UsageError for a folder without them."""
    try:
        setup = read_setup(flight / "messages.jsonl.gz")
    except (FileNotFoundError, NotADirectoryError):
        raise UsageError(f"{str(flight)!r} holds no messages.jsonl.gz: give the folder of a recorded flight") from None
    except (OSError, ValueError) as error:
        raise UsageError(f"the flight in {str(flight)!r} cannot be read: {error}") from None
    name = f"the flight in {str(flight)!r}"
    table = read_table(setup.settings, name)
    camera = cast("dict[str, object]", table.get("camera", {}))
    if camera.get("calibration") and (flight / CALIBRATION).is_file():  # the original may have changed or be gone
        table = {**table, "camera": {**camera, "calibration": str(flight / CALIBRATION)}}
    return name, table


def _scenario(first: Any) -> str | None:
    """The scenario that a command line names, if it names one."""
    camera: str = getattr(first, "camera", None) or ""
    return camera.removeprefix(SCENE) if camera.startswith(SCENE) else getattr(first, "scenario", None)


def _suggested(name: str) -> Table:
    from sim.scenarios import SCENARIOS  # noqa: PLC0415 - footage and real cameras do without the simulator

    return SCENARIOS[name].suggested if name in SCENARIOS else {}  # an unknown name is refused by its command


def _glance(words: Sequence[str]) -> Any:
    """The command of the first pass, without its settings; None for an invalid command line, or for help."""
    with contextlib.suppress(SystemExit), contextlib.redirect_stderr(io.StringIO()):
        # The second pass prints the help and reports errors.
        cli = cast(Any, tyro.cli)
        return cli(
            _commands(Config(), needs_all=False),
            args=words,
            prog=PROG,
            config=MARKERS,
            add_help=False,
            console_outputs=False,
        )
    return None


def _commands(config: Config, *, needs_all: bool = True, is_short: bool = False) -> Any:
    """The commands by name, with the settings of `config` as defaults.

    Without `needs_all` a missing required option is empty.  `is_short` help leaves out the settings.
    """
    named: list[Any] = []
    for name, kind in NAMES.items():
        known = {f.name for f in fields(kind)}
        given = {"config": _opened(config)} if "config" in known else {}
        hints = get_type_hints(kind)
        missing = {f.name: hints[f.name] for f in fields(kind) if f.default is f.default_factory is MISSING}
        required = {name: tyro.MISSING if needs_all else hint() for name, hint in missing.items()}
        shown = _short(name, kind) if is_short and given else _open(kind)
        default = shown(**required, **given)
        named.append(Annotated[shown, tyro.conf.subcommand(name, default=default)])
    return Union[tuple(named)]  # noqa: UP007 - as many as there are names


@functools.cache
def _open(kind: type[Any]) -> Any:
    """A copy of the dataclass `kind`, and of those in it, without checks of its values, and with the fields' help."""
    sentences, hints, plain = described.sentences(kind), get_type_hints(kind, include_extras=True), get_type_hints(kind)
    parts: list[tuple[str, Any, Any]] = []
    for f in fields(kind):
        hint, default = hints[f.name], field() if f.default is MISSING else field(default=f.default)
        if is_dataclass(plain[f.name]):
            inner = _open(plain[f.name])
            hint = Annotated[inner, tyro.conf.arg(name="")] if hint != plain[f.name] else inner
            default = field()
        else:
            hint = _with_help(hint, plain[f.name], f.name, sentences[f.name], is_required=f.default is MISSING)
        parts.append((f.name, hint, default))
    doc = described.summary(kind, whole=kind in NAMES.values())
    return make_dataclass(kind.__name__, parts, namespace={"__doc__": doc}, kw_only=True)


def _short(name: str, kind: type[Any]) -> Any:
    """The open class with a short help: it omits the settings and says how to list them."""
    whole = _open(kind)
    settings: Any = get_type_hints(whole)["config"]
    hint = Annotated[settings, tyro.conf.arg(name=""), tyro.conf.Suppress]
    doc = f"{whole.__doc__}\n\n{MORE.format(PROG, name)}"
    return make_dataclass(kind.__name__, [("config", hint)], bases=(whole,), namespace={"__doc__": doc}, kw_only=True)


def _with_help(hint: Any, plain: Any, name: str, text: str, *, is_required: bool) -> Any:
    """The field's type with its help: the sentence, the default with its unit, a metavar without None."""
    metadata = list(getattr(hint, "__metadata__", ()))
    known = [m for m in metadata if isinstance(m, ARG)]
    arg: Any = replace(known[0] if known else cast(Any, tyro.conf.arg()), help=text)
    if not is_required:
        arg = replace(arg, help_behavior_hint=functools.partial(_default_shown, described.unit(name)))
    if type(None) in get_args(plain) and arg.metavar is None:
        inner: Any = next(kind for kind in get_args(plain) if kind is not type(None))
        choices = "{" + ",".join(str(choice.value) for choice in inner) + "}" if issubclass(inner, Enum) else ""
        arg = replace(arg, metavar=choices or METAVARS.get(inner, "PATH" if inner.__name__ == "Path" else "TEXT"))
    return Annotated[(plain, *(m for m in metadata if m not in known), arg)]


def _default_shown(unit: str, default: str) -> str:
    """A default for the help; "" for a derived or empty one, which the sentence explains."""
    if default in ("None", "()", "''", ""):
        return ""
    return f"(default: {' '.join((default, unit)).strip()})"


def _opened(settings: Any) -> Any:
    """The same values in the open classes."""
    values = {f.name: getattr(settings, f.name) for f in fields(settings)}
    return _open(type(settings))(**{name: _opened(v) if is_dataclass(v) else v for name, v in values.items()})


def _judged(kind: type[Any], parsed: Any) -> Any:
    """The same values in the real classes; raises ValueError for an invalid one."""
    inner = get_type_hints(kind)
    values = {f.name: getattr(parsed, f.name) for f in fields(kind)}
    return kind(**{name: _judged(inner[name], v) if is_dataclass(v) else v for name, v in values.items()})
