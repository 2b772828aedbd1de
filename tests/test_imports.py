"""Imports run one way: racf <- follow <- sim, and sim never reaches the loop, the servo or the command line."""

import ast
from pathlib import Path

import pytest

import racf

ROOT = Path(__file__).parents[1]
SIM_MAY_SEE = {
    "follow.signing",
    "follow.messages",
    "follow.geometry",
    "follow.mavlink",
    "follow.link",
    "follow.camera",
    "racf.box",
}
WIRING = {"follow/cli_replay.py", "follow/cli_run.py", "follow/cli_sim.py"}  # the only files that build both seams


def imports(path: Path) -> set[str]:
    """Dotted modules of this project that a file imports, at any depth of its code."""
    names = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            names |= {node.module} | {f"{node.module}.{alias.name}" for alias in node.names}
    return {name for name in names if name.split(".")[0] in {"racf", "follow", "sim"}}


@pytest.mark.parametrize("path", sorted((ROOT / "racf").rglob("*.py")), ids=str)
def test_the_tracker_knows_nothing_of_drones(path):
    assert not {name for name in imports(path) if not name.startswith("racf")}


@pytest.mark.parametrize("path", sorted((ROOT / "follow").rglob("*.py")), ids=str)
def test_the_application_does_not_need_the_simulator(path):
    if str(path.relative_to(ROOT)) not in WIRING:
        assert not {name for name in imports(path) if name.startswith("sim")}


@pytest.mark.parametrize("path", sorted((ROOT / "sim").rglob("*.py")), ids=str)
def test_the_simulator_reaches_only_messages_geometry_and_boxes(path):
    for name in imports(path) - {"follow", "racf"}:
        if not name.startswith("sim"):
            assert any(name == seen or name.startswith(seen + ".") for seen in SIM_MAY_SEE), name


def test_every_public_name_of_the_tracker_is_there():
    assert "one_core" in racf.__all__
    assert all(callable(getattr(racf, name)) for name in racf.__all__)
    with pytest.raises(AttributeError, match="has no attribute 'two_cores'"):
        _ = racf.two_cores
