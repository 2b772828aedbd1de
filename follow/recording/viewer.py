"""Opens a recording in Rerun's viewer."""

import os
import shutil
import subprocess
import sys
from pathlib import Path


def recording(path: Path) -> Path:
    """The recording that a folder or file names.  Raises FileNotFoundError."""
    found = path / "flight.rrd" if path.is_dir() else path
    if not found.is_file():
        raise FileNotFoundError(f"no recording at {found}")
    if found.suffix != ".rrd":
        raise FileNotFoundError(f"{found} is not a recording: give a flight's folder or its flight.rrd")
    return found


def viewer() -> str:
    """The viewer that came with the installed Rerun.  Raises FileNotFoundError."""
    beside = Path(sys.executable).with_name("rerun")
    found = str(beside) if beside.is_file() else shutil.which("rerun")
    if found is None:
        raise FileNotFoundError("Rerun's viewer is not installed: pip install rerun-sdk")
    return found


def show(path: Path) -> None:
    """Open the viewer on a recording and wait until it is closed.  Raises OSError without a display, or if it fails."""
    found = recording(path)
    program = viewer()
    if sys.platform == "linux" and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        raise OSError(f"no display here: copy {found} to a computer with one and run: rerun {found.name}")
    status = subprocess.run([program, str(found)], check=False).returncode
    if status != 0:
        raise OSError(f"Rerun's viewer ended with status {status}")
