"""A first box that is too large or beside the target, on rendered images: it is told by what walks out of it."""

import math
from collections.abc import Callable, Iterator

import cv2
import numpy as np
import pytest

from racf import Box, Racf, leaving, preset
from racf.offground import INSIDE

TIGHTEN = "racf,robust,tighten=true"
ROWS, COLS, W, H = 240, 400, 24, 36
RANDOM = np.random.default_rng(11)


def texture(rows: int, cols: int, blur: float, low: int, high: int) -> np.ndarray:
    noise = RANDOM.integers(0, 256, (rows, cols, 3), dtype=np.uint8)
    return cv2.normalize(cv2.GaussianBlur(noise, (0, 0), blur), None, low, high, cv2.NORM_MINMAX)


# Light and dark earth: the points of the box are compared with the colours of the ground around it.
GROUND = cv2.merge([texture(ROWS + 200, COLS + 400, 3.0, 60, 190)[..., 0]] * 3)
GROUND[..., 0] -= 25
TARGET, PASSER = texture(H, W, 2.0, 0, 255), texture(H, W, 2.0, 0, 255)
LOOSE = [(1.5, 0.0, 0.0), (2.0, 0.0, 0.0), (1.5, 0.35, 0.2), (1.5, -0.35, -0.2)]
Path = Callable[[int], tuple[float, float]]


def put(image: np.ndarray, what: np.ndarray, x: float, y: float) -> None:
    """Draw with the middle at (x, y), between pixels also."""
    move = np.array([[1, 0, x - W / 2], [0, 1, y - H / 2]])
    size = (image.shape[1], image.shape[0])
    cover = cv2.warpAffine(np.ones((H, W), np.float32), move, size)[..., None]
    drawn = cv2.warpAffine(what.astype(np.float32), move, size)
    image[:] = (image * (1 - cover) + drawn * cover).astype(np.uint8)


def scene(target: Path, pan: float = 0.0, passer: Path | None = None, n: int = 70) -> Iterator[tuple[np.ndarray, Box]]:
    """Images and the target's boxes: its path over the ground from the image's middle, `pan` px a frame of camera."""
    for k in range(n):
        view = np.array([[1, 0, -200 - pan * k], [0, 1, -100]], float)
        image = cv2.warpAffine(GROUND, view, (COLS, ROWS))
        x, y = COLS / 2 - pan * k + target(k)[0], ROWS / 2 + target(k)[1]
        put(image, TARGET, x, y)
        if passer is not None:
            put(image, PASSER, COLS / 2 - pan * k + passer(k)[0], ROWS / 2 + passer(k)[1])
        yield image, Box.around(x, y, W, H)


def tracked(images: Iterator[tuple[np.ndarray, Box]], loose: tuple[float, float, float], text: str = TIGHTEN):
    """(tracks, true boxes) from a first box `loose` times too large and off by shares of the sides."""
    tracker, tracks, truth = Racf(text), [], []
    for image, box in images:
        if tracks:
            tracks.append(tracker.update(image))
        else:
            first = box.scaled(loose[0]).moved(loose[1] * box.w, loose[2] * box.h)
            tracks.append(tracker.init(image, first))
        truth.append(box)
    return tracks, truth


def is_on(box: Box, truth: Box) -> bool:
    return abs(box.centre_x - truth.centre_x) < W / 4 and abs(box.centre_y - truth.centre_y) < H / 4


@pytest.mark.parametrize("pan", [0.0, 1.3])
@pytest.mark.parametrize("loose", LOOSE)
def test_what_walks_out_of_a_loose_box_is_the_target(loose, pan):
    tracks, truth = tracked(scene(lambda k: (1.1 * k, 0.3 * k), pan), loose)
    assert sum(track.restarted for track in tracks) <= 1
    assert tracks[-1].box.iou(truth[-1]) > 0.4
    assert tracks[-1].found


