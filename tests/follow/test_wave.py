"""`follow doctor --wave`: mount, lens and delay of a camera that is turned by hand, against the drawn values."""

import math
import re
import sys
from dataclasses import replace

import numpy as np
import pytest

from follow.cli.commands import DoctorCommand
from follow.cli.doctor import diagnose
from follow.cli.layers import read
from follow.cli.program import main
from follow.cli.wave import unsafe
from follow.config import CameraConfig
from follow.flight.finding import Health, NotFitError
from follow.flight.wave import Measured, Mounting, Waved, WaveError, gather, measure, mount_matrix
from follow.flight.wave_findings import Believed, judge
from follow.geometry import camera_to_body
from follow.messages import Frame, Landed, VehicleState
from tests.support.real_flight import free_ports, program
from tools.studies.wave import BELIEVED, CASES, Case, measured, stamped, waved_frames

SECONDS = 9.0  # half of what a person is told to wave: each second costs half a second here
HARD = [
    Case("mount 29 for 43"),
    Case("lens 130 for 80", fov_deg=130.0),
    Case("upside down, 200 ms", upside_down=True, delay_s=0.2),
    Case("400 ms", delay_s=0.4),
]
SOUND = Mounting(
    down_deg=Measured(30.0, 0.2),
    roll_deg=Measured(0.5, 0.2),
    yaw_deg=Measured(-0.5, 0.3),
    fov_deg=Measured(70.5, 0.5),
    focal_ratio=Measured(0.99, 0.01),
    delay_s=Measured(0.101, 0.002),
    explained=0.98,
    turn_rad_s=0.7,
    intervals=150,
)
SETTINGS = Believed(down_deg=30.0, fov_deg=70.0, delay_s=0.1)


@pytest.mark.parametrize("case", HARD, ids=lambda case: case.name)
def test_waving_measures_mount_lens_and_delay_whatever_the_settings(case):
    """The settings are 80 degrees and no delay; the search does not use the mount."""
    found = measured(case, SECONDS)
    assert found.down_deg.value == pytest.approx(case.down_deg, abs=1.0)
    assert abs(math.remainder(found.roll_deg.value - (180.0 if case.upside_down else 0.0), 360.0)) < 1.0
    assert found.yaw_deg.value == pytest.approx(0.0, abs=1.0)
    assert found.fov_deg.value == pytest.approx(case.fov_deg, rel=0.03)
    assert found.delay_s.value == pytest.approx(case.delay_s, abs=0.015)
    assert found.down_deg.std < 1.0
    assert found.delay_s.std < 0.015


def test_a_vehicle_that_hardly_moves_gives_no_result_and_a_reason():
    with pytest.raises(WaveError, match=r"too little motion to tell anything: \d.\d degrees/s"):
        measured(next(case for case in CASES if case.name == "hardly moved"), SECONDS)


def test_a_frozen_image_of_a_moving_vehicle_gives_no_mount():
    camera, link = waved_frames(Case("frozen"), SECONDS)
    frames = stamped(camera, link, upside_down=False)
    first = next(frame for frame in frames if frame is not None)
    random = np.random.default_rng(0)

    def frozen():
        for frame in frames:
            noise = random.normal(0, 2, first.image.shape)
            yield frame and replace(first, image=np.clip(first.image + noise, 0, 255).astype(np.uint8), t_s=frame.t_s)

    found = judge(measure(gather(frozen(), link.state, SECONDS), BELIEVED), SETTINGS)
    assert [(finding.name, finding.verdict) for finding in found] == [("wave", Health.RED)]


def test_without_attitude_or_structure_in_the_image_there_is_a_reason():
    with pytest.raises(WaveError, match="only 0 attitudes"):
        measure(Waved(), BELIEVED)
    states = (VehicleState(t_s=t, attitude_t_s=t, yaw_rad=math.sin(t)) for t in np.arange(0.0, 9.0, 0.02))
    latest = VehicleState(t_s=0.0)

    def state() -> VehicleState:
        nonlocal latest
        latest = next(states, latest)
        return latest

    blank = np.full((180, 320, 3), 128, np.uint8)
    waved = gather((Frame(blank, n / 50, n) for n in range(450)), state, 8.0)
    with pytest.raises(WaveError, match="background was tracked in 0 intervals"):
        measure(waved, BELIEVED)


def test_the_mounts_angles_are_the_settings():
    np.testing.assert_allclose(mount_matrix(0.0, 0.5, 0.0), camera_to_body(0.5), atol=1e-12)
    axis = mount_matrix(0.3, 0.5, 1.0)[:, 2]
    assert math.asin(axis[2]) == pytest.approx(0.5)
    assert math.atan2(axis[1], axis[0]) == pytest.approx(0.3)
    upside_down = mount_matrix(0.0, 0.5, math.pi)
    np.testing.assert_allclose(upside_down[:, :2], -camera_to_body(0.5)[:, :2], atol=1e-12)


