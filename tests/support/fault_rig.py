"""A whole flight in lockstep on a virtual clock, with faults injected.

The application's own session (`follow.flight.live_flight.fly`) with the real target, servo and gate, the MAVLink
client in memory and the simulated autopilot with its rules.  Only the camera and the tracker are replaced: the tracker
returns the true box unless a fault changes it.  With `view` the images show textured ground, and their motion is
measured; without it they are noise.
"""

import math
import random
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from follow.control.image_motion import ImageMotionMeter
from follow.control.servo import Servo, ServoConfig
from follow.control.target import Target
from follow.flight.live_flight import Parts, fly
from follow.geometry import Intrinsics, camera_to_ned, project
from follow.link.client import MavlinkClient
from follow.messages import Autopilot, Frame, Setpoint, Tick, VehicleState
from follow.operator.authority import Operator
from follow.safety.gate import Limits, Safety
from follow.selection import AS_SET
from racf.box import Box
from racf.track import Track
from sim.autopilot.system import AutopilotSystem
from sim.dynamics import Vehicle, VehicleTruth
from tests.support.fit import fit
from tests.support.ground_view import look

FRAME_S = 1 / 30
SUBSTEPS = 4  # of a frame: telemetry of 50 Hz comes at its own times
FAULT_S = 15.0  # FOLLOW begins at some 4 s; the vehicle has reached the target's speed by then
WALK_M_S = 3.0  # a jog: there is speed to lose
HEIGHT_M = 8.0
STILL_M_S = 0.3  # drift of a PX4 that is told to stand is faster than none
DOWN_RAD = 0.5
LENS = Intrinsics.from_fov(640, 360, math.radians(80.0))
SIZE_M = (0.6, 1.8)  # the target's width and height
PARAMETERS = {autopilot: fit(autopilot) for autopilot in Autopilot}  # those that `follow doctor` asks for
Way = Callable[[list[bytes]], list[bytes]]


def unspoilt(packets: list[bytes]) -> list[bytes]:
    """Pass everything on."""
    return packets


@dataclass
class Sample:
    """The truth at one moment, and what was sent in it."""

    t_s: float
    motion: VehicleTruth
    speed_m_s: float  # horizontally, the less of the true and the reported one: PX4 wanders unseen, or sees it unmoved
    mode: str  # the autopilot's
    setpoints: int
    modes_asked: int


