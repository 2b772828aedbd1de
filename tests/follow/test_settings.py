"""Settings in a file: the same tree as the command line's, below it; whatever is wrong with a file is one line."""

import csv
import functools
import math
import re
from dataclasses import fields, is_dataclass, replace
from pathlib import Path
from typing import get_type_hints

import numpy as np
import pytest

from follow.cli import described
from follow.cli import run as cli_run
from follow.cli.commands import RunCommand
from follow.cli.layers import NAMES, read
from follow.cli.program import main
from follow.cli.run import open_camera, open_scene
from follow.cli.settings import as_toml, read_settings, tomllib
from follow.cli.sim import FlightSpec, simulate
from follow.config import PRESETS, CameraConfig, Config, TargetKind, resolve
from follow.control.pid import Gains
from follow.control.servo import ServoConfig, ServoMode
from follow.control.target import TargetConfig
from follow.messages import Autopilot
from follow.operator.terminal import Terminal
from follow.recording.recorder import RecordConfig
from follow.safety.limits import LEAST, MOST, Limits
from racf.commandline import UsageError
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


def value_of(config: Config, name: str) -> object:
    return functools.reduce(getattr, name.split("."), config)


def keys(table: dict[str, object], prefix: str = "") -> set[str]:
    found = set[str]()
    for key, value in table.items():
        found |= keys(value, f"{prefix}{key}.") if isinstance(value, dict) else {prefix + key}
    return found


DERIVED = {name for name in names(Config()) if value_of(Config(), name) is None}
BELOW = {f"{branch}.{name}" for layer in PRESETS.values() for branch, held in layer.items() for name in held}


def test_the_example_has_every_setting_at_its_default():
    """Those that follow from something else are there as comments, so that a file installed whole does not pin them."""
    text = EXAMPLE.read_text()
    assert read_settings(EXAMPLE) == Config()
    assert keys(tomllib.loads(text)) == names(Config()) - DERIVED - BELOW
    whole = tomllib.loads(re.sub(r"(?m)^#(\w+ = )", r"\1", text))
    assert keys(whole) == names(Config())


KINDS = (*NAMES.values(), CameraConfig, TargetConfig, ServoConfig, Gains, Limits, RecordConfig)


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.__name__)
def test_every_option_is_explained_by_whole_sentences(kind):
    for name, said in described.sentences(kind).items():
        if not is_dataclass(get_type_hints(kind)[name]):
            assert re.fullmatch(r"[A-Z].*[.)]", said), f"{name}: {said!r}"
            assert "..." not in said, name


@pytest.mark.parametrize("option", ["--help", "--help-all"])
@pytest.mark.parametrize("command", ["", *NAMES])
def test_help_fits_a_terminal_of_eighty_columns_and_shows_no_none(command, option, capfd, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    with pytest.raises(SystemExit) as left:
        main([*command.split(), option])
    text = capfd.readouterr().out
    assert not left.value.code
    assert max(map(len, text.splitlines())) <= 80
    assert "None" not in text
    assert "Raises" not in text


def test_the_help_is_short_and_says_how_to_see_the_settings(capfd, monkeypatch):
    monkeypatch.setenv("COLUMNS", "100")
    for name, kind in NAMES.items():
        shown: dict[str, str] = {}
        for option in ("--help", "--help-all"):
            with pytest.raises(SystemExit):
                main([name, option])
            shown[option] = capfd.readouterr().out
        assert len(shown["--help"].splitlines()) < 100
        if "config" in {f.name for f in fields(kind)}:
            assert f"follow {name} --help-all lists also the settings" in shown["--help"]
            assert "--limits.fence-m" not in shown["--help"]
            assert "--limits.fence-m" in shown["--help-all"]


def test_the_help_shows_a_default_with_its_unit_and_what_the_file_gives(capfd, tmp_path, monkeypatch):
    monkeypatch.setenv("COLUMNS", "200")
    path = file_of(tmp_path, "[limits]\nfence_m = 77.0\n")
    with pytest.raises(SystemExit):
        main(["run", "--help-all"])
    assert "(default: 300.0 m)" in " ".join(capfd.readouterr().out.replace("│", " ").split())
    with pytest.raises(SystemExit):
        main(["run", "--settings", str(path), "--help-all"])
    assert "77.0 m)" in capfd.readouterr().out
    with pytest.raises(SystemExit):
        main(["sim", "car", "--help-all"])
    assert f"{SCENARIOS['car'].standoff_m} m)" in capfd.readouterr().out


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
        limits=Limits(speed_m_s=1 / 3, fence_m=1e3 / 7),
        servo=ServoConfig(mode=ServoMode.TOP_DOWN, orbit_m_s=-2.5, climb=Gains(kp=1e-7)),
    )
    for config in (Config(), odd):
        assert read_settings(file_of(tmp_path, as_toml(config))) == config


