"""Builds trackers from their names, on the command line and in `racf.evaluate.evaluate`.

racf, racf-, racf--, bacf, arcf-hc     presets of racf.params, with any of its settings: racf,robust
csrt, kcf, mil, nano, vit              OpenCV's (see racf.evaluate.peers): nano,backbone=FILE,neckhead=FILE; `judged`
                                       puts their boxes under our confidence (see racf.judged), as `follow` does
module:Class                           your own (see racf.evaluate.own)
"""

import hashlib
from collections.abc import Generator, Iterable, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, cast

import cv2
import numpy as np
from typing_extensions import Self

import racf
from racf.evaluate import own
from racf.evaluate.own import OwnSpec
from racf.evaluate.peers import NETWORKS, OPENCV, PEERS, Peer, digest_of, opencv_has, peer_settings, require_opencv
from racf.evaluate.runner import Tracker, TrackerBuilder
from racf.judged import JudgedBoxes
from racf.nearest import hint
from racf.params import PRESETS, Params, preset, split_settings

__all__ = ["OPENCV", "PEERS", "Peer", "TrackerSpec", "builders_of", "opencv_has"]

# Files of the package on which no box depends: the fingerprint leaves them out and covers all others.
UNRELATED = {
    "cli.py", "commandline.py", "errors.py", "imagefolder.py", "judged.py", "nearest.py", "orientation.py",
    "parallel.py", "video.py", "video_writer.py",
}  # fmt: skip
# What the boxes of OpenCV's trackers depend on, and with the refinement: an edit of our filter leaves them as they are.
PEER_FILES = ("box.py", "evaluate/peers.py")
REFINING_FILES = ("patch.py", "refine.py")


@dataclass(frozen=True, slots=True)
class TrackerSpec:
    """A tracker by name, its settings as text, and the label of its row in tables."""

    label: str
    name: str
    settings: tuple[tuple[str, str], ...] = ()

    @classmethod
    def parse(cls, text: str) -> Self:
        """Read `name[,key=value...]`.  The label is the text without the files of a network."""
        name, settings = split_settings(text)
        files = NETWORKS.get(name, ())
        parts = [part for part in text.split(",") if part.partition("=")[0].strip() not in files]
        return cls(",".join(parts), name, settings)

    def check(self) -> None:
        """Raise ValueError for a name or a setting that is not known, or a tracker that is not installed."""
        if self.name in OPENCV:
            require_opencv(self.name)
            self._peer()
        elif ":" in self.name:
            own.build(self.name, dict(self.settings))
        else:
            self.params()

    def with_settings(self, settings: list[str]) -> Self:
        """The same with more settings, each `key=value`, or `key` alone for true."""
        return replace(self, settings=(*self.settings, *split_settings(",".join([self.name, *settings]))[1]))

    def build(self) -> Tracker:
        """A fresh tracker; raises ValueError for a name or a setting that is not known."""
        if self.name in OPENCV:
            judged, refine, files = self._peer()
            with _quiet_opencv():
                peer = Peer(self.name, refine=refine, files=files)
            return JudgedBoxes(peer) if judged else peer
        if ":" in self.name:
            return own.build(self.name, dict(self.settings))
        return racf.Racf(self.params())

    def flown(self) -> Self:
        """The same as `follow` flies it: an OpenCV tracker, which may report any box as found, is judged as well."""
        is_peer = self.name in OPENCV and dict(self.settings).get("judged", "false") == "false"
        return replace(self, settings=(*self.settings, ("judged", "true"))) if is_peer else self

    def _peer(self) -> tuple[bool, bool, dict[str, str]]:
        """Whether one of OpenCV's is judged and refined, and its network files; ValueError for another setting."""
        settings = dict(self.settings)
        judged = settings.pop("judged", "false")
        if judged not in {"true", "false"}:
            raise ValueError(f"judged is true or false, not {judged!r}")
        return (judged == "true", *peer_settings(self.name, settings))

    def params(self) -> Params:
        """The parameters of one of ours; raises ValueError for a name or a setting that is not known."""
        if self.name not in PRESETS:
            known = [*PRESETS, *OPENCV]
            every = f"there are {', '.join(known)}, and your own as module:Class"
            raise ValueError(f"there is no tracker {self.name!r}; {hint(self.name, known, every)}")
        return preset(self.name).with_settings(dict(self.settings))

    def fingerprint(self) -> str:
        """Changes whenever the boxes could: a digest of parameters, versions and the tracker's source."""
        source = _source_digest()
        if self.name in OPENCV:
            judged, refine, files = self._peer()
            what = f"{self.name} {Params() if refine else ''} {digest_of(files) if files else ''}{' judged' * judged}"
            peers = _digest(PEER_FILES + (REFINING_FILES if refine else ()))
            source = source + peers + _digest(["judged.py"]) if judged else peers
        elif ":" in self.name:
            what = f"{self.name} {self.settings} {own.source_of(own.load(self.name))}"
        else:
            what = repr(self.params())
        parts = (what, racf.__version__, cv2.__version__, np.__version__, source)
        return hashlib.sha256("\n".join(parts).encode()).hexdigest()[:16]


@contextmanager
def _quiet_opencv() -> Generator[None]:
    """Log errors only: at each start of a network OpenCV warns that a processor choice is not available."""
    logging = cv2.utils.logging
    level = logging.setLogLevel(logging.LOG_LEVEL_ERROR)
    try:
        yield
    finally:
        logging.setLogLevel(level)


def builders_of(trackers: object, settings: Iterable[str] = ()) -> list[TrackerBuilder]:
    """What to run, from names, specs, classes of your own, or a mapping of labels to any of these.

    `settings` (each key=value) are added to those given by name.  Raises ValueError for what is not known.
    """
    if isinstance(trackers, Mapping):
        given = [(str(label), what) for label, what in cast("Mapping[Any, Any]", trackers).items()]
    elif isinstance(trackers, str) or callable(trackers):
        given = [(None, trackers)]
    else:
        given = [(None, what) for what in (trackers if isinstance(trackers, Iterable) else (trackers,))]
    builders = [_builder(label, what, list(settings)) for label, what in given]
    labels = [builder.label for builder in builders]
    for label in labels:
        if labels.count(label) > 1:
            raise ValueError(f"each tracker is named once, not {label} {labels.count(label)} times")
    return builders


def _builder(label: str | None, what: Any, settings: list[str]) -> TrackerBuilder:
    if isinstance(what, str):
        spec = TrackerSpec.parse(what).with_settings(settings)
        spec.check()
        return spec if label is None else replace(spec, label=label)
    if callable(what):
        spec = OwnSpec(label or str(getattr(what, "__name__", what)), what)
        spec.build()
        return spec
    if all(hasattr(what, name) for name in ("label", "build", "fingerprint")):
        return cast("TrackerBuilder", what)
    raise ValueError(f"a tracker is a name, a class with {own.PROTOCOL}, or a TrackerSpec, not {what!r}")


def _source_digest() -> str:
    """Digest of the tracker's own files (not of this package, which only runs it)."""
    names = (path.name for path in Path(racf.__file__).parent.glob("*.py"))
    return _digest(name for name in names if name not in UNRELATED)


def _digest(names: Iterable[str]) -> str:
    """Of these files below the package's folder."""
    digest = hashlib.sha256()
    for name in sorted(names):
        digest.update((Path(racf.__file__).parent / name).read_bytes())
    return digest.hexdigest()
