"""Wrong use is found before anything is opened, waited for or made: one sentence, and exit status 2."""

from dataclasses import fields, is_dataclass
from pathlib import Path

import pytest

from follow.camera.calibration import Fit, as_opencv_yaml
from follow.cli.program import main
from follow.cli.settings import near_options
from follow.config import Config
from follow.geometry import Intrinsics
from sim.clip import write

RUN = ("run", "--link", "udpin:127.0.0.1:0", "--camera", "scene:walker")
TRACKERS = [
    (("--tracker", "cstr"), "there is no tracker 'cstr'; did you mean csrt?"),
    (("--tracker", "racf,rubust"), "did you mean robust?"),
    (("--tracker", "nosuchmodule:Tracker"), "nosuchmodule"),
    (("--tracker", "nano,backbone=a.onnx,neckhead=b.onnx"), "a.onnx is not one"),
]
FOLDERS = [
    (("--out", "file"), "--out 'file' must be a folder that can be written: it is a file"),
    (("--out", "file/out"), "--out 'file/out' must be a folder that can be written: Not a directory"),
    (("--out", "a" * 300), "too long"),
    (("--out", "~nobody/out"), "did not expand"),
]
ENCODERS = [(("--record.encoder", "h264_v4l2m2m"), "record.encoder h264_v4l2m2m does not open on this computer")]
REPLAY = ("replay", "clip.mp4", "--target", "309,192,22,48")


@pytest.fixture(autouse=True)
def work(monkeypatch, tmp_path) -> Path:
    """The current folder, with a file and a clip; neither a tracker nor a link nor a page may be opened."""
    monkeypatch.chdir(tmp_path)
    Path("file").write_text("")
    Path("empty").mkdir()
    write(Path("clip.mp4"), 2)
    wide = Intrinsics.from_fov(1280, 800, 1.2)
    Path("wide.yaml").write_text(as_opencv_yaml(wide, Fit(0.3, 20, "9x6")))
    for opened in ("run.warm_up", "run.connect", "run.open_page", "sim.each", "sim.build", "replay.open_replay"):
        monkeypatch.setattr(f"follow.cli.{opened}", lambda *_words, opened=opened, **_more: pytest.fail(opened))
    monkeypatch.setattr("follow.flight.session.warm_up", lambda: pytest.fail("the tracker was warmed"))
    return tmp_path


def refused(capfd, work: Path, words: tuple[str, ...], says: str) -> None:
    before = set(work.rglob("*"))
    assert main(list(words)) == 2
    out, err = capfd.readouterr()
    assert (out, err.count("\n")) == ("", 1)
    assert says in err
    assert set(work.rglob("*")) == before


@pytest.mark.parametrize(
    ("words", "says"),
    [
        *TRACKERS,
        *FOLDERS,
        *ENCODERS,
        (("--target", "900,1,20,30"), "lies outside the 640x360 image"),
        (("--camera.calibration", "wide.yaml"), "another aspect ratio"),
        (("--camera.calibration", "missing.yaml"), "'missing.yaml' is not a regular file"),
        (("--camera.down-deg", "2", "--limits.floor-m", "3"), "below limits.floor_m 3"),
        (("--limits.floor-m", "9"), "below limits.floor_m 9"),  # by the scene's own angle, whichever the autopilot is
        (("--detector", "missing.onnx"), "missing.onnx"),
        (("--settings", "missing.toml"), "missing.toml"),
        (("--camera", "empty", "--target", "1,2,30,40"), "folder empty holds no images"),
        (("--ground", "link", "--video-out", "rtp://127.0.0.1:5600", "--video.encoder", "h264_v4l2m2m"), "video.enc"),
    ],
)
def test_a_flight_waits_for_no_vehicle_with_settings_that_it_cannot_have(capfd, work, words, says):
    refused(capfd, work, (*RUN, *words), says)


@pytest.mark.parametrize(
    ("words", "says"),
    [(("--target", "900,1,20,30"), "outside the 640x360 image"), (("--camera.calibration", "wide.yaml"), "aspect")],
)
def test_a_target_or_lens_that_does_not_fit_footage_is_found_before_the_vehicle_is_waited_for(capfd, work, words, says):
    words = ("--camera", "clip.mp4", "--target", "309,192,22,48", *words)
    refused(capfd, work, (*RUN, *words), says)


@pytest.mark.parametrize("command", [("sim", "walker"), ("sim", "--all"), ("sim", "--page", "127.0.0.1:0"), REPLAY])
@pytest.mark.parametrize(("words", "says"), [*TRACKERS, *FOLDERS])
def test_a_simulation_and_a_replay_begin_with_no_tracker_or_folder_that_they_cannot_have(
    capfd, work, command, words, says
):
    refused(capfd, work, (*command, *words), says)


@pytest.mark.parametrize("command", [("sim",), RUN, REPLAY, ("refly", "."), ("doctor", "--camera", "clip.mp4")])
@pytest.mark.parametrize(
    ("option", "near"),
    [
        ("--limits.max-altitude-m", "did you mean --limits.ceiling-m"),
        ("--max-altitude-m", "did you mean --limits.ceiling-m"),
        ("--limit.max-speed", "did you mean --limits.speed-m-s"),
        ("--servo.distance", "did you mean --servo.standoff-m"),
        ("--max-encoder", "did you mean --record.encoder or --video.encoder?"),
        ("--limits.zzz", "--help-all lists the options"),
    ],
)
def test_an_option_that_is_no_setting_is_answered_with_those_that_mean_the_same(capfd, work, command, option, near):
    refused(capfd, work, (*command, option, "30"), near)


def test_a_setting_without_its_branch_is_answered_with_its_branch():
    branches = {f.name: getattr(Config(), f.name) for f in fields(Config)}
    names = [(name, f.name) for name, branch in branches.items() for f in fields(branch)]
    options = [
        f"--{name}.{leaf}".replace("_", "-") for name, leaf in names if not is_dataclass(getattr(branches[name], leaf))
    ]
    assert len(options) > 50
    for option in options:
        assert option in near_options(f"--{option.partition('.')[2]}")


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (("sim", *ENCODERS[0][0]), ENCODERS[0][1]),
        ((*REPLAY, *ENCODERS[0][0]), ENCODERS[0][1]),
        (("replay", "missing.mp4", "--target", "1,2,3,4"), "'missing.mp4' cannot be opened"),
        (("replay", "empty", "--target", "1,2,3,4"), "folder empty holds no images"),
        (("calibrate", "missing.mp4"), "'missing.mp4' cannot be opened"),
        (("doctor", "--camera", "clip.mp4", "--tracker", "cstr"), "did you mean csrt?"),
        (("doctor", "--camera", "clip.mp4", "--out", "file/out"), "Not a directory"),
    ],
)
def test_a_source_a_folder_or_an_encoder_that_is_not_there_is_wrong_use(capfd, work, words, says):
    refused(capfd, work, words, says)
