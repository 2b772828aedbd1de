"""What to say about a name that is not known: the names that resemble it, in the same words everywhere."""

import difflib
from collections.abc import Iterable, Sequence

MOST = 3  # suggestions: a person cannot choose among more


def hint(name: str, known: Iterable[str], otherwise: str = "") -> str:
    """`did you mean A or B?` for names that resemble `name` or begin with it; else `otherwise`, or the list of all."""
    names = list(known)
    return question(close(name, names)) or otherwise or f"there are {', '.join(names)}"


def question(near: Sequence[str]) -> str:
    """`did you mean A or B?`, of at most MOST names; "" without any."""
    return f"did you mean {' or '.join(near[:MOST])}?" if near else ""


def close(name: str, known: Iterable[str]) -> list[str]:
    """The known names that begin with `name`, then those that are spelled like it, nearest first; in any capitals."""
    by_lower = {text.lower(): text for text in known}
    near = difflib.get_close_matches(name.lower(), by_lower, n=MOST)
    begun = [text for text in by_lower if len(name) > 1 and text.startswith(name.lower())]
    return [by_lower[text] for text in dict.fromkeys([*begun, *near])]
