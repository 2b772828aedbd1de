"""Write docs/modes.md from the code: the table of modes and events.

    python -m tools.docs.safety

A test compares the file with the code.
"""

import re
from pathlib import Path

from follow import messages
from follow.messages import Cause, Mode
from follow.safety import modes as modes_source
from follow.safety.modes import FLYING, OPEN_MODES, ROWS, STREAMING, Event, Standing

DOCS = Path(__file__).parents[2] / "docs"


def reason(source: Path, name: str, within: str = "") -> str:
    """The comment beside the definition of `name`, in the class `within` if one is given."""
    text = source.read_text()
    start = text.index(f"class {within}(") if within else 0
    found = re.search(rf"(?m)^    {name}\b[^#\n]*#\s*(.*)$", text[start:])
    return found.group(1) if found else ""


def modes_page() -> str:
    """The diagram (Mermaid, which GitHub draws) and the tables."""
    source = Path(messages.__file__)
    left_out = (Event.CONTROL_LOST, Event.ORDER_OBSERVE, Event.ORDER_LEAVE, Event.STALE, Event.MUST_STOP)
    lines = [
        "# Modes of the gate",
        "",
        "This page is generated from the table in `follow/safety/modes.py` by `python -m tools.docs.safety`. An event",
        "that the table does not name for a mode changes nothing. The diagram leaves out what applies to",
        "every flying mode:",
        "",
        "- A takeover, a disarm, a stick, another sender or the order OBSERVE ends it.",
        "- Stale or contradictory data, a low battery, a lost remote control, a landing, a vehicle that does not obey,",
        "  or leaving the program changes it to brake.",
        "",
        "```mermaid",
        "stateDiagram-v2",
        f"    [*] --> {Mode.OBSERVE.value}",
    ]
    for modes, _, event, then in ROWS:
        lines += [f"    {mode.value} --> {then.value}: {event.value}" for mode in modes if event not in left_out]
    lines += ["```", "", "| mode | what it does | sends |", "|---|---|---|"]
    for mode in Mode:
        sends = "setpoints" if mode in STREAMING else "nothing"
        lines.append(f"| {mode.value} | {reason(source, mode.name, 'Mode')} | {sends} |")
    lines += ["", f"Flying modes: {', '.join(mode.value for mode in FLYING)}."]
    lines += ["", "## Whose mode the vehicle is in", "", "| | |", "|---|---|"]
    lines += [f"| {where.value} | {reason(Path(modes_source.__file__), where.name)} |" for where in Standing]
    lines += ["", "FOLLOW may be ordered, above the height `floor_m`, out of these modes of the vehicle:", ""]
    lines += [f"- {autopilot.value}: {', '.join(names)}" for autopilot, names in OPEN_MODES.items()]
    lines += ["", "## The table", "", "| our mode | vehicle's mode | event | next mode |", "|---|---|---|---|"]
    for modes, standings, event, then in ROWS:
        ours = ", ".join(mode.value for mode in modes)
        where = "any" if len(standings) == len(Standing) else ", ".join(standing.value for standing in standings)
        lines.append(f"| {ours} | {where} | {event.value} | {then.value} |")
    lines += [
        "",
        "## Reasons",
        "",
        "Every change of mode has a reason, and so has every order that waits, is refused or becomes void:",
        "",
    ]
    lines += [f"- {shown(cause)}" for cause in Cause]
    return "\n".join(lines) + "\n"


def shown(cause: Cause) -> str:
    """A cause's sentence with its parameters as words."""
    return re.sub(r"\{(\w+)[^}]*\}", lambda match: {"what": "*what*", "seconds": "*N*"}[match.group(1)], cause.value)


PAGES = {"modes.md": modes_page}

if __name__ == "__main__":
    for page, text in PAGES.items():
        (DOCS / page).write_text(text())
