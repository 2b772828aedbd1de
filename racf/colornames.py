"""Colour names: how likely people are to call a colour by each of eleven basic names.

The probabilities are computed here from the results of the XKCD colour survey (2010; five million answers), whose 949
most common names with their mean colours matplotlib ships.  Each surveyed name that contains a basic term of
Berlin and Kay, or a word that means one, votes for that term at colours near its own in CIE Lab:

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

from racf.kernels import compiled

UInt8 = NDArray[np.uint8]
UInt32 = NDArray[np.uint32]
UInt64 = NDArray[np.uint64]
Float32 = NDArray[np.float32]

GREY_OF_BGR = np.array([0.114, 0.587, 0.299], np.float32)  # ITU-R BT.601
GREY_OF_GREY = np.array([1.0, 0.0, 0.0], np.float32)

TERMS = ("black", "blue", "brown", "grey", "green", "orange", "pink", "purple", "red", "white", "yellow")
# Names in the survey that mean one of the terms without containing it.
KIN = {
    "gray": "grey", "tan": "brown", "beige": "brown", "violet": "purple", "lavender": "purple", "magenta": "pink",
    "teal": "green", "olive": "green", "navy": "blue", "cyan": "blue", "maroon": "red", "gold": "yellow",
    "mauve": "purple", "turquoise": "green", "salmon": "pink", "peach": "orange", "cream": "white", "aqua": "blue",
    "lime": "green", "rose": "pink", "lilac": "purple", "indigo": "purple", "crimson": "red", "khaki": "brown",
}  # fmt: skip
SIGMA_LAB = 10.0  # about the spread of the colours of one common name
LEVELS = 32  # per channel of the table: 8 grey levels a step, as usual for colour-name tables
CHANNELS = len(TERMS) - 1
STEP = 256 // LEVELS
WORDS = 4  # a row of the compiled kernel's table
FIELD = 21  # bits of a word that hold a sum over a cell; three in a word
_, U1, U2, U3 = np.arange(WORDS, dtype=np.uint64)  # unsigned steps, as numba wants them


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


def _levels(cell: int) -> int:
    """The number of quantisation levels of a name, chosen so that the sum over a cell fits its field."""
    return (2**FIELD - 1) // cell**2


@functools.lru_cache(maxsize=2)
def packed_table(cell: int) -> UInt64:
    """`table` packed for `Colours`, (LEVELS^3, 4) words and flat: name n is in word n % 4, field n // 4.

    Each name is quantised from -1..1 to 0.._levels(cell): ten integers are summed four words at a time, with the same
    result in any order.
    """
    counted = np.rint((table() + 1) / 2 * _levels(cell)).astype(np.uint64)
    fields = np.pad(counted, ((0, 0), (0, 3 * WORDS - CHANNELS))).reshape(-1, 3, WORDS)
    shifts = (FIELD * np.arange(3, dtype=np.uint64))[:, None]
    return np.ascontiguousarray(np.bitwise_or.reduce(fields << shifts, axis=1)).reshape(-1)


class Colours:
    """Colour names, if `named`, and grey of patches of one size; kept with their scratch."""

    def __init__(self, rows: int, cols: int, cell: int, named: bool) -> None:
        self._shape, self._cell = (rows, cols), cell
        self._names = packed_table(cell) if named else np.empty(0, np.uint64)
        self._places, self._grey = np.empty(cell * cols * cell, np.uint32), np.empty(cols * cell, np.float32)
        self._sums, self._share = np.empty(WORDS, np.uint64), np.float32(2 / (_levels(cell) * cell**2))

    def write(self, patch: UInt8, window: Float32, out: Float32) -> None:
        """Of (3 or 1, H, W) into the last channels of `out` (W/cell, H/cell, D): ten names, then grey, windowed.

        The names are those of `colour_names_numpy`; grey is a cell's mean of ITU-R BT.601's, -0.5..0.5.
        """
        colour = len(patch) == 3
        planes = np.arange(3, dtype=np.uint32) * np.uint32(patch[0].size if colour else 0)
        _cell_colours(
            patch.reshape(-1), planes, GREY_OF_BGR if colour else GREY_OF_GREY, self._cell, self._names,
            self._share, window.reshape(-1), self._places, self._sums, self._grey, out.reshape(-1), self._shape,
        )  # fmt: skip


@compiled
def _cell_colours(
    pixels: UInt8, planes: UInt32, mix: Float32, cell: int, names: UInt64, share: np.float32, window: Float32,
    places: UInt32, sums: UInt64, grey: Float32, out: Float32, shape: tuple[int, int],
) -> None:  # fmt: skip
    """See `Colours.write`; arrays are flat, `planes` says where blue, green and red begin.

    A sum of names times `share` is 0..2.
    """
    (rows, cols), width, channels = shape, np.uint32(grey.size), out.size // window.size
    mix_b, mix_g, mix_r = mix[0], mix[1], mix[2]
    scale, field = np.float32(1.0 / (255 * cell * cell)), np.uint64(2**FIELD - 1)
    named = channels - CHANNELS - 1
    for row in range(rows):
        for x in range(width):
            grey[x] = np.float32(0)
        for y in range(cell):
            begin, line = (row * cell + y) * grey.size, np.uint32(y * grey.size)
            b, g, r = np.uint32(planes[0] + begin), np.uint32(planes[1] + begin), np.uint32(planes[2] + begin)
            for x in range(width):
                blue, green, red = pixels[b + x], pixels[g + x], pixels[r + x]
                places[line + x] = ((blue // STEP * LEVELS + green // STEP) * LEVELS + red // STEP) * WORDS
                grey[x] += mix_b * np.float32(blue) + mix_g * np.float32(green) + mix_r * np.float32(red)
        for col in range(cols):
            place, total = col * rows + row, np.float32(0)
            for x in range(col * cell, (col + 1) * cell):
                total += grey[x]
            into = np.uint32(place * channels)
            out[into + np.uint32(channels - 1)] = (total * scale - np.float32(0.5)) * window[place]
            if names.size == 0:
                continue
            w0 = w1 = w2 = w3 = np.uint64(0)
            for y in range(cell):
                first = np.uint32(y * grey.size + col * cell)
                for x in range(np.uint32(cell)):
                    i = np.uint64(places[first + x])
                    w0 += names[i]
                    w1 += names[i + U1]
                    w2 += names[i + U2]
                    w3 += names[i + U3]
            sums[0], sums[1], sums[2], sums[3] = w0, w1, w2, w3
            for n in range(CHANNELS):
                total = np.float32(np.int64((sums[n % WORDS] >> np.uint64(FIELD * (n // WORDS))) & field))
                out[into + np.uint32(named + n)] = (total * share - np.float32(1)) * window[place]
