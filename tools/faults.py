"""Every fault, flown: prints the table and writes docs/faults.md; exits 1 when a row fails.

    python -m tools.faults [--only TEXT] [--no-processes]

The rows in lockstep fly on a virtual clock; the others are `follow run` itself as a process over UDP in real time.  One
that is late while the host takes the machine away is flown again, which standard error says.
"""

import argparse
import os
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[1]
os.environ["MAVLINK20"] = "1"

from follow.messages import Autopilot  # noqa: E402
from tests.support.fault_processes import PROCESS_ROWS, ProcessRow  # noqa: E402
from tests.support.fault_rows import ROWS  # noqa: E402
from tests.support.machine import STOLEN, LateError, awake, processor_ticks, stolen  # noqa: E402

ATTEMPTS = 6  # of a flight that the host made late

ABOUT = """# What happens when something fails

Made by `make faults`; each row is a flight, and the same rows are tests. A target jogs away at 3 m/s with the vehicle
in FOLLOW behind it; 15 s into the flight the fault comes. In lockstep the application's own session, gate, servo,
estimate and MAVLink client fly against the simulated autopilot on a virtual clock, with a tracker that knows the truth;
rows marked *process* are `follow run` with the drawn scene against `python -m sim.autopilot` over UDP, in real time,
with a target that walks at 1.4 m/s, on cores that processes of the lowest priority keep awake. "Stands" is the true
horizontal speed staying below 0.3 m/s; time and way count from the fault. The autopilots have the parameters that
`follow doctor` asks for.

A sender that the link does not carry to us cannot be seen: an autopilot passes on no setpoints that are addressed to
itself. Our own clock is the monotonic one, which no operating system sets; its jumps are here all the same.

| fault | rules | what must happen | bound | measured | vehicle ends in | |
|---|---|---|---|---|---|---|
"""


def rows(only: str, processes: bool) -> Iterator[tuple[str, tuple[str, ...]]]:
    """Fly, and yield each line of the table with what is wrong."""
    for row in ROWS:
        for autopilot in Autopilot if only in row.name else ():
            flown = row.fly(autopilot)
            e = row.expect
            cells = row.name, autopilot.value, e.must, e.bound, e.measured(flown.outcome), flown.outcome.vehicle_mode
            yield line(cells, flown.wrong), flown.wrong
    for row in PROCESS_ROWS if processes else ():
        for rules in row.rules if only in row.name else ():
            measured, mode, wrong = in_time(row, rules)
            yield line((f"{row.name} (*process*)", rules, row.must, row.bound, measured, mode), wrong), wrong


def in_time(row: ProcessRow, rules: str) -> tuple[str, str, tuple[str, ...]]:
    """Fly a row in real time; one that was late while the host took the machine away is flown again."""
    late = ""
    for _ in range(ATTEMPTS):
        ticks = processor_ticks()
        try:
            with tempfile.TemporaryDirectory() as out:
                return row.fly(rules, Path(out))
        except LateError as error:
            late, taken = str(error).splitlines()[0][:200], stolen(ticks, processor_ticks())
            print(f"{row.name}, {rules}: the host took {taken:.0%}; {late}", file=sys.stderr)
            if taken <= STOLEN:
                break
    return "", "", (f"late: {late}",)


def line(cells: tuple[str, ...], wrong: tuple[str, ...]) -> str:
    return f"| {' | '.join(cells)} | {'**fails**: ' + '; '.join(wrong) if wrong else 'pass'} |"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", default="", help="rows whose name holds this")
    parser.add_argument("--no-processes", action="store_true")
    options = parser.parse_args()
    began, ticks = time.monotonic(), processor_ticks()
    lines, failed = [], 0
    with awake():
        for text, wrong in rows(options.only, not options.no_processes):
            print(text, flush=True)
            lines.append(text)
            failed += bool(wrong)
    taken = stolen(ticks, processor_ticks())
    spent = f"{len(lines)} rows, {failed} failed; {time.monotonic() - began:.0f} s, {taken:.0%} of it taken by the host"
    print(spent, file=sys.stderr)
    if not options.only and not options.no_processes:
        (ROOT / "docs").mkdir(exist_ok=True)
        (ROOT / "docs/faults.md").write_text(ABOUT + "\n".join(lines) + f"\n\n{spent}\n")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
