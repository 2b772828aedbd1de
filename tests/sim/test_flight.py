import math
from dataclasses import replace

import numpy as np
import pytest

from follow.link.flight_modes import MODES_OF, STREAM_TIMEOUT_S
from follow.messages import HOVER, Autopilot, Setpoint, VehicleState
from sim.camera import MOVED_S, TURNED_S, CameraSettings, LiveFlight, SceneCamera
from sim.dynamics import Vehicle, VehicleTruth
from sim.link import SimLink
from sim.scenarios import SCENARIOS, build, doorway, head_on, hill
from sim.scene.rendering import Seen
from sim.scene.terrain import slope
from sim.scene.world import GAITS, Kind, Leg, route

BLANK = np.zeros((360, 640, 3), np.uint8)
NOTHING = (Seen(None, 0.0),)
both = pytest.mark.parametrize("autopilot", list(Autopilot))


@pytest.mark.parametrize("name", SCENARIOS)
def test_every_scenario_begins_with_the_target_near_the_middle(name):
    scenario = SCENARIOS[name]
    for autopilot in Autopilot:
        world = replace(scenario.world(0), ground_texels=1024)
        vehicle = Vehicle(autopilot, scenario.start(world, 0), scenario.wind)
        camera = SceneCamera(world, SimLink(vehicle), scenario.camera_settings(autopilot))
        _, box = camera.first()
        assert abs(box.centre_x - 320) < 70
        assert abs(box.centre_y - 180) < 120
        assert box.h > 25


@pytest.mark.parametrize("speed_m_s", [1.4, 3.0])
@pytest.mark.parametrize("grade", [0.03, 0.05, 0.08, 0.1, 0.2, -0.03, -0.05, -0.08, -0.1, -0.2])
def test_a_hill_is_as_steep_and_as_long_as_it_is_made(grade, speed_m_s):
    scenario = hill(grade, speed_m_s, distance_m=115.0)
    world = scenario.world(0)
    first, last = world.target(0.0), world.target(scenario.duration_s)
    assert last.north_m - first.north_m == pytest.approx(115.0, abs=speed_m_s + 1.5)
    late = world.target(scenario.duration_s - 20.0)
    assert (late.down_m - last.down_m) / (last.north_m - late.north_m) == pytest.approx(grade, rel=1e-6)
    start = scenario.start(world, 0)
    assert start.height_m == pytest.approx(scenario.height_m)


@pytest.mark.parametrize("speed_m_s", [1.4, 3.0, 6.0])
def test_the_head_on_actor_reaches_a_drone_that_does_nothing(speed_m_s):
    """Over the ground, within a step: only evading keeps the distance."""
    scenario = head_on(speed_m_s)
    world = scenario.world(0)
    start = scenario.start(world, 0)
    times = np.arange(0.0, scenario.duration_s, 0.05)
    poses = [world.target(t) for t in times]
    away = [math.hypot(p.north_m - start.north_m, p.east_m - start.east_m) for p in poses]
    assert away[0] == pytest.approx(scenario.standoff_m)
    assert min(away) < 0.5
    assert max(p.speed_m_s for p in poses) == pytest.approx(speed_m_s)
    assert math.cos(start.yaw_rad - poses[0].heading_rad) < -0.99  # face to face


def test_the_turn_back_actor_passes_below_the_start_of_the_drone():
    scenario = SCENARIOS["turn-back"]
    world = scenario.world(0)
    poses = [world.target(t) for t in np.arange(0.0, scenario.duration_s, 0.05)]
    furthest = max(p.north_m for p in poses)
    behind = furthest - scenario.standoff_m
    assert min(math.hypot(p.north_m - behind, p.east_m) for p in poses[-200:]) < 2.5
    assert poses[-1].north_m < behind
    assert math.cos(poses[-1].heading_rad) < -0.95


