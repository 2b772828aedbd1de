"""The application's own session against the simulated autopilot, in lockstep: orders at different times."""

from functools import partial

import pytest

from follow.control.acquire import Acquire
from follow.flight import live_flight
from follow.messages import Autopilot, Mode, Order
from racf.box import Box
from racf.track import Track
from tests.support import fault_rig
from tests.support.fault_rig import Rig

BOTH = pytest.mark.parametrize("autopilot", list(Autopilot))


class Standing(Rig):
    """The target stands 15 m away; FOLLOW is ordered when the fault's time has come."""

    def target_place(self, t_s: float) -> tuple[float, float]:
        return 15.0, 0.0


@BOTH
def test_an_order_after_minutes_of_observing_is_flown_like_an_early_one(autopilot):
    rig = Standing(autopilot, lambda rig: rig.operator.order(Order.FOLLOW), fault_t_s=120.0, end_t_s=145.0)
    rig.operator.at_once = False
    rig.fly()
    assert rig.error is None
    assert rig.ticks[-1].decision.mode is Mode.ENDED  # left by itself at the end
    ranges = [15.0 - s.motion.north_m for s in rig.samples]
    assert min(ranges) > 10.0  # the wanted distance is 12 m
    assert ranges[-1] == pytest.approx(12.0, abs=1.0)


def test_frames_that_end_give_their_own_reason_to_leave(monkeypatch):
    monkeypatch.setattr(fault_rig, "fly", partial(live_flight.fly, frames_over="the footage is over"))
    rig = Rig(Autopilot.PX4, lambda _rig: None, fault_t_s=99.0, end_t_s=4.0).fly()
    assert [line for line in rig.lines if line.startswith("leaving: ")] == ["leaving: the footage is over"]


@pytest.mark.parametrize("after_s", [0.1, 0.6])
def test_leaving_before_px4_obeys_does_not_take_the_vehicle(after_s):
    rig = Rig(Autopilot.PX4, lambda _rig: None, fault_t_s=99.0, end_t_s=10.0)
    began: list[float] = []
    all_frames = rig.frames

    def frames():
        for frame in all_frames():
            if rig.operator.mode is Mode.ENGAGE and not began:
                began.append(rig.t_s)
            if began and rig.t_s - began[0] >= after_s and not rig.operator.leaving:
                rig.operator.leave("Ctrl-C")
            yield frame

    rig.frames = frames
    rig.fly()
    assert began
    assert "OFFBOARD" not in {s.mode for s in rig.samples}
    assert rig.modes_asked == 0
    assert rig.last_setpoint_t_s <= began[0] + after_s + 0.1


class Passing(Rig):
    """The tracked target walks off to the side; the order means the other one, in the box of the start."""

    def target_place(self, t_s: float) -> tuple[float, float]:
        return 12.0, 0.0


@BOTH
def test_with_a_fixed_box_the_order_starts_on_its_content_at_that_time(autopilot):
    rig = Passing(autopilot, lambda rig: rig.operator.order(Order.FOLLOW), fault_t_s=20.0, end_t_s=30.0)
    rig.operator.at_once = False
    told: list[Box] = []
    drifted = Box(500, 100, 12, 30)  # what a tracker has that was started on the ground under way

    def init(_image, box):
        told.append(box)
        return Track(box, box.scaled(3), 0.0, 0.0, 1.0)

    def track(image, prior):
        return Track(drifted, drifted.scaled(3), 15.0, 60.0, 1.0) if len(told) == 1 else truth(image, prior)

    truth = rig.update
    sight = Box(310, 140, 20, 60)
    tracker = Acquire(init, track, sight)
    rig.update = tracker.update

    def aim():
        tracker.restart()
        rig.parts.target.forget()

    rig.operator.aim = aim
    rig.fly()
    assert told == [sight, sight]
    following = [t for t in rig.ticks if t.decision.mode is Mode.FOLLOW]
    assert following[-1].estimate.range_m == pytest.approx(12.0, abs=1.5)
    assert abs(following[-1].estimate.azimuth_rad) < 0.05
