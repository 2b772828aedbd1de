"""The command line with its settings: defaults < scenario < kind of target < file < command line.

The words are read twice.  The first reading only finds out what names a layer: a scenario, a kind of target, a file.
These are combined, and the second reading takes what they hold as its defaults.
"""

import contextlib
import functools
import io
from collections.abc import Sequence
from dataclasses import MISSING, field, fields, is_dataclass, make_dataclass
from typing import Annotated, Any, cast, get_type_hints

import tyro

from follow.cli.commands import MARKERS, ReplayCommand, RunCommand, SimCommand, commands, union
from follow.cli.settings import Table, file_layer, layered
from follow.config import PRESETS, Config, TargetKind
from racf.commandline import parse

PROG = "follow"
ABOUT = "Keep a target in view: PX4 and ArduPilot, replayed footage, or a simulated flight."
SCENE = "scene:"


def read(words: Sequence[str], scenario: str | None = None) -> Any:
    """The command that the words spell, with its settings; `scenario` flies another than they name.

    Raises UsageError, SystemExit(0) after `--help`.
    """
    return parse(commands(settings(words, scenario)), words, prog=PROG, description=ABOUT, config=MARKERS)


def settings(words: Sequence[str], scenario: str | None = None) -> Config:
    """The settings of all layers below the command line.  Raises UsageError."""
    first = _glance(words)
    layers: list[tuple[str, Table]] = []
    if name := scenario or _scenario(first):
        layers.append((f"scenario {name}", _suggested(name)))
    kind: TargetKind | None = getattr(first, "for_", None)
    if kind is not None:
        layers.append((f"--for {kind.value}", PRESETS[kind]))
    if (path := getattr(first, "settings", None)) is not None:
        layers.append(file_layer(path))
    return layered(*layers)


def _scenario(first: Any) -> str | None:
    """The scenario that a command line names, if it names one."""
    camera: str = getattr(first, "camera", None) or ""
    return camera.removeprefix(SCENE) if camera.startswith(SCENE) else getattr(first, "scenario", None)


def _suggested(name: str) -> Table:
    from sim.scenarios import SCENARIOS  # noqa: PLC0415 - footage and real cameras do without the simulator

    return SCENARIOS[name].suggested if name in SCENARIOS else {}  # an unknown name is refused by its command


def _glance(words: Sequence[str]) -> Any:
    """The command as far as it is clear without judging any setting; None for what cannot be read, or for help."""
    replay, sim, run = (_unjudged(kind) for kind in (ReplayCommand, SimCommand, RunCommand))
    known = union(replay, sim, run, _unjudged(Config)())
    with contextlib.suppress(SystemExit), contextlib.redirect_stderr(io.StringIO()):
        # Help and whatever is wrong with the words is the second reading's business.
        return cast(Any, tyro.cli)(known, args=words, prog=PROG, config=MARKERS, add_help=False, console_outputs=False)
    return None


@functools.cache
def _unjudged(kind: type[Any]) -> Any:
    """A dataclass like `kind`, and like those in it, whose fields may have any value of their type.

    What is wrong beside the defaults may be right beside a file: a floor above the default ceiling.
    """
    hints, plain = get_type_hints(kind, include_extras=True), get_type_hints(kind)
    parts: list[tuple[str, Any, Any]] = []
    for f in fields(kind):
        hint: Any = hints[f.name]
        default: Any = field() if f.default is MISSING else field(default=f.default)
        if is_dataclass(plain[f.name]):
            inner = _unjudged(plain[f.name])
            hint = Annotated[inner, tyro.conf.arg(name="")] if hint != plain[f.name] else inner
            default = field(default_factory=inner)
        elif f.default is MISSING and f.name == "kp":  # of the gains, the only setting without a default of its own
            default = field(default=0.0)
        parts.append((f.name, hint, default))
    return make_dataclass(kind.__name__, parts)
