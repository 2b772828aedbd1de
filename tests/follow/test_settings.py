"""Settings in a file: the same tree as the command line's, below it; whatever is wrong with a file is one line."""

import re
from dataclasses import fields, is_dataclass, replace
from pathlib import Path

import pytest

from follow.cli.commands import MARKERS, RunCommand, commands
from follow.cli.program import main
from follow.cli.run import scene_eye
from follow.cli.settings import as_toml, read_settings, settings_of, tomllib
from follow.config import Config
from follow.control.pid import Gains
from follow.control.servo import ServoConfig, ServoMode
from follow.messages import Autopilot
from follow.safety.limits import Limits
from racf.commandline import UsageError, parse
from sim.dynamics import Vehicle, VehicleTruth
from sim.link import SimLink
from sim.scenarios import SCENARIOS

EXAMPLE = Path(__file__).parents[2] / "docs" / "service" / "settings.toml"


def file_of(folder: Path, text: str | bytes) -> Path:
    path = folder / "mine.toml"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


def names(branch: object, prefix: str = "") -> set[str]:
    """Every setting below a branch, by its path."""
    found = set[str]()
    for f in fields(branch):
        value = getattr(branch, f.name)
        found |= names(value, f"{prefix}{f.name}.") if is_dataclass(value) else {prefix + f.name}
    return found


def keys(table: dict[str, object], prefix: str = "") -> set[str]:
    found = set[str]()
    for key, value in table.items():
        found |= keys(value, f"{prefix}{key}.") if isinstance(value, dict) else {prefix + key}
    return found


def test_the_example_has_every_setting_at_its_default():
    assert read_settings(EXAMPLE) == Config()
    assert keys(tomllib.loads(EXAMPLE.read_text())) == names(Config())


def test_the_example_explains_every_setting_but_a_gain():
    bare = [line for line in EXAMPLE.read_text().splitlines() if "=" in line and "#" not in line]
    assert set(bare) <= {"kd = 0.0"}


def test_a_file_sets_what_it_names_and_nothing_else(tmp_path):
    text = '[limits]\nspeed_m_s = 3\n[servo]\nmode = "orbit"\n[servo.yaw]\nkp = 2.0\n[record]\npictures = false\n'
    read = read_settings(file_of(tmp_path, text))
    assert read.limits == Limits(speed_m_s=3.0)
    assert isinstance(read.limits.speed_m_s, float)
    assert read.servo == ServoConfig(mode=ServoMode.ORBIT, yaw=replace(ServoConfig().yaw, kp=2.0))
    assert not read.record.pictures
    assert (read.camera, read.target) == (Config().camera, Config().target)


def test_what_is_written_is_read_again(tmp_path):
    odd = Config(
        limits=Limits(speed_m_s=1 / 3, fence_m=1e22),
        servo=ServoConfig(mode=ServoMode.TOP_DOWN, orbit_m_s=-2.5, climb=Gains(kp=1e-7)),
    )
    for config in (Config(), odd):
        assert read_settings(file_of(tmp_path, as_toml(config))) == config


