"""Draw docs/recording.jpg: what the viewer first shows of a recording, by the viewer itself, without a screen.

    python -m tools.docs.recording [flight.rrd]     flies eight seconds behind a walker if no recording is given

Needs Xvfb and a software Vulkan (Debian: xvfb, mesa-vulkan-drivers).
"""

import os
import subprocess
import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import cv2

from follow.cli.program import main
from follow.recording.rerun_log import layout
from follow.recording.viewer import viewer
from sim.scenarios import SCENARIOS

HERE = Path(__file__).parents[2] / "docs"
SIZE = (1600, 1000)


def draw(recording: Path, image_path: Path) -> None:
    """Show the recording's last moment in the viewer and save what it shows."""
    with tempfile.TemporaryDirectory() as folder:
        shot, blueprint = Path(folder) / "shot.png", Path(folder) / "layout.rbl"
        layout(play_state="following").save("follow-me", blueprint)
        # A virtual screen much larger than the window: its mouse pointer, in the middle, must not touch a plot.
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


if __name__ == "__main__":
    given = sys.argv[1:]
    # The viewer takes its screenshot before it has loaded a long recording.
    SCENARIOS["docs"] = replace(SCENARIOS["look-alike"], duration_s=8.0)
    if not given and main(["sim", "docs", "--out", "out/docs"]) != 0:
        sys.exit(1)
    draw(Path(given[0] if given else "out/docs/flight.rrd"), HERE / "recording.jpg")
