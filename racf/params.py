"""The tracker's settings: one flat frozen dataclass, and the paper's variants as presets.

[Paper] is Li et al., "Learning Residue-Aware Correlation Filters and Refining Scale Estimates with the GrabCut for
Real-Time UAV Tracking" (2021); [ARCF] the published parameters of ARCF-HC, whose features and scale filter the paper
says it uses; [measured] points to the tables in docs/notebook.md and docs/study.md.
"""

import math
import numbers
from dataclasses import dataclass, fields, replace
from typing import Any

from typing_extensions import Self

from racf.nearest import hint

_FRACTIONS = (
    "learning_rate", "scale_learning_rate", "refine_min_iou", "refine_blend", "strict_iou",
    "confidence_rate", "confidence_rate_doubtful", "velocity_rate", "velocity_decay",
)  # fmt: skip
ROBUST = ("gate_learning", "strict_refine", "predict_motion", "predict_scale", "coast", "redetect")
"""The switches that the word `robust` stands for."""
_WEIGHTS = ("residue", "spatial", "bowl", "temporal", "ridge", "aberrance", "redetect_near")


AT_MOST = {
    "admm_iterations": 1000, "newton_iterations": 1000, "refine_iterations": 1000, "redetect_places": 1000,
    "redetect_reach": 100, "cell_px": 64, "scales": 333, "scale_step": 2.0, "search_area": 1000.0,
    "sample_max_px": 4000, "refine_size_px": 4000, "scale_model_area_px": 1_000_000,
    "residue": 1e6, "spatial": 1e6, "bowl": 1e6, "temporal": 1e6, "ridge": 1e6, "aberrance": 1e6,
    "penalty": 1e9, "penalty_growth": 1e9, "penalty_max": 1e9, "label_sigma": 1e3, "scale_sigma": 1e3,
    "scale_ridge": 1e9,
}  # fmt: skip
"""Upper bounds far beyond any use: more would exhaust the memory or the time, or overflow float32."""

# Settings whose least value depends on another one.
_FROM = {"sample_min_px": " (4 cell_px)", "sample_max_px": " (sample_min_px)", "scale_model_area_px": " (4 cell_px²)"}


