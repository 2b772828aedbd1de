"""Many independent jobs, one to a processor."""

import os
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import get_context
from typing import TypeVar

JobT = TypeVar("JobT")
AnswerT = TypeVar("AnswerT")

ONE_THREAD = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1"}
"""Read by the numeric libraries when a process starts: several that each use every processor only wait for another."""


def each(work: Callable[[JobT], AnswerT], jobs: Iterable[JobT]) -> Iterator[AnswerT]:
    """The answers as they come.  The first error ends it; jobs that have not begun are dropped."""
    os.environ.update(ONE_THREAD)
    with ProcessPoolExecutor(mp_context=get_context("spawn")) as pool:
        futures = [pool.submit(work, job) for job in jobs]
        try:
            for future in as_completed(futures):
                yield future.result()
        finally:
            pool.shutdown(cancel_futures=True)
