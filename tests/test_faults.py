"""The rows of the fault matrix that a test run can afford, under one rule set each; `make faults` flies all of them."""

import itertools

import pytest
from fault_rows import ROWS, Row

from follow.messages import Autopilot

PAIRS = [(row, a) for row, a in zip((r for r in ROWS if r.fast), itertools.cycle(Autopilot), strict=False)]


@pytest.mark.parametrize(("row", "autopilot"), PAIRS, ids=[f"{row.name}, {a.value}" for row, a in PAIRS])
def test_a_fault_ends_as_it_must(row: Row, autopilot: Autopilot):
    result = row.fly(autopilot)
    assert not result.wrong, (result.wrong, result.outcome, result.lines)
