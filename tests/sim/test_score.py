"""The score of a flight: over made-up rounds, over a live flight through a scene, and over a cluster."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest

from follow.cli.layers import read
from follow.cli.program import execute
from follow.cli.run import open_scene
from follow.control.servo import Servo
from follow.control.target import Target
from follow.flight.session import once
from follow.geometry import Intrinsics
from follow.loop import follow
from follow.messages import HOVER, Autopilot, Order, Setpoint
from follow.safety.gate import Safety
from racf.box import Box
from racf.track import Track
from sim import camera as sim_camera
from sim.camera import FrameTruth
from sim.dynamics import Vehicle, VehicleTruth
from sim.link import SimLink
from sim.scenarios import SCENARIOS
from sim.scene.rendering import Seen
from sim.scene.world import ActorPose, Kind
from sim.score import BODY_M, ScoredTick, body_distance, score

CAMERA = Intrinsics.from_fov(640, 360, 1.4)


def rows(boxes, tracked=None, sent=HOVER, others=None, visible=None, dt=0.1, near=9.0) -> list[ScoredTick]:
    """A flight built from its true boxes; the tracker's boxes equal them unless given."""
    out = []
    for k, box in enumerate(boxes):
        vehicle = VehicleTruth(t_s=k * dt, down_m=-6.0)
        seen = (Seen(box, visible[k] if visible else 1.0), *((Seen(others[k], 1.0),) if others else ()))
        pose = ActorPose(9.0, 0.0, 0.0, 0.0, 0.0)
        truth = FrameTruth(k, k * dt, vehicle, (pose,) * len(seen), seen)
        nearest = near[k] if isinstance(near, list) else near
        setpoint = sent[k] if isinstance(sent, list) else sent
        out.append(
            ScoredTick(k * dt, vehicle, setpoint, 0.0, "follow", tracked[k] if tracked else box, True, truth, nearest)
        )
    return out


MIDDLE = Box.around(320, 180, 20, 50)
ASIDE = Box.around(480, 180, 20, 50)
LIMITS = {"speed_m_s": 5.0, "accel_m_s2": 3.0, "yaw_rate_rad_s": 1.0, "climb_m_s": 2.0, "floor_m": 2.0, "fence_m": 50.0}


def test_a_target_in_the_middle_at_its_distance_has_a_perfect_score():
    s = score(rows([MIDDLE] * 10), CAMERA, 9.0, LIMITS)
    assert (s.in_view, s.centring_rms, s.standoff_rms_m, s.off_target_s, s.decoy_s) == (1.0, 0.0, 0.0, 0.0, 0.0)
    assert s.violations == {}
    assert s.reacquired is None


def test_centring_is_the_root_mean_square_in_half_widths():
    s = score(rows([MIDDLE, ASIDE] * 5), CAMERA, 8.0, LIMITS)
    assert s.centring_rms == pytest.approx(0.5 / math.sqrt(2))
    assert s.worst_offset == pytest.approx(0.5)
    assert s.standoff_rms == pytest.approx(1 / 8)


def test_a_target_outside_or_behind_is_not_in_view():
    s = score(rows([MIDDLE, Box.around(700, 180, 20, 50), None, MIDDLE]), CAMERA, 9.0, LIMITS)
    assert s.in_view == 0.5


def test_following_the_look_alike_is_scored_by_its_longest_time():
    s = score(
        rows([MIDDLE] * 30, tracked=[MIDDLE] * 10 + [ASIDE] * 12 + [MIDDLE] * 8, others=[ASIDE] * 30), CAMERA, 9, {}
    )
    assert s.decoy_s == pytest.approx(1.2)
    assert s.off_target_s == pytest.approx(1.2)


@pytest.mark.parametrize("back", [True, False])
def test_reacquired_says_whether_the_box_came_back_after_hiding(back):
    visible = [1.0] * 10 + [0.0] * 30 + [1.0] * 50
    tracked = [MIDDLE] * 10 + [ASIDE] * 30 + [MIDDLE if back else ASIDE] * 50
    assert score(rows([MIDDLE] * 90, tracked, visible=visible), CAMERA, 9.0, {}).reacquired is back


def test_a_target_that_leaves_the_image_was_not_hidden():
    away = Box.around(900, 180, 20, 50)
    visible = [1.0] * 10 + [0.0] * 30 + [1.0] * 50
    boxes = [MIDDLE] * 10 + [away] * 30 + [MIDDLE] * 50
    assert score(rows(boxes, visible=visible), CAMERA, 9.0, {}).reacquired is None
    hides_and_leaves = [MIDDLE] * 20 + [away] * 20 + [MIDDLE] * 50
    assert score(rows(hides_and_leaves, visible=visible), CAMERA, 9.0, {}).reacquired is True


