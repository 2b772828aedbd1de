"""The scene's camera behind the Camera seam: on the built-in vehicle in lockstep, on any other link in real time."""

import math
import time
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from types import TracebackType
from typing import Protocol

import numpy as np
from typing_extensions import Self

from follow.geometry import Intrinsics, camera_to_ned, heading_to_ned
from follow.link import Link
from follow.messages import NEVER, Frame, VehicleState
from racf.box import Box
from sim.dynamics import GroundHeight, VehicleTruth, level
from sim.scene.drawing import View
from sim.scene.ground import Image
from sim.scene.optics import Lens, Optics, Sensor, smear
from sim.scene.rendering import Scene, Seen
from sim.scene.world import ActorPose, World

LENS_M = 0.2  # height of the lens of a landed vehicle: from a lens at height 0 the ground would project to a line
ON_GROUND_M = 0.5  # a vehicle lower than this has not taken off
ROUNDS_PER_S = 30.0  # at least, with or without a frame
# The longest extrapolation of telemetry: the image of a simulator that stalls or runs slowly then stands still
MOVED_S = 0.25  # of the position: half of the gate's position_age_s
TURNED_S = 0.1  # of the attitude: the gate's attitude_age_s, 38 pixels at 1 rad/s
TILTED_S = 0.01  # least time between two attitudes from which a tilt rate is computed


@dataclass(frozen=True, slots=True)
class CameraSettings:
    """One camera: its lens, mounting angle, frame rate, latency, dropped frames and image faults."""

    intrinsics: Intrinsics = field(default_factory=lambda: Intrinsics.from_fov(640, 360, math.radians(80.0)))
    down_rad: float = 0.5  # below the vehicle's nose
    frames_per_s: float = 30.0
    latency_s: float = 0.0
    drop_fraction: float = 0.0
    optics: Optics = field(default_factory=Optics)


@dataclass(frozen=True, slots=True)
class FrameTruth:
    """The ground truth of one frame: when and from where it was taken, each actor's pose, box and visible fraction."""

    index: int
    t_s: float
    vehicle: VehicleTruth
    poses: tuple[ActorPose, ...]
    seen: tuple[Seen, ...]

    @property
    def box(self) -> Box | None:
        """The target's whole box, which may reach beyond the image; None behind the camera."""
        return self.seen[0].box

    @property
    def visible(self) -> float:
        """The fraction of the target that is not hidden."""
        return self.seen[0].visible


class CameraCarrier(Protocol):
    """What carries the camera."""

    def advance(self, dt_s: float) -> VehicleTruth:
        """Let that much time pass and return the state of the camera's vehicle at its end."""
        ...


class LiveFlight:
    """Any link in real time: the vehicle's position from telemetry, extrapolated to now by the reported velocity.

    At the first call the scene is placed about the vehicle, so that it begins at the scenario's start and yaw.
    Heights are the vehicle's own, above the `ground` of the scene.
    """

    def __init__(self, link: Link, start: VehicleTruth, ground: GroundHeight = level) -> None:
        self.link, self.start, self.ground = link, start, ground
        self._anchor: VehicleTruth | None = None
        self._due_s = 0.0
        self._tilted: VehicleState | None = None  # the last state with a new attitude
        self._roll_rate = self._pitch_rate = 0.0

    def advance(self, dt_s: float) -> VehicleTruth:
        """Sleep until the time has passed; raises LinkError through the link when it breaks."""
        now = time.monotonic()
        self._due_s = max(self._due_s + dt_s, now - dt_s) if self._due_s else now + dt_s
        if self._due_s > now:
            time.sleep(self._due_s - now)
        m = self._telemetry()
        if self._anchor is None:
            self._anchor = m
        turn = self.start.yaw_rad - self._anchor.yaw_rad
        north_m_s, east_m_s = heading_to_ned(m.north_m_s, m.east_m_s, turn)
        north, east = self.placed(m.north_m, m.east_m)
        return replace(
            m,
            north_m=north,
            east_m=east,
            ground_m=self.ground(north, east),
            north_m_s=north_m_s,
            east_m_s=east_m_s,
            yaw_rad=math.remainder(m.yaw_rad + turn, math.tau),
        )

    def placed(self, north_m: float, east_m: float) -> tuple[float, float]:
        """A reported position in the scene, north and east, m; as it is before the first call of `advance`."""
        a, start = self._anchor, self.start
        if a is None:
            return north_m, east_m
        north, east = heading_to_ned(north_m - a.north_m, east_m - a.east_m, start.yaw_rad - a.yaw_rad)
        return start.north_m + north, start.east_m + east

    def _telemetry(self) -> VehicleTruth:
        s = self.link.state()
        old = min(s.t_s - s.position_t_s, MOVED_S) if s.position_t_s > NEVER else 0.0
        turned = min(s.t_s - s.attitude_t_s, TURNED_S) if s.attitude_t_s > NEVER else 0.0
        self._measure_tilting(s)
        return VehicleTruth(
            t_s=s.t_s,
            north_m=s.north_m + old * s.north_m_s,
            east_m=s.east_m + old * s.east_m_s,
            down_m=s.down_m + old * s.down_m_s,
            north_m_s=s.north_m_s,
            east_m_s=s.east_m_s,
            down_m_s=s.down_m_s,
            roll_rad=s.roll_rad + turned * self._roll_rate,
            pitch_rad=s.pitch_rad + turned * self._pitch_rate,
            yaw_rad=s.yaw_rad + turned * s.yaw_rate_rad_s,
            yaw_rate_rad_s=s.yaw_rate_rad_s,
        )

    def _measure_tilting(self, s: VehicleState) -> None:
        """Difference two attitudes: telemetry has no roll and pitch rates."""
        last = self._tilted or s
        since_s = s.attitude_t_s - last.attitude_t_s
        if TILTED_S < since_s < TURNED_S:
            self._roll_rate = (s.roll_rad - last.roll_rad) / since_s
            self._pitch_rate = (s.pitch_rad - last.pitch_rad) / since_s
        elif since_s >= TURNED_S:
            self._roll_rate = self._pitch_rate = 0.0
        if self._tilted is None or since_s > TILTED_S:
            self._tilted = s


