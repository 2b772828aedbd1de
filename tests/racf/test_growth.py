"""The size by optical flow: its accuracy on rendered targets of known size, and when it must give no result."""

import dataclasses
import itertools
import math
from collections.abc import Iterator

import cv2
import numpy as np
import pytest

from racf import Box, Racf, preset
from racf.flow import Flow
from racf.growth import LEAST_SIDE_PX, _log_growth, growth

ROWS, COLS = 300, 420
TEXTURE_PX = 240


def texture(seed: int) -> np.ndarray:
    coarse = np.random.default_rng(seed).integers(0, 256, (9, 9, 3), dtype=np.uint8)
    return cv2.resize(coarse, (TEXTURE_PX, TEXTURE_PX), interpolation=cv2.INTER_CUBIC)


GROUND = cv2.GaussianBlur(np.random.default_rng(7).integers(0, 256, (ROWS, COLS, 3), dtype=np.uint8), (0, 0), 3)


def image(x: float, y: float, side: float, *, turned_deg: float = 0.0, seed: int = 8) -> np.ndarray:
    """A textured square of `side` pixels with its middle at (x, y), in front of the ground."""
    similarity = cv2.getRotationMatrix2D((TEXTURE_PX / 2 - 0.5,) * 2, turned_deg, side / TEXTURE_PX)
    similarity[:, 2] += (x - TEXTURE_PX / 2, y - TEXTURE_PX / 2)
    size = (COLS, ROWS)
    over = cv2.warpAffine(texture(seed), similarity, size, flags=cv2.INTER_AREA)
    share = cv2.warpAffine(np.ones((TEXTURE_PX, TEXTURE_PX, 1), np.float32), similarity, size)[..., None]
    return (share * over + (1 - share) * GROUND).astype(np.uint8)


def told(first: np.ndarray, box: Box, second: np.ndarray, dx: float = 0.0, dy: float = 0.0) -> float:
    flow = Flow()
    flow.remember(first, box)
    flow.look(second, dx, dy)
    return growth(flow)


@pytest.mark.parametrize("side", [40, 90, 200])
@pytest.mark.parametrize("factor", [0.95, 0.99, 1.0, 1.02, 1.06])
@pytest.mark.parametrize("colour", [True, False])
def test_the_growth_of_a_moving_target_is_measured_within_a_percent(side, factor, colour):
    first, second = image(160, 140, side), image(165, 137, side * factor)
    if not colour:
        first, second = (cv2.cvtColor(of, cv2.COLOR_BGR2GRAY) for of in (first, second))
    assert told(first, Box.around(160, 140, side, side), second, 4, -2) == pytest.approx(factor, rel=0.012)


@pytest.mark.parametrize("factor", [0.95, 1.02, 1.06])
def test_the_growth_of_a_small_target_is_measured_as_well_or_not_at_all(factor):
    """A ring around 24 pixels is seen through windows that reach into the target."""
    factors = [
        told(
            image(160, 140, 24, seed=seed), Box.around(160, 140, 24, 24), image(165, 137, 24 * factor, seed=seed), 4, -2
        )
        for seed in range(20, 32)
    ]
    assert all(of == 1.0 or of == pytest.approx(factor, rel=0.02) for of in factors)


def test_a_box_full_of_ground_does_not_grow():
    """A camera that comes nearer makes everything grow, but the box is not the target's any more."""
    nearer = cv2.warpAffine(GROUND, cv2.getRotationMatrix2D((160, 140), 0.0, 1.04), (COLS, ROWS))
    assert told(GROUND, Box.around(160, 140, 60, 60), nearer) == 1.0


def test_a_target_that_turns_keeps_its_size():
    assert told(image(160, 140, 60), Box.around(160, 140, 60, 60), image(160, 140, 60, turned_deg=4)) == pytest.approx(
        1.0, abs=0.01
    )


