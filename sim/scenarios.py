"""Named flights: a world by seed, a vehicle, a camera, and the limits to fly within."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from follow.geometry import heading_to_ned
from follow.link import Link
from follow.messages import Autopilot
from sim.autopilot.parameters import Table, defaults, flown
from sim.camera import CameraSettings, LiveFlight, SceneCamera
from sim.dynamics import CALM, Vehicle, VehicleTruth, Wind
from sim.link import SimLink
from sim.measured import response_of
from sim.scene.optics import Optics
from sim.scene.world import Kind, World
from sim.scene.worlds import (
    car_road,
    footpath,
    hillside,
    look_alike,
    set_off,
    speeding_away,
    stops,
    straight_at,
    straight_back,
    through_door,
    trees_between,
    turn_back,
    wall_between,
)

Stage = Callable[[np.random.Generator, Kind, float], World]

LEAST_DOWN_RAD = 0.1  # with a camera that looks higher the target is out of the image while the vehicle hovers
MIDDLE_M = {Kind.WALKER: 0.9, Kind.RUNNER: 0.9, Kind.CYCLIST: 0.9, Kind.CAR: 0.7}  # height of an actor's middle


@dataclass(frozen=True, slots=True)
class Scenario:
    """One simulated flight: the world, the vehicle's start, the camera and the settings that differ from the defaults.

    The flight starts at `height_m` and `standoff_m` (along the ground), which the servo is to keep; the camera is
    mounted so that the target is in the image's middle row there at `cruise_m_s`.  `limits` are the gate's limits that
    differ in this flight, `parameters` the autopilot's; `size_m` is about the target's sqrt(width x height),
    `middle_fraction` the setting of that name.
    """

    name: str
    about: str
    kind: Kind
    stage: Stage
    duration_s: float = 30.0
    height_m: float = 6.0
    standoff_m: float = 9.0
    cruise_m_s: float = 1.4
    rolling_start: bool = False  # the vehicle already flies at the target's speed
    face_to_face: bool = False  # the vehicle starts in front of the target, not behind it
    size_m: float = 1.0
    middle_fraction: float = 0.5
    limits: dict[str, float] = field(default_factory=dict)
    parameters: dict[Autopilot, Table] = field(default_factory=dict)
    frames_per_s: float = 30.0
    latency_s: float = 0.0
    drop_fraction: float = 0.0
    wind: Wind = CALM
    optics: Optics = field(default_factory=Optics)
    distortion: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0, 0.0)
    fov_rad: float = math.radians(80.0)
    light: float = 1.0

    def world(self, seed: int) -> World:
        """The world of that seed."""
        world = self.stage(np.random.default_rng([seed, 0]), self.kind, self.duration_s)
        return replace(world, sun=replace(world.sun, light=self.light), seed=seed)

    def down_rad(self, autopilot: Autopilot) -> float:
        """The camera's angle below the nose: toward the target, less the vehicle's tilt at cruise speed."""
        lean = response_of(autopilot).horizontal.lean_rad(self.cruise_m_s)
        return max(math.atan2(self.height_m - MIDDLE_M[self.kind], self.standoff_m) - lean, LEAST_DOWN_RAD)

    @property
    def suggested(self) -> dict[str, dict[str, float]]:
        """The application's settings that suit this flight, by branch.

        The camera's angle is missing: it depends on the autopilot (`camera_settings`).
        """
        return {
            "camera": {"fov_deg": math.degrees(self.fov_rad), "delay_s": self.latency_s},
            "target": {"size_m": self.size_m, "middle_fraction": self.middle_fraction},
            "servo": {"standoff_m": self.standoff_m},
            "limits": dict(self.limits),
        }

    def start(self, world: World, seed: int) -> VehicleTruth:
        """Behind the target or in front of it, with the nose within a few degrees of its direction."""
        random = np.random.default_rng([seed, 7])
        target = world.target(0.0)
        yaw = target.heading_rad + (math.pi if self.face_to_face else 0.0)
        behind = heading_to_ned(-self.standoff_m, 0.0, yaw)
        velocity = heading_to_ned(self.cruise_m_s if self.rolling_start else 0.0, 0.0, yaw)
        north, east = target.north_m + behind[0], target.east_m + behind[1]
        return VehicleTruth(
            north_m=north,
            east_m=east,
            down_m=target.down_m - self.height_m,
            north_m_s=velocity[0],
            east_m_s=velocity[1],
            yaw_rad=math.remainder(yaw + random.uniform(-0.08, 0.08), math.tau),
            ground_m=world.terrain.height_m(north, east),
        )

    def camera_settings(
        self,
        autopilot: Autopilot,
        fov_rad: float | None = None,
        down_rad: float | None = None,
        latency_s: float | None = None,
    ) -> CameraSettings:
        """The camera of this flight, with another field of view, angle below the nose or latency if given."""
        base = CameraSettings()
        fov_rad = self.fov_rad if fov_rad is None else fov_rad
        lens = base.intrinsics.from_fov(base.intrinsics.width, base.intrinsics.height, fov_rad)
        return CameraSettings(
            replace(lens, distortion=self.distortion),
            self.down_rad(autopilot) if down_rad is None else down_rad,
            self.frames_per_s,
            self.latency_s if latency_s is None else latency_s,
            self.drop_fraction,
            self.optics,
        )


def build(
    scenario: Scenario, seed: int, autopilot: Autopilot, mount: CameraSettings | None = None
) -> tuple[SceneCamera, SimLink, World]:
    """The flight in lockstep: the camera's rounds advance the vehicle's time.  `mount` replaces the own camera."""
    world = scenario.world(seed)
    response = flown(response_of(autopilot, seed), defaults(autopilot) | scenario.parameters.get(autopilot, {}))
    start, ground = scenario.start(world, seed), world.terrain.height_m
    vehicle = Vehicle(autopilot, start, scenario.wind, seed, response, ground)
    link = SimLink(vehicle)
    camera = SceneCamera(world, link, mount or scenario.camera_settings(autopilot), scenario.duration_s, seed)
    return camera, link, world


def build_live(
    scenario: Scenario, seed: int, autopilot: Autopilot, link: Link, mount: CameraSettings | None = None
) -> tuple[SceneCamera, World]:
    """The same scene for a vehicle that flies in real time behind any link."""
    world = scenario.world(seed)
    flight = LiveFlight(link, scenario.start(world, seed), world.terrain.height_m)
    return SceneCamera(world, flight, mount or scenario.camera_settings(autopilot), seed=seed), world


WALK = Scenario("walker", "a walker on a winding path", Kind.WALKER, footpath)
RUN = replace(
    WALK,
    name="runner",
    about="a runner on a winding path",
    kind=Kind.RUNNER,
    cruise_m_s=4.0,
    rolling_start=True,
    height_m=7.0,
    standoff_m=10.0,
    limits={"speed_m_s": 7.0},
)
RIDE = replace(
    WALK,
    name="cyclist",
    about="a cyclist on a winding path",
    kind=Kind.CYCLIST,
    cruise_m_s=8.0,
    rolling_start=True,
    height_m=8.0,
    standoff_m=12.0,
    size_m=0.9,
    middle_fraction=0.4,
    limits={"speed_m_s": 12.0, "fence_m": 600.0, "clear_distance": 0.0},
)
DRIVE = replace(
    WALK,
    name="car",
    about="a car on a road with bends",
    kind=Kind.CAR,
    stage=car_road,
    cruise_m_s=15.0,
    rolling_start=True,
    height_m=15.0,
    standoff_m=22.0,
    size_m=2.5,
    middle_fraction=0.15,
    fov_rad=math.radians(90.0),
    limits={"speed_m_s": 20.0, "fence_m": 900.0, "accel_m_s2": 4.0, "clear_distance": 0.0},
    parameters={Autopilot.PX4: {"MPC_XY_VEL_MAX": 20.0}, Autopilot.ARDUPILOT: {"ATC_ANGLE_MAX": 45.0}},
)


def hill(grade: float = 0.1, speed_m_s: float = 1.4, distance_m: float = 70.0) -> Scenario:
    """Somebody on foot goes up a hill (grade < 0: down) for a distance at a constant speed, m/s."""
    return replace(
        WALK,
        name="hill",
        about=f"{'up' if grade > 0 else 'down'} a hill of {100 * abs(grade):g} % at {speed_m_s:g} m/s",
        kind=Kind.WALKER if speed_m_s < 2.0 else Kind.RUNNER,
        stage=partial(hillside, grade=grade, speed_m_s=speed_m_s),
        cruise_m_s=speed_m_s,
        duration_s=math.ceil(1.0 + distance_m / speed_m_s),
    )


def head_on(speed_m_s: float = 3.0, height_m: float = 8.0, standoff_m: float = 12.0) -> Scenario:
    """Somebody comes straight at the hovering drone.  `height_m` and `standoff_m` are where it hovers."""
    return replace(
        WALK,
        name="head-on",
        about=f"somebody comes straight at the drone at {speed_m_s:g} m/s",
        kind=Kind.WALKER if speed_m_s < 2.0 else Kind.RUNNER,
        stage=partial(straight_at, speed_m_s=speed_m_s),
        cruise_m_s=0.0,
        face_to_face=True,
        height_m=height_m,
        standoff_m=standoff_m,
        duration_s=math.ceil(14.0 + 24.0 / speed_m_s),
    )


def about_face(speed_m_s: float = 4.0) -> Scenario:
    """A runner turns on the spot and comes back along its own line, toward the drone."""
    return replace(
        RUN,
        name="turn-back",
        about=f"a runner at {speed_m_s:g} m/s who turns straight back",
        stage=partial(straight_back, speed_m_s=speed_m_s),
        cruise_m_s=speed_m_s,
        duration_s=22.0,
    )


def doorway(speed_m_s: float = 5.0) -> Scenario:
    """A runner vanishes through the door of a house that lies across the path."""
    return replace(
        RUN,
        name="doorway",
        about=f"a runner at {speed_m_s:g} m/s who vanishes through a door",
        stage=partial(through_door, speed_m_s=speed_m_s),
        cruise_m_s=speed_m_s,
        limits={"speed_m_s": speed_m_s + 2.0},
        duration_s=20.0,
    )


def outrun(speed_m_s: float = 8.0, limit_m_s: float = 5.0) -> Scenario:
    """A cyclist speeds up to `speed_m_s`, more than the vehicle's `limit_m_s`."""
    return replace(
        RIDE,
        name="outrun",
        about=f"a cyclist at {speed_m_s:g} m/s, the vehicle limited to {limit_m_s:g} m/s",
        stage=partial(speeding_away, from_m_s=limit_m_s - 1.0, to_m_s=speed_m_s),
        cruise_m_s=limit_m_s - 1.0,
        limits={**RIDE.limits, "speed_m_s": limit_m_s},
    )


