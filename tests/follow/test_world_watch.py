"""The loop closed in the drawn world: a frozen image brakes within a second of moving wrongly, a sound one never."""

from dataclasses import replace

import numpy as np
import pytest

from follow.control.image_motion import ImageMotionMeter
from follow.control.servo import Servo
from follow.control.target import Target
from follow.flight.session import once
from follow.loop import follow
from follow.messages import Autopilot, Mode, Order
from follow.safety.consistency import ImageWatch
from follow.safety.gate import Safety
from racf.track import Track
from sim.scenarios import SCENARIOS, build

FREEZE_S = 4.0
END_S = 8.0


class FrozenCamera:
    """The scene's camera, whose image stands still from `FREEZE_S` on while noise goes on changing its bytes."""

    def __init__(self, camera, fault):
        self.camera, self.fault, self.held = camera, fault, []

    def frames(self):
        random = np.random.default_rng(0)
        for frame in self.camera.frames():
            if self.fault == "none" or frame.t_s < FREEZE_S:
                yield frame
                continue
            if len(self.held) < (2 if self.fault == "two buffers" else 1):
                self.held.append(frame)
            held = self.held[frame.index % len(self.held)]
            image = held.image
            if self.fault == "noise":
                image = np.clip(image + random.normal(0, 3, image.shape), 0, 255).astype(np.uint8)
            yield replace(frame, image=image, index=held.index)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        return None


class TrueBoxes:
    """A tracker that knows the truth of the image that it is shown."""

    def __init__(self, camera):
        self.camera, self.index = camera, 0

    def update(self, image, prior=None):
        box = self.camera.camera.truth(self.index).box
        return Track(box, box.scaled(2.0), 20.0, 1.0, 1.0)


@pytest.mark.parametrize("fault", ["none", "noise", "two buffers"])
@pytest.mark.parametrize("autopilot", list(Autopilot))
def test_a_frozen_image_brakes_within_a_second_and_a_sound_one_never(fault, autopilot):
    scenario = replace(SCENARIOS["walker"], duration_s=END_S)
    scene, link, _ = build(scenario, 0, autopilot)
    lens, down_rad = scene.settings.intrinsics, scene.settings.down_rad
    camera = FrozenCamera(scene, fault)
    tracker = TrueBoxes(camera)

    def frames():
        for frame in FrozenCamera.frames(camera):
            tracker.index = frame.index
            yield frame

    camera.frames = frames
    watch = ImageWatch(ImageMotionMeter(lens, down_rad))
    parts = tracker, Target(lens, down_rad), Servo(down_rad), Safety()
    modes = [(t.state.t_s, t.decision.mode, t) for t in follow(camera, link, *parts, once(Order.FOLLOW), watch)]
    braked = [t_s for t_s, mode, _ in modes if mode is Mode.BRAKE]
    if fault == "none":
        assert not braked
        assert modes[-1][1] is Mode.FOLLOW
    else:
        assert FREEZE_S < braked[0] < FREEZE_S + 1.1  # a walker: the vehicle moves all the time
