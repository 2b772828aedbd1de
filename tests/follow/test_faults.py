"""The rows of the fault matrix that a test run can afford, under one rule set each; `make faults` flies all of them."""

import itertools
import os

import pytest

from follow.messages import Autopilot
from tests.support.fault_processes import PROCESS_ROWS, ProcessRow
from tests.support.fault_rows import ROWS, Row
from tests.support.fault_rows_people import AUTHORITY_ROWS, DISTANCE_ROWS

ALL = (*ROWS, *AUTHORITY_ROWS, *DISTANCE_ROWS)
PAIRS = [(row, a) for row, a in zip((r for r in ALL if r.fast), itertools.cycle(Autopilot), strict=False)]


@pytest.mark.parametrize(("row", "autopilot"), PAIRS, ids=[f"{row.name}, {a.value}" for row, a in PAIRS])
def test_a_fault_ends_as_it_must(row: Row, autopilot: Autopilot):
    result = row.fly(autopilot)
    assert not result.wrong, (result.wrong, result.outcome, result.lines)


@pytest.mark.realtime
@pytest.mark.parametrize("row", [row for row in PROCESS_ROWS if row.fast], ids=lambda row: row.name)
def test_a_fault_of_the_process_ends_as_it_must(row: ProcessRow, tmp_path, monkeypatch):
    monkeypatch.setitem(os.environ, "MAVLINK20", "1")
    measured, mode, wrong = row.fly(row.rules[0], tmp_path)
    assert not wrong, (measured, mode)