@dataclass
class Rig:
    """One flight.  At `fault_t_s`, `inject` changes the hooks, the autopilot or its vehicle."""

    autopilot: Autopilot
    inject: Callable[["Rig"], None]
    fault_t_s: float = FAULT_S
    end_t_s: float = FAULT_S + 15.0
    limits: Limits = field(default_factory=Limits)
    walk_m_s: float = WALK_M_S
    path: Callable[[float], tuple[float, float]] | None = None  # of the target: time -> north, east
    servo: ServoConfig = field(default_factory=ServoConfig)
    down_rad: float = DOWN_RAD
    lens: Intrinsics = LENS  # the true one; the application believes in LENS
    true_down_rad: float | None = None  # None: as believed
    is_upside_down: bool = False
    height_m: float = HEIGHT_M
    ground: Callable[[float, float], float] = lambda _north, _east: 0.0  # metres down at a place
    view: bool = False
    seed: int = 0  # of the vehicle: which sample of its response, and its wandering
    at_once: bool = True
    t_s: float = 0.0
    jump_s: float = 0.0  # of the application's clock
    to_client: Way = unspoilt
    to_autopilot: Way = unspoilt
    see: Callable[[Frame | None], Frame | None] = lambda frame: frame
    track: Callable[[Track], Track] = lambda track: track
    desired: Callable[[Setpoint], Setpoint] = lambda desired: desired
    samples: list[Sample] = field(default_factory=list)
    ticks: list[Tick] = field(default_factory=list)
    ticks_before: int = 0  # the fault; it may be one of the clock
    lines: list[str] = field(default_factory=list)
    error: Exception | None = None
    chance: random.Random = field(default_factory=lambda: random.Random(0))

    def __post_init__(self) -> None:
        start = VehicleTruth(down_m=-self.height_m)
        self.true_down_rad = self.down_rad if self.true_down_rad is None else self.true_down_rad
        self.system = AutopilotSystem(self.autopilot, Vehicle(self.autopilot, start, seed=self.seed))
        self.system.flight.parameters.update(PARAMETERS[self.autopilot])
        self.client = MavlinkClient()
        self.operator = Operator(self.lines.append, at_once=self.at_once, heard=self.client.heard)
        self.setpoints = 0
        self.modes_asked = 0
        self.last_setpoint_t_s = -math.inf
        self._rounds = np.random.default_rng(0)

    # The world

    @property
    def motion(self) -> VehicleTruth:
        return self.system.flight.vehicle.motion

    @property
    def now_s(self) -> float:
        """The application's clock."""
        return self.t_s + self.jump_s

    def target_place(self, t_s: float) -> tuple[float, float]:
        """North and east: it stands for 6 s, then runs away on a slight bend."""
        if self.path is not None:
            return self.path(t_s)
        path_m = self.walk_m_s * max(t_s - 6.0, 0.0)
        radius = 60.0
        return 10.0 + radius * math.sin(path_m / radius), radius * (1 - math.cos(path_m / radius))

    def true_box(self) -> Box | None:
        m = self.motion
        north, east = self.target_place(self.t_s)
        rotation = camera_to_ned(self.true_down_rad or 0.0, m.roll_rad, m.pitch_rad, m.yaw_rad)
        middle = [[north, east, self.ground(north, east) - SIZE_M[1] / 2]]
        pixels, depth = project(self.lens, rotation, (m.north_m, m.east_m, m.down_m), middle)
        x, y = pixels[0]
        if depth[0] < 0.5 or not (0 < x < LENS.width and 0 < y < LENS.height):
            return None
        if self.is_upside_down:
            x, y = LENS.width - x, LENS.height - y
        scale = self.lens.fx / depth[0]
        return Box.around(float(x), float(y), SIZE_M[0] * scale, SIZE_M[1] * scale)

    def advance(self, seconds: float = FRAME_S) -> None:
        """Let time pass for everything but the loop."""
        for _ in range(SUBSTEPS):
            before, self.t_s = self.t_s, self.t_s + seconds / SUBSTEPS
            if before < self.fault_t_s <= self.t_s:
                self.ticks_before = len(self.ticks)
                self.inject(self)
            self.system.step(self.t_s)
            for packet in self.to_client(self.system.take()):
                self.client.receive(packet, self.now_s, datagram=True)
            self.client.step(self.now_s)
            self.flush()
        told = self.system.flight.vehicle.reported
        speed_m_s = min(math.hypot(m.north_m_s, m.east_m_s) for m in (self.motion, told))
        self.samples.append(
            Sample(self.t_s, self.motion, speed_m_s, self.system.flight.mode, self.setpoints, self.modes_asked)
        )

    def flush(self) -> None:
        """Carry what the application sent."""
        out = self.client.take()
        for packet in out:
            number = int.from_bytes(packet[7:10], "little")
            if number == 84:  # SET_POSITION_TARGET_LOCAL_NED
                self.setpoints += 1
                self.last_setpoint_t_s = self.t_s
            elif number == 76 and int.from_bytes(packet[10 + 28 : 10 + 30], "little") == 176:  # DO_SET_MODE
                self.modes_asked += 1
        for packet in self.to_autopilot(out):
            self.system.receive(packet)

    # The pieces of the loop

    def frames(self) -> Iterator[Frame | None]:
        index = 0
        while self.t_s < self.end_t_s:
            self.advance()
            yield self.see(Frame(self.image(), self.now_s, index))
            index += 1

    def image(self) -> np.ndarray:
        """Never twice the same: noise, or what is to be seen with a little noise on it."""
        if not self.view:
            return self._rounds.integers(0, 256, (4, 4, 3), np.uint8)
        seen = look(self.lens, self.true_down_rad or 0.0, self.motion)
        seen = seen[::-1, ::-1] if self.is_upside_down else seen
        return seen ^ self._rounds.integers(0, 4, seen.shape, np.uint8)

    def update(self, _image: np.ndarray, _prior: Box | None = None) -> Track:
        """As a tracker: the true box, or lost when it is not in the image."""
        box = self.true_box()
        where = box or Box(0, 0, 20, 40)
        return self.track(Track(where, where.scaled(3), 15.0, 60.0, 1.0, found=box is not None))

    def state(self) -> VehicleState:
        return self.client.state(self.now_s)

    def send(self, setpoint: Setpoint | None) -> None:
        self.client.send_setpoint(setpoint, self.now_s)
        self.flush()

    def take_control(self) -> None:
        self.client.take_control()

    def hold(self, *, for_sticks: bool = False) -> None:
        self.client.hold(for_sticks=for_sticks)

    def __enter__(self) -> "Rig":
        return self

    def __exit__(self, *_error: object) -> None:
        return None

    # The flight

    def fly(self) -> "Rig":
        """The whole flight, and at least two seconds beyond it as the link's own leaving has them."""
        servo = Wishing(Servo(self.down_rad, self.servo), self)
        limits = replace(self.limits, half_view_rad=LENS.horizontal_fov_rad / 2)
        meter = ImageMotionMeter(LENS, self.down_rad) if self.view else None
        self.parts = Parts(self, self, self, Target(LENS, self.down_rad), servo, Safety(limits), meter)
        self.advance(2.0)
        try:
            fly(self.parts, self.operator, self.ticks.append, pause=self.advance)
        except (ValueError, RuntimeError) as error:
            self.error = error
        self.client.hold()
        end_s = max(self.end_t_s, self.t_s + 2.0)
        while self.t_s < end_s:
            self.advance()
        return self


