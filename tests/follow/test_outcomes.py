"""The end of a program: its exit status tells whether FOLLOW began, and a verdict whether the flight was safe."""

import sys
from dataclasses import replace

import pytest

from follow.cli import start
from follow.cli.program import main
from follow.operator.terminal import result
from sim.clip import write
from sim.scenarios import SCENARIOS
from tests.support.real_flight import real_flight

FAR = ("--limits.min-standoff-m", "50", "--servo.standoff-m", "60")  # FOLLOW is refused so near


def outcome(capfd, *words: object) -> tuple[int, str, str]:
    status = main([str(word) for word in (*words, "--record.no-pictures")])
    return status, *capfd.readouterr()


@pytest.fixture
def source(monkeypatch, tmp_path, request) -> tuple[object, ...]:
    if request.param == "sim":
        monkeypatch.setitem(SCENARIOS, "brief", replace(SCENARIOS["walker"], duration_s=4.0))
        return "sim", "brief", "--out", tmp_path / "out"
    write(tmp_path / "clip.mp4", 120)
    return "replay", tmp_path / "clip.mp4", "--truth", tmp_path / "clip.txt", "--out", tmp_path / "out"


@pytest.mark.parametrize("source", ["sim", "replay"], indirect=True)
def test_follow_that_never_began_is_a_failed_run_with_its_figures_and_one_line(capfd, source):
    assert outcome(capfd, *source)[0] == 0
    status, out, err = outcome(capfd, *source, *FAR)
    assert status == 1
    assert "setpoints" in out
    assert err.count("FOLLOW never began: the order is void: the target is nearer than 50 m") == 1
    status, _, err = outcome(capfd, "refly", source[-1])  # nobody orders anything here: it is equal, which is a success
    assert (status, "is equal to the last bit" in err) == (0, True)


@pytest.mark.parametrize(
    ("figures", "line"),
    [
        (
            {"violations": {}, "nearest_m": 9.4521},
            "yes by its limits, because it passed none; nearest: 9.452 m to the target",
        ),
        (
            {"violations": {}, "nearest_m": 9.0, "nearest_other_m": 0.5},
            "yes by its limits, because it passed none; nearest: 9 m to the target, 0.5 m to anybody else",
        ),
        (
            {"violations": {"floor_m": 3, "min_standoff_m": 12}, "nearest_m": 1.0},
            "no, because it passed floor_m in 3 rounds, min_standoff_m in 12 rounds",
        ),
    ],
)
def test_a_flight_with_ground_truth_ends_with_a_verdict_on_a_terminal_only(capfd, figures, line):
    result(figures, as_json=False)
    assert capfd.readouterr().out.splitlines()[-1] == f"was it safe: {line}"
    result(figures, as_json=True)
    assert "was it safe" not in capfd.readouterr().out
    result({"seconds": 3.0}, as_json=False)  # footage or a real camera: nobody knows
    assert "was it safe" not in capfd.readouterr().out


@pytest.mark.realtime
def test_an_order_of_the_command_line_that_is_never_granted_is_a_failed_run(tmp_path):
    with real_flight(
        "px4", tmp_path, options=["--follow", "--record.no-pictures"], settings=["COM_RC_OVERRIDE=1"], begins="observe"
    ) as real:
        assert real.application.end() == 1
        assert real.application.said("FOLLOW never began: COM_RC_OVERRIDE is red")


class Interrupted:
    """Ctrl-C while the program is imported."""

    @staticmethod
    def find_spec(name: str, *_more: object) -> None:
        if name == "follow.cli.program":
            raise KeyboardInterrupt


def test_ctrl_c_during_the_imports_ends_in_one_line(capfd, monkeypatch):
    monkeypatch.delitem(sys.modules, "follow.cli.program")
    monkeypatch.setattr(sys, "meta_path", [Interrupted, *sys.meta_path])
    assert start.main() == 1
    assert capfd.readouterr().err == "follow: error: stopped before it was done (Ctrl-C)\n"


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (("replay", "x", "--fps", "abc"), "--fps must be a number, not 'abc'"),
        (("replay", "x", "--fps", "0"), "--fps lies above 0, up to 1000, not 0"),
        (("report", "nodir"), "'nodir' holds no ticks.csv"),
        (("refly", "nodir"), "'nodir' holds no messages.jsonl.gz"),
        (("doctor", "--camera", "0?size=12x"), "size is WIDTHxHEIGHT in pixels, not '12x'"),
        (("doctor", "--link", "udp:127.0.0.1:1"), "did you mean udpin or udpout?"),
        (("sim", "walker", "--ground", "udpin:1"), "--ground: a link is udpin:HOST:PORT"),
        (("sim", "walker", "--page", "8080"), "--page '8080' must be HOST:PORT"),
        (("sim", "walkr"), "there is no scenario 'walkr'; did you mean walker"),
        (("sim", "--detector", __file__), "test_outcomes.py cannot be used: it is not an ONNX file"),
        (("sim", "--camera.calibration", __file__), "`follow calibrate` makes such a file"),
    ],
)
def test_wrong_use_ends_in_2_with_one_line_and_no_hint_at_a_cable(capfd, tmp_path, monkeypatch, words, says):
    monkeypatch.chdir(tmp_path)
    assert main(list(words)) == 2
    _, err = capfd.readouterr()
    assert err.count("\n") == 1
    assert says in err
    assert "cable" not in err
