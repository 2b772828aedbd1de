"""Rows of the fault matrix in which the image no longer shows the world: frozen behind something that still changes.

The images are of textured ground; the box of a frozen image is frozen with it.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from follow.messages import Frame
from racf.box import Box
from racf.track import Track
from tests.support.bounds import CONTRADICTED_S, RIDING_S, RUN_M_S, stop
from tests.support.fault_expectations import Expectation, stands_still, stops
from tests.support.fault_rig import Rig
from tests.support.fault_rows import Row

CLOCK = (slice(4, 20), slice(4, 100))  # where an on-screen display writes the time


@dataclass
class Frozen:
    """A camera of which `buffers` stale images are delivered in turn, each with its box and a change on it."""

    rig: Rig
    buffers: int
    change: Callable[[NDArray[np.uint8], np.random.Generator], NDArray[np.uint8]]

    def __post_init__(self) -> None:
        self._held: list[tuple[NDArray[np.uint8], Box | None]] = []
        self._random = np.random.default_rng(0)
        self._shown: Box | None = None

    def see(self, frame: Frame | None) -> Frame | None:
        if frame is None:
            return None
        if len(self._held) < self.buffers:
            self._held.append((frame.image, self.rig.true_box()))
        image, self._shown = self._held[frame.index % len(self._held)]
        return replace(frame, image=self.change(image.copy(), self._random))

    def track(self, track: Track) -> Track:
        box = self._shown
        return replace(track, found=False) if box is None else replace(track, box=box, search=box.scaled(3), found=True)


def noise(image: NDArray[np.uint8], random: np.random.Generator) -> NDArray[np.uint8]:
    """An analogue frame grabber."""
    return np.clip(image + random.normal(0.0, 3.0, image.shape), 0, 255).astype(np.uint8)


def clock(image: NDArray[np.uint8], random: np.random.Generator) -> NDArray[np.uint8]:
    """An on-screen display whose clock runs on."""
    image[CLOCK] = random.integers(0, 255, image[CLOCK].shape)
    return image


def unchanged(image: NDArray[np.uint8], _random: np.random.Generator) -> NDArray[np.uint8]:
    """The buffer as it is."""
    return image


def frozen(change: Callable[[NDArray[np.uint8], np.random.Generator], NDArray[np.uint8]], buffers: int = 1):
    def inject(rig: Rig) -> None:
        camera = Frozen(rig, buffers, change)
        rig.see, rig.track = camera.see, camera.track

    return inject


def rides(rig: Rig) -> None:
    """The tracker has slipped to the landing gear: it sits still in the image, in which the world goes on moving."""
    box = rig.true_box()
    assert box is not None
    rig.track = lambda track: replace(track, box=box, search=box.scaled(3), found=True)


FAULTS = {
    "image frozen, with noise": frozen(noise),
    "image frozen, its clock runs": frozen(clock),
    "two stale images in turn": frozen(unchanged, buffers=2),
    "tracker on the landing gear": rides,
}


def circle(t_s: float) -> tuple[float, float]:
    """Around the vehicle at the stand-off, 3 m/s: it turns and stays where it is."""
    angle = RUN_M_S / 12.0 * max(t_s - 6.0, 0.0)
    return 12.0 * math.cos(angle), 12.0 * math.sin(angle)


VIEW: dict[str, object] = {"view": True, "fault_t_s": 15.0, "end_t_s": 26.0}


def flights(noticed_s: float) -> dict[str, tuple[dict[str, object], Expectation]]:
    """What the vehicle does as the fault comes, and what must follow."""
    bound = stop(RUN_M_S, noticed_s)
    return {
        "hovering": ({"path": lambda _t_s: (12.0, 0.0), **VIEW, "end_t_s": 35.0}, stands_still(10.0)),
        "turning": ({"path": circle, **VIEW}, stops(bound)),
        "flying": (VIEW, stops(bound)),
    }


IMAGE_ROWS = tuple(
    Row(f"{fault}, {how}", inject, expect, rig, fast=how == "flying" and fault.startswith("two"))
    for fault, inject in FAULTS.items()
    for how, (rig, expect) in flights(RIDING_S if inject is rides else CONTRADICTED_S).items()
)
