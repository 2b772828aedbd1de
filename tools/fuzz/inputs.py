"""Garbage and mutations into everything that reads bytes or files from outside: no crash, no hang, errors in one line.

    python -m tools.fuzz.inputs --seconds 60 --seed 0

Each target is fuzzed for that long; prints the number of inputs and of those refused; exits 1 at the first violation
with the input as a Python literal.

MATLAB files of boxes are not among the targets: scipy's compiled reader itself crashes on broken ones, so `.mat` files
must come from a source that is trusted.  Nothing that flies reads them.
"""

import argparse
import math
import os
import random
import signal
import sys
import tempfile
import time
from collections.abc import Callable
from itertools import islice
from pathlib import Path

import cv2
import numpy as np
from pymavlink.dialects.v20 import common as dialect

from follow.camera import CameraError
from follow.camera.video import open_replay
from follow.cli.commands import Command
from follow.cli.settings import as_toml, read_settings
from follow.link.client import MavlinkClient
from follow.link.signing import read_key
from follow.messages import Autopilot, Setpoint, VehicleState
from follow.recording.scoring import Annotations
from racf.box import Box
from racf.commandline import UsageError, parse
from racf.evaluate.boxfiles import read_boxes
from racf.video_writer import VideoWriter
from sim.autopilot.system import AutopilotSystem
from sim.dynamics import Vehicle, VehicleTruth
from tools.fuzz.ground import ground_target

HANG_S = 5.0  # longer than any of these may take on a small board
REFUSALS = (ValueError, OSError, CameraError, UsageError)
Target = Callable[[bytes], None]


class Hang(BaseException):
    """One input took too long."""


def mutated(seed: bytes, rng: random.Random) -> bytes:
    """A seed with bits flipped and pieces removed, doubled or inserted; or plain garbage."""
    if rng.random() < 0.1:
        return rng.randbytes(rng.randrange(400))
    data = bytearray(seed)
    for _ in range(rng.choice((1, 1, 2, 5, 20))):
        at, length = rng.randrange(len(data) + 1), rng.choice((1, 2, 8, 100))
        kind = rng.randrange(4)
        if kind == 0 and at < len(data):
            data[at] ^= 1 << rng.randrange(8)
        elif kind == 1:
            del data[at : at + length]
        elif kind == 2:
            data[at:at] = rng.randbytes(length)
        else:
            data[at:at] = data[at : at + length]
    return bytes(data)


def mavlink_target() -> tuple[list[bytes], Target]:
    """One MAVLink client for the whole run, fed by datagrams and as a stream in turn; its numbers stay finite."""
    system = AutopilotSystem(Autopilot.PX4, Vehicle(Autopilot.PX4, VehicleTruth(down_m=-5.0)))
    seeds: list[bytes] = []
    for i in range(60):
        system.step(0.05 * i)
        seeds += system.take()
    client = MavlinkClient()
    clock = [0.0]
    fresh = dialect.MAVLink(None, 1, 1)
    good = dialect.MAVLink_heartbeat_message(2, 12, 1, 0, 4, 3).pack(fresh)

    def hear(data: bytes) -> None:
        clock[0] += 0.01
        for message in client.receive(data, clock[0], datagram=bool(len(data) % 2)):
            bytes(message.get_msgbuf())
        client.step(clock[0])
        client.take()
        state = client.state(clock[0])
        numbers = (getattr(state, name) for name in VehicleState.__slots__ if not name.endswith("_t_s"))
        if not all(math.isfinite(v) for v in numbers if isinstance(v, float)):
            raise AssertionError(f"a number that is not finite was believed: {state}")
        client.send_setpoint(Setpoint(), clock[0])
        for _ in range(30):  # after garbage a stream needs up to one longest packet to find the next start
            client.receive(good, clock[0])
        if client.state(clock[0]).heartbeat_t_s != clock[0]:
            raise AssertionError("a valid packet is no longer understood after it")

    return seeds, hear


def file_target(path: Path, read: Callable[[Path], object]) -> Target:
    """A reader of files."""

    def hear(data: bytes) -> None:
        path.write_bytes(data)
        path.chmod(0o600)
        read(path)

    return hear


def look(path: Path) -> None:
    """Play the first frames of a source."""
    with open_replay(str(path), None, lambda _line: None) as camera:
        _ = camera.size
        for _frame in islice(camera.frames(), 5):
            pass


def command_line(data: bytes) -> None:
    """A command line, a word a line."""
    words = [word for word in data.decode(errors="replace").split("\n") if "\0" not in word]
    try:
        parse(Command, words, prog="follow", description="")
    except SystemExit as stop:
        if stop.code:
            raise AssertionError(f"it ended with {stop.code!r} instead of an error") from None


