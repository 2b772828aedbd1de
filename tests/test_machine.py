"""The referee of the real-time tests: only time that the host took away excuses a failure."""

import pytest
from machine import parsed, processor_ticks, stolen

LINE = "cpu  100 0 50 800 10 0 5 {steal} 7 0\ncpu0 1 2 3 4 5 6 7 8 0 0\n"


def test_the_share_of_stolen_time_is_of_all_time_in_between():
    before, after = parsed(LINE.format(steal=5)), parsed("cpu  140 0 60 835 10 0 5 20 9 0\n")
    assert stolen(before, after) == pytest.approx(15 / 100)


def test_a_machine_that_does_not_say_excuses_nothing():
    assert stolen((0,) * 8, (0,) * 8) == 0.0


def test_ticks_only_grow():
    first, second = processor_ticks(), processor_ticks()
    assert all(a <= b for a, b in zip(first, second, strict=True))
    assert 0.0 <= stolen(first, second) <= 1.0