def run_command(*words: str) -> RunCommand:
    command = read(["run", "--link", "udpin:127.0.0.1:1", *words])
    assert isinstance(command, RunCommand)
    return command


def test_the_command_line_overrides_the_file(tmp_path):
    """A floor above the default ceiling is valid with the ceiling of the same file."""
    path = file_of(tmp_path, "[limits]\nspeed_m_s = 3.0\nfloor_m = 150.0\nceiling_m = 200.0\n")
    for option in (["--settings", str(path)], [f"--settings={path}"]):
        command = run_command(*option, "--limits.floor-m", "120")
        assert command.config.limits == Limits(speed_m_s=3.0, floor_m=120.0, ceiling_m=200.0)
        assert command.settings == path


@pytest.mark.parametrize(
    "setting",
    [
        ("target", "size_m", 170),
        ("target", "middle_fraction", 50),
        ("servo", "standoff_m", 1200),
        ("servo", "orbit_m_s", -200),
    ],
)
def test_a_value_in_another_unit_is_refused_in_file_and_option(tmp_path, setting):
    branch, name, value = setting
    with pytest.raises(UsageError, match=rf"'.*': .*{name} must be at most .*, not {value}: check its unit"):
        read_settings(file_of(tmp_path, f"[{branch}]\n{name} = {value}\n"))
    with pytest.raises(UsageError, match=rf"^{branch} setting {name} must be at most"):
        run_command(f"--{branch}.{name.replace('_', '-')}={value}")


@pytest.mark.parametrize("name", [f.name for f in fields(Limits) if f.name != "disobey_after_s"])
def test_a_limit_in_another_unit_is_refused(name):
    """Its largest value is allowed, 0.1 % more is not."""
    if name != "floor_m":  # which must lie below the ceiling
        Limits(**{name: MOST[name]})
    with pytest.raises(ValueError, match=rf"limit {name} must be at most .*: check its unit"):
        Limits(**{name: 1.001 * MOST[name]})


@pytest.mark.parametrize("name", LEAST)
def test_a_limit_that_protects_nobody_is_refused_in_file_and_option(tmp_path, name):
    """Its least value is allowed, 0.1 % less is not."""
    least = LEAST[name]
    assert getattr(Limits(**{name: least}), name) == least < getattr(Limits(), name)
    said = rf"limit {name} must be at least {least:g}, not {0.999 * least:g}: raise it"
    with pytest.raises(UsageError, match=said):
        read_settings(file_of(tmp_path, f"[limits]\n{name} = {0.999 * least}\n"))
    with pytest.raises(UsageError, match=said):
        run_command(f"--limits.{name.replace('_', '-')}={0.999 * least}")


class Still:
    """A camera that is never read."""

    size = (640, 480)
    scale = 1

    def __init__(self, *_: object, **__: object) -> None: ...


