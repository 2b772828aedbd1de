"""Many independent jobs, each in one of several processes here or on a Dask cluster."""

import importlib
import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from multiprocessing import active_children, get_context
from typing import Any, TypeVar

JobT = TypeVar("JobT")
AnswerT = TypeVar("AnswerT")

ONE_THREAD = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1"}
"""Read by the numeric libraries when a process starts: processes that each use every core slow one another down."""


def each(
    work: Callable[[JobT], AnswerT], jobs: Sequence[JobT], processes: int | None = None, dask: str | None = None
) -> Iterator[tuple[JobT, AnswerT]]:
    """Each job with its answer, in the order they finish; by default one process for each core.

    `dask` is the address of a scheduler to run on instead; its workers need the same version of the program.  Raises
    ValueError without Dask, OSError if the scheduler does not answer, ChildProcessError if a process dies.

    The first error cancels the jobs that have not begun.  An interruption, or a caller that stops iterating, also ends
    the running ones.
    """
    if not jobs:
        return
    if dask is not None:
        yield from _on_dask(work, jobs, dask)
        return
    try:
        yield from _in_processes(work, jobs, processes)
    except BrokenProcessPool:
        raise ChildProcessError(
            "a process ended before its work was done: in a program of your own, call this below "
            'if __name__ == "__main__": or with one job at a time; otherwise memory may be short, and fewer jobs help'
        ) from None


def _in_processes(
    work: Callable[[JobT], AnswerT], jobs: Sequence[JobT], processes: int | None
) -> Iterator[tuple[JobT, AnswerT]]:
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


def _on_dask(work: Callable[[JobT], AnswerT], jobs: Sequence[JobT], address: str) -> Iterator[tuple[JobT, AnswerT]]:
    try:
        distributed: Any = importlib.import_module("distributed")  # an extra
    except ImportError:
        raise ValueError("Dask needs the extra: pip install '.[dask]' in the clone") from None
    with distributed.Client(address) as client:
        waiting = {client.submit(work, job, pure=False): job for job in jobs}
        try:
            for future in distributed.as_completed(list(waiting)):
                yield waiting[future], future.result()
        finally:
            client.cancel(list(waiting))
