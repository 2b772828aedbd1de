"""The whole data flow on one screen."""

from collections.abc import Callable, Iterator
from time import perf_counter
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from follow.camera import Camera
from follow.link import Link
from follow.messages import (
    NEVER,
    NO_INSTRUCTION,
    Decision,
    Estimate,
    Frame,
    ImageMotion,
    Instruction,
    Order,
    Reason,
    Setpoint,
    Tick,
    VehicleState,
)
from follow.selection import AS_SET, Detections, Wanted
from racf.box import Box
from racf.track import Track


class ObjectDetector(Protocol):
    """Finds objects in some frames, with a delay; those of `follow.control.detecting` do."""

    def update(self, frame: Frame | None, t_s: float) -> Detections | None:
        """Take in a round at `t_s` and its frame; returns the last detections, None if they are too old."""
        ...


class BoxTracker(Protocol):
    """Finds the box again in each new image; `racf.Racf` is one."""

    def update(self, image: NDArray[np.uint8], prior: Box | None = None) -> Track | None:
        """Look for the target around `prior`, or around its last box when None; None: there is no target yet."""
        ...


class TargetEstimator(Protocol):
    """Estimates the target's position from boxes and the vehicle's motion; `follow.control.target.Target` is one."""

    def predict(self, state: VehicleState, t_s: float, found: Detections | None = None) -> Box | None:
        """The box where the target should appear in the image taken at `t_s`; None: search around its last box.

        `found` are the detector's objects, among which a lost target may be.
        """
        ...

    def update(
        self, track: Track | None, state: VehicleState, t_s: float, motion: ImageMotion | None = None
    ) -> Estimate:
        """Update with the track of the frame of `t_s` (None: no new frame); returns the estimate at `state.t_s`."""
        ...


class Controller(Protocol):
    """Computes the desired setpoint; `follow.control.servo.Servo` is one."""

    def update(self, estimate: Estimate, state: VehicleState, wanted: Wanted = AS_SET) -> Setpoint:
        """The velocity that brings the estimated target to its desired direction and distance."""
        ...


class SetpointGate(Protocol):
    """The gate; `follow.safety.gate.Safety` is one."""

    def allow(
        self,
        desired: Setpoint,
        estimate: Estimate,
        state: VehicleState,
        frame_t_s: float,
        instruction: Instruction = NO_INSTRUCTION,
        motion: ImageMotion | None = None,
    ) -> Decision:
        """Limit the desired setpoint at `state.t_s`; `frame_t_s` is when the newest frame was taken."""
        ...

    def order(self, order: Order, reason: Reason | None = None) -> None:
        """Give an order; the next round acts on it."""
        ...


class ImageMeter(Protocol):
    """Measures the image's motion; `follow.control.image_motion.ImageMotionMeter` is one."""

    def update(self, frame: Frame | None, track: Track | None, state: VehicleState) -> ImageMotion | None:
        """Take in a round; the newest measurement of the background's motion, or None."""
        ...


def follow(
    camera: Camera,
    link: Link,
    tracker: BoxTracker,
    target: TargetEstimator,
    servo: Controller,
    safety: SetpointGate,
    operator: Callable[[], Instruction] = lambda: NO_INSTRUCTION,
    meter: ImageMeter | None = None,
    detector: ObjectDetector | None = None,
) -> Iterator[Tick]:
    """Keep the target in view until the frames end, yielding one Tick a round."""
    frame_t_s = NEVER
    for frame in camera.frames():
        clock = [perf_counter()]
        state = link.state()
        found = detector.update(frame, state.t_s) if detector is not None else None
        track = None
        if frame is not None:
            frame_t_s = frame.t_s
            track = tracker.update(frame.image, target.predict(state, frame.t_s, found))
        clock.append(perf_counter())
        motion = meter.update(frame, track, state) if meter is not None else None
        estimate = target.update(track, state, frame_t_s, motion)
        instruction = operator()
        desired = servo.update(estimate, state, instruction.wanted)
        decision = safety.allow(desired, estimate, state, frame_t_s, instruction, motion)
        clock.append(perf_counter())
        link.send(decision.setpoint)
        clock.append(perf_counter())
        spent = zip(("tracker", "control", "send"), clock[:-1], clock[1:], strict=True)
        stage_ms = {name: 1e3 * (after - before) for name, before, after in spent}
        yield Tick(frame, track, state, estimate, desired, decision, stage_ms, motion, instruction, found)
