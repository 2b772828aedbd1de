"""Readers of the benchmarks' native layouts, and of a plain folder of sequences.

    name          frames                               annotations                      attributes
    folder        .../<name>/[img/]*.jpg               .../<name>/groundtruth_rect.txt  -
    dtb70         <name>/img/00001.jpg                 <name>/groundtruth_rect.txt      att/<name>.txt
    uav123        data_seq/UAV123/<folder>/000001.jpg  anno/UAV123/<name>.txt           anno/UAV123/att/<name>.txt
    uav123@10fps  the same with UAV123_10fps
    uavdt         <name>/img000001.jpg                 anno/<name>_gt.txt               att/<name>_att.txt
    visdrone2018  sequences/<name>/img0000001.jpg      annotations/<name>.txt           attributes/<name>_attr.txt

Annotations without frames (`anno/<name>.txt`) are enough to judge stored boxes.
"""

import re
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

from racf.box import Box
from racf.evaluate.boxfiles import read_boxes, read_numbers
from racf.evaluate.metrics import Boxes
from racf.imagefolder import image_paths, positions, visible

TRUTH_NAMES = ("groundtruth_rect.txt", "groundtruth.txt")
DEEPEST = 3  # how far below ROOT a folder of sequences may lie: ROOT/<benchmark>/<set>/<sequence>

# The columns of the benchmarks' attribute files, in the order of their toolkits' perfPlot.m.
UAV123_ATTRIBUTES = ("SV", "ARC", "LR", "FM", "FOC", "POC", "OV", "BC", "IV", "VC", "CM", "SOB")
VISDRONE_ATTRIBUTES = ("ARC", "BC", "CM", "FM", "FOC", "IV", "LR", "OV", "POC", "SOB", "SV", "VC")
UAVDT_ATTRIBUTES = ("BC", "CM", "OM", "SO", "IV", "OB", "SV", "LTT", "LO")
DTB70_ATTRIBUTES = ("SV", "ARV", "OCC", "DEF", "FCM", "IPR", "OPR", "OV", "BC", "SOA", "MB")

# UAV123 cuts `<folder>_1`, `_2`, ... out of one folder.  Each begins with the last frame of the one before it,
# except for these, which leave frames out (first frame at 30 per second, from the benchmark's configSeqs.m).
UAV123_FIRST_AFTER_A_GAP = {"bird1_2": 775, "bird1_3": 1573, "uav1_3": 2473}


@dataclass(frozen=True, slots=True, eq=False)
class Sequence:
    """A named video clip and its target's annotation.

    `truth` is (frames, 4), `x, y, w, h` in the benchmark's own 1-based pixels, NaN where the target is absent.
    `frames` is empty if there are only annotations; `missing` then names the files that were looked for.
    """

    name: str
    benchmark: str
    truth: Boxes
    frames: tuple[Path, ...] = ()
    attributes: tuple[str, ...] = ()
    missing: str = ""

    def first_box(self) -> Box:
        """The first annotation, in 0-based pixels; raises ValueError when it is not a box."""
        x, y, w, h = (float(v) for v in self.truth[0])
        try:
            return Box(x - 1, y - 1, w, h)
        except ValueError as error:
            raise ValueError(f"sequence {self.name}: the first annotation cannot start a tracker: {error}") from None

    def need_frames(self) -> None:
        """Raise FileNotFoundError unless there are frames to run a tracker on."""
        if not self.frames:
            raise FileNotFoundError(f"sequence {self.name} has no frames: {self.missing} does not exist")


def is_known(name: str) -> bool:
    """Whether a benchmark's layout is known by this name."""
    return _key(name) in _READERS


def read_benchmark(name: str, root: Path) -> list[Sequence]:
    """All sequences of a benchmark in its native layout, by name; by their path below `root` where names repeat.

    Raises ValueError for an unknown benchmark or a layout that is not found, and for a sequence whose frames and
    annotations do not belong together.
    """
    if not is_known(name):
        raise ValueError(f"benchmark {name!r} is not known; known are {', '.join(BENCHMARKS)}")
    if not root.is_dir():
        raise FileNotFoundError(f"{root} is not a folder")
    sequences = sorted(_READERS[_key(name)](root), key=lambda s: (s.benchmark, Path(s.name).name, s.name))
    if not sequences:
        raise ValueError(f"{root} holds no sequence in the layout of {name!r} (see the table in docs/evaluation.md)")
    return sequences


