"""Opens a recording in Rerun's viewer."""

import getpass
import ipaddress
import os
import shutil
import socket
import subprocess
import sys
import urllib.parse
from importlib import metadata
from pathlib import Path

HERE, WEB = "here", "web"
SERVED = "rerun+http://127.0.0.1:9876/proxy"  # by `rerun --serve-web`
SCHEMES = ("rerun+http", "rerun+https", "rerun")


def recording(path: Path) -> Path:
    """The recording that a folder or file names.  Raises FileNotFoundError."""
    found = path / "flight.rrd" if path.is_dir() else path
    if not found.is_file():
        raise FileNotFoundError(f"no recording at {found}")
    if found.suffix != ".rrd":
        raise FileNotFoundError(f"{found} is not a recording: give a flight's folder or its flight.rrd")
    return found


def installed_by() -> str:
    """The command that installs the viewer of the version that wrote the recordings here."""
    try:
        return f"pip install rerun-sdk=={metadata.version('rerun-sdk')}"
    except metadata.PackageNotFoundError:
        return "pip install rerun-sdk"


def viewer() -> str:
    """The viewer that came with the installed Rerun.  Raises FileNotFoundError."""
    beside = Path(sys.executable).with_name("rerun")
    found = str(beside) if beside.is_file() else shutil.which("rerun")
    if found is None:
        raise FileNotFoundError(f"Rerun's viewer is not installed: {installed_by()}")
    return found


def has_display() -> bool:
    """Whether a window can be opened here."""
    return sys.platform != "linux" or bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def show(path: Path) -> None:
    """Open the viewer on a recording and wait until it is closed.  Raises OSError without a display, or if it fails."""
    found = recording(path)
    program = viewer()
    if not has_display():
        user, host = getpass.getuser(), socket.gethostname()
        raise OSError(
            f"no display here. On a computer with one: scp {user}@{host}:{found.resolve()} . && rerun {found.name} "
            f"({installed_by()}). Or here: rerun --serve-web --bind 0.0.0.0 {found}, "
            f"then {page_address(SERVED, own_address())} in a browser. Or follow report {found.parent}"
        )
    status = subprocess.run([program, str(found)], check=False).returncode
    if status != 0:
        raise OSError(f"Rerun's viewer ended with status {status}")


def check_view(view: str) -> None:
    """Check a view before anything starts.

    Raises ValueError for one that is not a view, OSError if a viewer here has no display.
    """
    if view == HERE:
        if not has_display():
            raise OSError("--view needs a display here: give --view web, or --view rerun+http://HOST:9876/proxy")
        viewer()
        return
    if view == WEB:
        return
    parts = urllib.parse.urlsplit(view)
    try:
        known = parts.scheme in SCHEMES and bool(parts.hostname) and parts.port is not None
    except ValueError:  # a port beyond 65535
        known = False
    if not known or parts.path.rstrip("/") != "/proxy":
        raise ValueError(f"--view must be here, web or rerun+http://HOST:PORT/proxy, not {view!r}")


def page_address(url: str, host: str) -> str:
    """The URL of the viewer's page with the stream of `url`; `host` is this computer's address for other machines."""
    there = urllib.parse.urlsplit(url)
    stream = there._replace(netloc=f"{host}:{there.port}").geturl()
    return f"http://{host}:9090/?url={urllib.parse.quote(stream)}"


def own_address() -> str:
    """The address of this computer in its network; 127.0.0.1 without a network.  Sends nothing."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect((str(ipaddress.IPv4Address("192.0.2.1")), 9))  # a documentation address: no packet leaves
        except OSError:
            return "127.0.0.1"
        return str(probe.getsockname()[0])
