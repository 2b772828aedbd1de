"""Scores a flight over annotated footage: the tracker's boxes, and how well the target was kept in view."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from follow.messages import Tick
from follow.recording.summary import Figures
from racf.box import Box
from racf.evaluate.boxfiles import read_boxes
from racf.evaluate.metrics import Boxes, Convention, score


class Annotations:
    """The true boxes of footage.  The file is 1-based, as benchmarks are; everything returned is 0-based.

    Raises ValueError if the first row holds no box, because that box starts the tracker.
    """

    def __init__(self, path: Path) -> None:
        try:
            self.rows: Boxes = read_boxes(path)
        except UnicodeDecodeError:
            raise ValueError(
                f"{path} must be a text file with x,y,w,h in 1-based pixels in each row, and is not text"
            ) from None
        start = self.box(0)
        if start is None:
            raise ValueError(
                f"{path}, row 1: the first row must hold a box, x,y,w,h in 1-based pixels, not {_row(self.rows[0])}"
            )
        self.start = start

    def box(self, index: int) -> Box | None:
        """The true box in frame `index`; None if the target is absent or the rows have ended."""
        if not 0 <= index < len(self.rows):
            return None
        x, y, w, h = (float(v) for v in self.rows[index])
        good = np.all(np.isfinite(self.rows[index])) and w > 0 and h > 0
        return Box(x - 1, y - 1, w, h) if good else None


class FootageScore:
    """Collects boxes tick by tick over footage of size `whole`, in pixels of the source.

    `window` gives the part of it that the camera shows now; None if it shows all.
    """

    def __init__(self, truth: Annotations | None, whole: Box, window: Callable[[], Box] | None = None) -> None:
        self._truth = truth
        self._window = window or (lambda: whole)
        self._closed_loop = window is not None
        self._boxes = np.full_like(truth.rows, np.nan) if truth else np.empty((0, 4))
        self._rounds = 0
        self._frames = 0
        self._offsets: list[tuple[float, float]] = []
        self._times_s: list[float] = []

    def add(self, tick: Tick) -> Box | None:
        """Add one round; returns the true box in this round's image, if there is one."""
        if self._truth is None or tick.frame is None or tick.track is None:
            return None
        window = self._window()
        index, box = tick.frame.index, tick.track.box.zoomed(tick.frame.scale)
        self._frames = max(self._frames, index + 1)
        if index < len(self._boxes):
            self._rounds = max(self._rounds, index + 1)
            self._boxes[index] = (box.x + window.x + 1, box.y + window.y + 1, box.w, box.h)
        true = self._truth.box(index)
        if true is None:
            return None
        self._times_s.append(tick.frame.t_s)
        half_w, half_h = window.w / 2, window.h / 2
        self._offsets.append(((true.centre_x - window.centre_x) / half_w, (true.centre_y - window.centre_y) / half_h))
        return true.moved(-window.x, -window.y).zoomed(1 / tick.frame.scale)

    def figures(self) -> Figures:
        """Percent, over the rows that were played; for a moving window also how well it kept the target in view."""
        if self._truth is None or self._rounds == 0:
            return {}
        boxes, truth = self._boxes[: self._rounds], self._truth.rows[: self._rounds]
        toolkit, strict = (score(boxes, truth, convention) for convention in (Convention.TOOLKIT, Convention.STRICT))
        figures: Figures = {
            "precision_20px": round(toolkit.precision_20px, 3),
            "auc": round(toolkit.auc, 3),
            "precision_20px_strict": round(strict.precision_20px, 3),
            "auc_strict": round(strict.auc, 3),
        }
        if self._closed_loop:
            window = self._window()
            offsets = np.array(self._offsets)
            figures["in_view"] = round(1.0 - float(np.mean(self._outside())), 5)
            half_widths = offsets * (1.0, window.h / window.w)
            figures["centring_rms"] = round(float(np.sqrt(np.mean(np.sum(half_widths**2, axis=1)))), 5)
        return figures

    def left_window(self) -> str:
        """One sentence if the target's centre left the moving window; "" if not, or if there is no such window."""
        if not self._closed_loop or not self._offsets or not np.any(outside := self._outside()):
            return ""
        percent, first_s = 100 * np.mean(outside), self._times_s[int(np.argmax(outside))]
        return (
            f"the target left the window: outside in {percent:.0f} % of the annotated frames, first at "
            f"{first_s:.1f} s; yaw and climb came too late, or the gate forbade them "
            "(docs/evaluation.md, A window over footage)"
        )

    def _outside(self) -> NDArray[np.bool_]:
        """For each annotated frame, whether the target's centre was outside the view."""
        return np.any(np.abs(np.array(self._offsets)) > 1.0, axis=1)

    def shortfall(self) -> str | None:
        """One line if the numbers of rows and frames differ, else None."""
        if self._rounds < len(self._boxes):
            return f"{len(self._boxes)} annotated rows, but {self._rounds} frames: only those frames are scored"
        if self._truth is not None and self._frames > len(self._boxes):
            return f"{self._frames} frames, but {len(self._boxes)} annotated rows: only those rows are scored"
        return None


def _row(row: Boxes) -> str:
    return ",".join(f"{v:g}" for v in row)
