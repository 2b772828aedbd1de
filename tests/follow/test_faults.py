"""The rows of the fault matrix that a test run can afford, under one rule set each; `make faults` flies all of them."""

import itertools
import os
import re
from collections import Counter
from pathlib import Path

import pytest

from follow.messages import Autopilot
from tests.support.bounds import STOPS
from tests.support.fault_matrix import LOCKSTEP_ROWS, NAMES
from tests.support.fault_processes import PROCESS_ROWS, ProcessRow
from tests.support.fault_rows import Row

HAZARDS = (Path(__file__).parents[2] / "docs/hazards.md").read_text()
FAST = [row for row in LOCKSTEP_ROWS if row.fast]
PAIRS = [
    (row, autopilot if autopilot in row.autopilots else row.autopilots[0])
    for row, autopilot in zip(FAST, itertools.cycle(Autopilot), strict=False)
]


def table(heading: str) -> list[list[str]]:
    """The cells of the table below a heading of docs/hazards.md."""
    part = HAZARDS.split(f"## {heading}\n")[1].split("\n## ")[0]
    rows = [line.strip("|").split("|") for line in part.splitlines() if line.startswith("|")]
    return [[cell.strip() for cell in row] for row in rows[2:]]


def test_every_row_belongs_to_a_hazard_and_every_row_that_a_hazard_names_exists():
    named = Counter(name for row in table("Table") for name in re.findall(r"`([^`]+)`", row[-1]))
    assert set(named) == set(NAMES)
    assert len(NAMES) == len(set(NAMES))


def test_every_bound_of_the_page_is_the_computed_one():
    told = {row[0]: row[2] for row in table("Bounds of a stop")}
    assert told == {name: f"{bound.within_s:g} s, {bound.within_m:g} m" for name, bound in STOPS.items()}


def test_every_stop_of_the_matrix_has_a_bound_of_the_page():
    bounds = {f"stands within {bound.within_s:g} s, {bound.within_m:g} m" for bound in STOPS.values()}
    stops = {row.expect.bound for row in LOCKSTEP_ROWS if row.expect.bound.startswith("stands within")}
    assert {bound for text in stops for bound in text.split("; or ")[:1]} == bounds


@pytest.mark.parametrize(("row", "autopilot"), PAIRS, ids=[f"{row.name}, {a.value}" for row, a in PAIRS])
def test_a_lockstep_row_of_the_fault_matrix_passes(row: Row, autopilot: Autopilot):
    result = row.fly(autopilot)
    assert not result.wrong, (result.wrong, result.outcome, result.lines)


@pytest.mark.realtime
@pytest.mark.parametrize("row", [row for row in PROCESS_ROWS if row.fast], ids=lambda row: row.name)
def test_a_process_row_of_the_fault_matrix_passes(row: ProcessRow, tmp_path, monkeypatch):
    monkeypatch.setitem(os.environ, "MAVLINK20", "1")
    measured, mode, wrong = row.fly(row.rules[0], tmp_path)
    assert not wrong, (measured, mode)