def test_limits_are_checked_again_on_what_was_sent():
    fast = [Setpoint(0.2 * k) for k in range(30)]  # 2 m/s2, at last 5.8 m/s
    s = score(rows([MIDDLE] * 30, sent=fast), CAMERA, 9.0, LIMITS)
    assert s.violations == {"speed_m_s": 4}
    jump = [Setpoint(right_m_s=1.0 * (k > 4), yaw_rate_rad_s=1.5 * (k == 7)) for k in range(10)]
    assert score(rows([MIDDLE] * 10, sent=jump), CAMERA, 9.0, LIMITS).violations == {
        "accel_m_s2": 1,
        "yaw_rate_rad_s": 1,
    }
    flight = rows([MIDDLE] * 10, sent=jump)
    again = [replace(row, begins=k > 4) for k, row in enumerate(flight)]  # at the velocity of a vehicle that disobeys
    assert score(again, CAMERA, 9.0, LIMITS).violations == {"yaw_rate_rad_s": 1}
    late = [replace(row, begins=k > 3) for k, row in enumerate(flight)]
    assert "accel_m_s2" in score(late, CAMERA, 9.0, LIMITS).violations


@pytest.mark.parametrize(
    ("name", "position"),
    [("fence_m", {"north_m": 60.0}), ("floor_m", {"down_m": -1.0}), ("ceiling_m", {"down_m": -30.0})],
)
def test_where_the_vehicle_goes_is_checked_also_after_the_last_setpoint(name, position):
    flight = rows([MIDDLE] * 10, sent=[None] * 2 + [HOVER] * 3 + [None] * 5)
    away = [
        replace(row, vehicle=replace(row.vehicle, **position)) if k in (0, 7, 8, 9) else row
        for k, row in enumerate(flight)
    ]
    assert score(away, CAMERA, 9.0, LIMITS | {"ceiling_m": 20.0}).violations == {name: 3}


def test_the_fence_is_centred_on_home_once_that_is_known():
    """As the gate's: a flight that begins 40 m from home has 10 m left on that side, and 90 m on the other."""
    flight = [replace(row, home=(40.0, 0.0)) for row in rows([MIDDLE] * 10)]

    def passed(north_m):
        moved = [replace(row, vehicle=replace(row.vehicle, north_m=north_m)) for row in flight[1:]]
        return score([flight[0], *moved], CAMERA, 9.0, {"fence_m": 50.0}).violations

    assert passed(-9.9) == passed(89.9) == {}
    assert passed(-10.1) == passed(90.1) == {"fence_m": 9}


def test_nearer_than_the_minimum_stand_off_counts_while_setpoints_are_sent():
    near = [9.0, 3.9, 3.9, 4.0, 3.5, 3.0, 8.0]
    sent = [HOVER] * 5 + [None] * 2
    s = score(rows([MIDDLE] * 7, sent=sent, near=near), CAMERA, 9.0, {"min_standoff_m": 4.0})
    assert s.violations == {"min_standoff_m": 3}
    assert s.nearest_m == 3.0
    assert s.nearest_other_m is None


@pytest.mark.parametrize("ground_m", [0.0, 7.0])
@pytest.mark.parametrize("kind", list(Kind))
def test_the_distance_to_a_body_is_that_to_its_nearest_point(kind, ground_m):
    """Against a search over the points of the box that BODY_M describes, at the actor's heading and on its ground."""
    pose = ActorPose(3.0, -2.0, 0.7, 0.0, 0.0, down_m=-ground_m)
    length, width, height = BODY_M[kind]
    part = np.linspace(0.0, 1.0, 41)
    a, b, c = (x.ravel() for x in np.meshgrid((part - 0.5) * length, (part - 0.5) * width, part * height))
    north = 3.0 + a * math.cos(0.7) - b * math.sin(0.7)
    east = -2.0 + a * math.sin(0.7) + b * math.cos(0.7)
    for seed in range(20):
        n, e, up = np.random.default_rng(seed).uniform((-9, -9, -1), (9, 9, 9))
        vehicle = VehicleTruth(north_m=n, east_m=e, down_m=-ground_m - up)
        searched = np.sqrt((north - n) ** 2 + (east - e) ** 2 + (c - up) ** 2).min()
        assert body_distance(kind, pose, vehicle) == pytest.approx(searched, abs=0.06)
    assert body_distance(kind, pose, VehicleTruth(north_m=3.0, east_m=-2.0, down_m=-ground_m - 1.0)) == 0.0