def _key(name: str) -> str:
    return re.sub(r"[^a-z0-9]", "", name.lower())


def _read_folder(root: Path) -> Iterator[Sequence]:
    found = list(_sequence_folders(root, DEEPEST))
    names = _names([folder for folder, _ in found], root)
    for name, (folder, truth_path) in zip(names, found, strict=True):
        truth = read_boxes(truth_path)
        inside = folder / "img"
        frames = all_frames(inside if inside.is_dir() else folder)
        benchmark = folder.resolve().parent.name
        yield Sequence(name, benchmark, truth, _matching(frames, truth, truth_path), missing=f"{folder}/*.jpg")
    if not found:
        yield from _annotations_only(root)


def _names(places: list[Path], root: Path) -> list[str]:
    """The last part of each path, the whole of it below `root` where several end alike."""
    often = Counter(place.name for place in places)
    return [place.name if often[place.name] == 1 else place.relative_to(root).as_posix() for place in places]


def _sequence_folders(folder: Path, depth: int) -> Iterator[tuple[Path, Path]]:
    """Every folder at most `depth` below with an annotation in it, and that annotation."""
    for name in TRUTH_NAMES:
        if (folder / name).is_file():
            yield folder, folder / name
            return
    if depth:
        for below in sorted(visible(folder.iterdir())):
            if below.is_dir():
                yield from _sequence_folders(below, depth - 1)


def _annotations_only(root: Path) -> Iterator[Sequence]:
    """`ROOT/anno/<name>.txt`, or one such folder for each benchmark in ROOT."""
    paths = sorted(visible([*root.glob("anno/*.txt"), *root.glob("*/anno/*.txt")]))
    places = [path.parents[1] / path.stem for path in paths]
    for name, place, path in zip(_names(places, root), places, paths, strict=True):
        yield Sequence(name, place.parent.resolve().name, read_boxes(path), missing=str(place))


def _read_uav123(root: Path, subset: str, frames_left_out: int) -> Iterator[Sequence]:
    truths = {path.stem: read_boxes(path) for path in visible((root / "anno" / subset).glob("*.txt"))}
    if not truths:
        yield from _annotations_only(root)
    images = root / "data_seq" / subset
    for name, truth in truths.items():
        folder, first = images / name, 1
        if not folder.is_dir():
            stem, first = _uav123_cut(name, truths, frames_left_out)
            folder = images / stem
        frames = _numbered(folder, "{:06d}.jpg", first, len(truth)) if folder.is_dir() else ()
        attributes = _attributes(root / "anno" / subset / "att" / f"{name}.txt", UAV123_ATTRIBUTES)
        yield Sequence(name, subset, truth, frames, attributes, missing=str(folder))


def _uav123_cut(name: str, truths: dict[str, Boxes], frames_left_out: int) -> tuple[str, int]:
    """The folder out of which a sequence is cut, and its first frame there.

    `frames_left_out` is 2 for the version at 10 frames per second, which keeps every third frame.
    """
    piece = re.fullmatch(r"(.+)_(\d+)", name)
    if piece is None:
        return name, 1
    stem, number = piece[1], int(piece[2])
    if name in UAV123_FIRST_AFTER_A_GAP:
        return stem, (UAV123_FIRST_AFTER_A_GAP[name] - 1) // (frames_left_out + 1) + 1
    before = f"{stem}_{number - 1}"
    if number == 1:
        return stem, 1
    if before not in truths:
        raise ValueError(f"sequence {name} begins where {before} ends, and the annotation of {before} is not there")
    return stem, _uav123_cut(before, truths, frames_left_out)[1] + len(truths[before]) - 1