def test_what_agrees_with_the_settings_is_ok():
    assert {finding.verdict for finding in judge(SOUND, SETTINGS)} == {Health.OK}


@pytest.mark.parametrize(
    ("change", "name", "line"),
    [
        ({"down_deg": Measured(43.21, 0.3)}, "mount", "--camera.down-deg 43.2, .*: down_deg = 43.2"),
        ({"down_deg": Measured(-30.0, 0.3)}, "mount", "--camera.down-deg -30.0, .*: down_deg = -30.0"),
        (
            {"fov_deg": Measured(130.0, 1.0), "focal_ratio": Measured(0.33, 0.003)},
            "view",
            "--camera.fov-deg 130.0, .*: fov_deg = 130.0",
        ),
        ({"delay_s": Measured(0.3, 0.004)}, "delay", "--camera.delay-s 0.300, .*: delay_s = 0.300"),
        ({"delay_s": Measured(-0.05, 0.004)}, "delay", "time stamps"),
        ({"roll_deg": Measured(179.0, 0.4)}, "mount-roll", "rotate its image by 180 degrees"),
        ({"roll_deg": Measured(-91.0, 0.4)}, "mount-roll", "upright"),
        ({"yaw_deg": Measured(12.0, 0.4)}, "mount-yaw", "along the nose"),
    ],
)
def test_a_difference_from_the_settings_is_red_with_the_line_that_corrects_it(change, name, line):
    red = [finding for finding in judge(replace(SOUND, **change), SETTINGS) if finding.verdict is Health.RED]
    assert [finding.name for finding in red] == [name]
    assert re.search(line, red[0].fix)


@pytest.mark.parametrize(
    ("change", "name"),
    [
        ({"down_deg": Measured(43.0, 1.5)}, "mount"),
        ({"roll_deg": Measured(179.0, 2.0)}, "mount-roll"),
        ({"yaw_deg": Measured(12.0, 5.0)}, "mount-yaw"),
        ({"focal_ratio": Measured(0.5, 0.04)}, "view"),
        ({"delay_s": Measured(0.3, 0.05)}, "delay"),
    ],
)
def test_a_measurement_that_is_too_uncertain_is_not_judged(change, name):
    unclear = [f for f in judge(replace(SOUND, **change), SETTINGS) if f.verdict is not Health.OK]
    assert [(f.name, f.verdict) for f in unclear] == [(name, Health.WARN)]
    assert "too little motion to tell" in unclear[0].text


def test_a_calibration_of_another_lens_is_named():
    change = replace(SOUND, focal_ratio=Measured(0.7, 0.01))
    (view,) = [f for f in judge(change, replace(SETTINGS, calibration="cam.yaml")) if f.verdict is Health.RED]
    assert view.fix.startswith("cam.yaml is of another lens")


def test_an_armed_vehicle_is_not_waved():
    state = VehicleState(t_s=1.0, armed=True, landed_t_s=1.0, landed=Landed.ON_GROUND)
    refusal = unsafe(state)
    assert refusal is not None
    assert refusal.verdict is Health.RED
    assert unsafe(replace(state, armed=False)) is None
    assert unsafe(replace(state, landed=Landed.IN_AIR)) is None  # turned gently in a hover


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--wave", "20", "--link", "udpin:127.0.0.1:1"], "give --camera SOURCE and --link"),
        (["--wave", "2", "--link", "udpin:127.0.0.1:1", "--camera", "0"], "8..120 s, not 2"),
    ],
)
def test_wrong_use_is_refused(words, said, capsys):
    assert main(["doctor", *words]) == 2
    assert said in capsys.readouterr().err


@pytest.mark.realtime
def test_the_doctor_finds_a_wrong_mount_lens_and_delay_of_a_waved_autopilot(tmp_path, capsys):
    (port,) = free_ports(1)
    words = ["doctor", "--wave", "14", "--camera", "scene:walker", "--link", f"udpin:127.0.0.1:{port}"]
    words += ["--camera.down-deg", "43", "--camera.fov-deg", "80", "--out", str(tmp_path)]
    command = read(words)
    assert isinstance(command, DoctorCommand)
    drawn = CameraConfig(fov_deg=120.0, down_deg=29.0, delay_s=0.2)
    autopilot = [sys.executable, "-m", "sim.autopilot", "--wave", "--link", f"udpout:127.0.0.1:{port}"]
    with program(autopilot), pytest.raises(NotFitError, match="mount, view, delay"):
        diagnose(command, drawn)
    said = capsys.readouterr().err
    number = r"(-?[\d.]+)"
    assert float(re.search(rf"--camera.down-deg {number},", said)[1]) == pytest.approx(29.0, abs=1.0)
    assert float(re.search(rf"--camera.fov-deg {number},", said)[1]) == pytest.approx(120.0, rel=0.03)
    assert float(re.search(rf"--camera.delay-s {number},", said)[1]) == pytest.approx(0.2, abs=0.015)
