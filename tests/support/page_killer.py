"""The program `follow`, whose page's thread dies at SIGUSR2: python -m tests.support.page_killer sim walker --page ...

A thread cannot be killed from outside; SystemExit is raised in it at its next step, and all that it served is gone.
"""

import ctypes
import signal
import sys
import threading

from follow.cli.program import main


def kill(_number, _frame):
    """Raise SystemExit in the page's thread."""
    for thread in threading.enumerate():
        if thread.name == "page":
            ctypes.pythonapi.PyThreadState_SetAsyncExc(ctypes.c_ulong(thread.ident), ctypes.py_object(SystemExit))


if __name__ == "__main__":
    signal.signal(signal.SIGUSR2, kill)
    sys.exit(main())
