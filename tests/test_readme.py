"""What the README shows works: its commands are read, its footage commands run, its loop flies."""

import json
import re
import shlex
from dataclasses import replace
from pathlib import Path

import pytest

from follow.cli.layers import read
from follow.cli.program import main
from follow.control.acquire import Acquire
from follow.control.image_motion import ImageMotionMeter
from follow.control.servo import Servo
from follow.control.target import Target
from follow.messages import Autopilot, Order, Tick
from follow.safety.gate import Safety
from racf import Racf
from sim.autopilot.program import build as build_autopilot
from sim.autopilot.program import read as read_autopilot
from sim.clip import write
from sim.scenarios import SCENARIOS, build
from tests.support.real_flight import FIT

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text()


def blocks(language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```", README, re.MULTILINE | re.DOTALL)


def commands(program: str) -> list[list[str]]:
    lines = [line.split("#")[0].strip() for block in blocks("sh") for line in block.splitlines()]
    words = [shlex.split(line) for line in lines]
    return [w[1:] for w in words if w and Path(w[0]).name == program]


@pytest.mark.parametrize("words", commands("follow"), ids=" ".join)
def test_every_follow_command_of_the_readme_is_understood(words):
    assert read(words) is not None


def test_the_readme_has_both_autopilots():
    assert {read_autopilot(words[2:]).autopilot for words in commands("python")} == set(Autopilot)


@pytest.mark.parametrize("words", commands("python"), ids=" ".join)
def test_the_simulated_autopilot_of_the_readme_flies_and_is_set_as_doctor_asks(words):
    assert words[:2] == ["-m", "sim.autopilot"]
    options = read_autopilot(words[2:])
    flight = build_autopilot(options).flight
    assert not flight.vehicle.motion.landed
    asked = dict(setting.split("=") for setting in FIT[options.autopilot.value])
    assert {name: flight.parameters[name] for name in asked} == {name: float(value) for name, value in asked.items()}
    run = next(words for words in commands("follow") if "scene:walker" in words)
    assert options.link.rpartition(":")[2] == run[run.index("--link") + 1].rpartition(":")[2]


@pytest.mark.parametrize("words", commands("make"), ids=" ".join)
def test_every_make_target_of_the_readme_exists(words):
    targets = re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(), re.MULTILINE)
    assert set(words) <= set(targets)


WATCHED = "--page"  # flies in real time until a person ends it: tests/follow/test_page_flight.py


@pytest.mark.parametrize("words", [w for w in commands("follow") if w[0] == "sim" and WATCHED not in w], ids=" ".join)
def test_the_simulated_flights_of_the_readme_fly(words, tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setitem(SCENARIOS, words[1], replace(SCENARIOS[words[1]], duration_s=1.0))
    assert main([*words, "--json"]) == 0
    assert json.loads(capfd.readouterr().out)["scenario"] == words[1]


def test_the_recording_of_the_readme_is_the_one_that_make_demo_leaves():
    demo = re.search(r"^demo:.*\n\t(.*)$", (ROOT / "Makefile").read_text(), re.MULTILINE)
    assert demo is not None
    (inspected,) = [words[1] for words in commands("follow") if words[0] == "inspect"]
    assert shlex.split(demo[1])[-2:] == ["--out", inspected]


@pytest.mark.parametrize("words", [w for w in commands("follow") if w[0] == "replay"], ids=" ".join)
def test_the_footage_commands_of_the_readme_run(words, tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    write(Path("clip.mp4"), 12)
    assert main([*words, "--json"] if "--json" not in words else words) == 0
    assert json.loads(capfd.readouterr().out)["frames"] == 12
    for name in ("flight.rrd", "ticks.csv", "settings.toml", "summary.json"):
        assert (tmp_path / "out/replay" / name).is_file()


def test_the_loop_of_the_readme_flies():
    (loop,) = blocks("python")
    assert len(loop.splitlines()) == 9
    camera, link, _ = build(replace(SCENARIOS["walker"], duration_s=0.5), 0, Autopilot.PX4)
    box = camera.first()[1]
    tracker = Racf()
    safety = Safety()
    safety.order(Order.FOLLOW)
    ticks: list[Tick] = []
    parts = {
        "camera": camera,
        "link": link,
        "tracker": Acquire(tracker.init, tracker.update, box),
        "target": Target(camera.settings.intrinsics, camera.settings.down_rad),
        "meter": ImageMotionMeter(camera.settings.intrinsics, camera.settings.down_rad),
        "servo": Servo(camera.settings.down_rad),
        "safety": safety,
        "record": ticks.append,
        "Tick": Tick,
    }
    exec(loop, parts)  # the reader's own code
    assert len(ticks) == 16
    assert ticks[-1].decision.mode == "follow"


def test_the_images_and_pages_of_the_readme_exist():
    for path in re.findall(r"\]\(((?!https?:)[^)#]+)", README):
        assert (ROOT / path).exists(), path
    assert (ROOT / "docs/flight.gif").stat().st_size < 3e6
