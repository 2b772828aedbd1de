"""A detector beside the loop: the loop never waits for it, its detections have their true age, and it may fail."""

import logging
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from follow.cli.detector import simulated_detector
from follow.control import detecting
from follow.control.detecting import DELAY_S, NICEST, PERIOD_S, REST, DelayedDetector, DetectorProcess
from follow.control.servo import Servo
from follow.control.target import Target
from follow.flight.session import acquire, once
from follow.loop import follow
from follow.messages import Autopilot, Frame, Order
from follow.safety.gate import Safety
from follow.selection import DETECTIONS_S, Detection
from racf.box import Box
from racf.commandline import UsageError
from sim.scenarios import SCENARIOS, build
from tests.follow.test_detector import IMAGE, OBJECTS, yolov8
from tests.support.onnx_files import network

ROUND_S = 1 / 30
BLIND_S = 0.7, 2.0


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "network.onnx"
    path.write_bytes(network(yolov8(OBJECTS)))
    return path


def frame(n: int) -> Frame:
    return Frame(IMAGE, n * ROUND_S, n)


def test_in_a_simulation_a_result_comes_its_delay_later_and_names_its_frame():
    asked, came = [], {}

    def find(_image):
        asked.append(n)
        return (Detection(Box(float(n), 0.0, 1.0, 1.0), 0.5),)

    detector = DelayedDetector(find)
    for n in range(90):
        found = detector.update(frame(n), n * ROUND_S)
        if found is not None and found.index not in came:
            came[found.index] = n * ROUND_S - found.t_s
            assert found.objects[0].box.x == found.index
    assert list(came) == asked[: len(came)]
    assert all(DELAY_S - 1e-9 <= late < DELAY_S + ROUND_S + 1e-9 for late in came.values())
    gaps = np.diff(asked) * ROUND_S
    assert gaps.min() >= max(PERIOD_S, (1 + REST) * DELAY_S) - 1e-9
    assert gaps.max() < 0.5 + 1e-9, "two frames a second at least"


def test_detections_that_are_too_old_are_dropped():
    detector = DelayedDetector(lambda _image: ())
    detector.update(frame(0), 0.0)
    times = [n * ROUND_S for n in range(60)]
    known = [t for t in times if detector.update(None, t) is not None]
    assert known == [t for t in times if DELAY_S <= t <= DETECTIONS_S]


def test_a_network_that_fails_is_reported_and_the_simulation_goes_on(caplog):
    def fails(_image):
        raise ValueError("no such layer")

    detector = DelayedDetector(fails)
    assert all(detector.update(frame(n), n * ROUND_S) is None for n in range(60))
    assert caplog.messages[0] == "the detector failed: no such layer"


def until(detector, n=0, seconds=30.0):
    """Rounds as fast as they go, at simulated times, until something is found; the detections and the next round."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        found = detector.update(frame(n), n * ROUND_S)
        if found is not None:
            return found, n + 1
        n += 1
        os.sched_yield()
    raise AssertionError("nothing was found")


def test_the_process_finds_what_the_detector_finds_and_its_click_gets_the_same_box(file):
    direct = simulated_detector(file)
    direct.update(frame(0), 0.0)
    with DetectorProcess(file) as detector:
        box = detector.snap(IMAGE, 320, 200)
        started = time.monotonic()
        assert detector.update(frame(0), 0.0) is None
        assert time.monotonic() - started < 5.0, "it does not wait for the network"
        while detector.update(None, 0.0) is None:
            os.sched_yield()
        found = detector.update(None, 0.0)
        assert (found.t_s, found.index) == (0.0, 0)
        assert found.objects == direct.update(None, DELAY_S).objects
        assert detector.update(None, DETECTIONS_S + 0.1) is None
        process = detector._process
        assert os.getpriority(os.PRIO_PROCESS, process.pid) == NICEST
        os.kill(process.pid, signal.SIGINT)  # a Ctrl-C for the whole group is the loop's
        assert detector.snap(IMAGE, 320, 200) == box
        assert box is not None
    assert not process.is_alive()


def failures(caplog):
    """Drops the warnings about a slow detector: rounds in this test run faster than real time."""
    return [message for message in caplog.messages if message.startswith("the detector failed")]


def test_a_process_that_dies_is_reported_once_and_the_flight_goes_on(file, caplog):
    with caplog.at_level(logging.WARNING), DetectorProcess(file) as detector:
        _, n = until(detector)
        detector._process.kill()
        detector._process.join()
        for k in range(n, n + 3000):
            detector.update(frame(k), k * ROUND_S)
            if failures(caplog):
                break
            time.sleep(0)
        assert detector.update(frame(k + 60), (k + 60) * ROUND_S) is None
        assert detector.snap(IMAGE, 320, 200) is None
    assert failures(caplog) == ["the detector failed: its process has ended"]


KILLED = """
import os, signal, sys
from pathlib import Path
import numpy as np
from follow.control.detecting import DetectorProcess
with DetectorProcess(Path(sys.argv[1])) as detector:
    detector.snap(np.zeros((360, 640, 3), np.uint8), 320, 200)
    print(detector._process.pid, flush=True)
    os.kill(os.getpid(), signal.SIGKILL)
