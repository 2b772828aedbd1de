"""When a stream's frames were taken: network delay is removed for any origin of the time stamps."""

import itertools

import numpy as np
import pytest

from follow.camera.stream_clock import SETTLE_S, WINDOW_S, StreamClock

PERIOD_S = 1 / 30


def taken(stamps_s, arrivals_s) -> list[float | None]:
    clock = StreamClock()
    return [clock.taken_at(stamp, t) for stamp, t in zip(stamps_s, arrivals_s, strict=True)]


def never_overtaking(arrivals_s: np.ndarray) -> np.ndarray:
    """One connection carries all frames: none overtakes an earlier one."""
    return np.maximum.accumulate(arrivals_s)


@pytest.mark.parametrize("seed", range(5))
def test_network_jitter_is_removed_once_an_image_arrived_without_delay(seed):
    rng = np.random.default_rng(seed)
    stamps = PERIOD_S * np.arange(600) + rng.uniform(-1e5, 1e5)
    exposed = 1000.0 + PERIOD_S * np.arange(600)
    held_up = np.where(rng.random(600) < 0.2, 0.0, rng.exponential(0.05, 600))
    arrivals = never_overtaking(exposed + 0.08 + held_up)
    times = taken(stamps, arrivals)
    given = [(t, when, came) for t, when, came in zip(times, exposed, arrivals, strict=True) if t is not None]
    assert len(given) == sum(came >= arrivals[0] + SETTLE_S for came in arrivals)
    for t, when, came in given:
        assert t == pytest.approx(when + 0.08, abs=1e-6), "the way's least, and nothing of what held it up"
        assert t <= came, "no frame is from the future"


def test_a_backlog_keeps_the_times_at_which_it_was_taken():
    exposed = PERIOD_S * np.arange(300)
    arrivals = exposed.copy()
    stalled = (exposed > 5.0) & (exposed < 6.5)
    arrivals[stalled] = 6.5 + 1e-3 * np.arange(stalled.sum())
    times = taken(exposed, never_overtaking(arrivals))
    ages = [came - t for t, came in zip(times, arrivals, strict=True) if t is not None]
    assert max(ages) == pytest.approx(1.5, abs=PERIOD_S)
    assert all(b > a for a, b in itertools.pairwise(t for t in times if t is not None))


def test_frames_queued_while_a_stream_was_opened_are_discarded():
    """A second and a half of frames is there at once, then they come as they are taken."""
    exposed = PERIOD_S * np.arange(200)
    arrivals = np.maximum(exposed, 1.5 + 5e-3 * np.arange(200))
    times = taken(exposed, arrivals)
    ages = [came - t for t, came in zip(times, arrivals, strict=True) if t is not None]
    really = [came - when for t, when, came in zip(times, exposed, arrivals, strict=True) if t is not None]
    assert ages == pytest.approx(really)
    assert times[0] is None
    assert times[-1] == pytest.approx(exposed[-1])


def test_without_stamps_the_time_is_that_of_arrival():
    arrivals = 3.0 + PERIOD_S * np.arange(90)
    for stamps in (np.zeros(90), -arrivals):
        times = taken(stamps, arrivals)
        assert times[-30:] == pytest.approx(arrivals[-30:])


@pytest.mark.parametrize("jump_s", [-100.0, -0.5, 0.5, 1e6])
def test_stamps_that_jump_are_a_restarted_clock(jump_s):
    arrivals = PERIOD_S * np.arange(600)
    stamps = arrivals + np.where(arrivals > 8.0, jump_s, 0.0)
    times = taken(stamps, arrivals)
    assert times[-300:] == pytest.approx(arrivals[-300:])


def test_a_longer_network_delay_is_adopted_after_a_while():
    stamps = PERIOD_S * np.arange(900)
    arrivals = stamps + np.where(stamps > 8.0, 0.3, 0.0)
    ages = np.array([came - t for t, came in zip(taken(stamps, arrivals), arrivals, strict=True) if t is not None])
    came = arrivals[-len(ages) :]
    assert ages[(came > 8.0) & (came < 8.0 + WINDOW_S - 0.1)] == pytest.approx(0.3)
    assert ages[came > 8.1 + WINDOW_S] == pytest.approx(0.0)
