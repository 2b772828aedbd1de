"""The program `follow`, whose page's thread dies at SIGUSR2: python -m tests.support.page_killer sim walker --page ...

A thread cannot be killed from outside; SystemExit is raised in it at its next step, and all that it served is gone.
"""

import csv
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


def flown_last(folder, seconds):
    """The modes of a flight's last seconds before it was ended, and whether a setpoint was sent in every round."""
    with (folder / "ticks.csv").open() as file:
        rows = list(csv.DictReader(file))
    while rows and "leaving" in rows[-1]["reason"]:
        rows.pop()
    last = [row for row in rows if float(row["t_s"]) > float(rows[-1]["t_s"]) - seconds]
    return {row["mode"] for row in last}, all(row["setpoint_forward_m_s"] for row in last)


if __name__ == "__main__":
    signal.signal(signal.SIGUSR2, kill)
    sys.exit(main())
