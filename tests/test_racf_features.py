"""Compiled feature kernels against their numpy equations and independent facts."""

import numpy as np
import pytest

from racf import colornames, hog
from racf.features import Features


@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("size", [(24, 32), (40, 20)])
def test_compiled_fhog_equals_the_numpy_equations(channels, size):
    patch = np.random.default_rng(0).integers(0, 256, (*size, channels), dtype=np.uint8)
    out = np.empty((size[0] // 4, size[1] // 4, hog.CHANNELS), np.float32)
    hog.fhog(patch, 4, hog.orientation_bins(), out)
    np.testing.assert_allclose(out, hog.fhog_numpy(patch, 4), atol=1e-4)


def test_compiled_colour_names_equal_the_numpy_equation():
    patch = np.random.default_rng(0).integers(0, 256, (24, 32, 3), dtype=np.uint8)
    out = np.empty((6, 8, colornames.CHANNELS), np.float32)
    colornames.colour_names(patch, 4, colornames.table(), out, 0)
    np.testing.assert_allclose(out, colornames.colour_names_numpy(patch, 4, colornames.table()), atol=1e-5)


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
    flat = np.full((40, 40), 200, np.uint8)
    features = Features(10, 10, 4, colour=False).extract(flat)
    assert features.shape == (10, 10, 32)
    assert not features[..., :31].any()
    assert features[5, 5, 31] > 0.2
