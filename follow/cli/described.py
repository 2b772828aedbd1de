"""The descriptions of settings and options, read from the code: the single source of help and pages."""

import ast
import functools
import inspect
import io
import re
import textwrap
import tokenize
from dataclasses import fields
from typing import Any

UNITS = {
    "m_s": "m/s",
    "m_s2": "m/s²",
    "m_s3": "m/s³",
    "rad_s": "rad/s",
    "rad_s2": "rad/s²",
    "per_s": "1/s",
    "bit_s": "bit/s",
    "hz": "1/s",
    "px": "pixels",
    "deg": "degrees",
    "rad": "rad",
    "m": "m",
    "s": "s",
}
"""Suffix of a name -> its unit."""


def unit(name: str) -> str:
    """The unit in the suffix of a setting's name, or "" without one."""
    parts = name.split("_")
    return next((UNITS[end] for n in range(1, len(parts)) if (end := "_".join(parts[n:])) in UNITS), "")


@functools.cache
def sentences(kind: type[Any]) -> dict[str, str]:
    """Field -> its docstring, or else its comment; "" for a field that has neither.

    `kind` is a dataclass whose source is available.  A docstring follows its field, a comment ends the field's last
    line.
    """
    source = textwrap.dedent(inspect.getsource(kind))
    comments = {
        token.start[0]: token.string.lstrip("# ")
        for token in tokenize.generate_tokens(io.StringIO(source).readline)
        if token.type == tokenize.COMMENT
    }
    sentences_by_name = dict.fromkeys((f.name for f in fields(kind)), "")
    (definition,) = ast.parse(source).body
    assert isinstance(definition, ast.ClassDef)
    before = ""
    for node in definition.body:
        if isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
            before = node.target.id
            sentences_by_name[before] = comments.get(node.end_lineno or 0, "")
        elif before and isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
            sentences_by_name[before] = " ".join(str(node.value.value).split())
            before = ""
    return sentences_by_name


def summary(kind: type[Any], *, whole: bool) -> str:
    """A class's docstring for a person: its first sentence or all of it, without the part about errors."""
    text = re.sub(r"\s*\bRaises \w+Error\b[^.]*\.", "", inspect.getdoc(kind) or "").strip()
    return text if whole else " ".join(re.split(r"(?<=[.!?])\s", text, maxsplit=1)[0].split())