def test_the_growth_in_a_long_box_slightly_off_the_target_is_measured():
    box = Box.around(164, 136, 40, 66)
    assert told(image(160, 140, 60), box, image(161, 140, 62.4)) == pytest.approx(1.04, abs=0.012)


def test_points_with_different_motions_give_no_growth():
    first, second = image(160, 140, 60), image(160, 140, 60, seed=9)  # another target in the same place
    assert told(first, Box.around(160, 140, 60, 60), second) == 1.0


def test_no_growth_is_measured_of_a_tiny_or_unseen_target():
    side = LEAST_SIDE_PX - 1
    assert told(image(160, 140, side), Box.around(160, 140, side, side), image(160, 140, side * 1.05)) == 1.0
    flow = Flow()
    assert growth(flow) == 1.0
    flow.look(GROUND, 0, 0)
    assert growth(flow) == 1.0
    flow.remember(image(160, 140, 60), Box.around(160, 140, 60, 60))
    assert growth(flow) == 1.0
    flow.forget()
    flow.look(image(160, 140, 63), 0, 0)
    assert growth(flow) == 1.0


def test_growth_is_limited_to_a_tenth_a_frame():
    many = [told(image(160, 140, 60), Box.around(160, 140, 60, 60), image(160, 140, 60 * f)) for f in (0.8, 0.85, 1.2)]
    assert all(0.904 <= factor <= 1.106 for factor in many)
    assert max(many) > 1.1


SQUARE = np.array([[10, 10], [40, 10], [10, 40], [40, 40], [25, 30]], np.float32)


@pytest.mark.parametrize(
    ("points", "across", "down", "told_factor"),
    [
        (SQUARE, 1.04, 1.04, 1.04), (SQUARE, 1.04, 1.06, 1.04), (SQUARE, 0.93, 0.96, 0.96), (SQUARE, 1.04, 0.97, 1.0),
        (SQUARE, 1.0, 1.05, 1.0), (SQUARE, -1.02, 1.02, 1.0), (SQUARE, -1.02, -1.02, 1.0),
        (SQUARE[:4], 1.04, 1.04, 1.04), (SQUARE[:3], 1.04, 1.04, 1.0), (SQUARE[:0], 1.04, 1.04, 1.0),
        (SQUARE[[0, 3, 0, 3, 3]], 1.04, 1.04, 1.0), (SQUARE[[0, 0, 0, 0]], 1.04, 1.04, 1.0),
    ],
)  # fmt: skip
def test_the_smaller_growth_of_both_directions_counts_if_points_can_measure_it(points, across, down, told_factor):
    moved = (points * (across, down) + (3, -2)).astype(np.float32)
    assert math.exp(_log_growth(points, moved)) == pytest.approx(told_factor, abs=1e-4)


def test_a_turn_alone_is_no_growth():
    assert (
        math.exp(_log_growth(SQUARE, SQUARE @ cv2.getRotationMatrix2D((0, 0), 2, 1)[:, :2].T.astype(np.float32)))
        > 0.998
    )


class Followed(Flow):
    """Of 36 points in the box `agreeing` grow by 1.05, and `alike` of `around` ones; the others go their own ways.

    The flow of the first `surely` leads back best.
    """

    def __init__(
        self, agreeing: int, alike: int, around: int = 28, points: int = 36, surely: int | None = None
    ) -> None:
        super().__init__()
        self.of = {True: (points, agreeing), False: (around, alike)}
        self.surely = points if surely is None else surely

    def _flow(self, places):
        count, growing = self.of[float(np.abs(places).max()) < 0.5]
        random = np.random.default_rng(5)
        before = random.uniform(0, 60, (count, 2)).astype(np.float32)
        after = before * 1.05
        after[growing:] += random.uniform(3, 9, (count - growing, 2)) * random.choice([-1, 1], (count - growing, 2))
        apart = np.where(np.arange(count) < self.surely, 0.01, 0.5).astype(np.float32)
        return before, after.astype(np.float32), apart

    def told(self) -> float:
        self.remember(GROUND, Box.around(160, 140, 56, 56))
        self.look(GROUND, 0, 0)
        return growth(self)