def _read_uavdt(root: Path) -> Iterator[Sequence]:
    paths = sorted(visible((root / "anno").glob("*_gt.txt")))
    if not paths:
        yield from _annotations_only(root)
    for path in paths:
        name, truth = path.stem.removesuffix("_gt"), read_boxes(path)
        frames = _numbered(root / name, "img{:06d}.jpg", 1, len(truth)) if (root / name).is_dir() else ()
        attributes = _attributes(root / "att" / f"{name}_att.txt", UAVDT_ATTRIBUTES)
        yield Sequence(name, "UAVDT", truth, frames, attributes, missing=str(root / name))


def _read_visdrone(root: Path) -> Iterator[Sequence]:
    paths = sorted(visible((root / "annotations").glob("*.txt")))
    if not paths:
        yield from _annotations_only(root)
    for path in paths:
        truth, folder = read_boxes(path), root / "sequences" / path.stem
        frames = _numbered(folder, "img{:07d}.jpg", 1, len(truth)) if folder.is_dir() else ()
        attributes = _attributes(root / "attributes" / f"{path.stem}_attr.txt", VISDRONE_ATTRIBUTES)
        yield Sequence(path.stem, "VisDrone2018-SOT", truth, frames, attributes, missing=str(folder))


def _read_dtb70(root: Path) -> Iterator[Sequence]:
    for sequence in _read_folder(root):
        attributes = _attributes(root / "att" / f"{sequence.name}.txt", DTB70_ATTRIBUTES)
        yield replace(sequence, benchmark="DTB70", attributes=attributes)


def all_frames(folder: Path) -> tuple[Path, ...]:
    """The images of a folder in order; raises ValueError that says what to do about a gap in their numbers."""
    paths = image_paths(folder)
    for (path, following), (before, after) in zip(pairwise(paths), pairwise(positions(paths)), strict=True):
        if missing := after - before - 1:
            images = "one image is" if missing == 1 else f"{missing} images are"
            raise ValueError(
                f"{folder}: {images} missing between {path.name} and {following.name}, and each box belongs to one "
                f"image: copy what is missing, or if it never was, number the images without a gap"
            )
    return tuple(paths)


def _matching(frames: tuple[Path, ...], truth: Boxes, truth_path: Path) -> tuple[Path, ...]:
    """The frames, if there is one for each annotation or none at all."""
    if frames and len(frames) != len(truth):
        raise ValueError(
            f"{truth_path}: one annotation for each frame is needed, not {len(truth)} for {len(frames)} frames"
        )
    return frames


def _numbered(folder: Path, pattern: str, first: int, count: int) -> tuple[Path, ...]:
    """`count` frames from number `first` on; raises ValueError naming the first that is not there."""
    there = {path.name for path in folder.iterdir()}
    names = [pattern.format(number) for number in range(first, first + count)]
    for name in names:
        if name not in there:
            raise ValueError(f"{folder}: frame {name} is missing (the annotation has {count} rows from frame {first})")
    return tuple(folder / name for name in names)


def _attributes(path: Path, names: tuple[str, ...]) -> tuple[str, ...]:
    """The attributes that a file of zeros and ones sets; empty if there is no file."""
    if not path.is_file():
        return ()
    flags = [flag for row in read_numbers(path) for flag in row]
    if len(flags) < len(names):
        raise ValueError(f"{path}: {len(names)} attributes are needed ({', '.join(names)}), not {len(flags)}")
    return tuple(name for name, flag in zip(names, flags, strict=False) if flag > 0)


_READERS: dict[str, Callable[[Path], Iterator[Sequence]]] = {
    "folder": _read_folder,
    "dtb70": _read_dtb70,
    "uav123": lambda root: _read_uav123(root, "UAV123", 0),
    "uav12310fps": lambda root: _read_uav123(root, "UAV123_10fps", 2),
    "uavdt": _read_uavdt,
    "visdrone2018": _read_visdrone,
    "visdrone2018sot": _read_visdrone,
    "visdrone2018sottestdev": _read_visdrone,
}
BENCHMARKS = ("folder", "uav123", "uav123@10fps", "dtb70", "uavdt", "visdrone2018")
