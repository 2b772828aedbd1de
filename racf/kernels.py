"""Announces when numba compiles this package's kernels: once for a machine and a version, then its cache has them."""

import logging
from typing import Any

from numba.core import event

LOG = logging.getLogger("racf")


class Announcer(event.Listener):
    """Logs one warning when the first kernel of this package is compiled rather than loaded."""

    def __init__(self) -> None:
        self.said = False

    def on_start(self, event: Any) -> None:
        """A compilation begins (loading from the cache does not count)."""
        if not self.said and event.data["dispatcher"].py_func.__module__.startswith("racf."):
            self.said = True
            LOG.warning("compiling the tracker's kernels, once for this machine: this may take half a minute")

    def on_end(self, event: Any) -> None:
        """Nothing to do."""


def announce() -> None:
    """From here on, announce a compilation."""
    event.register("numba:compile", Announcer())
