"""Imports run one way: racf <- follow <- sim, and from room to room inside follow."""

import ast
from importlib.metadata import version
from pathlib import Path

import pytest

import follow
import racf

ROOT = Path(__file__).parents[1]
SPOKEN = {"messages", "geometry", "ranges", "selection", "disk"}  # what every room of follow speaks
MAY_IMPORT = {
    "messages": {"geometry", "selection"},
    "geometry": set(),
    "ranges": set(),
    "disk": {"messages"},
    "selection": set(),
    "loop": {"messages", "selection", "camera", "link"},
    "config": SPOKEN | {"camera", "control", "safety", "recording", "operator"},
    "camera": SPOKEN,
    "link": SPOKEN,
    "control": SPOKEN,
    "safety": SPOKEN | {"control"},
    "operator": SPOKEN | {"link", "safety", "recording"},
    "recording": SPOKEN,
    "flight": SPOKEN | {"camera", "link", "control", "safety", "operator", "recording", "loop"},
    "cli": SPOKEN | {"camera", "link", "control", "safety", "operator", "recording", "flight", "loop", "config"},
}
"""Which rooms of follow (folders, or files beside them) each room may import."""
SIM_MAY_IMPORT = {
    "follow.link.signing",
    "follow.messages",
    "follow.geometry",
    "follow.link",
    "follow.camera",
    "racf.box",
    "racf.commandline",  # of sim.autopilot, a program of its own
    "racf.video_writer",
}
WIRING = "follow/cli/"  # the only room that builds both seams


OURS = {"racf", "follow", "sim", "tests", "tools", "benchmarks", "examples"}


def imports(path: Path) -> set[str]:
    """Dotted modules of this project that a file imports, at any depth of its code."""
    return imported(path.read_text(), path.relative_to(ROOT).parts[:-1])


def imported(text: str, package: tuple[str, ...]) -> set[str]:
    """The same of a file's text in `package`: statements (relative ones also), and names given to a loader."""
    names = set()
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            above = package[: len(package) + 1 - node.level] if node.level else ()
            module = ".".join([*above, *([node.module] if node.module else [])])
            names |= {module} | {f"{module}.{alias.name}" for alias in node.names}
        elif isinstance(node, ast.Call) and ast.unparse(node.func).split(".")[-1] in {"import_module", "__import__"}:
            for argument in node.args[:1]:  # of an f-string the part before its first value
                first = argument.values[0] if isinstance(argument, ast.JoinedStr) else argument
                if isinstance(first, ast.Constant):
                    relative = str(first.value).startswith(".")
                    names.add(".".join(package) if relative else str(first.value).rstrip("."))
    return {name for name in names if name.split(".")[0] in OURS}


@pytest.mark.parametrize(
    "text",
    [
        "from follow.safety import gate",
        "from ..safety import gate",
        "from .. import safety",
        "def late():\n    import follow.safety.gate as g",
        "if TYPE_CHECKING:\n    from ..safety.gate import Safety",
        "importlib.import_module('follow.safety.gate')",
        "import_module(f'follow.safety.{name}')",
        "__import__('follow.safety')",
    ],
)
def test_every_form_of_import_is_checked(text):
    assert any(name.startswith("follow.safety") for name in imported(text, ("follow", "control")))


def sources(package: str) -> list[str]:
    return sorted(str(path.relative_to(ROOT)) for path in (ROOT / package).rglob("*.py"))


@pytest.mark.parametrize("source", sources("racf"))
def test_the_tracker_imports_no_other_package_of_the_project(source):
    assert not {name for name in imports(ROOT / source) if not name.startswith("racf")}


@pytest.mark.parametrize("source", sources("follow"))
def test_the_application_does_not_need_the_simulator(source):
    foreign = () if source.startswith(WIRING) else ("sim",)
    assert not {
        name
        for name in imports(ROOT / source)
        if name.startswith((*foreign, "tests", "tools", "benchmarks", "examples"))
    }


@pytest.mark.parametrize("source", sources("follow"))
def test_rooms_import_in_one_direction_only(source):
    if source == "follow/__init__.py":
        return
    room = source.split("/")[1].removesuffix(".py")
    seen = {name.split(".")[1] for name in imports(ROOT / source) if name.startswith("follow.")}
    assert seen - {room} <= MAY_IMPORT[room]


def test_every_room_is_listed_and_their_imports_form_no_cycle():
    rooms = {source.split("/")[1].removesuffix(".py") for source in sources("follow")} - {"__init__"}
    assert rooms == set(MAY_IMPORT)
    left = dict(MAY_IMPORT)
    while left:
        free = {room for room, needs in left.items() if not needs & set(left)}
        assert free, f"a circle among {sorted(left)}"
        left = {room: needs for room, needs in left.items() if room not in free}


@pytest.mark.parametrize("source", sources("sim"))
def test_the_simulator_reaches_only_seams_messages_geometry_and_boxes(source):
    for name in imports(ROOT / source) - {"follow", "racf"}:
        if not name.startswith("sim"):
            assert any(name == seen or name.startswith(seen + ".") for seen in SIM_MAY_IMPORT), name


def test_every_public_name_of_the_tracker_exists():
    assert "one_core" in racf.__all__
    assert all(callable(getattr(racf, name)) for name in racf.__all__ if name != "evaluate")
    assert set(racf.__all__) <= set(dir(racf))
    assert racf.evaluate.__name__ == "racf.evaluate"
    assert racf.__version__ == follow.__version__ == version("follow-me")
    with pytest.raises(AttributeError, match="has no attribute 'two_cores'"):
        _ = racf.two_cores