@dataclass(frozen=True, slots=True)
class Params:
    """All numbers and switches of a tracker.  Lengths are pixels of the fixed-size sample unless a unit says otherwise.

    `Params(...).robust()` switches on what a follower needs.  `Params()` is `racf-`, so that `Params().robust()` is
    `racf-,robust` as text; `racf` also refines: `preset("racf,robust")`.
    """

    # Sample and features [ARCF]
    cell_px: int = 4
    search_area: float = 5.0  # side of the square sample over sqrt(target area)
    sample_min_px: int = 150  # smallest side that the sample is resampled to
    sample_max_px: int = 200  # largest side that the sample is resampled to
    label_sigma: float = 1 / 24  # of the Gaussian label, over sqrt(target area) in cells: not given [measured]
    learning_rate: float = 0.0315  # alpha, Eq. 14: not given [measured]
    colour_names: bool = True  # colour-name channels of colour images; grey images never have them

    # Filter: the terms of Eq. 3 and their solver
    residue: float = 1.0  # eta [Paper]
    residue_to_model: bool = True  # residue against the previous model, not the previous sample [measured]
    spatial: float = 0.5  # theta [Paper]
    bowl: float = 1.5  # rho: height of the bowl's rim [Paper, form measured]
    temporal: float = 0.01  # tau [Paper]
    ridge: float = 0.55  # lambda [Paper]
    aberrance: float = 0.0  # gamma, Eq. 2: ARCF's term
    admm_iterations: int = 2  # [Paper]
    warm_start: bool = True  # iterations start from the last frame's filter, not from zero: not given [measured]
    penalty: float = 1.0  # mu of the first iteration [ARCF]
    penalty_growth: float = 10.0  # beta: factor on mu from one iteration to the next [ARCF]
    penalty_max: float = 10_000.0  # mu_max: mu grows no further [ARCF]
    reuse_cells: float = 0.0  # a target that moved no further is learned from the sample that localised it [measured]
    newton_iterations: int = 5  # on the interpolated response [ARCF]; the authors' RACF takes none [measured]

    # Scale filter [ARCF, fDSST]
    scales: int = 33
    scale_step: float = 1.03
    scale_sigma: float = 0.5  # of the scale label, over sqrt(scales)
    scale_learning_rate: float = 0.025
    scale_ridge: float = 1e-4
    scale_model_area_px: int = 512  # largest area of the target that the scale filter describes

    # GrabCut refinement
    refine: bool = False
    refine_size_px: int = 52  # s_g [Paper]
    refine_margin_px: float = 12.0  # Delta s, in pixels of the frame [Paper]
    refine_min_iou: float = 0.7  # sigma: the paper prints 0.5 [measured]
    refine_iterations: int = 3
    refine_blend: float = 0.5  # weight of the segment's box in the refined box [measured]
    refine_renew: int = 10  # frames for which GrabCut's colour models serve [measured]
    refine_pause: int = 31  # most frames skipped after rejected segments [measured]
    refine_min_target_px: float = 20.0  # smaller targets are too few pixels to segment [measured]

    # What a follower needs and the paper lacks: six switches (`robust` means all six) and their numbers
    gate_learning: bool = False  # learn, estimate scale and refine only in frames whose response is clear
    strict_refine: bool = False  # a segment must overlap the box by more than strict_iou, within strict_aspect
    predict_motion: bool = False  # search where the target's smoothed motion predicts it
    predict_scale: bool = False  # search with the size that the optical flow of the target's pixels predicts [measured]
    coast: bool = False  # a lost target's box follows the prediction, not the response
    redetect: bool = False  # search for a lost target further afield
    tighten: bool = False  # start again on what moves out of a loose first box [measured: docs/confidence.md]
    learn_above: float = 0.6  # gate_learning: least confidence (PSR and peak over their running means) of a clear frame
    # gate_learning: a clear frame is learned with a fraction of learning_rate, from 0 at this confidence to 1 at full
    # confidence: a slow occluder is learned less, a target that turns by 45 degrees/s still enough [measured].
    learn_share_from: float = 0.3
    lost_below: float = 0.5  # the target counts as lost below this confidence
    regain_above: float = 0.7  # a lost target is found again at this confidence
    # A memory of a hundred clear frames.  At 0.1 the means would follow a slow occlusion (PSR 14 to 5 within 0.7 s)
    # down, and the tracker would take the wall for the target [measured, sim wall].
    confidence_rate: float = 0.01  # of the running means, in clear frames
    confidence_rate_doubtful: float = 0.002  # of the running means, in other frames: a memory of five hundred
    usual_psr_max: float = 20.0  # cap of the running mean: a PSR above it is always sharp [measured]
    usual_psr_min: float = 10.0  # targets with features begin with at least 8 [measured]
    least_psr: float = 5.0  # a response below it is not the target: sky, noise and black have 3 to 4.5 [measured]
    settle_frames: int = 5  # frames after the start before the running means are used: see `racf.confidence`
    strict_iou: float = 0.8  # strict_refine: least overlap [measured]
    # strict_refine: largest factor between the box's aspect (w/h) and the first one's.  Without it, segments each a
    # little wider than the box made a walker's box 1.9 times as wide within a second [measured, sim trees].
    strict_aspect: float = 1.25
    velocity_rate: float = 0.35  # predict_motion: rate of the running mean of the motion [measured]
    velocity_decay: float = 0.95  # predict_motion: factor on the motion in each frame without the target
    redetect_glance: float = 0.35  # redetect: least confidence of an off-centre match for a second, centred search
    redetect_near: float = 1.0  # redetect: a match this near to the expected position, in sides, is the target
    redetect_agree: int = 10  # redetect: frames for which matches further away are compared before one is accepted
    redetect_places: int = 4  # redetect: positions searched per frame, a target's side or half a search region apart
    redetect_reach: int = 3  # redetect: most steps to each side
    redetect_patience: int = 10  # redetect: frames lost for each further step

    def __post_init__(self) -> None:
        for name, kind in self.field_types().items():
            self._require_kind(name, kind)
            if kind is float and not math.isfinite(getattr(self, name)):
                raise ValueError(f"{name} is a finite number, not {getattr(self, name)}")
        for name in _FRACTIONS:
            if not 0 <= getattr(self, name) <= 1:
                raise ValueError(f"{name} is between 0 and 1, not {getattr(self, name)}")
        for name in _WEIGHTS:
            if getattr(self, name) < 0:
                raise ValueError(f"{name} is at least 0, not {getattr(self, name)}")
        self._require_bounds()
        if not 0 < self.usual_psr_min <= self.usual_psr_max:
            raise ValueError(f"usual_psr_min is positive and at most usual_psr_max, not {self.usual_psr_min}")
        if self.scale_ridge <= 0:
            raise ValueError(f"scale_ridge is positive, not {self.scale_ridge}")
        if self.scale_step <= 1:
            raise ValueError(f"scale_step is above 1, not {self.scale_step}")

    def _require_kind(self, name: str, kind: type) -> None:
        """Raise ValueError unless a setting is of its type; numpy's numbers are allowed."""
        value = getattr(self, name)
        if kind is bool:
            if not isinstance(value, bool):
                raise ValueError(f"{name} is true or false, not {value!r}")
        elif isinstance(value, bool) or not isinstance(value, numbers.Integral if kind is int else numbers.Real):
            raise ValueError(f"{name} is a number ({kind.__name__}), not {value!r}")

    def _require_bounds(self) -> None:
        """Raise ValueError for a setting below its least value or above AT_MOST."""
        for name, most in AT_MOST.items():
            if getattr(self, name) > most:
                raise ValueError(f"{name} is at most {most}, not {getattr(self, name)}")
        at_least = {
            "cell_px": 1, "admm_iterations": 1, "newton_iterations": 0, "reuse_cells": 0.0, "scales": 3,
            "refine_size_px": 16, "refine_iterations": 1, "redetect_agree": 1, "redetect_places": 0,
            "redetect_reach": 1, "redetect_patience": 1, "search_area": 1.0, "sample_min_px": 4 * self.cell_px,
            "sample_max_px": self.sample_min_px, "scale_model_area_px": 4 * self.cell_px**2, "refine_margin_px": 0.0,
            "label_sigma": 1e-6, "scale_sigma": 1e-6, "penalty": 1e-6, "penalty_max": 1e-6, "penalty_growth": 1.0,
            "strict_aspect": 1.0,
        }  # fmt: skip
        for name, least in at_least.items():
            if getattr(self, name) < least:
                raise ValueError(f"{name} is at least {least}{_FROM.get(name, '')}, not {getattr(self, name)}")

    def robust(self, on: bool = True) -> Self:
        """A copy with the six switches of `ROBUST`, which a follower needs, all on (or all off)."""
        return replace(self, **dict.fromkeys(ROBUST, on))

    @classmethod
    def field_types(cls) -> dict[str, type]:
        """Name and type (bool, int or float) of every parameter, for a command line's `--set name=value`."""
        return {field.name: type(field.default) for field in fields(cls)}

    def with_settings(self, settings: dict[str, str]) -> Self:
        """A copy with fields set from text; raises ValueError naming the field, the rule and the value."""
        types, base, values = self.field_types(), self, dict[str, Any]()
        for name, text in settings.items():
            if name == "robust":  # stands for its switches; one that is named beside it overrides
                base = self.robust(bool(_parse(name, text, bool)))
            elif name not in types:
                known = sorted([*types, "robust"])
                raise ValueError(f"the tracker has no setting {name!r}; {hint(name, known)}")
            else:
                values[name] = _parse(name, text, types[name])
        return replace(base, **values)