@pytest.mark.parametrize("speed_m_s", [3.0, 5.0, 7.0])
def test_the_doorway_actor_runs_at_full_speed_and_is_not_visible_again(speed_m_s):
    scenario = doorway(speed_m_s)
    world = replace(scenario.world(0), ground_texels=1024)
    house = world.blocks[0]
    wall_m = house.north_m - house.length_m / 2
    poses = [(t, world.target(t)) for t in np.arange(0.0, scenario.duration_s, 0.1)]
    at_door = next(pose for _, pose in poses if pose.north_m > wall_m)
    assert at_door.speed_m_s == pytest.approx(speed_m_s, abs=0.05)
    last = poses[-1][1]
    assert last.speed_m_s == 0.0
    assert wall_m < last.north_m < wall_m + house.length_m
    vehicle = VehicleTruth(north_m=wall_m - scenario.standoff_m, down_m=-scenario.height_m)
    camera = SceneCamera(world, SimLink(Vehicle(Autopilot.PX4, vehicle)), scenario.camera_settings(Autopilot.PX4))
    visible = {t: camera._draw(vehicle, t, 0)[1][0].visible for t, pose in poses[::2] if abs(pose.north_m - wall_m) < 3}
    before = [seen for t, seen in visible.items() if world.target(t).north_m < wall_m - 0.5]
    inside = [seen for t, seen in visible.items() if world.target(t).north_m > wall_m + 0.5]
    assert min(before) == 1.0
    assert max(inside) == 0.0


def test_the_outrun_actor_is_faster_than_the_limit():
    scenario = SCENARIOS["outrun"]
    assert scenario.world(0).target(scenario.duration_s).speed_m_s > scenario.limits["speed_m_s"] + 2.0


@pytest.mark.parametrize("height_m", [0.0, -0.0, -0.3, 1e-9])
def test_the_camera_of_a_vehicle_on_the_ground_draws_and_says_in_one_sentence_that_the_target_is_not_in_view(height_m):
    """A lens in the ground's plane has no image of it: the matrix from ground to image is singular there."""
    scenario = SCENARIOS["walker"]
    world = replace(scenario.world(0), ground_texels=1024)
    link = SimLink(Vehicle(Autopilot.PX4, replace(scenario.start(world, 0), down_m=-height_m)))
    camera = SceneCamera(world, link, scenario.camera_settings(Autopilot.PX4))
    frame = next(camera.frames())
    assert frame is not None
    assert frame.image.std() > 5.0
    said = (
        r"not in the first image, seen from 0\.0 m .* camera 27 degrees below .* stands on the ground: .* --height-m 6"
    )
    with pytest.raises(ValueError, match=said):
        camera.first()


@both
def test_a_vehicle_lands_on_the_slope_and_its_truth_knows_the_height_above_it(autopilot):
    terrain = slope(0.1, 0.0, 60.0)
    start = VehicleTruth(north_m=30.0, down_m=-terrain.height_m(30.0, 0.0) - 1.5)
    vehicle = Vehicle(autopilot, start, ground=terrain.height_m)
    assert vehicle.motion.height_m == pytest.approx(1.5)
    assert not vehicle.motion.landed
    for _ in range(200):
        vehicle.step(Setpoint(down_m_s=0.5), 1 / 30)
    m = vehicle.motion
    assert m.landed
    assert m.height_m == 0.0
    assert -m.down_m == m.ground_m == terrain.height_m(m.north_m, m.east_m) > 2.0
    for _ in range(60):
        vehicle.step(Setpoint(down_m_s=-1.0), 1 / 30)
    assert not vehicle.motion.landed
    assert vehicle.motion.height_m > 0.5
    for _ in range(60):
        vehicle.step(None, 1 / 30)  # motors off
    assert vehicle.motion.landed
    assert vehicle.motion.height_m == 0.0


def test_a_vehicle_that_flies_level_into_a_hillside_ends_on_it():
    terrain = slope(0.2, 10.0, 60.0)
    vehicle = Vehicle(Autopilot.ARDUPILOT, VehicleTruth(down_m=-2.0, yaw_rad=0.0), ground=terrain.height_m)
    for _ in range(600):
        vehicle.step(Setpoint(forward_m_s=2.0), 1 / 30)
    assert vehicle.motion.landed
    assert vehicle.motion.ground_m == pytest.approx(2.0, abs=0.3)


def test_there_are_at_least_twelve_scenarios_over_all_targets():
    assert len(SCENARIOS) >= 12
    assert {s.kind for s in SCENARIOS.values()} == set(Kind)
    assert {s.latency_s for s in SCENARIOS.values()} >= {0.0, 0.1, 0.2, 0.4}
    assert {s.frames_per_s for s in SCENARIOS.values()} >= {10.0, 20.0, 30.0, 60.0}