def settings_seeds() -> list[bytes]:
    """The example with every setting, and each of its lines, so that short inputs reach each kind of setting."""
    example = Path(__file__).parents[2] / "docs" / "service" / "settings.toml"
    seeds = [example.read_bytes()]
    table = b""
    for line in seeds[0].splitlines():
        if line.startswith(b"["):
            table = line
        elif b"=" in line and table:
            seeds.append(table + b"\n" + line + b"\n")
    return seeds


def settings(path: Path) -> None:
    """A settings file: the only exception is UsageError; valid settings survive writing and reading again."""
    try:
        read = read_settings(path)
    except ValueError as error:
        if isinstance(error, UsageError):
            raise
        raise AssertionError(f"{type(error).__name__} instead of a UsageError: {error}") from error
    path.write_text(as_toml(read))
    try:
        again = read_settings(path)
    except UsageError as error:
        raise AssertionError(f"what was written cannot be read: {error}") from error
    if again != read:
        raise AssertionError(f"written and read again it is another: {read}")


def targets(folder: Path) -> dict[str, tuple[list[bytes], Target]]:
    """Name -> (seeds, the function that reads them)."""
    picture = np.random.default_rng(0).integers(0, 256, (48, 64, 3), np.uint8)
    video = folder / "seed.avi"
    with VideoWriter(video, 30.0) as writer:
        for i in range(8):
            writer.put(np.roll(picture, i, 1))
    stills = [cv2.imencode(suffix, picture)[1].tobytes() for suffix in (".png", ".jpg")]
    boxes = [b"1,2,3,4\n5,6,7,8\nNaN,NaN,NaN,NaN\n", b"1 2 3 4\n", b"1.5\t2\t3\t1e3\r\n"]
    words = [
        b"replay\nfilm.mp4\n--target\n1,2,3,4\n--config.limits.speed-m-s\n2",
        b"run\n--link\nudpin:0.0.0.0:14540\n--follow\n--camera\nscene:walker\n--limits.fence-m\n50",
        b"inspect\nout",
    ]
    stills_folder = folder / "stills"
    stills_folder.mkdir()
    return {
        "mavlink": mavlink_target(),
        "ground stations": ground_target(),
        "command lines": (words, command_line),
        "settings files": (settings_seeds(), file_target(folder / "settings.toml", settings)),
        "boxes in the command line": ([b"1,2,3,4"], lambda data: str(Box.parse(data.decode())) and None),
        "truth files": (boxes, file_target(folder / "truth.txt", Annotations)),
        "box files": (boxes, file_target(folder / "boxes.csv", read_boxes)),
        "signing keys": ([bytes(range(32)), b"00" * 32], file_target(folder / "key", read_key)),
        "video files": ([video.read_bytes()], file_target(folder / "film.avi", look)),
        "image files": (stills, file_target(stills_folder / "1.png", lambda path: look(path.parent))),
        "video paths": ([str(video).encode(), b"/dev/null", b"."], lambda data: look(Path(data.decode()))),
    }


def hang(_number: int, _frame: object) -> None:
    raise Hang


def fuzz(name: str, seeds: list[bytes], target: Target, seconds: float, rng: random.Random) -> tuple[str, str]:
    """Fuzz one target; returns a line of figures and the violation, if any."""
    rounds = refused = 0
    slowest, end = 0.0, time.monotonic() + seconds
    while time.monotonic() < end:
        data = mutated(rng.choice(seeds), rng) if rounds else seeds[0]
        began = time.monotonic()
        signal.setitimer(signal.ITIMER_REAL, HANG_S)
        try:
            target(data)
        except REFUSALS as error:
            refused += 1
            if "\n" in str(error).strip() or not str(error).strip():
                return "", f"{name}: {type(error).__name__} is not one line: {str(error)!r}, input {data!r}"
        except Hang:
            return "", f"{name}: no end within {HANG_S:g} s, input {data!r}"
        except Exception as error:  # noqa: BLE001 - any other exception is a violation
            return "", f"{name}: {type(error).__name__}: {error}, input {data!r}"
        finally:
            signal.setitimer(signal.ITIMER_REAL, 0.0)
        slowest = max(slowest, time.monotonic() - began)
        rounds += 1
    return f"{name}: {rounds} inputs, {refused} refused in one line, slowest {1e3 * slowest:.0f} ms", ""


def main(argv: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=60.0, help="for each target")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", default="", help="targets whose name holds this")
    options = parser.parse_args(argv)
    before = signal.signal(signal.SIGALRM, hang)
    failed = False
    quiet = os.open(os.devnull, os.O_WRONLY)
    stderr = os.dup(2)
    os.dup2(quiet, 2)  # libpng, libjpeg and FFmpeg write their own messages there
    with tempfile.TemporaryDirectory() as folder:
        for name, (seeds, target) in targets(Path(folder)).items():
            if options.only in name:
                figures, wrong = fuzz(name, seeds, target, options.seconds, random.Random(options.seed))
                print(wrong or figures, flush=True)
                failed |= bool(wrong)
    os.dup2(stderr, 2)
    signal.signal(signal.SIGALRM, before)
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
