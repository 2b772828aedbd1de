"""Sources without time stamps: no frame is dated too new.  The reference is a queue of known delays."""

import itertools

import numpy as np
import pytest

from follow.camera import CameraError
from follow.camera.program import PipeArrivals
from follow.camera.stream_clock import (
    GIVE_UP_S,
    LATE_S,
    LEARN_S,
    MEMORY_S,
    SETTLE_S,
    SteadyArrivals,
    most_understated_s,
)

FPS = 30.0
LEARNED_S = SETTLE_S + LEARN_S


def exposed(seconds: float, fps: float = FPS) -> np.ndarray:
    """The times at which a steady camera takes its frames, s."""
    return np.arange(0.0, seconds, 1 / fps)


def queued(taken_s: np.ndarray, fps: float, began_s: float = 0.0, stall_s: float = 0.0) -> np.ndarray:
    """Arrivals through a queue that from `began_s` on gives `fps` at most, after nothing at all for `stall_s`."""
    arrivals, last_s = [], -1.0
    for t_s in taken_s:
        last_s = max(t_s, last_s + 1 / fps, began_s + stall_s) if t_s >= began_s else t_s
        arrivals.append(last_s)
    return np.array(arrivals)


def clocked(arrivals_s: np.ndarray) -> tuple[np.ndarray, float | None]:
    """The time that the clock gives each frame (NaN: none), and when it gave the stream up."""
    clock, times = SteadyArrivals(), []
    for t_s in arrivals_s:
        try:
            taken_s = clock.taken_at(0.0, float(t_s))
        except CameraError:
            return np.array(times), float(t_s)
        times.append(np.nan if taken_s is None else taken_s)
    return np.array(times), None


def understated_s(taken_s: np.ndarray, times_s: np.ndarray) -> np.ndarray:
    """By how much each frame that is given seems newer than it is."""
    return (times_s - taken_s[: len(times_s)])[np.isfinite(times_s)]


def ages_s(arrivals_s: np.ndarray, times_s: np.ndarray) -> np.ndarray:
    """The reported ages of the delivered frames."""
    return (arrivals_s[: len(times_s)] - times_s)[np.isfinite(times_s)]


@pytest.mark.parametrize("ppm", [-200.0, 0.0, 200.0])
def test_a_steady_camera_is_fresh_for_half_an_hour_whatever_its_clock(ppm):
    arrivals = 7.0 + exposed(1800.0) * (1 + 1e-6 * ppm)
    times, gave_up_s = clocked(arrivals)
    assert gave_up_s is None
    assert np.isfinite(times[arrivals > 7.0 + LEARNED_S + 0.1]).all()
    assert ages_s(arrivals, times).max() < 1e-9


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("jitter_s", [0.003, 0.02])
def test_jitter_drops_no_frame_and_makes_none_newer(seed, jitter_s):
    rng = np.random.default_rng(seed)
    taken = exposed(120.0)
    waits = np.where(rng.random(len(taken)) < 0.3, 0.0, rng.exponential(jitter_s, len(taken)))
    arrivals = np.maximum.accumulate(taken + waits)
    times, gave_up_s = clocked(arrivals)
    assert gave_up_s is None
    assert np.isfinite(times[arrivals > LEARNED_S + 0.2]).all()
    assert understated_s(taken, times).max() < 0.05
    assert ages_s(arrivals, times).min() >= 0.0, "no frame is from the future"


@pytest.mark.parametrize("fps", [1000.0, 60.0, 33.0, 31.5])
@pytest.mark.parametrize("began_s", [4.0, 12.0, 60.0])
@pytest.mark.parametrize("stall_s", [0.2, 1.0, 5.0])
def test_frames_of_a_backlog_have_their_true_age_however_slowly_it_drains(fps, began_s, stall_s):
    taken = exposed(began_s + 100.0)
    arrivals = queued(taken, fps, began_s, stall_s)
    times, gave_up_s = clocked(arrivals)
    backlog_s = (gave_up_s or arrivals[-1]) - began_s
    if gave_up_s is None:  # then it was caught up
        backlog_s = stall_s * fps / (fps - FPS)
    assert understated_s(taken, times).max() < most_understated_s(began_s - LEARNED_S, backlog_s)
    assert times[np.isfinite(times)].tolist() == sorted(times[np.isfinite(times)])


def test_after_a_backlog_that_drains_soon_frames_are_fresh_again():
    arrivals = queued(exposed(40.0), 300.0, 20.0, 1.0)
    times, gave_up_s = clocked(arrivals)
    ages = arrivals - times
    assert gave_up_s is None
    assert ages[(arrivals > 21.0) & (arrivals < 21.02)].min() > 0.8, "the oldest of it"
    assert ages[arrivals > 21.3].max() < 0.01
    assert all(b > a for a, b in itertools.pairwise(times[np.isfinite(times)]))


