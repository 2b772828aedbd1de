"""A recorded flight read back: the columns of `ticks.csv` as arrays, and what reports derive from them."""

import csv
import itertools
import json
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
NUMBER = re.compile(r"-?\d+(\.\d+)?")


@dataclass(frozen=True, slots=True)
class Span:
    """An interval from `start_s` to `end_s`, with what it was and why."""

    start_s: float
    end_s: float
    what: str
    why: str = ""

    @property
    def seconds(self) -> float:
        """How long it lasted."""
        return self.end_s - self.start_s


class FlightTable:
    """The rows of one flight.  Raises OSError, ValueError for a folder without `ticks.csv` or one without rows."""

    def __init__(self, folder: Path) -> None:
        path = folder / "ticks.csv"
        try:
            with path.open(newline="", encoding="utf-8", errors="replace") as file:
                whole = list(csv.reader(line.replace("\0", "") for line in file))  # a power cut leaves zeros
        except (FileNotFoundError, NotADirectoryError):
            raise ValueError(f"{str(folder)!r} holds no ticks.csv: give the folder of a flight") from None
        rows = [row for row in whole[1:] if len(row) == len(whole[0])]  # a killed flight's last row may be incomplete
        self._path = path
        if not rows or "t_s" not in whole[0]:
            raise ValueError(f"{str(path)!r} holds no round of a flight")
        self._columns = {name: [row[n] for row in rows] for n, name in enumerate(whole[0])}
        self.t_s = self.numbers("t_s")

    def words(self, name: str) -> list[str]:
        """A column as text; empty texts if the file lacks it."""
        return self._columns.get(name, [""] * len(self.t_s))

    def numbers(self, name: str) -> Array:
        """A column as numbers, NaN where it is empty.  Raises ValueError for a cell that is not a number."""
        try:
            return np.array([float(cell) if cell else np.nan for cell in self._columns.get(name, [])])
        except ValueError as error:
            raise ValueError(f"{str(self._path)!r}: column {name} must hold numbers: {error}") from None

    def spans(self, names: Sequence[str], why: str = "") -> list[Span]:
        """Runs of rows in which the words of these columns stay the same, in order; `why` names a column of reasons."""
        keys = list(zip(*(self.words(name) for name in names), strict=True))
        reasons = self.words(why) if why else [""] * len(keys)
        ends = np.append(self.t_s[1:], self.t_s[-1])
        spans: list[Span] = []
        for key, run in itertools.groupby(range(len(keys)), key=keys.__getitem__):
            rows = list(run)
            spans.append(Span(float(self.t_s[rows[0]]), float(ends[rows[-1]]), ", ".join(key), reasons[rows[0]]))
        return spans

    def losses(self) -> list[Span]:
        """When the tracker did not find the target; rounds without a frame continue the round before."""
        spans: list[Span] = []
        last, start = "1", 0.0
        for t_s, found in zip(self.t_s, self.words("track_found"), strict=True):
            if found and found != last:
                if found == "1":
                    spans.append(Span(start, float(t_s), "lost"))
                last, start = found, float(t_s)
        return spans if last == "1" else [*spans, Span(start, float(self.t_s[-1]), "lost")]

    def notes(self) -> dict[str, Array]:
        """Note without its numbers -> the times of the rounds that had it."""
        times: dict[str, list[float]] = {}
        for t_s, notes in zip(self.t_s, self.words("notes"), strict=True):
            for note in filter(None, notes.split(" | ")):
                times.setdefault(without_numbers(note), []).append(float(t_s))
        return {note: np.array(found) for note, found in times.items()}

    def height_m(self) -> Array:
        """Height above the middle of the target."""
        return self.numbers("target_range_m") * np.tan(self.numbers("target_depression_rad"))

    def ages(self) -> Iterator[tuple[str, Array]]:
        """Name -> age in each round of the link's data, and of the newest frame, s."""
        for name in ("attitude", "position", "heartbeat"):
            yield name, self.t_s - self.numbers(f"vehicle_{name}_t_s")
        frames = self.numbers("frame_t_s")
        newest = np.maximum.accumulate(np.nan_to_num(frames, nan=-np.inf))
        yield "frame", np.where(np.isfinite(newest), self.t_s - newest, np.nan)


def without_numbers(text: str) -> str:
    """A text with … for each number, so that texts that differ only in numbers are equal."""
    return NUMBER.sub("…", text)


def summary_of(folder: Path) -> dict[str, object]:
    """`summary.json`; empty for a flight that was killed."""
    try:
        found = json.loads((folder / "summary.json").read_text())
    except (FileNotFoundError, ValueError):
        return {}
    return found if isinstance(found, dict) else {}


def settings_of(folder: Path) -> dict[str, str]:
    """Dotted name -> value as text, from `settings.toml`, derived ones by their plain names; empty without it."""
    try:
        text = (folder / "settings.toml").read_text(errors="replace")
    except FileNotFoundError:
        return {}
    return {name.removeprefix("derived."): value for name, value in setting_values(text).items()}


def setting_values(toml: str) -> dict[str, str]:
    """Dotted name -> value as text, from a recording's settings."""
    found: dict[str, str] = {}
    table = ""
    for line in toml.splitlines():
        if line.startswith("["):
            table = line.split("]")[0].lstrip("[")
        elif " = " in line:
            name, value = line.split(" = ", 1)
            found[f"{table}.{name.strip()}"] = value
    return found
