"""`messages.jsonl.gz`: the exact inputs of estimate, servo and gate, for `follow refly`.

Lines of JSON in a gzip stream.  The first line holds the flight's `Setup`, each other one a round of the loop: its
frame's time and number, the track, the vehicle's state (only the fields that changed since the round before), the
image's motion, the operator's instruction, and a digest of the outputs.  Messages to a person are between them.  Each
number reads back to the same 64 bits.  The stream is flushed once a second: the file of a killed flight is readable up
to there.
"""

import contextlib
import hashlib
import json
import math
import threading
import zlib
from collections.abc import Iterator, Mapping
from dataclasses import MISSING, dataclass, fields, is_dataclass
from enum import Enum
from pathlib import Path
from types import UnionType
from typing import Any, Union, cast, get_args, get_origin, get_type_hints

from follow.disk import BackgroundFile
from follow.geometry import Intrinsics
from follow.messages import NO_INSTRUCTION, ImageMotion, Instruction, Notify, Tick, VehicleState
from racf.box import Box
from racf.track import Track

VERSION = 1
FLUSH_EVERY_S = 1.0
GZIP = 31  # zlib's window bits for a gzip stream
SEEN = ("box", "search", "psr", "apce", "confidence", "found", "refined", "restarted")
"""The recorded fields of a track; the others are for display."""


@dataclass(frozen=True, slots=True)
class Setup:
    """The camera and the settings of a flight.

    lens, down_rad: the camera and its angle below the nose; settings: the whole resolved tree as TOML; moves_view:
    None, or for footage whether the view moved with the vehicle (`follow.control.footage`); about: a description.
    """

    lens: Intrinsics
    down_rad: float
    settings: str
    moves_view: bool | None = None
    about: str = ""


@dataclass(frozen=True, slots=True)
class Round:
    """The inputs of one round, and a digest of its outputs."""

    state: VehicleState
    frame: tuple[float, int] | None = None  # time and number
    scale: int = 1  # pixels of the source in one of the frame's
    track: Track | None = None
    motion: ImageMotion | None = None
    instruction: Instruction = NO_INSTRUCTION
    truth: Box | None = None
    outcome: str = ""


@dataclass(frozen=True, slots=True)
class ExactFlight:
    """A whole recording; `unix_s` is the first round on the wall clock, None for a simulation."""

    setup: Setup
    rounds: tuple[Round, ...]
    unix_s: float | None = None


class ExactWriter:
    """Writes `messages.jsonl.gz` without waiting for the disk."""

    def __init__(self, path: Path, setup: Setup, report: Notify) -> None:
        self._file = BackgroundFile(path, report)
        self._gzip = zlib.compressobj(level=6, wbits=GZIP)
        self._lock = threading.RLock()  # a line for a person may come from any thread
        self._state: dict[str, object] = {}
        self._flush_t_s = -math.inf
        self._closed = False  # a line reported after the flight does not belong to it
        self._put({"version": VERSION, "setup": plain(setup)})

    def add(self, tick: Tick, truth: Box | None, unix_s: float | None) -> None:
        """Write one round; `unix_s` is the wall clock of the first one."""
        state = cast("dict[str, object]", plain(tick.state))
        line: dict[str, object] = {"state": {k: v for k, v in state.items() if self._state.get(k, MISSING) != v}}
        if not self._state and unix_s is not None:
            line["unix_s"] = unix_s
        self._state = state
        if tick.frame is not None:
            line["frame"] = [tick.frame.t_s, tick.frame.index]
            if tick.frame.scale != 1:
                line["scale"] = tick.frame.scale
        if tick.track is not None:
            line["track"] = {name: plain(getattr(tick.track, name)) for name in SEEN}
        if tick.motion is not None:
            line["motion"] = plain(tick.motion)
        if tick.instruction != NO_INSTRUCTION:
            line["instruction"] = plain(tick.instruction)
        if truth is not None:
            line["truth"] = plain(truth)
        line["outcome"] = digest(tick)
        self._put(line)
        if tick.state.t_s - self._flush_t_s >= FLUSH_EVERY_S:
            self._flush_t_s = tick.state.t_s
            with self._lock:
                self._file.write(self._gzip.flush(zlib.Z_SYNC_FLUSH))

    def message(self, t_s: float, text: str) -> None:
        """Write one message to a person, `t_s` after the first round."""
        self._put({"said": text, "t_s": t_s})

    def close(self) -> None:
        """Write the rest."""
        with self._lock:
            self._closed = True
            self._file.write(self._gzip.flush())
        self._file.close()

    def _put(self, line: Mapping[str, object]) -> None:
        text = json.dumps(line, separators=(",", ":"), default=lambda value: value.item()) + "\n"
        with self._lock:
            if not self._closed and (data := self._gzip.compress(text.encode())):
                self._file.write(data)