@pytest.mark.parametrize("fps", [29.0, 25.0, 15.0, 5.0])
@pytest.mark.parametrize("began_s", [12.0, 60.0])
def test_a_connection_that_is_too_slow_is_detected_and_reopened(fps, began_s):
    """An overloaded machine or link: the queue grows for ever."""
    taken = exposed(began_s + 100.0)
    arrivals = queued(taken, fps, began_s)
    times, gave_up_s = clocked(arrivals)
    assert gave_up_s is not None
    assert understated_s(taken, times).max() < most_understated_s(began_s - LEARNED_S, gave_up_s - began_s)
    growth = 1 - fps / FPS
    assert gave_up_s - began_s < (LATE_S + 0.1) / growth + GIVE_UP_S + 1.0


def test_a_slower_rhythm_is_learned_by_a_new_connection_and_a_faster_one_is_at_once_fresh():
    slower = np.append(exposed(20.0, 30.0), 20.0 + exposed(20.0, 15.0))
    _, gave_up_s = clocked(slower)
    assert gave_up_s is not None
    assert gave_up_s < 20.0 + GIVE_UP_S + 0.5
    faster = np.append(exposed(20.0, 15.0), 20.0 + exposed(20.0, 30.0))
    times, gave_up_s = clocked(faster)
    assert gave_up_s is None
    assert ages_s(faster, times).max() < 1e-9


def test_a_backlog_after_the_rate_increased_is_dated_at_the_new_rate():
    """At the old period, twice as long, each frame would reduce the backlog's age by more than it really drained."""
    taken = np.append(exposed(20.0, 15.0), 20.0 + exposed(60.0, 30.0))
    arrivals = queued(taken, 33.0, 40.0, 1.0)
    times, gave_up_s = clocked(arrivals)
    assert gave_up_s is not None
    assert understated_s(taken, times).max() < most_understated_s(20.0, gave_up_s - 40.0)


@pytest.mark.parametrize("lost", [0.001, 0.01])
def test_lost_frames_make_others_seem_older_for_a_moment_only(lost):
    taken = exposed(300.0)
    kept = taken[np.random.default_rng(0).random(len(taken)) > lost]
    times, gave_up_s = clocked(kept)
    assert gave_up_s is None
    assert ages_s(kept, times).max() < 0.2, "the gate's limit of a frame's age"
    assert understated_s(kept, times).max() < 1e-9


def test_a_gap_without_a_backlog_is_forgotten_once_the_rate_is_back():
    taken = exposed(40.0)
    kept = taken[(taken < 20.0) | (taken > 21.0)]
    times, gave_up_s = clocked(kept)
    assert gave_up_s is None
    ages = kept - times
    assert ages[(kept > 21.0) & (kept < 22.0)].min() > 0.9, "it may be a backlog"
    assert ages[kept > 23.2].max() < 0.01


def test_the_bound_is_what_the_memory_allows():
    assert most_understated_s(MEMORY_S, 10.0) == most_understated_s(10.0, 10.0) == 0.1
    assert most_understated_s(10.0, 20.0) == 0.2


PIPE = 65_536


class SimulatedPipe:
    """A pipe that a program fills with pieces (bytes, when they are due), as far as it has room for their bytes."""

    def __init__(self, pieces: list[tuple[int, float]]) -> None:
        self.due, self.held, self.read_t_s = pieces, [], 0.0

    def fill(self, t_s: float) -> None:
        """Let everything in that is due at `t_s` and has room; what waited for room came when there was some."""
        while self.due and self.due[0][1] <= t_s and (room := PIPE - sum(count for count, _ in self.held)):
            count, due_s = self.due[0]
            self.held.append((min(count, room), max(due_s, self.read_t_s)))
            self.due[0] = (count - room, due_s)
            if count <= room:
                self.due.pop(0)

    def read(self, most: int, t_s: float) -> tuple[int, float]:
        """Take at most `most` bytes: how many there were, and when the last of them had come."""
        count, came_s = 0, 0.0
        while self.held and count < most:
            piece, came_s = self.held.pop(0)
            if piece > most - count:
                self.held.insert(0, (piece - (most - count), came_s))
            count += min(piece, most - count)
        self.read_t_s = t_s
        return count, came_s


@pytest.mark.parametrize("seed", range(12))
@pytest.mark.parametrize("most", [32_768, 1_000_000])
def test_frames_queued_in_a_pipe_are_never_dated_too_new(seed, most):
    rng = np.random.default_rng(seed)
    largest = int(rng.choice([20_000, 200_000]))
    written = np.cumsum(rng.exponential(0.03, 300))
    pipe = SimulatedPipe([(int(n), float(t)) for n, t in zip(rng.integers(1000, largest, 300), written, strict=True)])
    arrivals, now_s, waits, ages = PipeArrivals(PIPE, 0.0), 0.0, [], []
    pause_s = float(rng.choice([0.0, 0.01, 0.1]))
    while pipe.due:
        now_s += rng.exponential(pause_s) if pause_s else 1e-4
        pipe.fill(now_s)
        waited = not pipe.held
        if waited:
            now_s = pipe.due[0][1]
            pipe.fill(now_s)
        count, came_s = pipe.read(most, now_s)
        arrivals.read(count, count < most, waited, now_s)
        waits.append(now_s - came_s)
        ages.append(now_s - arrivals.came_t_s)
    assert min(np.array(ages) - waits) >= -1e-9
    if not pause_s:
        assert max(np.array(ages) - waits) < 2e-3, "a reader that is in time tells the very arrival"
