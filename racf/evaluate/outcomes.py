"""The boxes that an evaluation stores in `OUT/runs`, and how a later evaluation reuses them.

OUT/runs/<label>-<fingerprint>/<benchmark>/<sequence>[.startN].txt     boxes, 1-based, a line a frame
OUT/runs/<label>-<fingerprint>/<benchmark>/<sequence>[.startN].json    key, label, frames per second, stage times

A sequence that is named by its path, because another has the same name, lies in the folders of that path.
"""

import glob
import json
import math
import os
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from racf.evaluate.benchmarks import Sequence
from racf.evaluate.boxfiles import read_boxes, write_boxes
from racf.evaluate.metrics import Boxes
from racf.evaluate.stored import Stored

if TYPE_CHECKING:
    from racf.evaluate.runner import SequenceRun, Task

FOLDER = "runs"


def store(folder: Path, task: "Task", run: "SequenceRun") -> None:
    """Write the boxes, then the note that declares them complete: an interruption in between leaves no note."""
    boxes, note = _places(folder, task)
    boxes.parent.mkdir(parents=True, exist_ok=True)
    note.unlink(missing_ok=True)
    write_boxes(boxes, run.boxes)
    half = note.with_suffix(".part")
    known = {"key": task.key(), "label": task.spec.label, "fps": run.fps, "stage_ms": run.stage_ms}
    half.write_text(json.dumps(known))
    half.replace(note)


def find(folder: Path, task: "Task") -> tuple[Boxes, dict[str, Any]] | None:
    """The boxes and the note of an earlier evaluation, if they belong to this task (same key) and are complete."""
    place, note = _places(folder, task)
    try:
        known, boxes = _noted(note), read_boxes(place)
    except (OSError, ValueError):
        return None  # missing, or cut short by a full disk or a power loss: the task is run again
    return (boxes, known) if known["key"] == task.key() and len(boxes) == len(task.frames) else None


def read_outcomes(folder: Path, sequences: Iterable[Sequence]) -> dict[str, Stored]:
    """The results by label that an evaluation stored in `folder`; where two have the same label, the newer.

    Empty where `folder` is not the output of an evaluation.
    """
    sequences = list(sequences)
    newest: dict[str, tuple[float, Path]] = {}
    for place in _trackers(folder):
        notes = list(place.rglob("*.json"))
        if notes:
            label = str(_noted(notes[0]).get("label", place.name.rpartition("-")[0]))
            newest[label] = max(newest.get(label, (0.0, place)), (max(n.stat().st_mtime for n in notes), place))
    return {label: _read(place, sequences) for label, (_, place) in sorted(newest.items())}


def _trackers(folder: Path) -> Iterator[Path]:
    """Folders of one tracker each: below OUT, OUT/runs, or `folder` itself where it is one of them."""
    root = folder / FOLDER if (folder / FOLDER).is_dir() else folder
    if root.name != FOLDER:
        if root.parent.name == FOLDER:
            yield root
        return
    yield from sorted(place for place in root.iterdir() if place.is_dir())


def _read(place: Path, sequences: list[Sequence]) -> Stored:
    found = Stored({})
    for sequence in sequences:
        stem = place / sequence.benchmark / sequence.name
        boxes, note = Path(f"{stem}.txt"), Path(f"{stem}.json")
        if not note.is_file():
            continue
        found.boxes[sequence.name] = _checked(boxes, sequence)
        found.fps[sequence.name] = _noted(note)["fps"]
        starts = sorted(
            boxes.parent.glob(f"{glob.escape(stem.name)}.start*.txt"), key=lambda p: int(p.stem.rpartition(".start")[2])
        )
        if starts:
            found.jittered[sequence.name] = [_checked(path, sequence) for path in starts]
    return found


def _noted(note: Path) -> dict[str, Any]:
    """What a note says; raises ValueError that names the file."""
    try:
        known = json.loads(note.read_text())
    except ValueError as error:
        raise ValueError(f"{note} is not the JSON that an evaluation leaves: {error}; delete it") from None
    if not isinstance(known, dict) or not {"key", "fps"} <= set(known):
        raise ValueError(f"{note} is not what an evaluation leaves: it needs key and fps; delete it")
    stages = known.setdefault("stage_ms", {})
    if not isinstance(stages, dict) or not all(map(_is_number, (known["fps"], *stages.values()))):
        raise ValueError(f"{note} is not what an evaluation leaves: fps and stage_ms are numbers; delete it")
    return known


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and math.isfinite(value)


def _checked(path: Path, sequence: Sequence) -> Any:
    boxes = read_boxes(path)
    if len(boxes) != len(sequence.truth):
        raise ValueError(f"{path}: {len(sequence.truth)} boxes are needed, one a frame, not {len(boxes)}")
    return boxes


def _places(folder: Path, task: "Task") -> tuple[Path, Path]:
    start = f".start{task.start}" if task.start else ""
    tracker = f"{task.spec.label.replace(os.sep, '_')}-{task.spec.fingerprint()}"
    stem = folder / FOLDER / tracker / task.benchmark / (task.sequence + start)
    return Path(f"{stem}.txt"), Path(f"{stem}.json")
