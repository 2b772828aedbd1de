"""The whole data flow on one screen."""

from collections.abc import Callable, Iterator
from time import perf_counter
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from follow.camera import Camera
from follow.link import Link
from follow.messages import NEVER, Decision, Estimate, Order, Setpoint, Tick, VehicleState
from racf.box import Box
from racf.track import Track


class BoxTracker(Protocol):
    """Finds the box again in each new picture; `racf.Racf` is one."""

    def update(self, image: NDArray[np.uint8], prior: Box | None = None) -> Track:
        """Look for the target around `prior`, or around its last place when None."""
        ...


class TargetEstimator(Protocol):
    """Turns boxes and the vehicle's own motion into where the target is; `follow.control.target.Target` is one."""

    def predict(self, state: VehicleState, t_s: float) -> Box | None:
        """Where in the picture of `t_s` the target should appear, or None for where it last did."""
        ...

    def update(self, track: Track | None, state: VehicleState, t_s: float) -> Estimate:
        """Take in the track of the picture of `t_s` (None: no new picture); the answer is for `state.t_s`."""
        ...


class Controller(Protocol):
    """Wishes a velocity; `follow.control.servo.Servo` is one."""

    def update(self, estimate: Estimate, state: VehicleState) -> Setpoint:
        """The velocity that would keep the estimated target where it is wanted."""
        ...


class SetpointGate(Protocol):
    """The gate; `follow.safety.gate.Safety` is one."""

    def allow(self, desired: Setpoint, estimate: Estimate, state: VehicleState, frame_t_s: float) -> Decision:
        """What of the desired setpoint may be sent at `state.t_s`, given when the newest picture was taken."""
        ...

    def order(self, order: Order) -> None:
        """Take in what the operator asks for."""
        ...


def follow(
    camera: Camera,
    link: Link,
    tracker: BoxTracker,
    target: TargetEstimator,
    servo: Controller,
    safety: SetpointGate,
    orders: Callable[[], Order | None] = lambda: None,
) -> Iterator[Tick]:
    """Keep the target in view until the frames end, yielding one Tick a round."""
    frame_t_s = NEVER
    for frame in camera.frames():
        clock = [perf_counter()]
        state = link.state()
        track = None
        if frame is not None:
            frame_t_s = frame.t_s
            track = tracker.update(frame.image, target.predict(state, frame.t_s))
        clock.append(perf_counter())
        estimate = target.update(track, state, frame_t_s)
        desired = servo.update(estimate, state)
        if order := orders():
            safety.order(order)
        decision = safety.allow(desired, estimate, state, frame_t_s)
        clock.append(perf_counter())
        link.send(decision.setpoint)
        clock.append(perf_counter())
        spent = zip(("tracker", "control", "send"), clock[:-1], clock[1:], strict=True)
        stage_ms = {name: 1e3 * (after - before) for name, before, after in spent}
        yield Tick(frame, track, state, estimate, desired, decision, stage_ms)