@pytest.mark.parametrize("loose", [(2.0, 0.0, 0.0), (1.5, -0.35, -0.2), (2.0, 0.3, -0.3)])
def test_the_box_then_is_nearly_the_targets(loose):
    tracks, truth = tracked(scene(lambda k: (1.1 * k, 0.3 * k)), loose)
    at = next(k for k, track in enumerate(tracks) if track.restarted)
    assert truth[0].scaled(loose[0]).iou(truth[0]) < 0.45 < tracks[at].box.iou(truth[at])
    assert tracks[at].found


def test_a_target_that_sets_off_later_is_told_then():
    tracks, truth = tracked(scene(lambda k: (1.1 * max(k - 30, 0), 0.0)), (2.0, 0.0, 0.0))
    assert 32 <= next(k for k, track in enumerate(tracks) if track.restarted) < 30 + W / 1.1  # not yet its own width
    assert is_on(tracks[-1].box, truth[-1])


@pytest.mark.parametrize("path", [lambda k: (1.1 * k, 0.3 * k), lambda _k: (0.0, 0.0)])
@pytest.mark.parametrize("pan", [0.0, 1.3])
def test_a_right_first_box_is_tracked_as_if_nobody_looked(path, pan):
    texts = TIGHTEN, "racf,robust"
    with_it, without = (tracked(scene(path, pan), (1.0, 0.0, 0.0), text)[0] for text in texts)
    assert [track.box for track in with_it] == [track.box for track in without]


@pytest.mark.parametrize("loose", [(1.0, 0.0, 0.0), *LOOSE])
@pytest.mark.parametrize("speed", [-2.5, -1.0, 0.6, 1.5, 3.0])
def test_who_passes_in_front_of_a_standing_target_is_not_taken_for_it(loose, speed):
    meets = max(45.0, 45.0 / abs(speed))  # it begins 45 px away at least, outside of every box
    passes = scene(lambda _k: (0.0, 0.0), 0.4, lambda k: (speed * (k - meets), 4.0), n=100)
    assert not any(track.restarted for track in tracked(passes, loose)[0])


@pytest.mark.parametrize("loose", LOOSE)
def test_a_camera_that_comes_nearer_and_turns_moves_nothing_off_the_ground(loose):
    image, box = next(scene(lambda _k: (0.0, 0.0)))

    def views() -> Iterator[tuple[np.ndarray, Box]]:
        for k in range(60):
            turned = cv2.getRotationMatrix2D((COLS / 2 + 30, ROWS / 2), 0.3 * k, 1 + 0.004 * k)
            yield cv2.warpAffine(image, turned, (COLS, ROWS), borderMode=cv2.BORDER_REFLECT), box

    assert not any(track.restarted for track in tracked(views(), loose)[0])


def test_a_box_at_the_images_edge_and_a_tiny_one_are_looked_at_without_an_error():
    for box in (Box(-10, -10, 30, 30), Box(COLS - 12, ROWS - 9, 40, 40), Box(100, 100, 2, 2), Box(0, 0, COLS, ROWS)):
        tracker = Racf(TIGHTEN)
        for k, (image, _) in enumerate(scene(lambda k: (2.0 * k, 0.0), n=8)):
            _ = tracker.update(image) if k else tracker.init(image, box)


@pytest.mark.parametrize("channels", [1, 3])
def test_in_grey_images_no_box_is_given_up(channels):
    """Brightness alone does not tell ground from a body that stays."""
    grey = ((cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), box) for image, box in scene(lambda k: (1.1 * k, 0.0)))
    images = ((image if channels == 1 else cv2.merge([image] * 3), box) for image, box in grey)
    assert not any(track.restarted for track in tracked(images, (2.0, 0.0, 0.0))[0])