@pytest.mark.parametrize(("latency_s", "fps"), [(0.0, 30.0), (0.1, 30.0), (0.4, 20.0), (0.2, 10.0), (0.0, 60.0)])
def test_a_frame_arrives_after_the_latency_with_its_own_time(latency_s, fps):
    scenario = replace(SCENARIOS["walker"], latency_s=latency_s, frames_per_s=fps, duration_s=1.5)
    camera, link, _ = build(scenario, 0, Autopilot.ARDUPILOT)
    camera.scene.draw = lambda view, t_s: (BLANK, NOTHING)
    times, rounds = [], 0
    for frame in camera.frames():
        rounds += 1
        if frame is not None:
            times.append(frame.t_s)
            assert camera.truth(frame.index).t_s == frame.t_s
            age = link.state().t_s - frame.t_s
            assert latency_s - 1e-6 <= age < latency_s + 1 / 30 + 1e-6
    assert times == pytest.approx([k / fps for k in range(len(times))])
    assert len(times) == pytest.approx((1.5 - latency_s) * fps, abs=2)
    assert rounds >= 1.5 * 30  # a slow camera does not slow the loop down


def test_after_a_slow_round_a_frame_is_no_older_than_before():
    """Live, quick rounds make up for a slow one: frames wait in them, and the newest that is due is delivered."""
    camera, link, _ = build(replace(SCENARIOS["walker"], latency_s=0.05, duration_s=3.0), 0, Autopilot.PX4)
    camera.scene.draw = lambda view, t_s: (BLANK, NOTHING)
    advance, rounds = link.advance, iter([1 / 30] * 30 + [0.1, 0.005, 0.005])
    link.advance = lambda dt_s: advance(next(rounds, dt_s))
    frames = [(k, link.state().t_s - frame.t_s) for k, frame in enumerate(camera.frames()) if frame is not None]
    after = [age_s for k, age_s in frames if k > 40]
    assert after
    assert max(after) < 0.05 + 1 / 30 + 1e-6


def test_dropped_frames_leave_gaps_in_number_as_they_would_on_a_wire():
    camera, _, _ = build(replace(SCENARIOS["walker"], drop_fraction=0.3, duration_s=5.0), 0, Autopilot.PX4)
    camera.scene.draw = lambda view, t_s: (BLANK, NOTHING)
    indices = [f.index for f in camera.frames() if f is not None]
    assert indices[0] == 0
    assert len(indices) == pytest.approx(0.7 * 151, abs=15)


@both
def test_the_link_flies_the_setpoint_and_reports_it(autopilot):
    link = SimLink(Vehicle(autopilot, VehicleTruth(down_m=-20.0)))
    for _ in range(300):
        link.send(Setpoint(forward_m_s=2.0))
        link.advance(1 / 30)
    state = link.state()
    assert state.body_velocity_m_s()[0] == pytest.approx(2.0, abs=0.3)
    assert state.in_control
    assert state.mode == MODES_OF[state.autopilot].control
    assert state.attitude_t_s < state.t_s


@both
def test_when_the_stream_stops_the_vehicle_flies_on_and_then_does_what_was_measured(autopilot):
    link = SimLink(Vehicle(autopilot, VehicleTruth(down_m=-20.0)))
    for _ in range(240):
        link.send(Setpoint(forward_m_s=2.0))
        link.advance(1 / 30)
    patience = STREAM_TIMEOUT_S[autopilot]
    for _ in range(int(30 * (patience - 0.1))):
        link.send(None)
        link.advance(1 / 30)
    assert link.state().body_velocity_m_s()[0] > 1.6
    for _ in range(150):
        link.send(None)
        link.advance(1 / 30)
    state = link.state()
    assert abs(state.body_velocity_m_s()[0]) < 0.3
    sinks = autopilot is Autopilot.PX4
    assert state.in_control is not sinks
    assert state.down_m_s == pytest.approx(0.6 if sinks else 0.0, abs=0.25)


def test_leaving_the_link_ends_in_hover():
    link = SimLink(Vehicle(Autopilot.PX4, VehicleTruth(down_m=-20.0)))
    with link:
        link.send(Setpoint(1.0))
    assert link.setpoint == HOVER


def test_a_live_flight_places_the_scene_about_the_vehicle():
    vehicle = Vehicle(Autopilot.ARDUPILOT, VehicleTruth(north_m=70.0, east_m=-30.0, down_m=-6.0, yaw_rad=2.0))
    start = VehicleTruth(north_m=-9.0, down_m=-6.0, yaw_rad=0.1)
    flight = LiveFlight(SimLink(vehicle), start)
    first = flight.advance(0.0)
    assert (first.north_m, first.east_m, first.yaw_rad) == pytest.approx((-9.0, 0.0, 0.1))
    vehicle.motion = replace(
        vehicle.motion, north_m=70.0 + 3 * math.cos(2.0), east_m=-30.0 + 3 * math.sin(2.0)
    )  # 3 m along its nose
    flight.link._reports.append(vehicle.motion)
    flight.link._reports.popleft()
    moved = flight.advance(0.0)
    assert (moved.north_m, moved.east_m) == pytest.approx((-9.0 + 3 * math.cos(0.1), 3 * math.sin(0.1)))


