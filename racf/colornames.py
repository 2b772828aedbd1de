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

from racf.kernels import compiled

UInt8 = NDArray[np.uint8]
UInt32 = NDArray[np.uint32]
Float32 = NDArray[np.float32]

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
    cube = np.stack(np.meshgrid(middle, middle, middle, indexing="ij"), axis=-1).reshape(-1, 3)
    lab = _lab(cube)
    near = lab @ seeds.T * 2
    near -= np.sum(lab**2, axis=1, keepdims=True)
    near -= np.sum(seeds**2, axis=1)
    near -= near.max(axis=1, keepdims=True)  # colours far from every name still get their nearest one's
    near *= np.float32(1 / (2 * SIGMA_LAB**2))
    likely = np.exp(near, out=near) @ votes
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


def padded_table() -> Float32:
    """`table` as `colour_names` wants it, (LEVELS^3, 16): a row is one cache line, added in one instruction."""
    return np.pad(table(), ((0, 0), (0, PADDED - CHANNELS)))


@compiled
def colour_names(
    patch: UInt8, cell: int, names: Float32, window: Float32, work: UInt32, out: Float32, first: int
) -> None:
    """Write the colour names of (3, H, W) BGR times the window into `out[..., first:first+10]`, (W/cell, H/cell, D).

    Same as `colour_names_numpy` with a window of ones.  `work` (cell W,) is scratch.
    """
    cols, rows, width = out.shape[0], out.shape[1], work.size // cell
    step, share, table = 256 // LEVELS, np.float32(1.0 / (cell * cell)), names.ravel()
    for row in range(rows):
        for y in range(cell):
            b, g, r = patch[0, row * cell + y], patch[1, row * cell + y], patch[2, row * cell + y]
            at = work[y * width : (y + 1) * width]
            for x in range(width):
                at[x] = ((np.uint32(b[x] // step) * LEVELS + g[x] // step) * LEVELS + r[x] // step) * PADDED
        for col in range(cols):
            # Ten numbers by name, since the compiler keeps those in registers and an array's in memory.
            n0 = n1 = n2 = n3 = n4 = n5 = n6 = n7 = n8 = n9 = np.float32(0)
            for y in range(cell):
                for x in range(y * width + col * cell, y * width + (col + 1) * cell):
                    i = work[x]
                    n0, n1, n2, n3, n4 = (
                        n0 + table[i],
                        n1 + table[i + 1],
                        n2 + table[i + 2],
                        n3 + table[i + 3],
                        n4 + table[i + 4],
                    )
                    n5, n6, n7, n8, n9 = (
                        n5 + table[i + 5],
                        n6 + table[i + 6],
                        n7 + table[i + 7],
                        n8 + table[i + 8],
                        n9 + table[i + 9],
                    )
            into, weight = out[col, row, first:], share * window[col, row]
            into[0], into[1], into[2], into[3], into[4] = (
                n0 * weight,
                n1 * weight,
                n2 * weight,
                n3 * weight,
                n4 * weight,
            )
            into[5], into[6], into[7], into[8], into[9] = (
                n5 * weight,
                n6 * weight,
                n7 * weight,
                n8 * weight,
                n9 * weight,
            )