def test_who_leaves_a_standing_person_is_not_the_target():
    """Most of what stays is ground at the box's corners; the few points of the person must still count."""
    person = np.uint8(0.5 * texture(50, 14, 2.0, 0, 255) + np.array([90, 20, 20]))

    def image_at(k: int) -> np.ndarray:
        image = cv2.warpAffine(GROUND, np.array([[1, 0, -200], [0, 1, -100]], float), (COLS, ROWS))
        image[ROWS // 2 - 25 : ROWS // 2 + 25, COLS // 2 - 23 : COLS // 2 - 9] = person
        put(image, TARGET, COLS / 2 + 18 + 1.1 * max(k - 8, 0), ROWS / 2 + 12)
        return image

    tracker = Racf(TIGHTEN)
    tracker.init(image_at(0), Box.around(COLS / 2, ROWS / 2, 72, 76))
    assert not any(tracker.update(image_at(k)).restarted for k in range(1, 60))


def test_without_the_switch_nothing_is_looked_for():
    assert not preset("racf,robust").tighten
    assert preset(TIGHTEN).tighten
    tracks, _ = tracked(scene(lambda k: (1.1 * k, 0.0)), (2.0, 0.0, 0.0), "racf,robust")
    assert not any(track.restarted for track in tracks)
    assert "leaving" in tracks[-1].stage_ms


PATTERN = texture(60, 96, 4.0, 0, 255)
VEHICLES = {
    "ground": None,
    "red, with a pattern": np.uint8(0.6 * PATTERN + np.array([10, 10, 90])),
    "grey, with dark windows": np.uint8(170 + 0.2 * PATTERN)
    * np.uint8(np.indices((60, 96)).sum(axis=0) % 24 > 7)[..., None],
    "of all colours": PATTERN,
}


@pytest.mark.parametrize("stays", VEHICLES)
def test_who_leaves_a_standing_vehicle_is_not_taken_for_the_target(stays):
    """Right boxes around vehicles; the same box on ground is loose, and there who leaves is the target."""

    def image_at(k: int) -> np.ndarray:
        image = cv2.warpAffine(GROUND, np.array([[1, 0, -200], [0, 1, -100]], float), (COLS, ROWS))
        vehicle = VEHICLES[stays]
        if vehicle is not None:
            image[ROWS // 2 - 30 : ROWS // 2 + 30, COLS // 2 - 48 : COLS // 2 + 48] = vehicle
        put(image, TARGET, COLS / 2 + 1.1 * max(k - 8, 0), ROWS / 2 + 5)
        return image

    tracker = Racf(TIGHTEN)
    tracker.init(image_at(0), Box.around(COLS / 2, ROWS / 2, 96, 60))
    assert sum(tracker.update(image_at(k)).restarted for k in range(1, 70)) == (stays == "ground")


class Points:
    """Points of a first box of 40 by 80 px, each off the ground by its part of `motion`, and still followed."""

    def __init__(self, share: np.ndarray, motion: tuple[float, float]) -> None:
        self.zoom, self.grown, self.noise = 1.0, 1.0, 0.0
        self.sides, self.side = np.array([40.0, 80.0]), math.sqrt(3200.0)
        self.off = share[:, None] * np.array(motion)
        self.at = 100.0 + INSIDE * self.sides + self.off
        self.seen = np.full(len(share), True)

    def come_from_outside(self, _points: np.ndarray) -> bool:
        return False

    def look_the_same(self, _points: np.ndarray) -> bool:
        return True

    def leave_ground(self, _moved: np.ndarray, _still: np.ndarray) -> bool:
        return True


@pytest.mark.parametrize("motion", [(12.0, 0.0), (0.0, -9.0), (-8.0, 8.0)])
def test_an_upper_body_that_leans_with_the_view_has_not_left_and_what_moves_as_one_has(motion):
    across, down = INSIDE.T
    body = (np.abs(across) < 0.3) & (down < 0.25)
    leaves = Points(np.where(body, 1.0, 0.0), motion)
    leans = Points(np.where(body, 0.75 - 1.5 * down, 0.0), motion)  # feet stand: it moves in proportion to its height
    assert leaving._moved_off(leaves) is not None
    assert leaving._moved_off(leans) is None
