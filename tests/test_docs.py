"""The pages say what the program does: every column, figure and message, every link, every option."""

import ast
import math
import re
from pathlib import Path

import pytest

from follow.config import PRESETS, Config, TargetKind
from follow.flight.parameters import QUESTIONS
from follow.messages import Cause
from follow.recording.rows import COLUMNS
from follow.recording.summary import Figures
from follow.safety.limits import Limits
from tools.docs.geometry import height_m

ROOT = Path(__file__).parents[1]
AFTER = (ROOT / "docs/after_a_flight.md").read_text()
FIRST = (ROOT / "docs/first_flight.md").read_text()
PAGES = sorted([*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")])


def table(page: str, heading: str) -> list[list[str]]:
    """The cells of the rows of every table below a heading."""
    section = page.split(f"\n## {heading}\n")[1].split("\n## ", maxsplit=1)[0]
    rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in section.splitlines() if line[:2] == "| "]
    return [
        row for row in rows if row[0] not in ("column", "field", "message", "note", "file", "reason", "contradiction")
    ]


def names(cells: list[str]) -> list[str]:
    return [name for cell in cells for name in re.findall(r"`([^`]+)`", cell)]


def test_every_column_is_described_once_and_in_order():
    assert names([row[0] for row in table(AFTER, "Columns of ticks.csv")]) == list(COLUMNS)


def test_every_figure_is_described_once():
    described = names([row[0] for row in table(AFTER, "Fields of summary.json")])
    assert sorted(described) == sorted(Figures.__annotations__)


def text_of(node: ast.AST) -> str | None:
    """A string of the program with … for a value; None for what is no string."""
    if isinstance(node, ast.JoinedStr):
        return "".join(str(p.value) if isinstance(p, ast.Constant) else "…" for p in node.values)
    if isinstance(node, ast.Constant) and isinstance(node.value, str):
        return re.sub(r"%(\.\d)?[sdfrg]", "…", node.value)
    return None


def spoken() -> str:
    """Every string of the program, each message as its constant parts with … for a value."""
    strings: list[str] = []
    for source in [*(ROOT / "follow").rglob("*.py"), *(ROOT / "racf").glob("*.py")]:
        strings += [text for node in ast.walk(ast.parse(source.read_text())) if (text := text_of(node)) is not None]
    return "\n".join(" ".join(string.split()) for string in strings)


def test_every_reason_is_described_once():
    described = [" ".join(reason.split("…")) for reason in names([row[0] for row in table(AFTER, "Reasons")])]
    sentences = {re.sub(r"\{[^}]*\}", " ", cause.value) for cause in Cause}
    assert set(described) == {sentence for sentence in sentences if sentence.strip()}
    assert len(described) == len(set(described))


def test_every_message_of_the_page_is_one_that_the_program_gives():
    said = spoken()
    for row in table(AFTER, "Messages"):
        for message in names(row[:1]):
            for part in message.split("…"):
                assert part.strip(" ,;:()") in said, message


def test_every_note_of_the_page_is_one_sentence_of_the_program():
    said = spoken().splitlines()
    for message in names([row[0] for row in table(AFTER, "Notes")]):
        pattern = ".*".join(re.escape(part.strip()) for part in message.split("…"))
        assert any(re.search(pattern, line) for line in said), message


CHECKS = {"doctor.py", "calibrate.py", "wave.py"}
"""What these report is no flight's: their own pages tell."""


def reported() -> set[str]:
    """Every message that a flight, a replay or a simulation reports or logs, with … for a value."""
    messages: set[str] = set()
    for source in (ROOT / "follow").rglob("*.py"):
        for node in ast.walk(ast.parse(source.read_text())):
            if not isinstance(node, ast.Call) or not node.args or source.name in CHECKS:
                continue
            called = node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")
            if called in ("report", "_report", "warning", "info") and (text := text_of(node.args[0])):
                messages.add(text)
    return messages


def test_every_message_that_is_reported_is_on_the_page():
    page, messages = " ".join(AFTER.split()), reported()
    assert len(messages) > 20
    missing = [text for text in messages if any(part.strip(" ,;:()") not in page for part in text.split("…"))]
    assert not missing


def test_every_contradiction_is_described_once():
    said = spoken()
    described = names([row[0] for row in table(AFTER, "Contradictions")])
    assert all(part.strip(" ()") in said for text in described for part in text.split("…"))
    returned: list[str] = []
    for name in ("safety/consistency.py", "control/ground.py"):
        for node in ast.walk(ast.parse((ROOT / "follow" / name).read_text())):
            if isinstance(node, ast.JoinedStr) and len(text := text_of(node) or "") > 40:
                returned.append(text)
    ends = sorted(text.split("…")[-1] for text in returned)
    assert ends == sorted(text.split("…")[-1] for text in described)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_every_link_of_a_page_leads_somewhere(page):
    for path in re.findall(r"\]\(((?!https?:)[^)#]+)", page.read_text()):
        assert (page.parent / path).exists(), path


def test_the_parameters_of_the_first_flight_are_as_doctor_wants_them():
    section = FIRST.split("silent, or the pilot takes over")[1].split("\n## ")[0]
    rules = {p.name: p for questions in QUESTIONS.values() for question in questions for p in question if p.rule}
    advised = re.findall(r"`([A-Z_]+)` (\S+)", section)
    assert len(advised) >= 10
    for name, value in advised:
        parameter = rules[name]
        assert parameter.rule is not None
        if value != "without":
            assert parameter.rule.allows(float(value) * parameter.scale), f"{name} {value}: {parameter.rule.text}"


def test_heights_and_kinds_of_target_are_those_of_the_program():
    assert f"12 m at 30 degrees is {height_m(12, 30):.1f} m" in FIRST
    assert f"20 m at 30 degrees is {height_m(20, 30):.1f} m" in FIRST
    assert height_m(20, 24) + 0.9 == pytest.approx(10, abs=0.3)  # above the ground: plus half a person
    rows = {row[0].split("`")[1]: row[1:] for row in table(FIRST, "Person, cyclist or car") if "`" in row[0]}
    for option, (branch, name) in {
        "--target.size-m": ("target", "size_m"),
        "--servo.standoff-m": ("servo", "standoff_m"),
        "--limits.speed-m-s": ("limits", "speed_m_s"),
    }.items():
        assert [float(v) for v in rows[option]] == [PRESETS[kind][branch][name] for kind in TargetKind]


def option(config: object, path: str) -> object:
    """The default of a dotted option as it is typed; raises AttributeError where there is none."""
    for name in path.replace("-", "_").split("."):
        config = getattr(config, name)
    return config


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_setting_of_a_page_exists_and_a_number_in_brackets_is_its_default(page):
    text = page.read_text()
    for name in re.findall(r"--((?:camera|target|servo|limits)\.[a-z0-9.-]+[a-z0-9])", text):
        option(Config(), name)
    for name, number in re.findall(r"`--((?:camera|target|servo|limits)\.[a-z0-9.-]+)` \(([\d.]+)\)", text):
        assert float(number) == option(Config(), name), name


def test_the_limits_by_size_follow_from_the_mass():
    """Speed from 80 J and at most the default, energy, and the way of a stop with 1 s before it."""
    part = FIRST.split("## Limits by vehicle size")[1]
    rows = [line.strip("| ").split(" | ") for line in part.splitlines() if line.startswith("| ") and " kg " in line]
    assert len(rows) == 6
    for mass, speed, energy, accel, keeps, standoff, stop in rows:
        m, v, a = float(mass.split()[0]), float(speed), float(accel)
        assert v == min(Limits().speed_m_s, math.floor(10 * math.sqrt(160 / m)) / 10)
        assert energy == f"{m * v * v / 2:.0f} J"
        assert stop == f"{v * v / (2 * a) + v:.0f} m"
        Limits(speed_m_s=v, accel_m_s2=a, min_standoff_m=float(keeps))
        assert float(standoff) > 2 * float(keeps)
