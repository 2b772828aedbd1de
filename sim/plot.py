"""A flight on one picture: both ways from above, a strip of what the camera saw, the errors over time."""

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from follow.geometry import Intrinsics, heading_to_ned
from follow.messages import Frame
from racf.box import Box
from sim.scene.ground import Image
from sim.scene.world import World
from sim.score import ScoredTick, distance, offset

STRIP = 6  # pictures
STRIP_WIDTH = 320  # pixels of each


class Strip:
    """Keeps a few small pictures of a flight as it goes by, with the true box (yellow) and the tracker's (red)."""

    def __init__(self, duration_s: float) -> None:
        self.pictures: list[tuple[float, Image]] = []
        self._every_s = duration_s / STRIP

    def add(self, frame: Frame, true: Box | None, tracked: Box | None) -> None:
        """Keep this picture when it is time for the next one."""
        due = (len(self.pictures) + 0.5) * self._every_s
        if len(self.pictures) >= STRIP or frame.t_s < due:
            return
        image = frame.image.copy()
        for box, colour in ((true, (0, 230, 255)), (tracked, (40, 40, 255))):
            if box is not None:
                corner, opposite = (round(box.x), round(box.y)), (round(box.x + box.w), round(box.y + box.h))
                cv2.rectangle(image, corner, opposite, colour, 2)
        size = (STRIP_WIDTH, round(STRIP_WIDTH * image.shape[0] / image.shape[1]))
        small = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
        self.pictures.append((frame.t_s, np.asarray(small, np.uint8)))


def draw(
    path: Path,
    title: str,
    rows: Sequence[ScoredTick],
    world: World,
    camera: Intrinsics,
    standoff_m: float,
    strip: Strip,
) -> None:
    """Write the picture of a flight.  Raises OSError when the file cannot be written."""
    figure = Figure(figsize=(12, 8.5), layout="constrained")
    FigureCanvasAgg(figure)
    grid = figure.add_gridspec(2, 1, height_ratios=(1, 3))
    above, beside = figure.add_subfigure(grid[0]), figure.add_subfigure(grid[1])
    above.suptitle(title, fontsize=11)
    for ax, (t_s, image) in zip(np.atleast_1d(above.subplots(1, STRIP)).flat, strip.pictures, strict=False):
        ax.imshow(cv2.cvtColor(image, cv2.COLOR_BGR2RGB))
        ax.set_title(f"{t_s:.1f} s", fontsize=8)
    for ax in above.axes:
        ax.set_axis_off()
    halves = beside.add_gridspec(1, 2)
    left, right = beside.add_subfigure(halves[0]), beside.add_subfigure(halves[1])
    _ways(left.subplots(), rows, world)
    _errors(list(np.atleast_1d(right.subplots(3, 1, sharex=True)).flat), rows, camera, standoff_m)
    figure.savefig(path, dpi=90)


def _ways(ax: Axes, rows: Sequence[ScoredTick], world: World) -> None:
    """Vehicle and target from above, with lines of sight every few seconds, walls and trees."""
    seen = [row for row in rows if row.truth is not None]
    places = np.array([(p.east_m, p.north_m) for row in seen if row.truth for p in row.truth.places[:1]])
    own = np.array([(row.truth.motion.east_m, row.truth.motion.north_m) for row in seen if row.truth])
    for block in world.blocks:
        n, e = heading_to_ned(block.length_m / 2, 0.0, block.heading_rad)
        ends = (block.east_m - e, block.east_m + e), (block.north_m - n, block.north_m + n)
        ax.plot(*ends, color="0.45", lw=5 if block.windows else 3, solid_capstyle="butt")
    for tree in world.trees:
        ax.scatter([tree.east_m], [tree.north_m], s=12 * tree.radius_m, color="tab:green", alpha=0.35, lw=0)
    for k in range(0, len(seen), max(1, len(seen) // 12)):
        ax.plot((own[k, 0], places[k, 0]), (own[k, 1], places[k, 1]), color="0.8", lw=0.8)
    ax.plot(own[:, 0], own[:, 1], color="tab:blue", label="vehicle")
    ax.plot(places[:, 0], places[:, 1], color="tab:red", label="target")
    both = np.concatenate([own, places])
    middle, reach = (both.max(axis=0) + both.min(axis=0)) / 2, float(np.ptp(both, axis=0).max()) / 2 + 5
    ax.set_xlim(middle[0] - reach, middle[0] + reach)
    ax.set_ylim(middle[1] - reach, middle[1] + reach)
    ax.set_aspect("equal")
    ax.set_xlabel("east, m")
    ax.set_ylabel("north, m")
    ax.grid(alpha=0.3)
    ax.legend(fontsize=8)


def _errors(axes: Sequence[Axes], rows: Sequence[ScoredTick], camera: Intrinsics, standoff_m: float) -> None:
    """Offset in the picture, stand-off error, and what was sent."""
    seen = [row for row in rows if row.truth is not None]
    t = [row.t_s for row in seen]
    offsets = np.array([offset(row, camera) for row in seen])
    hidden = [row.truth is not None and row.truth.visible < 0.5 for row in seen]
    axes[0].plot(t, offsets[:, 0], label="right")
    axes[0].plot(t, offsets[:, 1], label="down")
    axes[0].set_ylabel("offset, half widths")
    axes[1].plot(t, [distance(row) - standoff_m for row in seen], color="tab:purple")
    axes[1].set_ylabel("stand-off error, m")
    for ax in axes[:2]:
        ax.fill_between(t, 0, 1, where=hidden, transform=ax.get_xaxis_transform(), color="0.85", lw=0)
    sent = [row for row in rows if row.setpoint is not None]
    times = [row.t_s for row in sent]
    for name, label in (
        ("forward_m_s", "forward, m/s"),
        ("right_m_s", "right, m/s"),
        ("down_m_s", "down, m/s"),
        ("yaw_rate_rad_s", "yaw rate, rad/s"),
    ):
        axes[2].plot(times, [getattr(row.setpoint, name) for row in sent], label=label, lw=1)
    axes[2].set_ylabel("setpoint")
    axes[2].set_xlabel("time, s")
    for ax in axes:
        ax.grid(alpha=0.3)
        if ax.get_legend_handles_labels()[0]:
            ax.legend(fontsize=7, ncols=2)
