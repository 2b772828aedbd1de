"""The whole tracker on rendered images: geometry, odd inputs, refusals."""

import dataclasses
import sys

import cv2
import numpy as np
import pytest
from numba.core.dispatcher import Dispatcher

from racf import Box, Racf, preset, warm_up
from racf.patch import shrunk
from racf.translation import TranslationFilter

TEXTURE = cv2.GaussianBlur(np.random.default_rng(5).integers(0, 256, (700, 900, 3), dtype=np.uint8), (0, 0), 3)
TEXTURE = cv2.normalize(TEXTURE, None, 0, 255, cv2.NORM_MINMAX)
PATTERN = cv2.resize(np.random.default_rng(6).integers(0, 256, (6, 6, 3), dtype=np.uint8), (120, 120), interpolation=0)


def scene(x: float, y: float, side: float, shape=(240, 320)) -> np.ndarray:
    """A patterned square of `side` pixels centred at (x, y) over a still texture."""
    rows, cols = shape
    image = TEXTURE[:rows, :cols].copy()
    scale = side / PATTERN.shape[0]
    warp = np.array([[scale, 0, x - side / 2 + scale / 2 - 0.5], [0, scale, y - side / 2 + scale / 2 - 0.5]])
    cv2.warpAffine(PATTERN, warp, (cols, rows), dst=image, flags=cv2.INTER_AREA, borderMode=cv2.BORDER_TRANSPARENT)
    return image


def around(x: float, y: float, side: float) -> Box:
    return Box.around(x, y, side, side)


@pytest.mark.parametrize("name", ["racf", "racf-", "racf--", "bacf", "arcf-hc"])
@pytest.mark.parametrize("grey", [False, True])
def test_a_moving_target_is_followed(name, grey):
    tracker = Racf(preset(name))
    for k in range(12):
        x, y = 100 + 4 * k, 80 + 2.5 * k
        image = scene(x, y, 40)
        image = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY) if grey else image
        track = tracker.update(image) if k else tracker.init(image, around(x, y, 40))
    assert abs(track.box.centre_x - x) < 2
    assert abs(track.box.centre_y - y) < 2
    assert track.box.iou(around(x, y, 40)) > 0.8
    assert track.found


@pytest.mark.parametrize("shift", [(7, 0), (0, -9), (11, 5)])
def test_moving_the_image_moves_the_box_by_the_same_amount(shift):
    image = scene(160, 120, 44)
    moved = np.roll(image, (shift[1], shift[0]), axis=(0, 1))
    tracker = Racf(preset("racf-"))
    tracker.init(image, around(160, 120, 44))
    track = tracker.update(moved)
    assert track.box.centre_x == pytest.approx(160 + shift[0], abs=0.5)
    assert track.box.centre_y == pytest.approx(120 + shift[1], abs=0.5)


def test_a_growing_target_grows_the_box():
    tracker = Racf(preset("racf-"))
    tracker.init(scene(160, 120, 40), around(160, 120, 40))
    for side in np.linspace(40, 60, 15):
        track = tracker.update(scene(160, 120, side))
    assert track.box.w == pytest.approx(60, rel=0.1)


def test_the_same_frames_give_the_same_boxes():
    def run() -> list[Box]:
        tracker = Racf(preset("racf"))
        tracker.init(scene(100, 100, 40), around(100, 100, 40))
        return [tracker.update(scene(100 + 3 * k, 100, 40)).box for k in range(5)]

    assert run() == run()


@pytest.mark.parametrize("shape", [(241, 321), (97, 131), (480, 641)])
@pytest.mark.parametrize("side", [4, 17, 90])
@pytest.mark.parametrize("at", [(0.5, 0.5), (0.02, 0.02), (0.98, 0.5)])
def test_odd_sizes_and_places_are_tracked_without_an_error(shape, side, at):
    x, y = at[0] * shape[1], at[1] * shape[0]
    tracker = Racf(preset("racf"))
    tracker.init(scene(x, y, side, shape), around(x, y, side))
    for _ in range(2):
        track = tracker.update(scene(x, y, side, shape))
    assert abs(track.box.centre_x - x) < max(4, side / 2)
    assert abs(track.box.centre_y - y) < max(4, side / 2)


def test_a_target_larger_than_half_the_frame_is_tracked():
    tracker = Racf(preset("racf"))
    tracker.init(scene(160, 120, 200), around(160, 120, 200))
    track = tracker.update(scene(166, 120, 200))
    assert track.box.centre_x == pytest.approx(166, abs=4)


@pytest.mark.parametrize(
    ("image", "box", "message"),
    [
        (np.zeros((0, 10, 3), np.uint8), Box(1, 1, 5, 5), "at least one pixel"),
        (np.zeros((90, 90, 3), np.float32), Box(1, 1, 5, 5), "uint8, not float32"),
        (np.zeros((90, 90, 4), np.uint8), Box(1, 1, 5, 5), r"not \(90, 90, 4\)"),
        (np.zeros((90, 90, 3), np.uint8), Box(100, 1, 5, 5), "target 100,1,5,5 lies outside the 90x90 image"),
        (np.zeros((90, 90, 3), np.uint8), Box(1, 1, 1, 5), "at least 2 pixels"),
        (np.zeros((90, 90, 3), np.uint8), (1, 1, 5, 5), r"a target is a racf\.Box\(x, y, w, h\), not \(1, 1, 5, 5\)"),
    ],
)
def test_what_cannot_be_tracked_is_refused_in_one_sentence(image, box, message):
    with pytest.raises(ValueError, match=message):
        Racf().init(image, box)


