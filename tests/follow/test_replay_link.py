"""The replayed vehicle and the virtual camera: they respond, and refuse setpoints, as a real autopilot does."""

import json
import math

import numpy as np
import pytest

from follow.camera.window import WindowCamera, cut
from follow.cli.program import main
from follow.cli.replay import refusals
from follow.geometry import Intrinsics
from follow.link.flight_modes import STREAM_TIMEOUT_S
from follow.link.replay import ReplayLink
from follow.messages import HOVER, Autopilot, Frame, Setpoint
from racf.box import Box
from sim.clip import write

FPS = 30.0


def fly(link: ReplayLink, setpoint: Setpoint | None, seconds: float) -> None:
    for _ in range(round(seconds * FPS)):
        link.send(setpoint)


@pytest.mark.parametrize("fps", [7.0, 10.0, 30.0, 59.94])
def test_time_is_the_number_of_rounds_over_the_rate(fps):
    link = ReplayLink(fps, 10.0)
    for n in range(200):
        state = link.state()
        assert state.t_s == n / fps == state.attitude_t_s == state.position_t_s
        link.send(HOVER)


def test_a_constant_setpoint_is_reached_in_the_heading_frame():
    link = ReplayLink(FPS, 10.0)
    fly(link, Setpoint(yaw_rate_rad_s=0.5), 4.0)
    fly(link, Setpoint(2.0, -1.0, 0.5), 8.0)
    forward, right, down = link.state().body_velocity_m_s()
    assert (forward, right, down) == pytest.approx((2.0, -1.0, 0.5), abs=1e-3)
    assert abs(link.state().yaw_rate_rad_s) < 1e-6


def test_a_yaw_step_turns_as_far_as_its_rate_less_the_lag():
    link = ReplayLink(FPS, 10.0)
    fly(link, Setpoint(yaw_rate_rad_s=0.4), 3.0)
    fly(link, HOVER, 5.0)
    assert link.state().yaw_rad == pytest.approx(0.4 * 3.0, rel=0.01)  # lag at the start comes back at the end


@pytest.mark.parametrize(
    ("bad", "rule"),
    [
        (Setpoint(100.0), "too fast"),
        (Setpoint(yaw_rate_rad_s=-10.0), "too fast"),
    ],
)
def test_a_setpoint_that_no_autopilot_takes_is_counted_and_not_flown(bad, rule):
    link = ReplayLink(FPS, 10.0)
    fly(link, bad, 1.0)
    assert link.refused[rule] == round(FPS)
    assert link.state().body_velocity_m_s() == (0.0, 0.0, 0.0)
    assert math.isfinite(link.state().yaw_rad)


@pytest.mark.parametrize("autopilot", list(Autopilot))
def test_a_stream_that_stops_is_flown_on_for_the_measured_time_and_then_stopped(autopilot):
    link = ReplayLink(FPS, 10.0, autopilot)
    fly(link, Setpoint(2.0), 5.0)
    fly(link, None, STREAM_TIMEOUT_S[autopilot] - 0.1)
    assert link.state().north_m_s == pytest.approx(2.0, abs=0.01)
    fly(link, None, 5.0)
    assert link.state().north_m_s == pytest.approx(0.0, abs=0.01)
    assert link.refused["stream timeout"] == 1


def test_a_vehicle_that_holds_its_position_still_turns_and_climbs():
    link = ReplayLink(FPS, 10.0, holds_place=True)
    fly(link, Setpoint(3.0, 1.0, -1.0, 0.3), 4.0)
    state = link.state()
    assert (state.north_m, state.east_m) == (0.0, 0.0)
    assert state.down_m < -12.0
    assert state.yaw_rad > 0.9


class Still:
    """A camera that shows the same image for ever."""

    def __init__(self, image):
        self.image = image

    def frames(self):
        n = 0
        while True:
            yield Frame(self.image, n / FPS, n)
            n += 1

    def __enter__(self):
        return self

    def __exit__(self, *error):
        return None


def test_turning_right_moves_the_window_right_and_descending_moves_it_down():
    rows, columns = np.mgrid[:200, :300]
    image = np.stack([rows, columns, columns], axis=2).astype(np.uint8)
    link = ReplayLink(FPS, 10.0, holds_place=True)
    lens = Intrinsics.from_fov(300, 200, math.radians(60))
    with WindowCamera(Still(image), link.state, lens, (60, 40), (150, 100), range_m=20.0) as camera:
        frames = camera.frames()
        first = next(frames)
        assert first is not None
        assert first.image.shape == (40, 60, 3)
        assert tuple(first.image[0, 0, :2]) == (80, 120)
        fly(link, Setpoint(down_m_s=0.5, yaw_rate_rad_s=0.1), 2.0)
        state = link.state()
        second = next(frames)
        assert second is not None
        dx, dy = int(camera.window.x) - 120, int(camera.window.y) - 80
        assert dx == round(lens.fx * state.yaw_rad) > 0
        assert dy == round(lens.fy * (state.down_m + 10.0) / 20.0) > 0
        assert np.array_equal(second.image, image[80 + dy : 120 + dy, 120 + dx : 180 + dx])


def test_a_window_beyond_the_footage_repeats_its_edge():
    image = np.arange(12, dtype=np.uint8).reshape(3, 4)
    assert cut(image, Box(-2, -1, 3, 3)).tolist() == [[0, 0, 0], [0, 0, 0], [4, 4, 4]]
    assert cut(image, Box(100, 100, 2, 2)).tolist() == [[11, 11], [11, 11]]


@pytest.mark.parametrize(
    ("refused", "followed", "said"),
    [
        ((0, 0), True, []),
        ((0, 1), False, []),
        ((0, 1), True, ["no setpoint came for longer than the autopilot waits: the pretended vehicle hovered"]),
        ((3, 0), True, ["the pretended vehicle refused 3 of the setpoints, because they were faster"]),
    ],
)
def test_what_the_vehicle_did_not_fly_is_told_in_sentences_without_what_did_not_occur(refused, followed, said):
    lines = list(refusals(dict(zip(("too fast", "stream timeout"), refused, strict=True)), followed))
    assert len(lines) == len(said)
    assert all(line.startswith(start) for line, start in zip(lines, said, strict=True))


@pytest.mark.parametrize("still", [False, True])
def test_a_target_that_left_the_window_is_told_with_the_fraction_and_the_time(capfd, tmp_path, still):
    truth = write(tmp_path / "clip.mp4", 110)
    gains = ("--servo.yaw.kp", "0", "--servo.climb.kp", "0", "--servo.feed-forward", "0") if still else ()
    words = ("replay", tmp_path / "clip.mp4", "--truth", truth, "--ptz", "--out", tmp_path, "--json", *gains)
    assert main([*map(str, words), "--record.no-pictures"]) == 0
    out, err = capfd.readouterr()
    outside = 100 * (1 - json.loads(out)["in_view"])
    said = f"the target left the window: outside in {outside:.0f} % of the annotated frames, first at "
    assert (outside > 20) == still
    assert err.count(said) == (outside > 0)
