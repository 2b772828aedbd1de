"""Draw docs/report.png and docs/refly.png: the plots of `follow report` and `follow refly`.

python -m tools.docs.pages     flies behind a runner who vanishes through a door, then again with other settings
"""

import sys
from pathlib import Path

from follow.cli.program import main
from follow.recording.flight_table import FlightTable
from follow.recording.plots import comparison_figure, flight_figure
from follow.recording.report import wanted

DOCS = Path(__file__).parents[2] / "docs"
FLIGHT, AGAIN = Path("out/pages"), Path("out/pages-again")


def draw() -> None:
    flown, again = FlightTable(FLIGHT), FlightTable(AGAIN)
    flight_figure(flown, wanted(FLIGHT)).savefig(DOCS / "report.png", dpi=80, bbox_inches="tight")
    comparison_figure(flown, again).savefig(DOCS / "refly.png", dpi=80, bbox_inches="tight")


if __name__ == "__main__":
    plain = ["--record.no-pictures"]
    other = ["--servo.standoff-m", "16", "--limits.speed-m-s", "3"]
    flown = main(["sim", "doorway", "--out", str(FLIGHT), *plain]) or main(["report", str(FLIGHT)])
    if flown or main(["refly", str(FLIGHT), "--out", str(AGAIN), *other, *plain]):
        sys.exit(1)
    draw()
