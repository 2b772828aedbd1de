"""The loop closed in the drawn world: a frozen image brakes within a second of moving wrongly, a sound one never."""

from dataclasses import replace

import pytest

from follow.control.image_motion import ImageMotionMeter
from follow.control.servo import Servo
from follow.control.target import Target
from follow.flight.session import once
from follow.loop import follow
from follow.messages import Autopilot, Mode, Order
from follow.safety.gate import Safety
from sim.scenarios import SCENARIOS, build
from tools.studies.consistency import FaultyCamera, TrueBoxes

FREEZE_S = 4.0
END_S = 8.0


@pytest.mark.parametrize("fault", ["none", "noise", "two buffers"])
@pytest.mark.parametrize("autopilot", list(Autopilot))
def test_a_frozen_image_brakes_within_a_second_and_a_sound_one_never(fault, autopilot):
    scenario = replace(SCENARIOS["walker"], duration_s=END_S)
    scene, link, _ = build(scenario, 0, autopilot)
    lens, down_rad = scene.settings.intrinsics, scene.settings.down_rad
    camera = FaultyCamera(scene, fault, FREEZE_S)
    tracker = TrueBoxes(camera)
    meter = ImageMotionMeter(lens, down_rad)
    parts = tracker, Target(lens, down_rad), Servo(down_rad), Safety()
    modes = [(t.state.t_s, t.decision.mode, t) for t in follow(camera, link, *parts, once(Order.FOLLOW), meter)]
    braked = [t_s for t_s, mode, _ in modes if mode is Mode.BRAKE]
    if fault == "none":
        assert not braked
        assert modes[-1][1] is Mode.FOLLOW
    else:
        assert FREEZE_S < braked[0] < FREEZE_S + 1.1  # a walker: the vehicle moves all the time