def installed(folder: Path, **changed: float) -> Path:
    """The example, whole, with some of its lines changed as an editor does it."""
    text = EXAMPLE.read_text()
    for name, value in changed.items():
        text, count = re.subn(rf"(?m)^{name} = \S+", f"{name} = {value}", text)
        assert count == 1
    return file_of(folder, text)


def test_the_installed_file_with_another_lens_and_delay_gives_the_gate_their_limits(tmp_path, monkeypatch):
    """The bug: the file's own lines counted as chosen, and the gate kept 35 degrees and no delay."""
    monkeypatch.setattr(cli_run, "LiveVideo", Still)
    words = ("--camera", "/dev/video0", "--target", "1,2,30,40")
    command = run_command(*words, "--settings", str(installed(tmp_path, fov_deg=120, delay_s=0.1)))
    config = open_camera(command, SimLink(Vehicle(Autopilot.PX4, VehicleTruth())), print).config
    assert (config.limits.half_view_rad, config.limits.latency_s) == (pytest.approx(math.radians(60)), 0.1)
    typed = run_command(*words, "--limits.half-view-rad", "0.5", "--settings", str(command.settings))
    assert open_camera(typed, SimLink(Vehicle(Autopilot.PX4, VehicleTruth())), print).config.limits.half_view_rad == 0.5


def test_the_installed_file_pins_neither_the_scenario_nor_the_kind_of_target(tmp_path):
    path = str(installed(tmp_path))
    assert run_command("--camera", "scene:car", "--settings", path).config.servo.standoff_m == 22.0
    assert run_command("--for", "car", "--settings", path).config.target.size_m == 2.5


def test_nothing_is_left_to_be_derived_once_the_camera_is_known():
    lens = CameraConfig().intrinsics(640, 360)
    resolved = resolve(Config(), lens, 0.4, 0.1)
    assert {"camera.down_deg", "servo.top_rad", "limits.half_view_rad", "limits.latency_s"} == DERIVED
    assert all(value_of(resolved, name) is not None for name in names(resolved))
    assert keys(tomllib.loads(as_toml(resolved))) == names(Config())


def test_the_kind_of_target_overrides_the_scenario_and_yields_to_file_and_command_line(tmp_path):
    path = file_of(tmp_path, "[servo]\nstandoff_m = 30.0\n")
    words = ("--camera", "scene:runner", "--for", "car", "--settings", str(path), "--limits.speed-m-s", "11")
    config = run_command(*words).config
    assert (config.target.size_m, config.servo.standoff_m, config.limits.speed_m_s) == (2.5, 30.0, 11.0)


@pytest.mark.parametrize("kind", TargetKind)
def test_each_kind_of_target_sets_size_stand_off_and_speed_limit(kind):
    assert {f"{branch}.{name}" for branch, held in PRESETS[kind].items() for name in held} == BELOW
    assert read(["sim", "walker", "--for", kind.value]).config != read(["sim", "walker"]).config


def test_a_file_with_a_byte_order_mark_is_read(tmp_path):
    path = file_of(tmp_path, b"\xef\xbb\xbf[servo]\r\nstandoff_m = 13.0\r\n")
    assert read_settings(path).servo.standoff_m == 13.0


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[limit]\nspeed_m_s = 1.0", "no setting 'limit'; did you mean limits?"),
        ("[limits]\nspeed = 1.0", "no setting 'limits.speed'; did you mean speed_m_s?"),
        ("[limits]\nmax_altitude_m = 1.0", "no setting 'limits.max_altitude_m'; did you mean ceiling_m or "),
        ("[lens]\nx = 1.0", "no setting 'lens'; there are camera, target, servo, limits, record"),
        ("speed_m_s = 3.0", "no setting 'speed_m_s'; 'speed_m_s' belongs under [limits]"),
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
        ("[servo]\nmode = 'hover'", "servo.mode must be one of 'chase', 'spotlight'"),
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


