"""Whole programs with a viewer that hangs or is gone: each flies on, and ends."""

import socket
import subprocess
import sys
from pathlib import Path

import pytest

from follow.recording.exact import read_exact
from sim.clip import write

FOLLOW = "import sys\nfrom follow.cli.program import main\nsys.exit(main())"
ENDS_S = 120.0  # a bound against hanging for ever, no figure of speed


def replay(clip: Path, out: Path, *words: str) -> subprocess.CompletedProcess[str]:
    """Run `follow replay` as a program."""
    truth = str(clip.with_suffix(".txt"))
    full = [sys.executable, "-c", FOLLOW, "replay", str(clip), "--truth", truth, "--out", str(out), *words]
    return subprocess.run(full, capture_output=True, text=True, timeout=ENDS_S, check=False)


@pytest.fixture(scope="module")
def clip(tmp_path_factory):
    path = tmp_path_factory.mktemp("clip") / "clip.mp4"
    write(path, 30)
    return path


def outcomes(out: Path) -> list[str]:
    return [r.outcome for r in read_exact(out / "messages.jsonl.gz").rounds]


def test_a_viewer_that_accepts_and_hangs_or_is_gone_changes_no_setpoint(clip, tmp_path):
    assert replay(clip, tmp_path / "alone").returncode == 0
    with socket.create_server(("127.0.0.1", 0)) as hanging:
        port = hanging.getsockname()[1]
        done = replay(clip, tmp_path / "hanging", "--view", f"rerun+http://127.0.0.1:{port}/proxy")
    assert done.returncode == 0, done.stderr
    gone = replay(clip, tmp_path / "gone", "--view", f"rerun+http://127.0.0.1:{port}/proxy")
    assert gone.returncode == 0, gone.stderr
    for name in ("hanging", "gone"):
        assert outcomes(tmp_path / name) == outcomes(tmp_path / "alone")
        assert (tmp_path / name / "summary.json").is_file()
