"""One-pass evaluation as a library: benchmark readers, the runner, the published metrics, tables and plots.

    evaluation = racf.evaluate.evaluate("path/to/sequences", trackers=["racf", "racf,robust"], jitter=5)
    print(evaluation.summary[0].markdown())

`evaluate` does what `racf eval` does.  Its parts: `benchmarks` and `boxfiles` read sequences and boxes; `trackers`
builds a tracker from its name; `runner` runs them; `metrics` and `report` score the boxes; `plots` and `studies` show
results; `speed` measures the time of a frame.
"""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from racf.evaluate.benchmarks import Sequence as Sequence
    from racf.evaluate.benchmarks import read_benchmark as read_benchmark
    from racf.evaluate.evaluation import Evaluation as Evaluation
    from racf.evaluate.evaluation import evaluate as evaluate
    from racf.evaluate.trackers import TrackerSpec as TrackerSpec

__all__ = ["Evaluation", "Sequence", "TrackerSpec", "evaluate", "read_benchmark"]

_HOME = {
    "Evaluation": "racf.evaluate.evaluation",
    "Sequence": "racf.evaluate.benchmarks",
    "TrackerSpec": "racf.evaluate.trackers",
    "evaluate": "racf.evaluate.evaluation",
    "read_benchmark": "racf.evaluate.benchmarks",
}


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module 'racf.evaluate' has no attribute {name!r}")
    import importlib  # noqa: PLC0415 - only when a name is used: a flight imports only the box files

    return getattr(importlib.import_module(_HOME[name]), name)


def __dir__() -> list[str]:
    return sorted({*__all__, *(name for name in globals() if name.startswith("__"))})
