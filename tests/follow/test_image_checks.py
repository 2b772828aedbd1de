"""Images without content are reported; images of a scene, however poor, are not."""

import cv2
import numpy as np
import pytest

from follow.cli.program import main
from follow.flight.finding import Health
from follow.flight.image_checks import check_images, fault_of
from follow.messages import Frame
from sim.clip import clip
from tests.support.clips import encode, numbered

RNG = np.random.default_rng(0)
SCENE = next(clip(1))[0]


def noisy(level: float, noise: float) -> np.ndarray:
    return np.clip(RNG.normal(level, noise, (360, 640, 3)), 0, 255).astype(np.uint8)


def test_black_flat_and_saturated_images_are_told_apart():
    assert fault_of(noisy(2, 4)) == "black"
    assert fault_of(np.zeros((120, 160, 3), np.uint8)) == "black"
    assert fault_of(noisy(120, 1)) == "flat"
    assert fault_of(np.full((120, 160, 3), (40, 90, 200), np.uint8)) == "flat"
    bright = SCENE.copy()
    bright[:200] = 255
    assert fault_of(bright) == "saturated"
    assert fault_of(SCENE) == ""


@pytest.mark.parametrize(
    "poor",
    [
        cv2.GaussianBlur(SCENE, (0, 0), 9),
        (0.25 * SCENE).astype(np.uint8),
        np.clip(SCENE.astype(int) + 90, 0, 255).astype(np.uint8),
        (200 + 0.1 * SCENE).astype(np.uint8),
        cv2.cvtColor(SCENE, cv2.COLOR_BGR2GRAY)[..., None].repeat(3, 2),
    ],
    ids=["blurred", "dusk", "bright", "fog", "grey"],
)
def test_a_poor_image_of_a_scene_passes(poor):
    assert fault_of(poor) == ""


def test_some_frames_are_a_warning_and_most_are_red():
    def findings(black: int) -> Health:
        dark = np.zeros((60, 80, 3), np.uint8)
        return check_images([Frame(dark if n < black else SCENE, float(n), n) for n in range(10)]).verdict

    assert [findings(black) for black in (0, 3, 6)] == [Health.OK, Health.WARN, Health.RED]


@pytest.mark.parametrize(
    ("name", "image"),
    [("black", np.zeros((120, 192, 3), np.uint8)), ("flat", np.full((120, 192, 3), 128, np.uint8))],
)
def test_doctor_names_them(tmp_path, capfd, name, image):
    path = encode(tmp_path / "a.mp4", [image] * 30)
    assert main(["doctor", "--camera", str(path), "--out", str(tmp_path / "out")]) == 1
    assert f"red image: of 30 frames: 30 {name}" in capfd.readouterr().err
    path = encode(tmp_path / "b.mp4", map(numbered, range(30)))
    main(["doctor", "--camera", str(path), "--out", str(tmp_path / "out")])
    assert "none is black, flat or saturated" in capfd.readouterr().err