@dataclass
class Wishing:
    """A servo whose desired setpoint a fault may change."""

    servo: Servo
    rig: Rig

    def update(self, estimate, state, wanted=AS_SET) -> Setpoint:
        return self.rig.desired(self.servo.update(estimate, state, wanted))


@dataclass(frozen=True)
class Outcome:
    """The result of one flight, by the vehicle's true motion since the fault."""

    followed: bool  # it was in FOLLOW when the fault came
    stop_s: float | None  # until it stood for good; None: it never did
    stop_m: float  # distance flown until then, or to the end
    silent_s: float  # until the last setpoint was sent
    gate_mode: str
    vehicle_mode: str
    modes_asked: int  # since the fault
    setpoints_at_end: bool  # whether it was still streaming in the last second
    off_m: float  # then, from the wanted distance to the target
    fastest_m_s: float
    lowest_m: float
    highest_m: float
    farthest_m: float  # from the place of the start
    nearest_m: float  # to the target's body


def to_body_m(rig: Rig, sample: Sample) -> float:
    """The true distance from the vehicle to the target's body, a vertical line from its feet to its head."""
    north, east = rig.target_place(sample.t_s)
    feet = rig.ground(north, east)
    above = max(feet - SIZE_M[1] - sample.motion.down_m, sample.motion.down_m - feet, 0.0)
    return math.hypot(north - sample.motion.north_m, east - sample.motion.east_m, above)


def outcome(rig: Rig) -> Outcome:
    """Measure a flight."""
    after = [s for s in rig.samples if s.t_s >= rig.fault_t_s]
    speeds = [s.speed_m_s for s in after]
    moving = [i for i, speed in enumerate(speeds) if speed > STILL_M_S]
    last = moving[-1] + 1 if moving else 0
    stood = last < len(after) - round(0.5 / FRAME_S)
    distance_m = sum(speed * FRAME_S for speed in speeds[:last])
    before = rig.ticks[: rig.ticks_before]
    end = next((s for s in after if s.t_s >= rig.end_t_s - FRAME_S), after[-1])
    north, east = rig.target_place(end.t_s)
    to_target_m = math.hypot(north - end.motion.north_m, east - end.motion.east_m)
    return Outcome(
        followed=bool(before) and before[-1].decision.mode == "follow",
        stop_s=after[last].t_s - rig.fault_t_s if stood else None,
        stop_m=distance_m,
        silent_s=rig.last_setpoint_t_s - rig.fault_t_s,
        gate_mode=rig.ticks[-1].decision.mode,
        vehicle_mode=after[-1].mode,
        modes_asked=after[-1].modes_asked - after[0].modes_asked,
        setpoints_at_end=end.setpoints > after[max(after.index(end) - 30, 0)].setpoints,
        off_m=abs(to_target_m - rig.servo.standoff_m),
        fastest_m_s=max(speeds),
        lowest_m=min(rig.ground(s.motion.north_m, s.motion.east_m) - s.motion.down_m for s in after),
        highest_m=max(rig.ground(s.motion.north_m, s.motion.east_m) - s.motion.down_m for s in after),
        nearest_m=min(to_body_m(rig, s) for s in after),
        farthest_m=max(math.hypot(s.motion.north_m, s.motion.east_m) for s in rig.samples),
    )
