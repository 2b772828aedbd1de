"""The house's own rules: short files and functions, one name for one class, plain words.

What does not yet obey stands in three lists, which may only get shorter; a file that is not in a list must obey.
"""

import ast
import io
import re
import tokenize
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGES = ("racf", "follow", "sim")
CODE = (*PACKAGES, "tests", "tools", "benchmarks", "examples")
FILE_LINES = 400
FUNCTION_LINES = 50

LONG_FILES: dict[str, int] = {}
"""Files over the limit -> the lines they may have at most, until somebody splits them."""

LONG_FUNCTIONS: dict[str, int] = {}
"""The same for functions, as "file:function"."""

BANNED = {
    r"\bpictures?\b": "`frame` is the timestamped message, `image` the array",
    r"\bwish(es|ed)?\b": "desired",
    r"\bmend(s|ed|ing)?\b": "fix",
    r"\banew\b": "again, new",
    r"(?<!not )\bso (long|many)\b(?! (as|that)\b)": "for this long, at most N, timeout, grace period",
    r"(?<!there )\bis (?-i:none)\b(?! of\b)": "invalid X, not an X",
    r"\bstands? above\b": "overrides",
    r"\b(is|are) (asked|said|thought)\b(?!( for)?( only)? by\b)": "name who asks, says or assumes",
    r", too(?=\s*([.,;:)]|$))": "also",
    r"(?<!not )\bbut for\b": "except, unless",
    r"\bwhere (it is )?not given\b": "if not given",
}
"""Phrases that an engineer has to read twice -> what to write."""


def sources(*folders: str) -> list[str]:
    return sorted(str(path.relative_to(ROOT)) for folder in folders for path in (ROOT / folder).rglob("*.py"))


def functions(source: str) -> Iterator[tuple[str, int]]:
    """Each function of a file with its number of lines, decorators not counted."""
    for node in ast.walk(ast.parse((ROOT / source).read_text())):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            assert node.end_lineno is not None
            yield f"{source}:{node.name}", node.end_lineno - node.lineno + 1


def prose_of_code(text: str) -> Iterator[str]:
    """Comments (lines below each other as one), and strings that hold more than one word."""
    comment, last = "", 0
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type == tokenize.COMMENT:
            if comment and token.start[0] > last + 1:
                yield comment
                comment = ""
            comment, last = f"{comment} {token.string.lstrip('# ')}", token.start[0]
    yield comment
    pieces: set[int] = set()
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.JoinedStr):  # a message with values in it: its constant parts make one sentence
            parts = [part for part in node.values if isinstance(part, ast.Constant)]
            pieces |= {id(part) for part in parts}
            yield "…".join(str(part.value) for part in parts)
        elif isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in pieces:
            yield node.value if " " in node.value else ""


def prose_of_page(text: str) -> Iterator[str]:
    """The paragraphs of a page without the names of options, files and fields in backticks."""
    yield from re.sub(r"`[^`\n]+`", "`…`", text).split("\n\n")


def findings(prose: Iterator[str]) -> list[str]:
    """Each banned phrase with the words around it and its cure."""
    found: list[str] = []
    for text in prose:
        line = " ".join(text.split())
        for phrase, cure in BANNED.items():
            for match in re.finditer(phrase, line, re.IGNORECASE):
                around = line[max(match.start() - 40, 0) : match.end() + 30]
                found.append(f"{around!r}: write {cure}")
    return found


def pages() -> list[str]:
    return sorted(str(path.relative_to(ROOT)) for path in [*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")])


def all_findings() -> dict[str, list[str]]:
    """File -> what it holds of the banned phrases.  This file, which quotes them, is left out."""
    others = [source for source in sources(*CODE) if ROOT / source != Path(__file__)]
    found = {source: findings(prose_of_code((ROOT / source).read_text())) for source in others}
    found |= {page: findings(prose_of_page((ROOT / page).read_text())) for page in pages()}
    return {name: lines for name, lines in found.items() if lines}


WORDS_LEFT: dict[str, int] = {
    "tests/follow/test_follow_cli.py": 1,
    "tests/follow/test_settings.py": 3,
}
"""The setting `record.pictures` keeps its name, which settings files and scripts of users hold: its tests write it."""


def test_no_file_is_longer_than_the_limit():
    lines = {source: len((ROOT / source).read_text().splitlines()) for source in sources(*CODE)}
    assert {s: n for s, n in lines.items() if n > LONG_FILES.get(s, FILE_LINES)} == {}
    assert {s for s in LONG_FILES if lines[s] <= FILE_LINES} == set(), "take it off the list"


def test_no_function_is_longer_than_the_limit():
    lines = dict(function for source in sources(*PACKAGES) for function in functions(source))
    assert {s: n for s, n in lines.items() if n > LONG_FUNCTIONS.get(s, FUNCTION_LINES)} == {}
    assert {s for s in LONG_FUNCTIONS if lines[s] <= FUNCTION_LINES} == set(), "take it off the list"


def test_a_class_name_means_one_thing():
    where: defaultdict[str, list[str]] = defaultdict(list)
    for source in sources(*PACKAGES):
        for node in ast.walk(ast.parse((ROOT / source).read_text())):
            if isinstance(node, ast.ClassDef):
                where[node.name].append(source)
    assert {name: files for name, files in where.items() if len(files) > 1} == {}


def test_words_are_plain():
    found = all_findings()
    worse = {name: lines for name, lines in found.items() if len(lines) > WORDS_LEFT.get(name, 0)}
    assert not worse, "\n".join(f"{name}: {line}" for name, lines in worse.items() for line in lines)


@pytest.mark.parametrize(
    "text",
    [
        "so long as it is heard",
        "so many that no one counts",
        "None when there is none",
        "is none of ours",
        "the box is too small, too late",
        "not for the pilot, not but for him",
        "what the pilot asked for",
        "recommend, amend",
        "a mode is asked for only by the pilot",
        "it is None",
    ],
)
def test_plain_words_are_accepted(text):
    assert findings(iter([text])) == []


def test_a_phrase_is_found_in_a_comment_over_two_lines_in_a_message_and_on_a_page():
    code = '# unseen for\n# so long is lost\nx = 1\nprint(f"{x} is not there, too")\n'
    assert len(findings(prose_of_code(code))) == 2
    assert len(findings(prose_of_page("The *picture* stays; `record.pictures` is a name.\n\nA wish."))) == 2
    assert len(findings(prose_of_page("Pictures come first.\n\nIs said to be there.\n\nSo long it waits."))) == 3
