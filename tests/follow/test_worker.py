import threading

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


def test_the_report_of_a_full_disk_may_be_put_into_the_worker_that_ended():
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
