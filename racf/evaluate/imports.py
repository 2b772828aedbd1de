"""Stored boxes to compare with: `NAME=DIR`, `DIR` for all trackers in it, or the output folder of an evaluation."""

from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

from racf.errors import UsageError
from racf.evaluate.benchmarks import Sequence
from racf.evaluate.outcomes import read_outcomes
from racf.evaluate.stored import Stored, read_stored, sequences_of_trackers, trackers_in

Notify = Callable[[str], None]


def import_boxes(
    texts: Iterable[str], sequences: list[Sequence], taken: Iterable[str], notify: Notify
) -> dict[str, Stored]:
    """The stored boxes that each of `texts` names, by label; `taken` are the labels of the trackers that are run.

    `notify` is given a line for what is left out.  Raises UsageError that names a text without boxes.
    """
    found, running = dict[str, Stored](), set(taken)
    for text in texts:
        folder = Path(text.partition("=")[2] or text)
        if not folder.is_dir():
            raise UsageError(f"import {text}: {folder} is not a folder")
        for label, stored in _of(text, folder, sequences, running | set(found), notify):
            if label in running:
                label = f"{label} (stored)"  # noqa: PLW2901
            if label in found:
                raise UsageError(f"import {text}: {label} is imported already; NAME=DIR gives it another name")
            if len(stored.boxes) < len(sequences):
                notify(
                    f"import {text}: {label} has boxes for {len(stored.boxes)} of {len(sequences)} sequences; "
                    "the others are left out of the mean"
                )
            found[label] = stored
    return found


def _of(
    text: str, folder: Path, sequences: list[Sequence], taken: set[str], notify: Notify
) -> Iterator[tuple[str, Stored]]:
    """Label and boxes of each tracker that one text names."""
    name = text.partition("=")[0] if "=" in text else None
    ours = read_outcomes(folder, sequences)
    if ours:
        yield from _of_an_evaluation(text, name, folder, ours, taken)
        return
    names = [name] if name else _complete(text, folder, sequences, notify)
    if not names:
        raise UsageError(f"import {text}: {folder} has no boxes for any of the sequences")
    for tracker in names:
        stored = read_stored(folder, tracker, sequences)
        if not stored.boxes:
            raise UsageError(f"import {text}: {folder} has no boxes of {tracker} for any of the sequences")
        yield tracker, stored


def _of_an_evaluation(
    text: str, name: str | None, folder: Path, ours: dict[str, Stored], taken: set[str]
) -> Iterator[tuple[str, Stored]]:
    if not any(stored.boxes for stored in ours.values()):
        raise UsageError(f"import {text}: the evaluation in {folder} has none of the sequences")
    if name is None:
        for label, stored in ours.items():
            if stored.boxes:
                yield (f"{label} ({folder.name})" if label in taken else label), stored
    elif name in ours:
        yield name, ours[name]
    elif len(ours) == 1:
        yield name, next(iter(ours.values()))
    else:
        raise UsageError(
            f"import {text}: {folder} holds {', '.join(ours)}; NAME is one of these, or import a folder in runs"
        )


def _complete(text: str, folder: Path, sequences: list[Sequence], notify: Notify) -> list[str]:
    """The trackers of a folder that have the most sequences; `notify` gets those left out."""
    names = trackers_in(folder, sequences)
    for name, has in sequences_of_trackers(folder, sequences).items():
        if has and name not in names:
            notify(f"import {text}: {name} is left out, for it has boxes for only {len(has)} of the sequences")
    return names
