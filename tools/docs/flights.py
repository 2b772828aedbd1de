"""Write the table of docs/flights.md from the flights of `follow sim --all`.

    follow sim --all --seeds 1 --json --out out/sim > all.json
    python -m tools.docs.flights out/sim

The folder holds a folder for each flight, with its summary.json.  The text outside the table is not changed.
"""

import argparse
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from statistics import mean
from typing import Any

from sim.scenarios import SCENARIOS

PAGE = Path(__file__).parents[2] / "docs" / "flights.md"
BEGIN, END = "<!-- flights: python -m tools.docs.flights -->", "<!-- end of flights -->"
AUTOPILOTS = ("px4", "ardupilot")
Summary = Mapping[str, Any]


def summaries(folder: Path) -> list[Summary]:
    """The summaries of all flights in a folder.  Raises ValueError if there is none."""
    found = [json.loads(path.read_text()) for path in sorted(folder.glob("*/summary.json"))]
    if not found:
        raise ValueError(f"{folder} holds no flight with a summary.json")
    return found


def row(name: str, flights: Sequence[Summary]) -> str:
    """One line of the table: means over seeds by autopilot, and the worst of all flights."""
    cells = [f"`{name}`", f"{min(f['in_view'] for f in flights):.3f}"]
    for autopilot in AUTOPILOTS:
        own = [f for f in flights if f["autopilot"] == autopilot]
        cells.append(f"{mean(f['centring_rms'] for f in own):.3f}" if own else "-")
        cells.append(f"{100 * mean(f['standoff_rms'] for f in own):.1f} %" if own else "-")
    cells.append(f"{min(f['nearest_m'] for f in flights):.1f} m")
    cells.append(f"{mean(f['lost_s'] for f in flights):.1f} s")
    broken = sorted({name for f in flights for name in f["violations"]})
    return "| " + " | ".join([*cells, ", ".join(broken) or "none"]) + " |"


def table(flights: Sequence[Summary]) -> str:
    """The table in the order of the scenarios."""
    seeds = len({f["seed"] for f in flights})
    about = f"{len(flights)} flights, {seeds} seed{'s' * (seeds > 1)} of each scenario and autopilot"
    heads = "scenario", "in_view, least", *(f"{a}: {what}" for a in AUTOPILOTS for what in ("centring", "stand-off"))
    lines = [
        f"{about}, `{flights[0]['tracker']}`.",
        "",
        "| " + " | ".join([*heads, "nearest", "unseen", "limits broken"]) + " |",
        "|---" + "|---:" * 7 + "|---|",
    ]
    of = {name: [f for f in flights if f["scenario"] == name] for name in SCENARIOS}
    return "\n".join([*lines, *(row(name, own) for name, own in of.items() if own)])


def main() -> None:
    """Put the table into the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, help="the --out of follow sim --all")
    folder = parser.parse_args().folder
    before, rest = PAGE.read_text().split(BEGIN)
    after = rest.split(END)[1]
    PAGE.write_text(f"{before}{BEGIN}\n{table(summaries(folder))}\n{END}{after}")


if __name__ == "__main__":
    main()