@pytest.mark.parametrize(
    ("name", "said"), [("none.toml", "No such file"), (".", "is not a regular file"), ("", "is not a")]
)
def test_an_invalid_settings_file_is_one_line(tmp_path, monkeypatch, name, said):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(UsageError, match=said) as refusal:
        read_settings(Path(name))
    assert "\n" not in str(refusal.value)


def test_the_option_without_a_file_is_wrong_use(capfd):
    assert main(["sim", "--settings"]) == 2
    assert re.fullmatch(r"follow: error: .*--settings.*\n", capfd.readouterr().err)


def test_a_command_without_settings_refuses_the_option(capfd):
    assert main(["inspect", "x", "--settings", str(EXAMPLE)]) == 2
    assert "--settings" in capfd.readouterr().err


def hovering(height_m: float = 8.0) -> SimLink:
    return SimLink(Vehicle(Autopilot.PX4, VehicleTruth(down_m=-height_m)))


def test_in_a_live_scene_settings_of_the_user_override_those_of_the_scenario():
    scenario = SCENARIOS["runner"]
    seen = open_scene(run_command("--camera", "scene:runner", "--limits.fence-m", "80"), hovering())
    assert seen.config.servo.standoff_m == scenario.standoff_m != ServoConfig().standoff_m
    assert seen.config.target.size_m == scenario.size_m != Config().target.size_m
    assert seen.config.limits.half_view_rad == pytest.approx(scenario.fov_rad / 2)
    wanted = Limits(fence_m=80.0, speed_m_s=scenario.limits["speed_m_s"])
    assert replace(seen.config.limits, half_view_rad=None, latency_s=None) == wanted


def test_camera_options_change_the_drawn_and_the_assumed_camera_alike():
    """The referee is the drawn camera: by where it draws the same target."""
    own = open_scene(run_command("--camera", "scene:walker"), hovering(6.0))
    words = ("--camera", "scene:walker", "--camera.fov-deg", "50", "--camera.down-deg", "35", "--camera.delay-s", "0.2")
    other = open_scene(run_command(*words), hovering(6.0))
    for seen in (own, other):
        drawn = seen.camera.settings
        assert (drawn.intrinsics, drawn.down_rad) == (seen.lens, seen.down_rad)
        assert (drawn.latency_s, math.degrees(drawn.down_rad)) == (
            seen.config.limits.latency_s,
            pytest.approx(seen.config.camera.down_deg),
        )
    assert other.target.area / own.target.area == pytest.approx((other.lens.fx / own.lens.fx) ** 2, rel=0.2)
    assert other.camera.settings.latency_s == 0.2
    assert not np.array_equal(own.camera.first()[0].image, other.camera.first()[0].image)


@pytest.fixture
def brief(monkeypatch) -> str:
    monkeypatch.setitem(SCENARIOS, "brief", replace(SCENARIOS["walker"], name="brief", duration_s=0.5))
    return "brief"


def test_a_simulated_flight_flies_the_mount_that_was_given_and_a_test_may_draw_another(brief, tmp_path):
    """The referee is where the scenario puts the target: 5.1 m below the camera, 9 m ahead."""
    config = read(["sim", brief, "--camera.down-deg", "25", "--record.no-pictures"]).config
    right = FlightSpec(brief, 0, Autopilot.PX4, "racf-", config, tmp_path / "right")
    wrong = replace(right, drawn=replace(config.camera, down_deg=35.0), out=tmp_path / "wrong")
    for flight, off_rad in ((right, 0.0), (wrong, math.radians(10.0))):
        simulate(flight, Terminal(), bar=False)
        assert read_settings(flight.out / "settings.toml").camera.down_deg == 25.0
        with (flight.out / "ticks.csv").open() as file:
            first = next(csv.DictReader(file))
        assert float(first["target_depression_rad"]) == pytest.approx(math.atan2(5.1, 9.0) - off_rad, abs=0.02)