def test_the_command_line_stands_above_the_file(tmp_path):
    path = file_of(tmp_path, "[limits]\nspeed_m_s = 3.0\nfloor_m = 150.0\nceiling_m = 200.0\n")
    for option in (["--settings", str(path)], [f"--settings={path}"]):
        words = ["run", "--link", "udpin:0.0.0.0:1", *option, "--limits.floor-m", "120"]
        command = parse(commands(settings_of(words)), words, prog="follow", description="", config=MARKERS)
        assert isinstance(command, RunCommand)
        assert command.config.limits == Limits(speed_m_s=3.0, floor_m=120.0, ceiling_m=200.0)
        assert command.settings == path


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[limit]\nspeed_m_s = 1.0", "no setting 'limit'; there are camera, target, servo, limits, record"),
        ("[limits]\nspeed = 1.0", "no setting 'limits.speed'; there are speed_m_s, coast_m_s"),
        ("[servo.yaw]\nkq = 1.0", "no setting 'servo.yaw.kq'; there are kp, ki"),
        ("limits = 3", "limits must be a table, not 3"),
        ("[[limits]]\nspeed_m_s = 1.0", "limits must be a table, not ["),
        ("[limits]\nspeed_m_s = '3'", "limits.speed_m_s must be a number, not '3'"),
        ("[limits]\nspeed_m_s = true", "limits.speed_m_s must be a number, not True"),
        ("[limits]\nspeed_m_s = 1" + 400 * "0", "limits.speed_m_s must be a number below 1e308"),
        ("[limits]\nspeed_m_s = -1.0", "limit speed_m_s must be a positive number, not -1"),
        ("[limits]\nspeed_m_s = nan", "limit speed_m_s must be a positive number, not nan"),
        ("[limits]\nfloor_m = 200.0", "the floor 200 m must lie below the ceiling 100 m"),
        ("[camera]\nfov_deg = 200", "1..170 degrees, not 200"),
        ("[camera]\ndelay_s = 2", "0..1 s, not 2"),
        ("[servo]\nmode = 'hover'", "servo.mode must be one of 'chase', 'centre'"),
        ("[servo]\nstandoff_m = 0", "servo setting standoff_m must be a positive number, not 0"),
        ("[servo]\nfeed_forward = -1", "feed_forward must be zero or a positive number, not -1"),
        ("[servo]\norbit_m_s = inf", "orbit_m_s must be a finite number, not inf"),
        ("[servo.climb]\nki = inf", "a PID's gains are finite"),
        ("[target]\nsize_m = 0.0", "target setting size_m must be a positive number, not 0"),
        ("[target]\nconfirm = 2.5", "target.confirm must be a whole number, not 2.5"),
        ("[record]\npictures = 1", "record.pictures must be true or false, not 1"),
        ("[record]\njpeg_quality = 101", "jpeg_quality must lie in 1..100, not 101"),
        ("[limits]\nspeed_m_s = 1979-05-27", "limits.speed_m_s must be a number, not datetime.date"),
        ("speed_m_s 3", "must be TOML: Expected '=' after a key"),
        (b"[limits]\n# \xff", "must be UTF-8, not byte 0xff at 11"),
        (b"a = " + 5000 * b"[", "must be TOML"),
    ],
)
def test_a_wrong_file_is_one_line_with_thing_rule_and_value(tmp_path, capfd, text, said):
    path = file_of(tmp_path, text)
    assert main(["sim", "walker", "--settings", str(path), "--out", str(tmp_path / "out")]) == 2
    out, err = capfd.readouterr()
    assert out == ""
    assert err.startswith(f"follow: error: settings '{path}'")
    assert said in err
    assert err.count("\n") == 1
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(("name", "said"), [("none.toml", "No such file"), (".", "must be a file"), ("", "must be")])
def test_a_file_that_is_none_is_one_line(tmp_path, monkeypatch, name, said):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(UsageError, match=said) as refusal:
        read_settings(Path(name))
    assert "\n" not in str(refusal.value)


def test_the_option_without_a_file_is_wrong_use(capfd):
    assert main(["sim", "--settings"]) == 2
    assert re.fullmatch(r"follow: error: .*--settings.*\n", capfd.readouterr().err)


def test_a_command_without_settings_refuses_the_option(capfd):
    assert main(["doctor", "--settings", str(EXAMPLE)]) == 2
    assert "--settings" in capfd.readouterr().err


def test_a_live_scene_is_flown_with_what_its_scenario_suggests_beneath_what_a_person_chose():
    scenario = SCENARIOS["runner"]
    chosen = Config(limits=Limits(fence_m=80.0))
    command = RunCommand("udpin:0.0.0.0:1", camera="scene:runner", config=chosen)
    with SimLink(Vehicle(Autopilot.PX4, VehicleTruth(down_m=-8.0))) as link:
        seen = scene_eye(command, link)
    assert seen.config.servo.standoff_m == scenario.standoff_m != ServoConfig().standoff_m
    assert seen.config.target.size_m == scenario.size_m != Config().target.size_m
    assert seen.config.limits.half_view_rad == pytest.approx(scenario.fov_rad / 2)
    wanted = replace(chosen.limits, speed_m_s=scenario.limits["speed_m_s"])
    assert replace(seen.config.limits, half_view_rad=wanted.half_view_rad) == wanted
