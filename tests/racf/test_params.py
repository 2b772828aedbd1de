"""Settings of the tracker: each one changes something, and `robust` is a word for its switches."""

import dataclasses
import hashlib
from functools import cache
from typing import Any

import cv2
import numpy as np
import pytest

from racf import Box, Params, Racf, preset
from racf.params import AT_MOST, PRESETS, ROBUST

ROWS, COLS, SIDE, FRAMES = 200, 320, 34, 64
START = Box(40, 84, 30, 34)  # a little wrong, so that the refinement has something to correct


@cache
def clip(ground_px: int = 3) -> list[np.ndarray]:
    """A target that moves, grows, passes behind a wall and comes out elsewhere; (200, 320, 3) each."""
    rng = np.random.default_rng(7)
    ground = cv2.GaussianBlur(rng.integers(0, 256, (ROWS, COLS, 3), dtype=np.uint8), (0, 0), ground_px)
    ground = cv2.normalize(ground, None, 60, 190, cv2.NORM_MINMAX)
    pattern = cv2.resize(rng.integers(0, 256, (5, 5, 3), dtype=np.uint8), (SIDE, SIDE), interpolation=cv2.INTER_NEAREST)
    wall = cv2.GaussianBlur(rng.integers(0, 256, (ROWS, 70, 3), dtype=np.uint8), (0, 0), 1)
    images = []
    for k in range(FRAMES):
        image, side = ground.copy(), round(SIDE * 1.006**k)
        x, y = (40 + 3 * k + k * k // 100, 82 + k // 3) if k < 40 else (260 - (k - 40), 20)
        image[y : y + side, x : x + side] = cv2.resize(pattern, (side, side))[:, : max(COLS - x, 0)]
        if 18 <= k < 46:
            image[:, 110 : 110 + 70] = wall
        images.append(np.clip(image + rng.normal(0, 4, image.shape), 0, 255).astype(np.uint8))
    return images


@cache
def outcome(params: Params) -> str:
    """Digest of all that a run of the clip gives out, except times."""
    tracker = Racf(params)
    tracks = [tracker.init(clip()[0], START), *(tracker.update(image) for image in clip()[1:])]
    given = [
        (t.box, t.search, t.psr, t.confidence, t.found, t.refined, None if t.mask is None else t.mask.tobytes())
        for t in tracks
    ]
    return hashlib.sha256(repr(given).encode()).hexdigest()


ALL = dataclasses.replace(preset("racf,robust"), aberrance=0.0)
OTHER: dict[str, tuple[Any, dict[str, Any]]] = {
    "cell_px": (5, {}), "search_area": (4.0, {}), "sample_min_px": (190, {}),
    "sample_max_px": (160, {"search_area": 7.0}),
    "label_sigma": (1 / 16, {}), "learning_rate": (0.02, {}), "colour_names": (False, {}),
    "residue": (0.2, {}), "residue_to_model": (False, {}), "spatial": (0.1, {}), "bowl": (3.0, {}),
    "temporal": (0.1, {}), "ridge": (0.1, {}), "aberrance": (0.7, {}), "admm_iterations": (3, {}),
    "warm_start": (False, {}), "penalty": (3.0, {}), "penalty_growth": (5.0, {}), "penalty_max": (5.0, {}),
    "newton_iterations": (0, {}), "reuse_cells": (1.5, {}),
    "scales": (17, {}), "scale_step": (1.02, {}), "scale_sigma": (1.0, {}),
    "scale_learning_rate": (0.3, {}), "scale_ridge": (100.0, {}), "scale_model_area_px": (300, {}),
    "refine": (False, {}), "refine_size_px": (40, {}), "refine_margin_px": (6.0, {}),
    "refine_min_iou": (0.95, {"strict_refine": False}), "refine_iterations": (1, {}), "refine_blend": (0.2, {}),
    "refine_renew": (1, {}), "refine_pause": (0, {}), "refine_min_target_px": (60.0, {}),
    "gate_learning": (False, {"learn_above": 0.9, "usual_psr_max": 99.0}),
    "strict_refine": (False, {"strict_iou": 0.95}),
    "predict_motion": (False, {}), "predict_scale": (False, {}), "coast": (False, {}), "redetect": (False, {}),
    "tighten": (False, {}),
    "learn_above": (0.95, {"usual_psr_max": 99.0}),
    "learn_share_from": (0.9, {"usual_psr_max": 99.0}),
    "lost_below": (0.3, {}), "regain_above": (0.95, {}), "confidence_rate": (0.3, {}),
    "confidence_rate_doubtful": (0.2, {}),
    "usual_psr_max": (60.0, {}), "usual_psr_min": (50.0, {"usual_psr_max": 60.0}), "least_psr": (30.0, {}),
    "settle_frames": (0, {"learn_above": 0.99, "usual_psr_max": 99.0}), "strict_iou": (0.95, {}),
    "strict_aspect": (1.0, {}),
    "velocity_rate": (0.1, {}), "velocity_decay": (0.5, {}), "redetect_glance": (0.9, {}),
    "redetect_near": (9.0, {"redetect_patience": 1}), "redetect_agree": (1, {"redetect_patience": 1}),
    "redetect_places": (0, {"redetect_patience": 1}),
    "redetect_reach": (1, {"redetect_patience": 1, "search_area": 3.0}), "redetect_patience": (1, {}),
}  # fmt: skip
"""Another value of each setting, and what must be set beside it for that to matter."""


def test_every_setting_has_another_value_here():
    assert set(OTHER) == set(Params.field_types())


# Of a right first box `tighten` changes nothing: test_leaving.
@pytest.mark.parametrize("name", [name for name in OTHER if name != "tighten"])
def test_every_setting_changes_what_the_tracker_gives_out(name):
    value, beside = OTHER[name]
    base = dataclasses.replace(ALL, **beside)
    assert outcome(dataclasses.replace(base, **{name: value})) != outcome(base)


@pytest.mark.parametrize("name", AT_MOST)
def test_a_setting_that_would_take_the_memory_or_never_end_is_refused(name):
    most = AT_MOST[name]
    assert getattr(Params(), name) < most / 2 or name == "scale_step"
    with pytest.raises(ValueError, match=rf"{name} is at most {most}, not "):
        Racf(f"racf,{name}={100 * most}")


@pytest.mark.parametrize(
    ("wrong", "told"),
    [
        ("sample_max_px=100", r"sample_max_px is at least 150 \(sample_min_px\), not 100"),
        ("sample_min_px=16,cell_px=8", r"sample_min_px is at least 32 \(4 cell_px\), not 16"),
        ("scale_model_area_px=10", r"scale_model_area_px is at least 64 \(4 cell_px²\), not 10"),
        ("scales=2", "scales is at least 3, not 2"),
        ("penalty=1e-300", "penalty is at least 1e-06, not 1e-300"),
        ("penalty_growth=0.5", "penalty_growth is at least 1.0, not 0.5"),
        ("label_sigma=1e-300", "label_sigma is at least 1e-06, not 1e-300"),
        ("refine_margin_px=-1e300", r"refine_margin_px is at least 0\.0, not -1e\+300"),
    ],
)
def test_a_setting_below_its_least_value_is_told_with_what_that_follows_from(wrong, told):
    with pytest.raises(ValueError, match=told):
        Racf(f"racf,{wrong}")


@pytest.mark.parametrize(
    ("wrong", "told"),
    [
        ({"cell_px": "4"}, r"cell_px is a number \(int\), not '4'"),
        ({"admm_iterations": 2.5}, r"admm_iterations is a number \(int\), not 2\.5"),
        ({"scales": True}, r"scales is a number \(int\), not True"),
        ({"ridge": None}, r"ridge is a number \(float\), not None"),
        ({"coast": "false"}, "coast is true or false, not 'false'"),
    ],
)
def test_a_setting_of_another_type_is_refused_when_it_is_given(wrong, told):
    with pytest.raises(ValueError, match=told):
        Params(**wrong)


def test_numbers_of_numpy_are_numbers():
    assert Params(cell_px=np.int64(5), ridge=np.float32(0.5)).cell_px == 5  # pyright: ignore[reportArgumentType]


@pytest.mark.parametrize("name", [name for name in AT_MOST if isinstance(AT_MOST[name], float)])
def test_a_tracker_runs_at_the_largest_weights(name):
    tracker = Racf(dataclasses.replace(ALL, **{name: AT_MOST[name]}))
    tracker.init(clip()[0], START)
    tracks = [tracker.update(image) for image in clip()[1:6]]
    assert np.isfinite([[t.psr, t.apce, t.confidence, t.box.area] for t in tracks]).all()


def test_robust_is_a_word_for_its_switches():
    assert all(getattr(preset("racf,robust"), name) for name in ROBUST)
    assert not any(getattr(params, name) for name in ROBUST for params in PRESETS.values())
    assert preset("racf,robust") == preset("racf").robust() == preset("racf," + ",".join(ROBUST))
    for text in ("racf,robust,coast=false", "racf,coast=false,robust"):
        assert preset(text) == dataclasses.replace(preset("racf,robust"), coast=False)
    assert preset("racf,robust=off") == preset("racf")


def test_a_tracker_takes_a_text_or_params_and_refuses_the_rest_at_once():
    assert Racf().params == Racf("racf").params == preset("racf")
    assert Racf("bacf,admm_iterations=3").params == dataclasses.replace(preset("bacf"), admm_iterations=3)
    with pytest.raises(ValueError, match=r"there is no tracker 'rafc'; did you mean racf"):
        Racf("rafc")
    with pytest.raises(ValueError, match=r"takes a racf\.Params or a text such as 'racf,robust', not 3"):
        Racf(3)