@pytest.mark.parametrize(
    ("flow", "believed"),
    [
        (Followed(36, 0), True), (Followed(20, 0), True), (Followed(16, 0), False),
        (Followed(36, 13), True), (Followed(36, 14), False), (Followed(36, 28), False),
        (Followed(36, 7, around=7), True), (Followed(36, 8, around=8), False), (Followed(36, 0, around=0), True),
        (Followed(8, 0, points=8), True), (Followed(7, 0, points=7), False),
        (Followed(18, 0, surely=18), True), (Followed(9, 0, surely=18), True), (Followed(8, 0, surely=18), False),
    ],
)  # fmt: skip
def test_growth_is_accepted_where_half_of_the_best_points_agree_and_half_of_those_around_do_not(flow, believed):
    assert flow.told() == pytest.approx(1.05 if believed else 1.0, abs=1e-3)


@pytest.mark.parametrize(
    "box", [Box(-30, 100, 60, 60), Box(390, 270, 60, 60), Box(-500, -500, 40, 40), Box(0, 0, COLS, ROWS),
            Box(-1e6, 10, 1e6, 22), Box(10, -5e5, 22, 1e6)],
)  # fmt: skip
def test_a_box_at_or_beyond_the_edge_of_the_image_gives_a_number(box):
    assert 0.9 <= told(GROUND, box, image(160, 140, 60), 1e5, -1e5) <= 1.11
    assert 0.9 <= told(GROUND, box, GROUND) <= 1.11


def test_what_lies_beyond_the_images_edge_does_not_hold_back_a_target_that_is_half_outside():
    assert told(image(10, 140, 80), Box.around(10, 140, 80, 80), image(10, 140, 84)) == pytest.approx(1.05, abs=0.012)


@pytest.mark.parametrize("slid", [1, 2, 3, 4, -2, -3])
@pytest.mark.parametrize("left", [115, 125, 135, 145, 155])
def test_ground_that_slides_beside_the_target_is_no_growth(slid, left):
    """A part of the box is a standing target, the rest is ground that moves: no size changes."""
    wide = cv2.GaussianBlur(np.random.default_rng(1).integers(0, 256, (240, 420, 3), dtype=np.uint8), (0, 0), 3)
    ground = cv2.normalize(wide, None, 40, 210, cv2.NORM_MINMAX)
    target = cv2.normalize(GROUND[:80, :40], None, 40, 210, cv2.NORM_MINMAX)
    first, second = ground[:, 50:370].copy(), ground[:, 50 - slid : 370 - slid].copy()
    first[80:160, 160:200] = second[80:160, 160:200] = target
    assert told(first, Box(left, 85, 70, 70), second) == pytest.approx(1.0, abs=0.004)


@pytest.mark.parametrize("wider", [0.96, 1.03, 1.06])
def test_what_grows_in_width_alone_has_not_come_nearer(wider):
    """A car that turns shows more of its side."""
    first = image(160, 140, 60)
    second = cv2.warpAffine(first, np.array([[wider, 0, 160 * (1 - wider)], [0, 1, 0]]), (COLS, ROWS))
    assert told(first, Box.around(160, 140, 60, 60), second) == pytest.approx(1.0, abs=0.005)


def clip(rate: float, frames: int) -> list[tuple[np.ndarray, Box]]:
    """A target that grows by `rate` a frame and drifts by a pixel."""
    sides = [30 * rate**k for k in range(frames)]
    places = [(140 + 1.0 * k, 140.0) for k in range(frames)]
    return [(image(*at, side), Box.around(*at, side, side)) for at, side in zip(places, sides, strict=True)]


