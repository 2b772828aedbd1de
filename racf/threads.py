"""One core for the tracker: its matrix products are small, so a library's threads cost more time than they save."""

import os
from typing import Any

import cv2
from threadpoolctl import threadpool_limits

_held: list[Any] = []  # a limit lasts as long as its object


def one_core() -> None:
    """Keep BLAS and OpenCV to the calling thread for the rest of the process.

    The program decides this, so no import does it.  On two loaded cores a frame then takes a tenth to a fifth of the
    time.
    """
    if not _held:
        os.environ["OPENBLAS_NUM_THREADS"] = "1"  # for libraries and processes that start later
        _held.append(threadpool_limits(1, user_api="blas"))
    cv2.setNumThreads(1)