def test_a_changed_frame_size_is_refused():
    tracker = Racf()
    tracker.init(scene(100, 100, 40), around(100, 100, 40))
    with pytest.raises(ValueError, match=r"shape \(240, 320, 3\), not \(100, 320, 3\)"):
        tracker.update(scene(100, 50, 40, (100, 320)))


def test_a_prior_that_is_no_box_is_refused():
    tracker = Racf()
    tracker.init(scene(100, 100, 40), around(100, 100, 40))
    with pytest.raises(ValueError, match=r"a prior is a racf\.Box"):
        tracker.update(scene(100, 100, 40), (80, 80, 40, 40))


def read_only(image: np.ndarray) -> np.ndarray:
    return np.frombuffer(image.tobytes(), np.uint8).reshape(image.shape)


def reversed_channels(image: np.ndarray) -> np.ndarray:
    return image[:, :, ::-1].copy()[:, :, ::-1]


def compiled_kernels() -> dict[str, int]:
    """How many types of arguments each kernel was compiled, or loaded, for."""
    kernels = (
        thing for name, module in sys.modules.items() if name.startswith("racf.") for thing in vars(module).values()
    )
    return {kernel.__name__: len(kernel.signatures) for kernel in kernels if isinstance(kernel, Dispatcher)}


@pytest.mark.parametrize("side", [40, 200])
@pytest.mark.parametrize("kind", [read_only, reversed_channels, np.ascontiguousarray])
@pytest.mark.parametrize("number", [float, int, np.float32])
def test_after_the_warm_up_no_kind_of_image_or_box_compiles_a_kernel(kind, number, side):
    warm_up()
    before, tracker = compiled_kernels(), Racf()
    tracker.init(kind(scene(160, 120, side)), Box(*map(number, (160 - side / 2, 120 - side / 2, side, side))))
    tracker.update(kind(scene(163, 120, side)))
    assert compiled_kernels() == before


@pytest.mark.parametrize("kind", [read_only, reversed_channels])
def test_every_kind_of_image_gives_the_same_boxes(kind):
    def run(kind) -> list[Box]:
        tracker = Racf()
        tracker.init(kind(scene(100, 100, 40)), around(100, 100, 40))
        return [tracker.update(kind(scene(100 + 3 * k, 100, 40))).box for k in range(3)]

    assert run(kind) == run(np.ascontiguousarray)


def test_a_view_is_copied_once_for_all_samples(monkeypatch):
    sampled: list[np.ndarray] = []

    def watched(image, *where):
        sampled.append(image)
        return shrunk(image, *where)

    monkeypatch.setattr("racf.patch.shrunk", watched)
    monkeypatch.setattr("racf.scale.shrunk", watched)
    tracker = Racf()
    tracker.init(reversed_channels(scene(100, 100, 40)), around(100, 100, 40))
    tracker.update(reversed_channels(scene(103, 100, 40)))
    assert len(sampled) > 4
    assert all(image.flags.c_contiguous for image in sampled)
    assert len({id(image) for image in sampled}) == 2


@pytest.mark.parametrize(("move", "samples"), [(0, 1), (2, 1), (30, 2)])
def test_a_target_that_hardly_moved_is_learned_from_the_sample_that_localised_it(move, samples, monkeypatch):
    taken: list[Box] = []
    sample = TranslationFilter.sample

    def watched(self, image, box, out=None):
        taken.append(box)
        return sample(self, image, box, out)

    images = [scene(150 + (k % 2) * move, 100, 40) for k in range(12)]
    boxes = []
    for reuse in (1.5, 0.0):
        tracker = Racf(f"racf-,reuse_cells={reuse}")
        tracker.init(images[0], around(150, 100, 40))
        with monkeypatch.context() as patch:
            patch.setattr(TranslationFilter, "sample", watched)
            boxes.append([tracker.update(image).box for image in images[1:]])
    assert len(taken) == (samples + 2) * 11
    assert min(a.iou(b) for a, b in zip(*boxes, strict=True)) > 0.95


def test_update_before_init_is_refused():
    with pytest.raises(ValueError, match="init before update"):
        Racf().update(scene(100, 100, 40))


def test_settings_are_parsed_by_their_type_and_refused_by_name():
    params = preset("racf").with_settings({"residue": "0.5", "admm_iterations": "3", "robust": ""})
    assert params == dataclasses.replace(preset("racf"), residue=0.5, admm_iterations=3).robust()
    with pytest.raises(ValueError, match="no setting 'eta'"):
        params.with_settings({"eta": "1"})
    with pytest.raises(ValueError, match="no setting 'robst'; did you mean robust"):
        params.with_settings({"robst": ""})
    with pytest.raises(ValueError, match="admm_iterations is a number"):
        params.with_settings({"admm_iterations": "two"})
    with pytest.raises(ValueError, match="admm_iterations is at least 1, not 0"):
        params.with_settings({"admm_iterations": "0"})
    with pytest.raises(ValueError, match="no tracker 'kcf'"):
        preset("kcf")


@pytest.mark.parametrize(
    ("setting", "sentence"),
    [
        ({"residue": "nan"}, "residue is a finite number, not nan"),
        ({"penalty_max": "inf"}, "penalty_max is a finite number, not inf"),
        ({"learning_rate": "1.5"}, "learning_rate is between 0 and 1, not 1.5"),
        ({"refine_blend": "-0.1"}, "refine_blend is between 0 and 1, not -0.1"),
        ({"ridge": "-1"}, "ridge is at least 0, not -1.0"),
    ],
)
def test_a_number_that_makes_no_sense_is_refused_in_one_sentence(setting, sentence):
    with pytest.raises(ValueError, match=sentence):
        preset("racf").with_settings(setting)
