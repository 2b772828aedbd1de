"""The loop closed over the scenarios' worlds and vehicles, with a tracker that knows the truth, with some noise.

Nothing is drawn: only servo, target estimate and gate are tested.
"""

import math
from collections import deque
from dataclasses import replace
from functools import lru_cache
from itertools import pairwise

import numpy as np
import pytest

from follow.control.pid import Gains
from follow.control.servo import Servo, ServoConfig
from follow.control.target import Target, TargetConfig
from follow.geometry import camera_to_ned, project
from follow.loop import follow
from follow.messages import Autopilot, Frame, Order
from follow.safety.gate import Limits, Safety
from racf.box import Box
from racf.track import Track
from sim.scenarios import MIDDLE_M, SCENARIOS, build

DRAWN = np.zeros((1, 1), np.uint8)


class KnownScene:
    """Camera and tracker in one: the true box, with noise of 1.5 pixels and 5 % of size, late and hidden as told."""

    def __init__(self, scenario, seed, autopilot, hidden_s):
        self.scenario, self.hidden_s = scenario, hidden_s
        _, self.link, self.world = build(scenario, seed, autopilot)
        settings = scenario.camera_settings(autopilot)
        self.lens, self.down_rad = settings.intrinsics, settings.down_rad
        self.noise = np.random.default_rng([seed, 9])
        self.rows = []
        self.track = None

    def look(self, motion):
        """The track of a frame taken now, and a row of what is true of it."""
        place, middle = self.world.target(motion.t_s), MIDDLE_M[self.scenario.kind]
        rotation = camera_to_ned(self.down_rad, motion.roll_rad, motion.pitch_rad, motion.yaw_rad)
        lens_ned = np.array([motion.north_m, motion.east_m, motion.down_m])
        point = np.array([[place.north_m, place.east_m, -middle]])
        pixels, depth = project(self.lens, rotation, lens_ned, point)
        x, y = pixels[0]
        inside = bool(depth[0] > 0 and 0 <= x < self.lens.width and 0 <= y < self.lens.height)
        away = math.hypot(place.north_m - motion.north_m, place.east_m - motion.east_m)
        half = self.lens.width / 2
        self.rows.append((inside, (x - half) / half, (y - self.lens.height / 2) / half, away))
        scale = self.lens.fx / float(np.linalg.norm(point - lens_ned)) * math.exp(self.noise.normal(0, 0.05))
        dx, dy = self.noise.normal(0, 1.5, 2)
        found = inside and not self.hidden_s[0] <= motion.t_s < self.hidden_s[1]
        width = self.scenario.size_m**2 / (2 * middle)
        box = Box.around(x + dx, y + dy, width * scale, 2 * middle * scale) if found else Box(300, 160, 20, 40)
        return Track(box, box, psr=20.0, apce=50.0, confidence=0.9, found=found)

    def frames(self):
        s = self.scenario
        waiting, motion = deque(), self.link.advance(0.0)
        while motion.t_s <= s.duration_s:
            waiting.append((motion.t_s, self.look(motion)))
            if motion.t_s - waiting[0][0] >= s.latency_s - 1e-6:
                t_s, self.track = waiting.popleft()
                yield Frame(DRAWN, t_s, len(self.rows))
            else:
                yield None
            motion = self.link.advance(1 / s.frames_per_s)

    def update(self, image, prior=None):
        return self.track


@lru_cache
def flown(name, autopilot=Autopilot.PX4, servo=None, compensate=True, hidden_s=(math.inf, math.inf), seed=0):
    """Ticks and (share in view, RMS of centring, relative RMS of stand-off) of one flight."""
    scenario = SCENARIOS[name]
    scene = KnownScene(scenario, seed, autopilot, hidden_s)
    target = Target(scene.lens, scene.down_rad, TargetConfig(size_m=scenario.size_m, compensate=compensate))
    config = replace(servo or ServoConfig(), standoff_m=scenario.standoff_m)
    seen = {"latency_s": scenario.latency_s, "half_view_rad": scenario.fov_rad / 2}
    safety = Safety(Limits(**{**seen, **scenario.limits}))
    safety.order(Order.FOLLOW)
    ticks = list(follow(scene, scene.link, scene, target, Servo(scene.down_rad, config), safety))
    inside, x, y, away = np.array(scene.rows, float).T
    standoff = np.sqrt(np.mean((away / scenario.standoff_m - 1) ** 2))
    return ticks, (inside.mean(), np.sqrt(np.nanmean(x**2 + y**2)), standoff)


