"""Compiled feature kernels against their numpy equations and independent facts."""

import cv2
import numpy as np
import pytest

from racf import colornames, hog, patch
from racf.features import Features


@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize(("size", "cell"), [((24, 32), 4), ((40, 20), 4), ((18, 27), 3), ((20, 25), 5), ((12, 8), 2)])
def test_compiled_fhog_equals_the_numpy_equations(channels, size, cell):
    pixels = np.random.default_rng(0).integers(0, 256, (channels, *size), dtype=np.uint8)
    rows, cols = size[0] // cell, size[1] // cell
    work, flipped = hog.scratch(rows, cols, cell, count=2), pixels[:, ::-1]
    windows = np.random.default_rng(1).random((2, cols, rows), dtype=np.float32)
    out = np.empty((2, cols, rows, hog.CHANNELS), np.float32)
    for _ in range(2):  # the scratch leaves nothing behind
        hog.fhog(np.stack([pixels, flipped]), cell, hog.orientation_bins(), work, windows, out)
    for patch_out, each, window in zip(out, (pixels, flipped), windows, strict=True):
        expected = hog.fhog_numpy(each, cell).transpose(1, 0, 2) * window[..., None]
        np.testing.assert_allclose(patch_out, expected, atol=1e-4)


@pytest.mark.parametrize("cell", [3, 4])
def test_compiled_colours_equal_the_numpy_equations(cell):
    pixels = np.random.default_rng(0).integers(0, 256, (3, 6 * cell, 8 * cell), dtype=np.uint8)
    out, window = np.empty((8, 6, 2 + colornames.CHANNELS + 1), np.float32), np.full((8, 6), 0.5, np.float32)
    colornames.Colours(6, 8, cell, named=True).write(pixels, window, out)
    expected = colornames.colour_names_numpy(pixels, cell, colornames.table()).transpose(1, 0, 2) / 2
    np.testing.assert_allclose(out[..., 2:-1], expected, atol=1e-5)
    np.testing.assert_allclose(out[..., -1], mean_grey(np.tensordot([0.114, 0.587, 0.299], pixels, 1), cell), atol=1e-5)


def test_compiled_grey_equals_the_numpy_equation():
    pixels = np.random.default_rng(0).integers(0, 256, (1, 24, 32), dtype=np.uint8)
    out, window = np.zeros((8, 6, 12), np.float32), np.full((8, 6), 0.5, np.float32)
    colornames.Colours(6, 8, 4, named=False).write(pixels, window, out)
    np.testing.assert_allclose(out[..., -1], mean_grey(pixels[0], 4), atol=1e-5)
    assert not out[..., :-1].any()


def mean_grey(plane: np.ndarray, cell: int) -> np.ndarray:
    """(H, W) -> (W/cell, H/cell), half of -0.5..0.5."""
    rows, cols = plane.shape
    return (plane.reshape(rows // cell, cell, cols // cell, cell).mean(axis=(1, 3)) / 255 - 0.5).T / 2


@pytest.mark.parametrize(
    ("bgr", "name"),
    [
        ((0, 0, 0), "black"),
        ((255, 0, 0), "blue"),
        ((0, 0, 255), "red"),
        ((0, 255, 0), "green"),
        ((0, 255, 255), "yellow"),
        ((128, 128, 128), "grey"),
        ((0, 128, 255), "orange"),
        ((20, 50, 100), "brown"),
    ],
)
def test_pure_colours_get_their_own_names(bgr, name):
    b, g, r = (value // (256 // colornames.LEVELS) for value in bgr)
    likely = colornames.probabilities()[(b * colornames.LEVELS + g) * colornames.LEVELS + r]
    assert colornames.TERMS[int(np.argmax(likely))] == name


def test_ten_coordinates_keep_the_distances_of_eleven_probabilities():
    likely, kept = colornames.probabilities()[::997], colornames.table()[::997]
    full = np.linalg.norm(likely[:, None] - likely[None], axis=2)
    np.testing.assert_allclose(np.linalg.norm(kept[:, None] - kept[None], axis=2), full, atol=1e-4)


def test_a_flat_patch_has_no_gradients_and_grey_has_no_colour_channels():
    flat = np.full((1, 40, 40), 200, np.uint8)
    features = Features(10, 10, 4, colour=False).extract(flat)
    assert features.shape == (10, 10, 32)
    assert not features[..., :31].any()
    assert features[5, 5, 31] > 0.2


@pytest.mark.parametrize("step", [(0.31, 0.4), (1.0, 1.0), (1.7, 1.9)])
@pytest.mark.parametrize("first", [(-5.3, 2.2), (10.0, 31.7)])
def test_compiled_resampling_equals_opencv(step, first):
    image = np.random.default_rng(1).integers(0, 256, (40, 50, 3), dtype=np.uint8)
    out = np.empty((2, 3, 16, 20), np.uint8)
    patch.bilinear(image, [(0.0, 1.0, 0.0, 1.0), (first[0], step[0], first[1], step[1])], out)
    assert (out[0].transpose(1, 2, 0) == image[:16, :20]).all()
    map_x, map_y = np.meshgrid(first[0] + step[0] * np.arange(20), first[1] + step[1] * np.arange(16))
    expected = cv2.remap(
        image.astype(np.float32), map_x.astype(np.float32), map_y.astype(np.float32), cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_REPLICATE,
    )  # fmt: skip
    assert np.abs(out[1].transpose(1, 2, 0) - expected).max() < 5  # OpenCV rounds places to 1/32 pixel


@pytest.mark.parametrize("factor", [1, 3])
def test_resampling_keeps_places(factor):
    ramp = np.add.outer(np.zeros(90), np.arange(120) * 2).astype(np.uint8)
    sampled = patch.resample(ramp, 50.0, 40.0, 20.0 * factor, 20.0 * factor, 20, 20)
    expected = 2 * (50 - 10 * factor + (np.arange(20) + 0.5) * factor - 0.5)
    np.testing.assert_allclose(sampled[0, 10], expected, atol=1.01)
