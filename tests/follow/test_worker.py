import threading

from follow.recording import worker as workers
from follow.recording.worker import Worker


class Full:
    """A sink whose first entry fails once the lane behind it is full."""

    def __init__(self, began, full):
        self.began, self.full = began, full

    def write(self):
        self.began.set()
        assert self.full.wait(10.0)
        raise OSError("no space left")

    def close(self):
        """Nothing is left to write."""


def test_a_worker_that_ended_accepts_the_report_of_a_full_disk():
    """A replay waits for room in the lanes, and its messages are recorded as well: no worker may wait for itself."""
    began, full, said = threading.Event(), threading.Event(), []

    def report(text):
        said.append(text)
        if threading.current_thread() is not threading.main_thread():
            worker.put(lambda sink: None)

    worker = Worker("flight.rrd", lambda: Full(began, full), report, heavy=1, waits=True)
    worker.put(Full.write)
    assert began.wait(10.0)
    worker.put(lambda sink: None, heavy=lambda sink: None)  # now the lane is full
    full.set()
    worker.close(timeout_s=10.0)
    assert said == ["no space left"]
    assert (worker.lost, worker.dropped) == (1, 1)


class Slow:
    """A sink that is written only once `told` is set."""

    def __init__(self, told):
        self.told = told

    def close(self):
        assert self.told.wait(10.0)


def test_a_long_wait_at_the_end_is_reported_while_it_lasts(monkeypatch):
    """The operator must learn that the program waits for the disk, not for the vehicle; the line is not queued."""
    monkeypatch.setattr(workers, "QUIET_S", 0.05)
    told, said = threading.Event(), []

    def report(text):
        said.append(text)
        worker.put(lambda sink: None, heavy=lambda sink: None)
        worker.put(lambda sink: None, heavy=lambda sink: None)  # the lane of one is full, and the thread is in `close`
        told.set()

    worker = Worker("flight.rrd", lambda: Slow(told), report, heavy=1, waits=True)
    worker.close(timeout_s=10.05)
    assert said == ["flight.rrd is not written yet: waiting up to 10 s; Ctrl-C leaves now, without its end"]


def test_a_worker_that_ends_at_once_says_nothing():
    told, said = threading.Event(), []
    told.set()
    Worker("flight.rrd", lambda: Slow(told), said.append, heavy=1, waits=False).close()
    assert said == []
