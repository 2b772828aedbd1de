"""Compilation of this package's kernels, and the messages about it.

numba compiles a kernel the first time it runs and keeps the machine code beside the source, or in the user's cache
folder; a read-only installation without a home has neither, and compiles in each process.
"""

import gc
import logging
from collections.abc import Callable
from typing import Any, TypeVar, cast

import numba
from numba.core import event

LOG = logging.getLogger("racf")
CallableT = TypeVar("CallableT", bound=Callable[..., Any])


def compiled(function: CallableT) -> CallableT:
    """Decorate a kernel: compiled by numba when it first runs, and cached if there is a folder for that.

    A tracker cannot start before all are compiled, so they are written to compile fast.  Scratch arrays are arguments:
    compiling an allocation takes longer than all the rest.  Arrays are flat, with unsigned indices: each view of a row
    costs more than the sums on it, and numba checks signed indices, which also prevents vectorisation (the sum of an
    unsigned index and a literal is signed: hence `np.uint32(1)`).  A loop writes and reads different arrays, because
    checks for overlap would prevent vectorisation.  No kernel calls another: a callee is compiled by itself and then
    again in each caller, and numba's cache would not notice a change of its file.
    """
    # Nothing calls these from C: they compile sooner without the C wrapper.
    options: dict[str, Any] = {"fastmath": True, "error_model": "numpy", "no_cfunc_wrapper": True}
    try:
        made: Any = numba.njit(cache=True, **options)(function)
    except RuntimeError:  # numba found no folder that it may write
        _announcer.cached = False
        made = numba.njit(**options)(function)
    return cast("CallableT", made)


def inlined(function: CallableT) -> CallableT:
    """Decorate a part of a kernel that is inlined into the kernels that use it."""
    return cast("CallableT", numba.njit(inline="always", fastmath=True, error_model="numpy")(function))


class Announcer(event.Listener):
    """Logs one warning when the first kernel of this package is compiled rather than loaded."""

    def __init__(self) -> None:
        self.said = False
        self.cached = True

    def on_start(self, event: Any) -> None:
        """Warn once that a compilation begins (loading from the cache does not count)."""
        if self.said or not _is_ours(event):
            return
        self.said = True
        if self.cached:
            LOG.warning("compiling the tracker's kernels, once for this machine: this takes some seconds")
        else:
            LOG.warning(
                "compiling the tracker's kernels, in each process: neither the package's folder nor a home can be "
                "written; set NUMBA_CACHE_DIR to a folder that can"
            )

    def on_end(self, event: Any) -> None:
        """Do nothing."""


class Uninterrupted(event.Listener):
    """Pauses Python's garbage collection, a twelfth of the time, while a kernel of this package is compiled."""

    def __init__(self) -> None:
        self._collected: list[bool] = []

    def on_start(self, event: Any) -> None:
        """Pause at the start of a compilation, which may be nested in another."""
        if _is_ours(event):
            self._collected.append(gc.isenabled())
            gc.disable()

    def on_end(self, event: Any) -> None:
        """Resume after its end or failure."""
        if _is_ours(event) and self._collected.pop():
            gc.enable()


def _is_ours(event: Any) -> bool:
    # A function that was made by exec, or at run time, may have no module: None.
    return str(event.data["dispatcher"].py_func.__module__).startswith("racf.")


_announcer = Announcer()


def announce() -> None:
    """Register both listeners with numba."""
    event.register("numba:compile", _announcer)
    event.register("numba:compile", Uninterrupted())