def _parse(name: str, text: str, kind: type) -> bool | int | float:
    if kind is bool:
        words = {"true": True, "1": True, "on": True, "": True, "false": False, "0": False, "off": False}
        if text.lower() not in words:
            raise ValueError(f"{name} is true or false, not {text!r}")
        return words[text.lower()]
    try:
        return kind(text)
    except ValueError:
        raise ValueError(f"{name} is a number ({kind.__name__}), not {text!r}") from None


_RACF_MINUS = Params()
_RACF_MINUS_MINUS = replace(_RACF_MINUS, spatial=0.0, temporal=0.0)
# The baselines have the label, ridge, rates and cold start of their authors' published code.
_BASELINE = replace(_RACF_MINUS_MINUS, residue=0.0, label_sigma=1 / 16, ridge=0.01, warm_start=False)
PRESETS = {
    "racf": replace(_RACF_MINUS, refine=True),
    "racf-": _RACF_MINUS,
    "racf--": _RACF_MINUS_MINUS,
    "bacf": replace(_BASELINE, learning_rate=0.013),
    "arcf-hc": replace(_BASELINE, learning_rate=0.0192, aberrance=0.71, admm_iterations=5),
}
"""The paper's three variants (Table 1) and its two baselines."""


def preset(text: str) -> Params:
    """The parameters that `text` names, a preset and its settings: `racf`, `racf,robust`, `bacf,admm_iterations=3`.

    A setting without a value is true.  Raises ValueError that lists the presets, or names the setting, rule and value.
    """
    name, settings = split_settings(text)
    if name not in PRESETS:
        raise ValueError(f"there is no tracker {name!r}; {hint(name, PRESETS)}")
    return PRESETS[name].with_settings(dict(settings))


def split_settings(text: str) -> tuple[str, tuple[tuple[str, str], ...]]:
    """The name and the (key, value) settings of `name[,key=value...]`; a key alone is true."""
    name, *settings = (part.strip() for part in text.split(","))
    pairs = ((key.strip(), value.strip() or "true") for key, _, value in (part.partition("=") for part in settings))
    return name, tuple(pairs)
