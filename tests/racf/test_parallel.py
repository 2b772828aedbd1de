"""Independent jobs in several processes."""

import os
import time
from multiprocessing import active_children
from pathlib import Path

import pytest

from racf.parallel import each


def leave_a_mark(job: tuple[float, Path]) -> str:
    """Sleep, then leave a file behind."""
    seconds, mark = job
    time.sleep(seconds)
    mark.touch()
    return mark.name


def test_every_job_returns_its_own_result(tmp_path):
    jobs = [(0.01 * (3 - i), tmp_path / str(i)) for i in range(4)]
    assert {job[1].name: answer for job, answer in each(leave_a_mark, jobs, 2)} == {str(i): str(i) for i in range(4)}
    assert not list(each(leave_a_mark, []))


def test_the_end_of_the_caller_ends_running_work(tmp_path):
    quick, slow = tmp_path / "quick", tmp_path / "slow"
    answers = each(leave_a_mark, [(0.0, quick), (20.0, slow)], 2)
    next(answers)
    answers.close()
    assert quick.exists()
    assert not slow.exists()
    assert not active_children()


def die(_: int) -> None:
    """End the process at once, as the kernel does when memory is short."""
    os._exit(1)


def test_a_process_that_dies_is_reported_with_the_remedy():
    with pytest.raises(ChildProcessError, match="__main__"):
        list(each(die, [1, 2], 1))