def digest(tick: Tick) -> str:
    """64 bits of a hash over the estimate, the desired setpoint and the decision, each number to its last bit."""
    text = repr((tick.estimate, tick.desired, tick.decision))
    return hashlib.blake2b(text.encode(), digest_size=8).hexdigest()


def read_setup(path: Path) -> Setup:
    """The setup of a flight.  Raises OSError, ValueError if the file does not hold one."""
    return _setup(path, next(_lines(path), {}))


def read_exact(path: Path) -> ExactFlight:
    """The whole recording, up to where the file ends.  Raises OSError, ValueError if it is not such a file."""
    lines = _lines(path)
    setup = _setup(path, next(lines, {}))
    rounds: list[Round] = []
    state: dict[str, object] = {}
    unix_s: float | None = None
    for line in lines:
        if "said" in line:
            continue
        try:
            unix_s = line.get("unix_s", unix_s)
            state |= line["state"]
            track = line.get("track")
            found = Round(
                revive(VehicleState, state),
                cast("tuple[float, int]", tuple(line["frame"])) if "frame" in line else None,
                int(line.get("scale", 1)),
                revive(Track, track) if track is not None else None,
                revive(ImageMotion, line["motion"]) if "motion" in line else None,
                revive(Instruction, line["instruction"]) if "instruction" in line else NO_INSTRUCTION,
                revive(Box, line["truth"]) if "truth" in line else None,
                line["outcome"],
            )
        except (KeyError, TypeError, ValueError) as error:
            raise ValueError(f"{path}: round {len(rounds)} cannot be read: {error!r}") from None
        rounds.append(found)
    if not rounds:
        raise ValueError(f"{path} holds no round of a flight")
    return ExactFlight(setup, tuple(rounds), unix_s)


def read_said(path: Path) -> list[tuple[float, str]]:
    """Time and text of each message to a person; empty if the file is missing or is not such a file."""
    try:
        return [(float(line["t_s"]), str(line["said"])) for line in _lines(path) if "said" in line]
    except (OSError, ValueError, KeyError, TypeError):
        return []


def _setup(path: Path, line: dict[str, Any]) -> Setup:
    if not line:
        raise ValueError(f"{path} holds nothing: the flight broke off before its first second was written")
    if line.get("version") != VERSION:
        raise ValueError(f"{path} is not a recording of version {VERSION}")
    try:
        return revive(Setup, line["setup"])
    except (KeyError, TypeError, ValueError) as error:
        raise ValueError(f"{path}: its setup cannot be read: {error!r}") from None


def _lines(path: Path) -> Iterator[dict[str, Any]]:
    """Each complete line of a file that may be truncated anywhere."""
    unzip = zlib.decompressobj(wbits=GZIP)
    rest, lines = b"", 0
    with path.open("rb") as file:
        while data := file.read(1 << 16):
            before, broken = unzip.copy(), None
            try:
                text = unzip.decompress(data)
            except zlib.error as error:
                text, broken = _until_broken(before, data), error
            *whole, rest = (rest + text).split(b"\n")
            for line in whole:
                lines += 1
                found = json.loads(line)
                if not isinstance(found, dict):
                    raise ValueError(f"{path}: a line is not a JSON object")
                yield found
            if broken is not None:
                if not lines:
                    raise ValueError(f"{path} is not a gzip file: {broken}") from None
                return  # garbage after the last flush, such as the zeros that a power cut leaves


def _until_broken(unzip: Any, data: bytes) -> bytes:
    """The text of the bytes before the first invalid one."""
    text = b""
    with contextlib.suppress(zlib.error):
        for n in range(len(data)):
            text += unzip.decompress(data[n : n + 1])
    return text


def plain(value: object) -> object:
    """A message for JSON: dataclasses as objects, enums as their values, tuples as lists."""
    if is_dataclass(value) and not isinstance(value, type):
        return {f.name: plain(getattr(value, f.name)) for f in fields(value)}
    if isinstance(value, Enum):
        return value.value
    return [plain(part) for part in value] if isinstance(value, tuple) else value


def revive(kind: type[Any], value: Mapping[str, object]) -> Any:
    """The inverse of `plain` for a dataclass of that kind; a missing field gets its default."""
    hints = get_type_hints(kind)
    return kind(**{f.name: _revived(hints[f.name], value[f.name]) for f in fields(kind) if f.name in value})


def _revived(hint: Any, value: Any) -> Any:
    origin, inner = get_origin(hint), get_args(hint)
    if value is None:
        return None
    if origin in (Union, UnionType):
        return _revived(next(kind for kind in inner if kind is not type(None)), value)
    if origin is tuple:
        kinds = [inner[0]] * len(value) if len(inner) == 2 and inner[1] is Ellipsis else inner
        return tuple(_revived(kind, part) for kind, part in zip(kinds, value, strict=True))
    if is_dataclass(hint) and isinstance(hint, type):
        return revive(hint, value)
    if isinstance(hint, type) and issubclass(hint, Enum):
        return hint(value)
    return float(value) if hint is float else value