def overlap_at_end(tracker: Racf, shown: list[tuple[np.ndarray, Box]]) -> float:
    tracker.init(*shown[0])
    tracks = [tracker.update(of) for of, _ in shown[1:]]
    assert tracks[-1].found
    return tracks[-1].box.iou(shown[-1][1])


@pytest.mark.parametrize("rate", [1.0, 1.02, 1.05, 0.98])
def test_a_tracker_keeps_the_size_of_a_target_that_grows_fast(rate):
    shown = clip(rate, 36)
    with_flow = preset("racf-,robust")
    without = dataclasses.replace(with_flow, predict_scale=False)
    overlap = overlap_at_end(Racf(with_flow), shown)
    assert overlap > 0.8
    assert overlap > overlap_at_end(Racf(without), shown) - 0.05


def test_a_lost_target_keeps_its_size():
    """While it is not seen its box coasts, however fast the ground behind it comes nearer."""
    shown = clip(1.0, 12)
    tracker = Racf("racf-,robust")
    tracker.init(*shown[0])
    before = [tracker.update(of) for of, _ in shown[1:]][-1]
    for k in range(8):
        nearer = cv2.getRotationMatrix2D((150, 140), 0.0, 1.05**k)
        track = tracker.update(cv2.warpAffine(GROUND, nearer, (COLS, ROWS)))
        assert not track.found
        assert track.box.w == pytest.approx(before.box.w)


def turning(seed: int, frames: int = 200) -> Iterator[tuple[np.ndarray, Box]]:
    """A disc of 40 pixels that turns by 1.5 degrees a frame over ground that slides by a pixel, with noise."""
    random, pixels, side = np.random.default_rng(seed), 240, 40
    rough = sum(
        of * cv2.resize(random.normal(0, 1, (n, n, 3)), (pixels, pixels), interpolation=cv2.INTER_CUBIC)
        for n, of in ((6, 1.0), (12, 0.6), (40, 0.4))
    )
    disc = np.clip(125 + 45 * (rough - rough.mean()) / rough.std(), 0, 255).astype(np.uint8)
    round_ = cv2.circle(np.zeros((pixels, pixels), np.float32), (pixels // 2,) * 2, pixels // 2 - 2, 1.0, -1)
    layers = [
        cv2.GaussianBlur(random.normal(0, 1, (ROWS, COLS + frames, 3)), (0, 0), blur) for blur in (2.0, 6.0, 20.0)
    ]
    mixed = sum(of * layer / layer.std() for of, layer in zip((0.6, 1.0, 1.0), layers, strict=True))
    ground = np.clip(120 + 35 * mixed / np.std(mixed), 0, 255)
    for k in range(frames):
        x, y = 110 + 0.3 * k, 110 + 0.1 * k
        turn = cv2.getRotationMatrix2D((pixels / 2 - 0.5,) * 2, -1.5 * k, side / pixels)
        turn[:, 2] += (x - pixels / 2, y - pixels / 2)
        over = cv2.warpAffine(cv2.GaussianBlur(disc, (0, 0), 2), turn, (COLS, ROWS))
        share = cv2.warpAffine(round_, turn, (COLS, ROWS))[..., None]
        shown = share * over + (1 - share) * ground[:, k : k + COLS] + random.normal(0, 3, (ROWS, COLS, 3))
        yield np.clip(shown, 0, 255).astype(np.uint8), Box.around(x, y, side, side)


@pytest.mark.parametrize("seed", range(3))
def test_a_target_that_turns_under_a_misplaced_box_hardly_seems_to_grow(seed):
    """A little in each frame would let the box run away: no more than a fifth in a hundred frames is told."""
    shown, sum_of_logs = list(turning(seed, 100)), 0.0
    for (first, box), (second, _) in itertools.pairwise(shown):
        slipped = box.moved(-8, 4).scaled(1.3)
        sum_of_logs += math.log(told(first, slipped, second, 0.3, 0.1))
    assert abs(sum_of_logs) < 0.18