class Stalled(SimLink):
    """Its telemetry is as old as it is told to be, while the vehicle flies and turns."""

    age_s = 0.0

    def state(self) -> VehicleState:
        return replace(
            super().state(),
            t_s=100.0,
            attitude_t_s=100.0 - self.age_s,
            position_t_s=100.0 - self.age_s,
            north_m_s=4.0,
            yaw_rate_rad_s=1.0,
        )


@pytest.mark.parametrize("age_s", [0.0, 0.05, 0.3, 2.0, 60.0])
def test_a_live_scene_extrapolates_the_vehicle_by_its_velocity_within_a_bound(age_s):
    link = Stalled(Vehicle(Autopilot.ARDUPILOT, VehicleTruth(down_m=-6.0)))
    flight = LiveFlight(link, VehicleTruth(down_m=-6.0))
    flight.advance(0.0)
    link.age_s = age_s
    seen = flight.advance(0.0)
    assert seen.north_m == pytest.approx(4.0 * min(age_s, MOVED_S))
    assert seen.yaw_rad == pytest.approx(1.0 * min(age_s, TURNED_S))


class Nods(SimLink):
    """Its attitudes come 30 times a second and up to 33 ms old, while the vehicle pitches and rolls."""

    now_s = 0.0

    def state(self) -> VehicleState:
        attitude_s = math.floor(self.now_s * 30 + 1e-6) / 30
        roll, pitch = tilts(attitude_s)
        return replace(super().state(), t_s=self.now_s, attitude_t_s=attitude_s, roll_rad=roll, pitch_rad=pitch)


def tilts(t_s):
    """Roll and pitch: 3 degrees at 1 Hz."""
    return 0.05 * math.cos(math.tau * t_s), 0.05 * math.sin(math.tau * t_s)


def test_a_live_scene_tilts_as_the_vehicle_at_the_time_of_the_image():
    """Drawn with the newest attitude it was 11 ms late, and the vehicle that followed what it saw there swung."""
    link = Nods(Vehicle(Autopilot.PX4, VehicleTruth(down_m=-6.0)))
    flight = LiveFlight(link, VehicleTruth(down_m=-6.0))
    off = []
    for n in range(200):
        link.now_s = 100.0 + n * 0.0137
        drawn = flight.advance(0.0)
        off.append(np.subtract((drawn.roll_rad, drawn.pitch_rad), tilts(drawn.t_s)))
    newest = 0.05 * math.tau / 30  # how far off the newest attitude is at most, 1/30 s old
    assert np.abs(off[10:]).max() < newest / 3


@pytest.mark.parametrize("kind", list(Kind))
def test_an_actor_keeps_its_speed_and_its_sideways_acceleration(kind):
    gait = GAITS[kind]
    table = route(kind, (Leg(0, 0), Leg(100, 0), Leg(100, 100), Leg(400, 300)), 30.0).table
    assert table[:, 3].max() <= gait.speed_m_s + 1e-9
    turn = abs((table[1:, 2] - table[:-1, 2]) / 0.02)
    assert (turn * table[:-1, 3]).max() <= gait.turn_m_s2 * 1.05
    steps = ((table[1:, :2] - table[:-1, :2]) ** 2).sum(axis=1) ** 0.5
    assert steps.sum() == pytest.approx(table[-1, 4], rel=1e-6)


def test_an_actor_stops_where_it_is_reports_for_as_long():
    path = route(Kind.WALKER, (Leg(0, 0), Leg(7, 0, pause_s=5.0), Leg(20, 0)), 30.0)
    still = [t / 10 for t in range(300) if path.at(t / 10).speed_m_s == 0.0 and path.at(t / 10).north_m < 15]
    assert max(still) - min(still) == pytest.approx(5.0, abs=0.4)
    assert path.at(min(still) + 1).north_m == pytest.approx(7.0, abs=0.2)


def test_settings_of_a_scenario_reach_the_camera():
    scenario = SCENARIOS["lens"]
    settings = scenario.camera_settings(Autopilot.PX4)
    assert isinstance(settings, CameraSettings)
    assert settings.intrinsics.distortion == scenario.distortion
    assert settings.down_rad > scenario.camera_settings(Autopilot.ARDUPILOT).down_rad  # it leans more at the same speed
    assert isinstance(build(scenario, 0, Autopilot.PX4)[0], SceneCamera)
