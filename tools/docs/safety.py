"""Write docs/modes.md from the code: the table of modes and events.

    python -m tools.docs.safety

A test compares the file with the code.
"""

import re
from pathlib import Path

from follow import messages
from follow.messages import Mode
from follow.safety.modes import FLYING, STREAMING, TABLE, Event

DOCS = Path(__file__).parents[2] / "docs"


def reason(source: Path, name: str) -> str:
    """The comment beside the definition of `name`."""
    found = re.search(rf"(?m)^    {name}\b[^#\n]*#\s*(.*)$", source.read_text())
    return found.group(1) if found else ""


def modes_page() -> str:
    """The diagram (Mermaid, which GitHub draws) and the table."""
    source = Path(messages.__file__)
    lines = [
        "# Modes of the gate",
        "",
        "Generated from the table in `follow/safety/modes.py` by `python -m tools.docs.safety`. An event that the",
        "table does not name for a mode changes nothing. A takeover, a disarm or the order OBSERVE ends every flying",
        "mode, and stale data change every flying mode to brake; the diagram leaves these arrows out.",
        "",
        "```mermaid",
        "stateDiagram-v2",
        f"    [*] --> {Mode.OBSERVE.value}",
    ]
    common = (Event.CONTROL_LOST, Event.ORDER_OBSERVE, Event.STALE)
    lines += [f"    {a.value} --> {b.value}: {e.value}" for (a, e), b in TABLE.items() if e not in common]
    lines += ["```", "", "| mode | what it does | sends |", "|---|---|---|"]
    for mode in Mode:
        sends = "setpoints" if mode in STREAMING else "nothing"
        lines.append(f"| {mode.value} | {reason(source, mode.name)} | {sends} |")
    names = ", ".join(mode.value for mode in FLYING)
    lines += ["", f"Flying modes: {names}.", "", "| in | on | to |", "|---|---|---|"]
    lines += [f"| {a.value} | {e.value} | {b.value} |" for (a, e), b in TABLE.items()]
    return "\n".join(lines) + "\n"


PAGES = {"modes.md": modes_page}

if __name__ == "__main__":
    for page, text in PAGES.items():
        (DOCS / page).write_text(text())