DUSK = Optics(shutter_s=1 / 40, noise=9.0, swing=0.12, jpeg_quality=70)

_ALL = (
    WALK,
    RUN,
    RIDE,
    DRIVE,
    replace(WALK, name="walker-stops", about="a walker who stands still now and then", stage=stops),
    replace(RUN, name="runner-start", about="a runner who sets off from standing", stage=set_off, rolling_start=False),
    replace(RUN, name="runner-uturn", about="a runner who turns back toward the drone", stage=turn_back),
    replace(RIDE, name="cyclist-uturn", about="a cyclist who turns back", stage=turn_back, limits={**RIDE.limits}),
    replace(WALK, name="wall", about="a walker goes behind a wall for 3 s", stage=wall_between),
    replace(WALK, name="trees", about="a walker goes behind trees for 3 s", stage=trees_between),
    replace(WALK, name="look-alike", about="someone dressed the same crosses close by", stage=look_alike),
    replace(RUN, name="wind", about="a runner in 7 m/s of wind with gusts", wind=Wind(7.0, 1.2, gust_m_s=1.5)),
    *(
        replace(base, name=f"{base.name}-latency-{ms}", about=f"{base.about}, {ms} ms late", latency_s=ms / 1000)
        for base in (WALK, RIDE)
        for ms in (100, 200, 400)
    ),
    *(
        replace(base, name=f"{base.name}-{fps}fps", about=f"{base.about}, {fps} frames/s", frames_per_s=fps)
        for base, fps in ((WALK, 10), (WALK, 20), (RUN, 60))
    ),
    replace(WALK, name="dusk", about="a walker in low light: blur, noise, compression", light=0.45, optics=DUSK),
    replace(RUN, name="drops", about="a runner, every fifth frame is lost", drop_fraction=0.2),
    replace(
        WALK,
        name="lens",
        about="a walker through a wide, distorting lens",
        fov_rad=math.radians(90.0),
        distortion=(-0.18, 0.03, 0.0, 0.0, 0.0),
    ),
    hill(),
    head_on(),
    about_face(),
    doorway(),
    outrun(),
)
SCENARIOS: dict[str, Scenario] = {scenario.name: scenario for scenario in _ALL}