"""


def test_the_process_ends_with_a_flight_that_is_killed(file):
    flight = subprocess.run([sys.executable, "-c", KILLED, file], capture_output=True, check=False, timeout=60)
    assert flight.returncode == -signal.SIGKILL
    end = time.monotonic() + 30.0
    while is_running(int(flight.stdout)):
        assert time.monotonic() < end
        os.sched_yield()


def is_running(pid: int) -> bool:
    """Whether a process runs; one that ended and was not yet waited for does not."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def test_a_network_that_fails_in_the_process_is_reported_once_and_works_again_afterwards(file, caplog):
    with DetectorProcess(file) as detector:
        bad = np.zeros((4, 4, 2), np.uint8)  # an image of no known kind
        assert detector.snap(bad, 1, 1) is None
        assert detector.snap(bad, 1, 1) is None
        assert detector.snap(IMAGE, 320, 200) is not None
    assert len(failures(caplog)) == 1


def test_a_stopped_process_does_not_keep_the_program_from_ending(file):
    with DetectorProcess(file) as detector:
        pid = detector._process.pid
        os.kill(pid, signal.SIGSTOP)
    assert not is_running(pid)


def test_while_a_process_hangs_one_click_waits_and_no_other_is_queued_behind_it(file, monkeypatch):
    monkeypatch.setattr(detecting, "CLICK_S", 0.05)
    with DetectorProcess(file) as detector:
        while detector.snap(IMAGE, 320, 200) is None:
            pass
        os.kill(detector._process.pid, signal.SIGSTOP)
        assert [detector.snap(IMAGE, 320, 200) for _ in range(20)] == [None] * 20
        assert detector._calls._work_queue.qsize() <= 1
        os.kill(detector._process.pid, signal.SIGCONT)
        monkeypatch.setattr(detecting, "CLICK_S", 30.0)
        detector._late.result(30.0)
        assert detector.snap(IMAGE, 320, 200) is not None, "and a later click is looked at"


def answered(detector, n, t_s):
    """Submit a frame, and collect its detections at `t_s`."""
    detector.update(frame(n), n * ROUND_S)
    detector._asked[0].result(30.0)
    detector.update(None, t_s)


def test_a_detector_that_is_too_slow_is_reported_once(file, caplog):
    with DetectorProcess(file) as detector:
        answered(detector, 0, 8.0)  # the process starts meanwhile
        assert not caplog.messages
        answered(detector, 500, 500 * ROUND_S + DETECTIONS_S)
        assert not caplog.messages
        for n in (1000, 1500):
            answered(detector, n, n * ROUND_S + 2.3)
    (line,) = caplog.messages
    assert line.startswith("the detector is too slow: it found boxes 2.3 s after their frame")


def test_a_detector_that_does_not_answer_is_reported_once(file, caplog):
    with DetectorProcess(file) as detector:
        os.kill(detector._process.pid, signal.SIGSTOP)
        for n in range(1000):
            detector.update(frame(n), n * ROUND_S)
    (line,) = caplog.messages
    assert line.startswith("the detector has not answered for 10 s")


def test_where_memory_runs_out_the_detector_is_ended_first(file):
    with DetectorProcess(file) as detector:
        until(detector)
        assert Path(f"/proc/{detector._process.pid}/oom_score_adj").read_text().strip() == "1000"


class BlindAWhile:
    """A tracker that finds nothing from BLIND_S[0] to BLIND_S[1], so that what is found acts on the flight."""

    def __init__(self, tracker):
        self._tracker, self._n = tracker, 0

    def update(self, image, prior=None):
        self._n += 1
        track = self._tracker.update(image, prior)
        return replace(track, found=not BLIND_S[0] <= self._n * ROUND_S < BLIND_S[1])


def flown(path):
    """Each round's box and setpoint, in a flight with the detector of a file."""
    scenario = replace(SCENARIOS["walker"], duration_s=BLIND_S[1] + 0.3)
    camera, link, _ = build(scenario, 0, Autopilot.PX4)
    lens, down_rad = camera.settings.intrinsics, camera.settings.down_rad
    tracker = BlindAWhile(acquire("racf--", camera.first()[1]))
    parts = Target(lens, down_rad), Servo(down_rad), Safety()
    ticks = follow(camera, link, tracker, *parts, once(Order.FOLLOW), detector=simulated_detector(path))
    return [(tick.track and tick.track.box, tick.decision.setpoint, tick.estimate) for tick in ticks]


def test_the_same_detector_gives_the_same_flight_and_one_that_finds_nothing_gives_that_without(tmp_path):
    nothing, something = tmp_path / "nothing.onnx", tmp_path / "something.onnx"
    nothing.write_bytes(network(yolov8([])))
    something.write_bytes(network(yolov8(OBJECTS)))
    bare, with_it = flown(None), flown(something)
    assert flown(nothing) == bare
    assert flown(something) == with_it
    assert [box for box, *_ in with_it] != [box for box, *_ in bare], "what was found was looked at"


def test_a_simulation_with_a_file_that_is_no_detector_is_refused(tmp_path):
    with pytest.raises(UsageError, match="No such file"):
        simulated_detector(tmp_path / "none.onnx")
