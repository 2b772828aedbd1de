"""A drawn scene's settings are recorded as comments and not as choices: a real camera and target have others."""

import pytest

from follow.cli.layers import from_scene, read, settings_of, without_scene
from follow.cli.run import unused_line
from follow.cli.settings import as_toml, read_settings, scene_values
from follow.config import Config, resolve
from follow.messages import Autopilot
from sim.scenarios import SCENARIOS

CAR = SCENARIOS["car"]


def recorded(tmp_path, *words: str):
    """The file that a flight with these words leaves, and the names in it that are the scene's."""
    config = settings_of(words, "car")
    scene = from_scene("car", config, without_scene(words))
    path = tmp_path / "settings.toml"
    mount = CAR.camera_settings(Autopilot.PX4)
    path.write_text(as_toml(config, resolve(config, mount.intrinsics, mount.down_rad, mount.latency_s), scene))
    return path, scene


def test_settings_of_the_user_are_kept_and_those_of_the_scene_are_not(tmp_path):
    path, scene = recorded(tmp_path, "sim", "car", "--limits.accel-m-s2", "3", "--servo.standoff-m", "30")
    kept = read_settings(path)
    assert (kept.limits.accel_m_s2, kept.servo.standoff_m) == (3.0, 30.0)
    assert kept.camera.fov_deg == Config().camera.fov_deg
    assert kept.limits.speed_m_s == Config().limits.speed_m_s
    assert "servo.standoff_m" not in scene
    assert scene_values(path)["target.size_m"] == CAR.size_m


def test_a_choice_that_equals_the_scenes_is_a_choice(tmp_path):
    path, scene = recorded(tmp_path, "sim", "car", "--servo.standoff-m", str(CAR.standoff_m))
    assert "servo.standoff_m" not in scene
    assert read_settings(path).servo.standoff_m == CAR.standoff_m


def test_a_file_and_a_kind_of_target_are_choices(tmp_path):
    given = tmp_path / "given.toml"
    given.write_text("[camera]\nfov_deg = 55.0\n")
    path, scene = recorded(tmp_path, "sim", "car", "--settings", str(given), "--for", "cyclist")
    assert not {"camera.fov_deg", "target.size_m", "servo.standoff_m"} & scene
    assert read_settings(path).camera.fov_deg == 55.0


def test_the_same_scene_flies_the_same_again_from_its_file(tmp_path):
    path, _ = recorded(tmp_path, "sim", "car", "--limits.accel-m-s2", "3")
    again = ("sim", "car", "--settings", str(path))
    assert settings_of(again, "car") == settings_of(("sim", "car", "--limits.accel-m-s2", "3"), "car")


def test_a_real_camera_is_told_what_is_not_used(tmp_path):
    path, _ = recorded(tmp_path, "sim", "car")
    words = ("run", "--link", "udpin:127.0.0.1:14540", "--settings", str(path), "--target", "1,2,30,40")
    line = unused_line(read((*words, "--camera", "0")))
    assert f"servo.standoff_m {CAR.standoff_m:g}" in line
    assert "camera.fov_deg" in line
    assert "half_view_rad" not in line  # it follows from every camera
    assert unused_line(read((*words, "--camera", "scene:car"))) == ""
    chosen = tmp_path / "chosen.toml"
    chosen.write_text(as_toml(Config()))
    assert unused_line(read((*words, "--camera", "0", "--settings", str(chosen)))) == ""


@pytest.mark.parametrize("text", ["derived = 3\n", "[derived]\ncamera = 3\n", "[derived.nothing]\na = 1\n", ""])
def test_a_derived_table_of_any_form_is_passed_over(tmp_path, text):
    path = tmp_path / "odd.toml"
    path.write_text(text)
    assert scene_values(path) == {}