class SceneCamera:
    """A camera that flies through a drawn world.

    A frame shows the world at its own time `t_s` and is yielded `latency_s` later.  Rounds without a frame (a slow or
    a late camera, a dropped frame) yield None, so that the loop runs at least ROUNDS_PER_S.
    """

    def __init__(
        self, world: World, flight: CameraCarrier, settings: CameraSettings, duration_s: float = math.inf, seed: int = 0
    ) -> None:
        self.world, self.flight, self.settings, self.duration_s = world, flight, settings, duration_s
        self.lens = Lens(settings.intrinsics)
        self.scene = Scene(world, self.lens.ideal)
        self._sensor = Sensor(settings.optics, world.sun.light, seed)
        self._seed = seed
        self._truths: dict[int, FrameTruth] = {}
        self._begin: VehicleTruth | None = None
        self._now: VehicleTruth | None = None

    def first(self) -> tuple[Frame, Box]:
        """The frame at the start and the target's box in it, to begin tracking with.

        Raises ValueError when the target is not there.
        """
        vehicle = self._start()
        image, seen = self._draw(vehicle, 0.0, 0)
        if seen[0].box is None or seen[0].visible <= 0.0:
            down_deg, height_m = math.degrees(self.settings.down_rad), max(0.0, vehicle.height_m)
            helps = (
                "the vehicle stands on the ground: start the simulated autopilot with --height-m 6"
                if height_m < ON_GROUND_M
                else "fly higher, or turn the camera: raise camera.down_deg only with a smaller servo.standoff_m"
            )
            raise ValueError(
                f"the target is not in the first image, seen from {height_m:.1f} m above the ground by a camera "
                f"{down_deg:.0f} degrees below the nose: {helps}"
            )
        return Frame(image, vehicle.t_s, 0), seen[0].box

    def truth(self, index: int) -> FrameTruth:
        """The ground truth of the frame with that index.  Raises KeyError if it was never yielded."""
        return self._truths[index]

    def now(self) -> tuple[VehicleTruth, tuple[ActorPose, ...]]:
        """Where the vehicle and each actor are in this round, with or without a frame."""
        vehicle = self._now or self._start()
        return vehicle, self.world.poses(vehicle.t_s - self._start().t_s)

    def home(self, state: VehicleState) -> tuple[float, float] | None:
        """Home in the scene, north and east, m; None if the link does not tell it."""
        if state.home_t_s == NEVER or not isinstance(self.flight, LiveFlight):
            return None
        return self.flight.placed(state.home_north_m, state.home_east_m)

    def frames(self) -> Iterator[Frame | None]:
        """Each round's frame or None, until the scenario is over."""
        s = self.settings
        rounds = max(1, math.ceil(ROUNDS_PER_S / s.frames_per_s - 1e-9))
        round_s = 1.0 / (s.frames_per_s * rounds)
        vehicle = self._start()
        begin_s = vehicle.t_s
        waiting: deque[tuple[int, VehicleTruth]] = deque()
        count = 0
        while vehicle.t_s - begin_s <= self.duration_s + 1e-9:
            if count % rounds == 0:
                waiting.append((count // rounds, vehicle))
            due = sum(vehicle.t_s - taken.t_s >= s.latency_s - 1e-6 for _, taken in waiting)
            while due > 1 and waiting[0][0] > 0:  # after a stall, live; the first frame is never dropped
                waiting.popleft()
                due -= 1
            yield self._deliver(*waiting.popleft(), begin_s) if due else None
            self._now = vehicle = self.flight.advance(round_s)
            count += 1

    def _start(self) -> VehicleTruth:
        if self._begin is None:
            self._begin = self.flight.advance(0.0)
        return self._begin

    def _deliver(self, index: int, vehicle: VehicleTruth, begin_s: float) -> Frame | None:
        t_s = vehicle.t_s - begin_s
        # The first frame is never dropped: tracking begins with it.
        if index > 0 and np.random.default_rng([self._seed, 6, index]).random() < self.settings.drop_fraction:
            return None
        image, seen = self._draw(vehicle, t_s, index)
        self._truths[index] = FrameTruth(index, vehicle.t_s, vehicle, self.world.poses(t_s), seen)
        return Frame(image, vehicle.t_s, index)

    def _draw(self, vehicle: VehicleTruth, t_s: float, index: int) -> tuple[Image, tuple[Seen, ...]]:
        view = self._view(vehicle)
        image, seen = self.scene.draw(view, t_s)
        shutter = self.settings.optics.shutter_s
        before = replace(
            vehicle,
            north_m=vehicle.north_m - shutter * vehicle.north_m_s,
            east_m=vehicle.east_m - shutter * vehicle.east_m_s,
            yaw_rad=vehicle.yaw_rad - shutter * vehicle.yaw_rate_rad_s,
        )
        image = self.lens.bend(image)
        image = self._sensor.expose(image, smear(self._view(before), view, vehicle.ground_m), t_s, index)
        return image, tuple(self.lens.bend_box(one) for one in seen)

    def _view(self, m: VehicleTruth) -> View:
        rotation = camera_to_ned(self.settings.down_rad, m.roll_rad, m.pitch_rad, m.yaw_rad)
        return View(self.lens.ideal, rotation, np.array([m.north_m, m.east_m, min(m.down_m, -m.ground_m - LENS_M)]))

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        return None
