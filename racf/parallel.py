"""Many independent jobs, each in one of several processes."""

import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import active_children, get_context
from typing import TypeVar

JobT = TypeVar("JobT")
AnswerT = TypeVar("AnswerT")

ONE_THREAD = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1"}
"""Read by the numeric libraries when a process starts: processes that each use every core slow one another down."""


def each(
    work: Callable[[JobT], AnswerT], jobs: Sequence[JobT], processes: int | None = None
) -> Iterator[tuple[JobT, AnswerT]]:
    """Each job with its answer, in the order they finish; by default one process for each core.

    The first error cancels the jobs that have not begun.  An interruption, or a caller who stops iterating, also ends
    those that have.
    """
    if not jobs:
        return
    os.environ.update(ONE_THREAD)
    others = active_children()
    # Spawned, not forked: a fork would copy the progress bar's thread and OpenCV's locks in an unknown state.
    with ProcessPoolExecutor(processes and min(processes, len(jobs)), mp_context=get_context("spawn")) as pool:
        waiting = {pool.submit(work, job): job for job in jobs}
        try:
            for future in as_completed(waiting):
                yield waiting[future], future.result()
        except (KeyboardInterrupt, GeneratorExit):
            for child in active_children():
                if child not in others:
                    child.terminate()
            raise
        finally:
            pool.shutdown(cancel_futures=True)
