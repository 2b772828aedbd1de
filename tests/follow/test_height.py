"""The height that follows from stand-off and camera angle is reported before a flight; a wrong angle is warned of."""

import math
from dataclasses import replace

import pytest

from follow.cli.height import height_conflict, height_line, height_report
from follow.cli.program import main
from follow.config import CameraConfig, Config
from follow.control.servo import ServoConfig, ServoMode
from follow.messages import Autopilot
from follow.safety.limits import Limits
from sim.scenarios import SCENARIOS


def config_of(down_deg: float, standoff_m: float = 12.0) -> Config:
    return Config(CameraConfig(down_deg=down_deg), servo=ServoConfig(standoff_m=standoff_m))


@pytest.mark.parametrize(("down_deg", "standoff_m", "height_m"), [(30.0, 12.0, 7), (45.0, 20.0, 20), (27.5, 22.0, 11)])
def test_the_height_that_follows_from_stand_off_and_angle_is_reported(down_deg, standoff_m, height_m):
    config = config_of(down_deg, standoff_m)
    why = f"{standoff_m:g} m away with the camera {down_deg:g} degrees below the nose"
    assert height_report(config) == height_line(config)
    assert height_line(config) == f"will fly about {height_m} m above a target that stands: {why}"
    assert height_report(replace(config, servo=ServoConfig(mode=ServoMode.SPOTLIGHT))) == ""


@pytest.mark.parametrize("down_deg", [math.radians(30), 5.0, -20.0])
def test_an_angle_that_leads_below_the_floor_is_named_with_its_value_and_unit(down_deg):
    said = height_report(config_of(down_deg))
    assert said.startswith(f"warning: camera.down_deg {down_deg:.3g} (in degrees) and servo.standoff_m 12 mean ")
    assert "below limits.floor_m 2" in said


def test_there_is_a_conflict_outside_the_altitude_band_and_nowhere_else():
    for down_deg in range(84):
        height_m = 12.0 * math.tan(math.radians(down_deg))
        inside = Limits().floor_m <= height_m <= Limits().ceiling_m
        assert bool(height_conflict(config_of(down_deg))) is not inside


@pytest.mark.parametrize("name", SCENARIOS)
def test_no_scenario_contradicts_its_own_limits(name):
    scenario = SCENARIOS[name]
    for autopilot in Autopilot:
        config = config_of(math.degrees(scenario.down_rad(autopilot)), scenario.standoff_m)
        assert height_conflict(replace(config, limits=Limits(**scenario.limits))) == ""


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ((), "will fly about 5 m above a target that stands: 9 m away with the camera "),
        (("--camera.down-deg", "0.5"), "warning: camera.down_deg 0.5 (in degrees) and servo.standoff_m 9 mean 0.1 m "),
    ],
)
def test_a_simulated_flight_reports_its_height_or_warns_of_the_angle(capfd, tmp_path, monkeypatch, words, said):
    monkeypatch.setitem(SCENARIOS, "brief", replace(SCENARIOS["walker"], name="brief", duration_s=0.5))
    assert main(["sim", "brief", "--record.no-pictures", "--out", str(tmp_path / "out"), *words]) == 0
    assert said in capfd.readouterr().err
