"""Draw docs/recording.jpg and docs/recording_moments.jpg: screenshots of the viewer's first view, on a virtual screen.

    python -m tools.docs.recording [MOMENT ...]     start, steady, lost, found, over; all five if none is named

Flies behind a runner who passes through a door, until the pilot takes over, and draws a recording that ends at each
moment.  Needs Xvfb and a software Vulkan (Debian: xvfb, mesa-vulkan-drivers).  Frames are recorded as JPEG, because the
viewer needs `ffmpeg` for H.264.
"""

import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

from follow.cli.sim import scene_camera
from follow.config import CameraConfig, Config, resolve
from follow.control.image_motion import ImageMotionMeter
from follow.control.servo import Servo
from follow.control.target import Target
from follow.flight.session import acquire, kept_geometry
from follow.loop import follow
from follow.messages import NO_INSTRUCTION, Autopilot, Cause, Instruction, Mode, Order, Reason, Tick
from follow.operator.mode_changes import ModeChanges
from follow.recording.layout import layout
from follow.recording.recorder import RecordConfig, Recorder
from follow.recording.video_encoder import Encoder
from follow.recording.viewer import viewer
from follow.safety.gate import Safety
from racf.box import Box
from sim.scenarios import SCENARIOS, build

HERE = Path(__file__).parents[2] / "docs"
SIZE = (1600, 1000)
SECONDS = 14.0  # the viewer takes its screenshot before it has loaded a long recording
TAKEN_S = 12.5
MOMENTS = ("start", "steady", "lost", "found", "over")


def orders() -> Iterator[Instruction]:
    """FOLLOW in the first round, OBSERVE at `TAKEN_S`."""
    yield Instruction(Order.FOLLOW, Reason(Cause.FOLLOW_ORDERED, "the command line"))
    for _ in range(int(TAKEN_S * 30)):
        yield NO_INSTRUCTION
    yield Instruction(Order.OBSERVE, Reason(Cause.OBSERVE_ORDERED, "key o"))
    while True:
        yield NO_INSTRUCTION


def flown() -> tuple[list[tuple[Tick, Box | None]], Config, float]:
    """Every round of the flight with the true box, the settings, and the camera's angle."""
    scenario = replace(SCENARIOS["doorway"], duration_s=SECONDS)
    drawn = scene_camera(scenario, Autopilot.PX4, CameraConfig())
    camera, link, _ = build(scenario, 0, Autopilot.PX4, drawn)
    lens, down_rad = drawn.intrinsics, drawn.down_rad
    suggested = scenario.suggested
    config = Config()
    config = replace(config, servo=replace(config.servo, **suggested.get("servo", {})))
    config = resolve(config, lens, down_rad, drawn.latency_s)
    target, servo = Target(lens, down_rad, config.target), Servo(down_rad, config.servo)
    tracker, meter = acquire("racf,robust", camera.first()[1]), ImageMotionMeter(lens, down_rad)
    told = orders()
    rounds: list[tuple[Tick, Box | None]] = []
    with camera, link:
        for tick in follow(camera, link, tracker, target, servo, Safety(config.limits), lambda: next(told), meter):
            rounds.append((tick, None if tick.frame is None else camera.truth(tick.frame.index).box))
    return rounds, config, down_rad


def ends(ticks: list[Tick]) -> dict[str, float]:
    """The time of each moment, s."""
    modes = [(tick.state.t_s, tick.decision.mode) for tick in ticks]
    lost = next(t_s for t_s, mode in modes if mode is Mode.COAST)
    found = next(t_s for t_s, mode in modes if t_s > lost and mode is Mode.FOLLOW)
    return {"start": 0.7, "steady": lost - 1.0, "lost": lost + 1.0, "found": found + 0.7, "over": TAKEN_S + 1.0}


def record(rounds: list[tuple[Tick, Box | None]], config: Config, down_rad: float, end_s: float, out: Path) -> None:
    """The recording of the flight up to a moment."""
    about, kept = "# A runner vanishes through a door\n\na simulated flight", kept_geometry(config.servo, down_rad)
    settings = RecordConfig(encoder=Encoder.JPEG)
    with Recorder(out, settings, print, waits=True, about=about, desired=kept) as recorder:
        changes = ModeChanges(recorder.message)
        for tick, truth in rounds:
            if tick.state.t_s <= end_s:
                recorder.tick(tick, truth)
                changes.see(tick)


def draw(recording: Path, image_path: Path) -> None:
    """Show the recording's last moment in the viewer and save a screenshot."""
    with tempfile.TemporaryDirectory() as folder:
        shot, blueprint = Path(folder) / "shot.png", Path(folder) / "layout.rbl"
        layout(play_state="following").save("follow-me", blueprint)
        # A virtual screen much larger than the window: the mouse pointer in its middle must not be over a plot.
        screen = ["xvfb-run", "-a", "-s", "-screen 0 7000x4400x24"]
        window = ["--window-size", f"{SIZE[0]}x{SIZE[1]}", "--screenshot-to", str(shot)]
        subprocess.run(
            [*screen, viewer(), "--port", "auto", *window, str(recording), str(blueprint)],
            check=True,
            timeout=300,
            env={**os.environ, "LIBGL_ALWAYS_SOFTWARE": "1", "XDG_RUNTIME_DIR": folder, "RUST_LOG": "error"},
        )
        image = cv2.resize(cv2.imread(str(shot)), SIZE, interpolation=cv2.INTER_AREA)
    cv2.imwrite(str(image_path), image, [cv2.IMWRITE_JPEG_QUALITY, 85])


def main(moments: list[str]) -> None:
    out = Path("out/moments")
    out.mkdir(parents=True, exist_ok=True)
    rounds, config, down_rad = flown()
    when = ends([tick for tick, _ in rounds])
    for moment in moments:
        with tempfile.TemporaryDirectory() as folder:
            record(rounds, config, down_rad, when[moment], Path(folder))
            draw(Path(folder) / "flight.rrd", out / f"{moment}.jpg")
        print(f"{moment}: {when[moment]:.1f} s, {out / f'{moment}.jpg'}", flush=True)
    if all((out / f"{moment}.jpg").exists() for moment in MOMENTS):
        shots = [np.asarray(cv2.imread(str(out / f"{moment}.jpg")), np.uint8) for moment in MOMENTS]
        cv2.imwrite(str(HERE / "recording.jpg"), shots[2], [cv2.IMWRITE_JPEG_QUALITY, 85])
        small = [cv2.resize(shot, (1000, 625), interpolation=cv2.INTER_AREA) for shot in shots]
        cv2.imwrite(str(HERE / "recording_moments.jpg"), np.vstack(small), [cv2.IMWRITE_JPEG_QUALITY, 80])


if __name__ == "__main__":
    main(sys.argv[1:] or list(MOMENTS))
