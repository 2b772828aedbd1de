"""Boxes that somebody's tracker left in files, found for the sequences of a benchmark.

Known arrangements, with `.txt` or `.mat` files: `DIR/<sequence>`, `DIR/<tracker>/<sequence>`, the same in a folder
`DIR/<benchmark>` or `results` (also `DIR/<benchmark>/results`), and the toolkits' `<sequence>_<tracker>.mat`.
"""

from collections.abc import Iterable
from pathlib import Path

from racf.evaluate.benchmarks import Sequence
from racf.evaluate.boxfiles import read_boxes
from racf.evaluate.metrics import Boxes


def stored_boxes(folder: Path, tracker: str, sequences: Iterable[Sequence]) -> dict[str, Boxes]:
    """Boxes of a tracker by sequence, for those sequences that it has; raises ValueError when a file is too short."""
    found: dict[str, Boxes] = {}
    for sequence in sequences:
        path = _find(folder, tracker, sequence)
        if path is not None:
            boxes = read_boxes(path)
            if len(boxes) != len(sequence.truth):
                raise ValueError(f"{path}: {len(sequence.truth)} boxes are needed, one a frame, not {len(boxes)}")
            found[sequence.name] = boxes
    return found


def trackers_in(folder: Path, sequences: list[Sequence]) -> list[str]:
    """The trackers that have a result for as many of the sequences as any does, by name."""
    places = {folder / part for s in sequences for part in ("", "results", s.benchmark, f"{s.benchmark}/results")}
    names = {below.name for place in places if place.is_dir() for below in place.iterdir() if below.is_dir()}
    covered = {name: sum(_find(folder, name, s) is not None for s in sequences) for name in names}
    most = max(covered.values(), default=0)
    return sorted(name for name, count in covered.items() if count == most and most > 0)


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
