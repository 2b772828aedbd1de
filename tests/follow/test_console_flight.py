"""A person at a console while the target is lost, and after: whole simulated flights, faster than real time."""

import math
from contextlib import contextmanager
from types import SimpleNamespace

import pytest

from follow.cli import sim_page
from follow.cli.commands import SimCommand
from follow.cli.sim import FlightSpec, Referee
from follow.config import Config
from follow.control.selector import contrast
from follow.messages import Autopilot, Mode
from follow.operator.consoles import SPOTLIGHT, ConsoleCommand
from follow.operator.page.exchange import Exchange
from follow.operator.terminal import Terminal
from follow.selection import HOVER_HERE, Selection
from racf.box import Box

BY = "a test"


def flown(scenario, person, seconds, out, monkeypatch):
    """Fly with a person, a generator that gets each tick; returns the person's notes."""
    monkeypatch.setattr(sim_page, "RealTimePace", lambda link: link)
    monkeypatch.setattr(sim_page, "PATH_S", seconds)
    noted, seen = [], SimpleNamespace(box=None)

    class Eyes(Referee):
        """What the person sees: the target's true box, which the program is not told."""

        def box(self, tick):
            seen.box = super().box(tick)
            return seen.box

    @contextmanager
    def desk(_exchange, consoles, _out):
        script = person(consoles, seen)
        next(script)

        def see(tick):
            noted.append(tick)
            script.send(tick)

        yield SimpleNamespace(see=see)

    monkeypatch.setattr(sim_page, "Referee", Eyes)

    monkeypatch.setattr(sim_page, "desk_of", desk)
    flight = FlightSpec(scenario, 0, Autopilot.PX4, "racf,robust", Config(), out)
    sim_page.fly_in_real_time(SimCommand(scenario), flight, Exchange(), Terminal())
    return noted


def until(is_so):
    """Wait for a tick that meets a condition."""
    while not is_so(tick := (yield)):
        pass
    return tick


def passed(seconds):
    t_s = (yield).state.t_s
    return (yield from until(lambda tick: tick.state.t_s - t_s >= seconds))


def draw(consoles, box, tick):
    """Draw a box, in pixels, in the image that is shown now; returns the reason of a refusal."""
    rows, columns = tick.frame.image.shape[:2]
    shares = box.x / columns, box.y / rows, box.w / columns, box.h / rows
    return consoles.choose(Selection(*shares, tick.frame.t_s, BY))


def draws_the_walker(consoles, seen):
    """Draw a box around the walker and order FOLLOW, until FOLLOW is granted."""
    yield from passed(1.0)
    tick = yield from until(lambda tick: tick.frame is not None)
    assert draw(consoles, seen.box.scaled(1.1), tick) == ""
    yield from until(lambda tick: tick.decision.mode is Mode.READY)
    assert consoles.order(ConsoleCommand.FOLLOW, BY).done
    yield from until(lambda tick: tick.decision.mode is Mode.FOLLOW)


def horizontal_m_s(tick):
    setpoint = tick.decision.setpoint
    return 0.0 if setpoint is None else math.hypot(setpoint.forward_m_s, setpoint.right_m_s)


def test_after_a_loss_follow_asks_for_confirm_and_confirm_flies(tmp_path, monkeypatch):
    """A walker goes behind a wall and comes back; later the person holds, orders FOLLOW, and confirms."""
    said, passes = {}, []

    def person(consoles, seen):
        yield from draws_the_walker(consoles, seen)
        yield from until(lambda tick: tick.decision.mode is Mode.COAST)
        yield from passed(1.2)
        said["lost"] = consoles.proposal()
        yield from until(lambda tick: tick.decision.mode is Mode.FOLLOW)
        assert consoles.order(ConsoleCommand.HOLD, BY).done
        yield from passed(3.0)
        said["follow"] = consoles.order(ConsoleCommand.FOLLOW, BY)
        tick = yield from passed(2.0)
        passes.append((horizontal_m_s(tick), consoles.wanted.mode))
        said["confirm"] = consoles.order(ConsoleCommand.CONFIRM, BY)
        tick = yield from passed(8.0)
        passes.append((tick.estimate.range_m, tick.decision.mode))
        consoles.order(ConsoleCommand.STOP, BY)
        tick = yield from passed(1.5)
        passes.append((tick.decision.setpoint, tick.decision.mode))
        yield from passed(1e6)

    flown("wall", person, 36.0, tmp_path, monkeypatch)
    assert said["lost"].startswith("not seen for "), "what would be flown is old"
    assert not said["follow"].done
    assert said["follow"].words.startswith("CONFIRM: ")
    assert said["confirm"].done
    (speed_m_s, wanted), (range_m, mode), (setpoint, last) = passes
    assert (wanted, mode) == (HOVER_HERE, Mode.FOLLOW), "before CONFIRM it hovers on"
    assert speed_m_s < 0.3
    assert range_m == pytest.approx(Config().servo.standoff_m, abs=2.0), "at its stand-off again"
    assert (setpoint, last) == (None, Mode.ENDED)


def test_a_target_that_is_chosen_while_another_is_lost_is_tracked_and_not_followed(tmp_path, monkeypatch):
    """While the walker is behind the wall the person chooses something else that stands out."""
    looked, flew = [], []

    def person(consoles, seen):
        yield from draws_the_walker(consoles, seen)
        yield from until(lambda tick: tick.decision.mode is Mode.COAST)
        yield from passed(1.0)
        tick = yield from until(lambda tick: tick.frame is not None)
        image = tick.frame.image
        places = [Box(x, y, 40, 40) for x in range(60, 560, 20) for y in range(120, 300, 20)]
        assert draw(consoles, max(places, key=lambda box: contrast(image, box)), tick) == ""
        tick = yield from until(lambda tick: tick.decision.mode is Mode.FOLLOW)
        looked.append(consoles.wanted.mode)
        for _ in range(150):
            tick = yield
            looked.append(horizontal_m_s(tick))
        assert consoles.order(ConsoleCommand.FOLLOW, BY).done, "drawn a moment ago: no CONFIRM"
        tick = yield from passed(6.0)
        flew.append((consoles.wanted.mode, tick.decision.mode, tick.estimate.range_m))
        yield from passed(1e6)

    flown("wall", person, 30.0, tmp_path, monkeypatch)
    wanted, *speeds = looked
    assert wanted == SPOTLIGHT
    assert max(speeds[45:]) < 0.4, "once it has braked it only turns and climbs"
    ((wanted, mode, range_m),) = flew
    assert (wanted, mode) == ("", Mode.FOLLOW)
    assert range_m == pytest.approx(Config().servo.standoff_m, abs=2.0)