def test_height_limits_are_about_the_ground_below_the_vehicle():
    flight = [replace(row, vehicle=replace(row.vehicle, ground_m=4.5)) for row in rows([MIDDLE] * 4)]
    assert score(flight, CAMERA, 9.0, LIMITS).violations == {"floor_m": 4}
    sunk = [replace(row, vehicle=replace(row.vehicle, ground_m=-20.0)) for row in rows([MIDDLE] * 4)]
    assert score(sunk, CAMERA, 9.0, LIMITS | {"ceiling_m": 20.0}).violations == {"ceiling_m": 4}


def test_the_first_setpoint_after_a_pause_is_no_acceleration():
    sent = [HOVER, None, Setpoint(2.0), Setpoint(2.0), Setpoint(forward_m_s=2.0, down_m_s=1.0)]
    limits = LIMITS | {"climb_accel_m_s2": 2.0}
    assert score(rows([MIDDLE] * 5, sent=sent), CAMERA, 9.0, limits).violations == {"climb_accel_m_s2": 1}


class Clockwork:
    """A clock for `sim.camera` that a vehicle's flight drives: sleeping is flying."""

    def __init__(self, link: SimLink) -> None:
        self.link = link

    def monotonic(self) -> float:
        return self.link.vehicle.motion.t_s

    def sleep(self, seconds: float) -> None:
        self.link.advance(seconds)


class TrueBoxes:
    """A tracker that knows the target's true box."""

    def __init__(self, camera: sim_camera.SceneCamera) -> None:
        self.camera, self.count = camera, -1

    def update(self, image, prior=None) -> Track:
        self.count += 1
        box = self.camera.truth(self.count).box
        return Track(box, box, psr=20.0, apce=0.0, confidence=1.0)


def test_a_live_flight_through_a_scene_is_scored_from_the_first_setpoint_to_the_last(monkeypatch):
    vehicle = Vehicle(Autopilot.PX4, VehicleTruth(t_s=9000.0, north_m=50.0, down_m=-6.0, yaw_rad=1.0))
    link = SimLink(vehicle)
    monkeypatch.setattr(sim_camera, "time", Clockwork(link))
    seen = open_scene(read(["run", "--link", "udpin:127.0.0.1:14550", "--camera", "scene:walker"]), link)
    servo, safety = Servo(seen.down_rad, seen.config.servo), Safety(seen.config.limits)
    parts = TrueBoxes(seen.camera), Target(seen.lens, seen.down_rad, seen.config.target), servo, safety
    assert seen.score() == {"scenario": "walker", "seed": 0}, "nothing flown, nothing scored"
    times_s = []
    for k, tick in enumerate(follow(seen.camera, link, *parts, once(Order.FOLLOW))):
        times_s.append(tick.state.t_s)
        assert seen.truth(tick) == (tick.track.box if tick.track else None)
        if k == 90:
            safety.order(Order.OBSERVE)
        if k == 100:
            break
    figures = seen.score()
    assert figures["in_view"] == 1.0
    assert figures["centring_rms"] < 0.3
    assert 7.0 < figures["nearest_m"] < 12.0  # from 6 m up and 9 m behind to 1.75 m
    assert figures["violations"] == {}
    assert "nearest_other_m" not in figures
    assert 0.0 <= figures["worst_t_s"] <= times_s[-1] - times_s[0], "from the first round on, as in ticks.csv"
    assert (figures["scenario"], figures["seed"]) == ("walker", 0)


MEASURED_HERE = {"fps_tracker", "tick_ms", "tracker_ms", "started_utc"}


def test_a_cluster_gives_the_same_figures_as_this_machine(monkeypatch, tmp_path, capsys):
    distributed = pytest.importorskip("distributed", reason="distributed (the extra dask) is missing")
    for name in set(SCENARIOS) - {"walker", "drops"}:
        monkeypatch.delitem(SCENARIOS, name)
    for name, scenario in list(SCENARIOS.items()):
        monkeypatch.setitem(SCENARIOS, name, replace(scenario, duration_s=0.8))
    words = ["sim", "--all", "--seeds", "1", "--autopilot", "px4", "--tracker", "racf--", "--json"]
    with distributed.LocalCluster(
        n_workers=1, threads_per_worker=2, processes=False, dashboard_address=None
    ) as cluster:
        execute([*words, "--out", str(tmp_path / "cluster"), "--dask", cluster.scheduler_address])
    there = json.loads(capsys.readouterr().out)
    here = []
    for name in SCENARIOS:
        execute(["sim", name, *words[4:], "--out", str(tmp_path / name)])
        here.append(json.loads(capsys.readouterr().out))
    assert [s["scenario"] for s in there] == list(SCENARIOS)
    for a, b in zip(there, here, strict=True):
        assert {k: v for k, v in a.items() if k not in MEASURED_HERE} == {
            k: v for k, v in b.items() if k not in MEASURED_HERE
        }
    assert (tmp_path / "cluster" / "all.txt").exists()
