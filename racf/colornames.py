"""Colour names: how likely people are to call a colour by each of eleven basic names.

The probabilities are computed here from the results of the XKCD colour survey (2010; five million answers), whose 949
most common names with their mean colours matplotlib ships.  Each surveyed name is counted to the basic term of Berlin
and Kay that it contains or is nearest to, and votes for colours near it in CIE Lab:

    p(term | colour) ~ sum over names of that term of exp(-|Lab(colour) - Lab(name)|^2 / (2 sigma^2))

The eleven probabilities sum to one, so ten coordinates hold them all: `table` gives them in an orthonormal basis of
that plane (distances between colours' distributions are kept), with the origin at "all names equally likely".
"""

import functools
import importlib.util
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from racf.kernels import compiled, inlined

UInt8 = NDArray[np.uint8]
UInt32 = NDArray[np.uint32]
Float32 = NDArray[np.float32]

GREY_OF_BGR = np.array([0.114, 0.587, 0.299], np.float32)  # ITU-R BT.601
GREY_OF_GREY = np.array([1.0, 0.0, 0.0], np.float32)

TERMS = ("black", "blue", "brown", "grey", "green", "orange", "pink", "purple", "red", "white", "yellow")
# Names in the survey that mean one of the terms without containing it; the rest vote by their nearest kin.
KIN = {
    "gray": "grey", "tan": "brown", "beige": "brown", "violet": "purple", "lavender": "purple", "magenta": "pink",
    "teal": "green", "olive": "green", "navy": "blue", "cyan": "blue", "maroon": "red", "gold": "yellow",
    "mauve": "purple", "turquoise": "green", "salmon": "pink", "peach": "orange", "cream": "white", "aqua": "blue",
    "lime": "green", "rose": "pink", "lilac": "purple", "indigo": "purple", "crimson": "red", "khaki": "brown",
}  # fmt: skip
SIGMA_LAB = 10.0  # about the spread of what one common name is used for
LEVELS = 32  # per channel of the table: 8 grey levels a step, as usual for colour-name tables
CHANNELS = len(TERMS) - 1
STEP = 256 // LEVELS
U1, U2, U3, U4, U5, U6, U7, U8, U9 = np.arange(1, CHANNELS, dtype=np.uint32)  # unsigned steps, as numba wants them
PADDED = 16  # numbers a row of the compiled kernel's table


def _survey() -> dict[str, str]:
    """Survey name -> "#rrggbb".  Only matplotlib's data file is run: the package itself takes 0.8 s to import."""
    package = importlib.util.find_spec("matplotlib")
    if package is None or package.origin is None:
        raise ImportError("colour names need matplotlib's list of the XKCD survey's names; matplotlib is missing")
    path = Path(package.origin).parent / "_color_data.py"
    spec = importlib.util.spec_from_file_location("racf_xkcd_survey", path)
    if spec is None or spec.loader is None:
        raise ImportError(f"matplotlib's colour list {path} cannot be read")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return {name.removeprefix("xkcd:"): value for name, value in module.XKCD_COLORS.items()}


def _term(name: str) -> str | None:
    """The basic term that a surveyed name counts for: the last one it contains ("bluish green" is a green)."""
    for word in reversed(name.replace("/", " ").split()):
        if word in TERMS:
            return word
        if word in KIN:
            return KIN[word]
    return None


def _lab(bgr: UInt8) -> Float32:
    """CIE Lab (L in 0..100) of (N, 3) BGR bytes."""
    scaled = bgr.reshape(1, -1, 3).astype(np.float32) / np.float32(255)
    return np.asarray(cv2.cvtColor(scaled, cv2.COLOR_BGR2Lab), dtype=np.float32)[0]


