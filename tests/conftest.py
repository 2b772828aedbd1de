"""Tests run one to a core, so a library's own threads would only compete with the tests on other cores."""

from collections.abc import Generator
from contextlib import nullcontext

import pytest
from hypothesis import HealthCheck, settings

from racf.threads import one_core
from tests.support.machine import STOLEN, LateError, awake, processor_ticks, stolen

one_core()
# A law does not depend on how busy the machine is.
settings.register_profile("laws", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("laws")


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call(item: pytest.Item) -> Generator[None, object, object]:
    """Skip a test that is late while the host takes processor time away: it would measure the host."""
    before = processor_ticks()
    try:
        with awake() if item.get_closest_marker("realtime") else nullcontext():
            return (yield)
    except LateError as error:
        taken = stolen(before, processor_ticks())
        if taken <= STOLEN:
            raise
        pytest.skip(f"the host took {taken:.0%} of this machine's time away; it was late: {str(error)[:200]}")
