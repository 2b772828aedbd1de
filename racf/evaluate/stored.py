"""Boxes of other trackers in files, found for the sequences of a benchmark.

Known arrangements, with `.txt` or `.mat` files: `DIR/<sequence>`, `DIR/<tracker>/<sequence>`, the same in a folder
`DIR/<benchmark>` or `results` (also `DIR/<benchmark>/results`), and the toolkits' `<sequence>_<tracker>.mat`.  A file
`fps.json` beside them holds frames per second by sequence.
"""

import json
import math
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path

from racf.evaluate.benchmarks import Sequence
from racf.evaluate.boxfiles import read_boxes
from racf.evaluate.metrics import Boxes
from racf.imagefolder import visible


@dataclass(frozen=True, slots=True, eq=False)
class Stored:
    """A tracker's boxes by sequence, for those that it has; frames per second and jittered starts if they are known."""

    boxes: dict[str, Boxes]
    fps: dict[str, float] = field(default_factory=dict)
    jittered: dict[str, list[Boxes]] = field(default_factory=dict)


def read_stored(folder: Path, tracker: str, sequences: Iterable[Sequence]) -> Stored:
    """A tracker's boxes in `folder`; raises ValueError if a file does not have one box for each frame."""
    found = Stored({})
    for sequence in sequences:
        path = _find(folder, tracker, sequence)
        if path is None:
            continue
        boxes = read_boxes(path)
        if len(boxes) != len(sequence.truth):
            raise ValueError(f"{path}: {len(sequence.truth)} boxes are needed, one a frame, not {len(boxes)}")
        found.boxes[sequence.name] = boxes
        speed = _speeds(path.with_name("fps.json")).get(path.stem)
        if speed is not None:
            found.fps[sequence.name] = speed
    return found


def _speeds(note: Path) -> dict[str, float]:
    """Frames per second by sequence, empty without the file; raises ValueError that names it."""
    if not note.is_file():
        return {}
    try:
        speeds = json.loads(note.read_text())
        found = {str(name): float(speed) for name, speed in speeds.items()}
    except (AttributeError, TypeError, ValueError) as error:
        raise ValueError(
            f'{note} holds frames per second by sequence, {{"car1": 30}}: {error}; correct or delete it'
        ) from None
    if wrong := [name for name, speed in found.items() if not math.isfinite(speed)]:
        raise ValueError(f"{note}: the frames per second of {wrong[0]} are not a finite number; correct or delete it")
    return found


def trackers_in(folder: Path, sequences: list[Sequence]) -> list[str]:
    """The trackers with results for the largest number of the sequences, by name."""
    covered = sequences_of_trackers(folder, sequences)
    most = max(map(len, covered.values()), default=0)
    return sorted(name for name, names in covered.items() if len(names) == most and most > 0)


def with_results(folder: Path, sequences: list[Sequence]) -> set[str]:
    """Names of the sequences that some tracker in `folder` has a result for."""
    return set().union(*sequences_of_trackers(folder, sequences).values())


def sequences_of_trackers(folder: Path, sequences: list[Sequence]) -> dict[str, set[str]]:
    """Names of the sequences that each tracker in `folder` has a result for; the folder `anno` is not a tracker."""
    places = {folder / part for s in sequences for part in ("", "results", s.benchmark, f"{s.benchmark}/results")}
    trackers = {p.name for place in places if place.is_dir() for p in visible(place.iterdir()) if p.is_dir()}
    return {name: {s.name for s in sequences if _find(folder, name, s)} for name in sorted(trackers - {"anno"})}


def _find(folder: Path, tracker: str, sequence: Sequence) -> Path | None:
    stem = sequence.name.rpartition("/")[2]
    own = folder / sequence.benchmark
    for place in (
        own / tracker,
        own / "results" / tracker,
        folder / "results" / tracker,
        folder / tracker,
        own,
        folder,
    ):
        for name in (f"{stem}.txt", f"{stem}.mat", f"{stem}_{tracker}.mat", f"{stem}_{tracker}.txt"):
            if (place / name).is_file():
                return place / name
    return None