@functools.lru_cache(maxsize=1)
def probabilities() -> Float32:
    """(LEVELS^3, 11): p(term | colour) at the middle of each cell of the BGR cube; blue is the slowest index."""
    named = [(TERMS.index(term), value) for name, value in _survey().items() if (term := _term(name)) is not None]
    votes = np.zeros((len(named), len(TERMS)), np.float32)
    votes[np.arange(len(named)), [index for index, _ in named]] = 1
    hex_rgb = np.array([list(bytes.fromhex(value[1:])) for _, value in named], np.uint8)
    seeds = _lab(np.ascontiguousarray(hex_rgb[:, ::-1]))
    middle = (np.arange(LEVELS) * (256 // LEVELS) + 128 // LEVELS).astype(np.uint8)
    cube = np.stack(np.meshgrid(middle, middle, middle, indexing="ij"), axis=-1)
    likely = np.empty((LEVELS, LEVELS**2, len(TERMS)), np.float32)
    for blue, of_blue in zip(cube.reshape(LEVELS, -1, 3), likely, strict=True):  # a part that the cache holds
        lab = _lab(blue)
        near = lab @ seeds.T * 2
        near -= np.sum(lab**2, axis=1, keepdims=True)
        near -= np.sum(seeds**2, axis=1)
        near -= near.max(axis=1, keepdims=True)  # colours far from every name still get their nearest one's
        near *= np.float32(1 / (2 * SIGMA_LAB**2))
        np.matmul(np.exp(near, out=near), votes, out=of_blue)
    likely = likely.reshape(-1, len(TERMS))
    return np.asarray(likely / likely.sum(axis=1, keepdims=True), dtype=np.float32)


@functools.lru_cache(maxsize=1)
def table() -> Float32:
    """(LEVELS^3, 10): the probabilities in an orthonormal (Helmert) basis of the plane where they sum to one."""
    terms = len(TERMS)
    basis = np.zeros((terms, CHANNELS), np.float64)
    for k in range(1, terms):
        basis[:k, k - 1] = 1 / np.sqrt(k * (k + 1))
        basis[k, k - 1] = -k / np.sqrt(k * (k + 1))
    return np.ascontiguousarray(probabilities() @ basis.astype(np.float32))


def colour_names_numpy(patch: UInt8, cell: int, names: Float32) -> Float32:
    """The equation that `colour_names` compiles: look each pixel up, average over cells.  (3, H, W) -> (h, w, 10)."""
    b, g, r = (plane.astype(np.int64) // (256 // LEVELS) for plane in patch)
    rows, cols = patch.shape[1] // cell, patch.shape[2] // cell
    looked_up = names[(b * LEVELS + g) * LEVELS + r][: rows * cell, : cols * cell]
    return np.asarray(looked_up.reshape(rows, cell, cols, cell, -1).mean(axis=(1, 3)), dtype=np.float32)


@functools.lru_cache(maxsize=1)
def padded_table() -> Float32:
    """`table` as `colours` wants it, (LEVELS^3, 16) and flat: a row is one cache line."""
    return np.ascontiguousarray(np.pad(table(), ((0, 0), (0, PADDED - CHANNELS)))).reshape(-1)


class Colours:
    """Colour names, if `named`, and grey of patches of one size; kept with their scratch."""

    def __init__(self, rows: int, cols: int, cell: int, named: bool) -> None:
        self._shape, self._cell = (rows, cols), cell
        self._names = padded_table() if named else np.empty(0, np.float32)
        self._places, self._grey = np.empty(cell * cols * cell, np.uint32), np.empty(cols * cell, np.float32)

    def write(self, patch: UInt8, window: Float32, out: Float32) -> None:
        """Of (3 or 1, H, W) into the last channels of `out` (W/cell, H/cell, D): ten names, then grey, windowed.

        The names are those of `colour_names_numpy`; grey is a cell's mean of ITU-R BT.601's, -0.5..0.5.
        """
        colour = len(patch) == 3
        planes = np.arange(3, dtype=np.uint32) * np.uint32(patch[0].size if colour else 0)
        _cell_colours(
            patch.reshape(-1), planes, GREY_OF_BGR if colour else GREY_OF_GREY, self._cell, self._names,
            window.reshape(-1), self._places, self._grey, out.reshape(-1), self._shape,
        )  # fmt: skip


@inlined
def _named(
    places: UInt32, begin: int, cell: int, width: int, names: Float32, weight: np.float32, into: int, out: Float32
) -> None:  # fmt: skip
    """Write the names of a cell times a weight.  Ten numbers by name: an array's would be kept in memory."""
    n0 = n1 = n2 = n3 = n4 = n5 = n6 = n7 = n8 = n9 = np.float32(0)
    for y in range(cell):
        first = np.uint32(y * width + begin)
        for x in range(np.uint32(cell)):
            i = places[first + x]
            n0 += names[i]
            n1 += names[i + U1]
            n2 += names[i + U2]
            n3 += names[i + U3]
            n4 += names[i + U4]
            n5 += names[i + U5]
            n6 += names[i + U6]
            n7 += names[i + U7]
            n8 += names[i + U8]
            n9 += names[i + U9]
    out[into] = n0 * weight
    out[into + U1] = n1 * weight
    out[into + U2] = n2 * weight
    out[into + U3] = n3 * weight
    out[into + U4] = n4 * weight
    out[into + U5] = n5 * weight
    out[into + U6] = n6 * weight
    out[into + U7] = n7 * weight
    out[into + U8] = n8 * weight
    out[into + U9] = n9 * weight


@compiled
def _cell_colours(
    pixels: UInt8, planes: UInt32, mix: Float32, cell: int, names: Float32, window: Float32, places: UInt32,
    grey: Float32, out: Float32, shape: tuple[int, int],
) -> None:  # fmt: skip
    """See `Colours.write`; arrays are flat, `planes` says where blue, green and red begin."""
    (rows, cols), width, channels = shape, np.uint32(grey.size), out.size // window.size
    mix_b, mix_g, mix_r = mix[0], mix[1], mix[2]
    share, scale = np.float32(1.0 / (cell * cell)), np.float32(1.0 / (255 * cell * cell))
    named = np.uint32(channels - CHANNELS - 1)
    for row in range(rows):
        for x in range(width):
            grey[x] = np.float32(0)
        for y in range(cell):
            begin, line = (row * cell + y) * grey.size, np.uint32(y * grey.size)
            b, g, r = np.uint32(planes[0] + begin), np.uint32(planes[1] + begin), np.uint32(planes[2] + begin)
            for x in range(width):
                blue, green, red = pixels[b + x], pixels[g + x], pixels[r + x]
                places[line + x] = ((blue // STEP * LEVELS + green // STEP) * LEVELS + red // STEP) * PADDED
                grey[x] += mix_b * np.float32(blue) + mix_g * np.float32(green) + mix_r * np.float32(red)
        for col in range(cols):
            place, total = col * rows + row, np.float32(0)
            for x in range(col * cell, (col + 1) * cell):
                total += grey[x]
            into = np.uint32(place * channels)
            out[into + np.uint32(channels - 1)] = (total * scale - np.float32(0.5)) * window[place]
            if names.size == 0:
                continue
            _named(places, col * cell, cell, grey.size, names, share * window[place], into + named, out)
