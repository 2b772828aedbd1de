"""Shapes that the docstrings of the numeric functions promise, checked while a tracker runs (jaxtyping and beartype).

Letters: H, W cells of the sample, F = W//2 + 1 kept frequencies, D channels, m, n the filter's support, S scales.
"""

import sys
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from beartype import beartype
from jaxtyping import Complex64, Float32, UInt8, jaxtyped

import racf.tracker  # loaded before anything is wrapped
from racf import features, filter, fourier, patch, refine, response, scale
from racf.box import Box

checked = jaxtyped(typechecker=beartype)
Array = np.ndarray


class Seen:
    """Replaces functions by typed ones that call them, and counts the calls."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self._patch = monkeypatch
        self.calls: dict[str, int] = {}

    def wrap(self, owner: Any, name: str, typed: Callable[[Callable[..., Any]], Callable[..., Any]]) -> None:
        """Put the checked version of `owner.name` everywhere that the package imported it."""
        original = getattr(owner, name)
        self.calls[name] = 0
        inner = checked(typed(original))

        def counted(*args: Any, **kwargs: Any) -> Any:
            self.calls[name] += 1
            return inner(*args, **kwargs)

        if isinstance(owner, type):
            self._patch.setattr(owner, name, counted)
            return
        for module in [m for key, m in sys.modules.items() if key.startswith("racf.")]:
            for attribute, value in list(vars(module).items()):
                if value is original:
                    self._patch.setattr(module, attribute, counted)


SPECTRUM = "2 K 2 {self.half} D"  # folded: K = H//2 + 1


def forward(f: Any) -> Any:
    def forward(self: Any, x: Float32[Array, "W H D"], out: Any = None) -> Float32[Array, SPECTRUM]:
        return f(self, x, out)

    return forward


def forward_support(f: Any) -> Any:
    def forward_support(
        self: Any, g: Float32[Array, "{self.support[1]} {self.support[0]} D"], out: Any = None
    ) -> Float32[Array, SPECTRUM]:
        return f(self, g, out)

    return forward_support


def inverse_support(f: Any) -> Any:
    def inverse_support(
        self: Any, g_f: Float32[Array, SPECTRUM], out: Any = None
    ) -> Float32[Array, "{self.support[1]} {self.support[0]} D"]:
        return f(self, g_f, out)

    return inverse_support


def learn(f: Any) -> Any:
    def learn(
        self: Any,
        x_f: Float32[Array, "2 K 2 F D"],
        residue_f: Float32[Array, "2 K 2 F D"],
        y_f: Float32[Array, "2 {self.grid.rows} F"],
        aberrance: float = 0.0,
    ) -> Any:
        learned = f(self, x_f, residue_f, y_f, aberrance)
        assert learned.f_f.shape == learned.g_f.shape == x_f.shape
        return learned

    return learn


def response_map(f: Any) -> Any:
    def response_map(response_f: Complex64[Array, "H F"], shape: tuple[int, int]) -> Float32[Array, "H {shape[1]}"]:
        return f(response_f, shape)

    return response_map


def sharpness(f: Any) -> Any:
    def sharpness(response: Float32[Array, "H W"], target_cells: tuple[float, float]) -> tuple[float, float]:
        return f(response, target_cells)

    return sharpness


def resample(f: Any) -> Any:
    def resample(
        image: UInt8[Array, "rows cols *C"], x: float, y: float, w: float, h: float, out_w: int, out_h: int
    ) -> UInt8[Array, "planes {out_h} {out_w}"]:
        return f(image, x, y, w, h, out_w, out_h)

    return resample


def extract(f: Any) -> Any:
    def extract(
        self: Any, patch: UInt8[Array, "C {self.shape[1]*self.cell} {self.shape[0]*self.cell}"]
    ) -> Float32[Array, "{self.shape[0]} {self.shape[1]} {self.shape[2]}"]:
        return f(self, patch)

    return extract


def scale_sample(f: Any) -> Any:
    def sample(
        self: Any, image: UInt8[Array, "rows cols *C"], box: Box
    ) -> Complex64[Array, "{self.params.scales//2+1} d"]:
        return f(self, image, box)

    return sample


def cut(f: Any) -> Any:
    def cut(self: Any, patch: UInt8[Array, "s s 3"], inner: tuple[int, int, int, int]) -> UInt8[Array, "s s"]:
        return f(self, patch, inner)

    return cut


def bowl(f: Any) -> Any:
    def bowl(rows: int, cols: int, rim: float) -> Float32[Array, "{rows} {cols}"]:
        return f(rows, cols, rim)

    return bowl


WRAPPED = [
    (fourier.PrunedDft, "forward", forward),
    (fourier.PrunedDft, "forward_support", forward_support),
    (fourier.PrunedDft, "inverse_support", inverse_support),
    (filter.Solver, "learn", learn),
    (filter, "bowl_weight", bowl),
    (response, "response_map", response_map),
    (response, "sharpness", sharpness),
    (patch, "resample", resample),
    (features.Features, "extract", extract),
    (scale.ScaleFilter, "sample", scale_sample),
    (refine.Refiner, "_cut", cut),
]


@pytest.mark.parametrize("name", ["racf,robust", "arcf-hc"])
@pytest.mark.parametrize("colour", [True, False])
@pytest.mark.parametrize("box", [Box(60, 40, 40, 22), Box(31.5, 20.25, 12.5, 37.5)])
def test_arrays_have_the_shapes_that_the_docstrings_say(name, colour, box, monkeypatch):
    seen = Seen(monkeypatch)
    for owner, attribute, typed in WRAPPED:
        seen.wrap(owner, attribute, typed)
    shape = (121, 163, 3) if colour else (121, 163)
    image = np.random.default_rng(0).integers(0, 256, shape, dtype=np.uint8)
    image = np.ascontiguousarray(image.repeat(3, 0).repeat(3, 1)[: shape[0], : shape[1]])  # edges, not noise
    tracker = racf.Racf(name)
    tracker.init(image, box)
    for _ in range(2):
        track = tracker.update(image)
    assert track.response is not None
    unused = {attribute for attribute, calls in seen.calls.items() if calls == 0}
    assert unused == (set() if name == "racf,robust" else {"_cut"})


def test_a_wrong_shape_is_detected(monkeypatch):
    seen = Seen(monkeypatch)
    seen.wrap(fourier.PrunedDft, "forward", forward)
    grid = fourier.PrunedDft(10, 12, (4, 4), 3)
    assert grid.forward(np.zeros((12, 10, 3), np.float32)).shape == (2, 6, 2, 7, 3)
    with pytest.raises(Exception, match=r"(?i)type-check"):
        grid.forward(np.zeros((12, 10), np.float32))
    with pytest.raises(Exception, match=r"(?i)type-check"):
        grid.forward(np.zeros((12, 10, 3), np.float64))