def good(figures, centred=0.08):
    in_view, centring, standoff = figures
    return in_view >= 0.99 and centring <= centred and standoff <= 0.15


@pytest.mark.parametrize("autopilot", Autopilot)
@pytest.mark.parametrize("name", ["walker", "runner", "cyclist", "car"])
def test_the_target_stays_centred_and_at_its_distance(name, autopilot):
    _, figures = flown(name, autopilot)
    # ArduCopter leans 41 degrees at the car's 15 m/s; a camera for that would see no target while it hovers.
    leans = (name, autopilot) == ("car", Autopilot.ARDUPILOT)
    assert good(figures, 0.15 if leans else 0.08), figures


@pytest.mark.parametrize("name", ["runner-start", "runner-uturn", "cyclist-uturn", "wind"])
def test_a_target_that_starts_turns_back_or_has_wind_stays_in_view(name):
    _, (in_view, _, standoff) = flown(name)
    assert in_view >= 0.99
    assert standoff <= 0.2


NOTHING = Gains(kp=0.0)
WRONG = {
    "zero gains": ServoConfig(yaw=NOTHING, climb=NOTHING, approach=NOTHING, feed_forward=0.0),
    "yaw to the wrong side": ServoConfig(yaw=Gains(kp=-3.0, limit=1.5), feed_forward=0.0),
    "approach backwards": ServoConfig(approach=Gains(kp=-0.35, limit=6.0), feed_forward=0.0),
}


@pytest.mark.parametrize("name", WRONG)
def test_a_servo_that_does_nothing_or_has_a_wrong_sign_fails_these_tests(name):
    _, figures = flown("walker", servo=WRONG[name])
    assert not good(figures), figures


def test_with_compensation_images_400_ms_old_cost_little_and_without_they_cost_much():
    _, (in_view, compensated, _) = flown("cyclist-latency-400")
    _, (_, uncompensated, _) = flown("cyclist-latency-400", compensate=False)
    assert in_view >= 0.98
    assert uncompensated > 1.5 * compensated


@pytest.mark.parametrize(("seconds", "seen_modes"), [(3.0, {"follow", "coast"}), (6.0, {"follow", "coast", "search"})])
def test_a_walker_hidden_for_a_while_is_followed_again(seconds, seen_modes):
    ticks, (in_view, *_) = flown("walker", hidden_s=(12.0, 12.0 + seconds))
    assert {tick.decision.mode for tick in ticks} == seen_modes
    assert ticks[-1].decision.mode == "follow"
    assert in_view >= 0.97  # unseen, the vehicle brakes to stand before the last sighting: the walker gets ahead


def test_what_is_sent_ramps_within_the_limits():
    """The reference is plain differences of the setpoints, turned into NED with the heading that the gate used."""
    ticks, _ = flown("runner-start")
    limits = Limits()
    sent = [(t.state.t_s, t.state.yaw_rad, t.decision.setpoint) for t in ticks if t.decision.setpoint]
    ned = [(t, complex(s.forward_m_s, s.right_m_s) * np.exp(1j * yaw), s) for t, yaw, s in sent]
    for (t0, v0, s0), (t1, v1, s1) in pairwise(ned):
        assert abs(v1 - v0) <= limits.accel_m_s2 * (t1 - t0) + 1e-6
        assert abs(s1.down_m_s - s0.down_m_s) <= limits.climb_accel_m_s2 * (t1 - t0) + 1e-6
        assert abs(s1.yaw_rate_rad_s - s0.yaw_rate_rad_s) <= limits.yaw_accel_rad_s2 * (t1 - t0) + 1e-6
