"""The figures of an evaluation as JSON holds them; shares are percent.  A key that does not apply is absent."""

from typing import TypedDict

from typing_extensions import NotRequired


class ScoreFigures(TypedDict):
    """The four figures of a sequence, or their means over several: toolkit convention, then strict."""

    precision_20px: float
    auc: float
    precision_20px_strict: float
    auc_strict: float


class JitterFigures(ScoreFigures):
    """The mean over jittered starts."""

    starts: int


class IntervalFigures(TypedDict):
    """95 % bootstrap intervals over sequences: [low, high]."""

    precision_20px: list[float]
    auc: list[float]


class DifferenceFigures(TypedDict):
    """Mean over sequences of a tracker's figure minus that of the tracker `to`, paired by sequence."""

    to: str
    precision_20px: float
    auc: float
    interval_95: IntervalFigures


class DifferencesFigures(DifferenceFigures):
    """The difference from the annotated first box, and from jittered ones if both trackers have the same number."""

    jittered: NotRequired[DifferenceFigures]


class SequenceFigures(ScoreFigures):
    """One tracker on one sequence."""

    fps: NotRequired[float]
    jittered: NotRequired[ScoreFigures]
    frames: int
    benchmark: str
    counted: bool


class TrackerFigures(ScoreFigures):
    """One tracker over all counted sequences."""

    fps: NotRequired[float]
    interval_95: IntervalFigures
    difference: NotRequired[DifferencesFigures]
    jittered: NotRequired[JitterFigures]
    benchmarks: NotRequired[dict[str, ScoreFigures]]
    attributes: NotRequired[dict[str, ScoreFigures]]
    sequences: dict[str, SequenceFigures]


class CostFigures(TypedDict):
    """The cost of a frame: its share of a 30 Hz camera's time, cycles, and the least operations and bytes."""

    share_of_30hz_percent: float
    least_megaflops: float
    least_megabytes: float
    megacycles: NotRequired[float]


class SpeedFigures(TypedDict):
    """One tracker's speed: frames per second, median milliseconds by stage, and the least that a stage can take."""

    fps: float
    ms: NotRequired[dict[str, float]]
    times_as_fast_as: NotRequired[dict[str, float]]
    floor_ms: NotRequired[dict[str, float]]
    cost: NotRequired[CostFigures]


class ClipFigures(TypedDict):
    """One tracker on one clip."""

    fps: float
    frames: int


class MachineFigures(TypedDict):
    """Where a speed was measured."""

    cpu: str
    python: str
    opencv: str
    threads: int


class BenchFigures(TypedDict):
    """What `racf bench --json` prints."""

    tracker: dict[str, SpeedFigures]
    peers: dict[str, SpeedFigures]
    clips: dict[str, dict[str, ClipFigures]]
    machine: MachineFigures
    first_call: NotRequired[dict[str, dict[str, float]]]
    memory_mb: NotRequired[dict[str, float]]
