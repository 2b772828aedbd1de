"""Tests run one to a core: a library's own threads would only fight the neighbour's."""

from collections.abc import Generator

import pytest
from hypothesis import settings
from machine import STOLEN, processor_ticks, stolen

from racf.threads import one_core

one_core()
settings.register_profile("laws", deadline=None)  # a law does not depend on how busy the machine is
settings.load_profile("laws")


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call(item: pytest.Item) -> Generator[None, object, object]:
    """A real-time test that fails while the host takes the machine away is skipped: it has measured the host."""
    before = processor_ticks()
    try:
        return (yield)
    except Exception as error:  # whatever it failed with
        taken = stolen(before, processor_ticks())
        if item.get_closest_marker("realtime") is None or taken <= STOLEN:
            raise
        pytest.skip(f"the host took {taken:.0%} of this machine's time away; it failed with: {str(error)[:200]}")
