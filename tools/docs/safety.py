"""Write docs/modes.md and docs/limits.md from the code: the table of modes and events, the gate's numbers.

    python -m tools.docs.safety

A test holds that both files say what the code says.
"""

import re
from pathlib import Path

from follow.safety import limits, modes
from follow.safety.limits import Limits
from follow.safety.modes import FLYING, TABLE, Event, Mode

DOCS = Path(__file__).parents[2] / "docs"


def reason(source: Path, name: str) -> str:
    """The comment beside a definition of that name."""
    found = re.search(rf"(?m)^    {name}\b[^#\n]*#\s*(.*)$", source.read_text())
    return found.group(1).lstrip(". ") if found else ""


def modes_page() -> str:
    """The diagram (Mermaid, which GitHub draws) and the table."""
    source = Path(modes.__file__)
    lines = [
        "# Modes of the gate",
        "",
        "Made from the table in `follow/safety/modes.py` by `python -m tools.docs.safety`. An event that the table",
        "does not name for a mode changes nothing. A takeover, a disarm or the order to observe ends every flying",
        "mode; stale data brake every flying mode; these arrows are left out of the picture, not out of the table.",
        "",
        "```mermaid",
        "stateDiagram-v2",
        f"    [*] --> {Mode.OBSERVE.value}",
    ]
    common = (Event.CONTROL_LOST, Event.ORDER_OBSERVE, Event.STALE)
    lines += [f"    {a.value} --> {b.value}: {e.value}" for (a, e), b in TABLE.items() if e not in common]
    lines += ["```", "", "| mode | what it does | sends |", "|---|---|---|"]
    for mode in Mode:
        sends = "setpoints" if mode in modes.STREAMING else "nothing"
        lines.append(f"| {mode.value} | {reason(source, mode.name)} | {sends} |")
    names = ", ".join(mode.value for mode in FLYING)
    lines += ["", f"Flying modes: {names}.", "", "| in | on | to |", "|---|---|---|"]
    lines += [f"| {a.value} | {e.value} | {b.value} |" for (a, e), b in TABLE.items()]
    return "\n".join(lines) + "\n"


def limits_page() -> str:
    """Each limit with its default and why."""
    source = Path(limits.__file__)
    lines = [
        "# Limits of the gate",
        "",
        "Made from `follow/safety/limits.py` by `python -m tools.docs.safety`. On the command line: "
        "`--limits.speed-m-s 2`.",
        "",
        "| limit | default | why |",
        "|---|---|---|",
    ]
    defaults = Limits()
    for name in Limits.__slots__:
        lines.append(f"| `{name}` | {getattr(defaults, name):.4g} | {reason(source, name)} |")
    return "\n".join(lines) + "\n"


PAGES = {"modes.md": modes_page, "limits.md": limits_page}

if __name__ == "__main__":
    for page, text in PAGES.items():
        (DOCS / page).write_text(text())
