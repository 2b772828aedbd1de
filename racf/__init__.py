"""RACF: residue-aware correlation filters with GrabCut scale refinement (Li et al. 2021), as a library.

    import racf

    racf.one_core()
    tracker = racf.Racf("racf,robust")
    track = tracker.init(image, racf.Box(x, y, w, h))
    track = tracker.update(next_image)

`help(racf.Racf)` explains the tracker, `help(racf.Params)` its settings, `help(racf.evaluate.evaluate)` the evaluation
on benchmarks.  Names are loaded on first use, so that `import racf` stays quick.
"""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from racf import evaluate as evaluate
    from racf.box import Box as Box
    from racf.params import Params as Params
    from racf.params import preset as preset
    from racf.refine import Refined as Refined
    from racf.refine import Refiner as Refiner
    from racf.threads import one_core as one_core
    from racf.track import Track as Track
    from racf.tracker import Racf as Racf
    from racf.tracker import warm_up as warm_up
    from racf.video import Video as Video

    __version__: str

__all__ = ["Box", "Params", "Racf", "Refined", "Refiner", "Track", "Video", "evaluate", "one_core", "preset", "warm_up"]

_HOME = {
    "Box": "racf.box",
    "Params": "racf.params",
    "Racf": "racf.tracker",
    "Refined": "racf.refine",
    "Refiner": "racf.refine",
    "Track": "racf.track",
    "Video": "racf.video",
    "one_core": "racf.threads",
    "preset": "racf.params",
    "warm_up": "racf.tracker",
}


def __getattr__(name: str) -> Any:
    if name == "__version__":
        from importlib.metadata import version  # noqa: PLC0415 - only when it is used

        return version("follow-me")  # of the one distribution that holds racf, follow and sim
    if name not in __all__:
        raise AttributeError(f"module 'racf' has no attribute {name!r}")
    import importlib  # noqa: PLC0415 - only when a name is used

    if name not in _HOME:
        return importlib.import_module(f"racf.{name}")
    return getattr(importlib.import_module(_HOME[name]), name)


def __dir__() -> list[str]:
    return sorted({*__all__, "__version__", *(name for name in globals() if name.startswith("__"))})
