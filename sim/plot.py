"""Draws `flight.png`: both paths from above, a strip of camera images, the errors over time."""

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from follow.geometry import Intrinsics, heading_to_ned
from follow.messages import Frame
from racf.box import Box
from sim.scene.ground import Image
from sim.scene.world import World
from sim.score import ScoredTick, distance, offset

STRIP = 6  # images
STRIP_WIDTH = 320  # of each, px
TRUE, TRACKED = (235, 190, 0), (255, 40, 40)  # colours of the target's and the tracker's box, RGB: yellow and red
HALF = 0.5  # of the target visible, below which the plot marks it as hidden


class Strip:
    """Keeps a few small images of a running flight, with the true box (yellow) and the tracker's (red)."""

    def __init__(self, duration_s: float) -> None:
        self.images: list[tuple[float, Image]] = []
        self._every_s = duration_s / STRIP

    def add(self, frame: Frame, true: Box | None, tracked: Box | None) -> None:
        """Keep this frame's image if the next one is due."""
        due = (len(self.images) + 0.5) * self._every_s
        if len(self.images) >= STRIP or frame.t_s < due:
            return
        image = frame.image.copy()
        for box, colour in ((true, TRUE[::-1]), (tracked, TRACKED[::-1])):
            if box is not None:
                corner, opposite = (round(box.x), round(box.y)), (round(box.x + box.w), round(box.y + box.h))
                cv2.rectangle(image, corner, opposite, colour, 2)
        size = (STRIP_WIDTH, round(STRIP_WIDTH * image.shape[0] / image.shape[1]))
        small = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
        self.images.append((frame.t_s, np.asarray(small, np.uint8)))


def draw(
    path: Path,
    title: str,
    rows: Sequence[ScoredTick],
    world: World,
    camera: Intrinsics,
    standoff_m: float,
    strip: Strip,
) -> None:
    """Write the plot of a flight.  Raises OSError if the file cannot be written."""
    figure = Figure(figsize=(12, 8.5), layout="constrained")
    FigureCanvasAgg(figure)
    grid = figure.add_gridspec(2, 1, height_ratios=(1, 3))
    above, beside = figure.add_subfigure(grid[0]), figure.add_subfigure(grid[1])
    above.suptitle(f"{title}: what the camera saw (yellow: true box, red: the tracker's)", fontsize=11)
    for ax, (t_s, image) in zip(np.atleast_1d(above.subplots(1, STRIP)).flat, strip.images, strict=False):
        ax.imshow(cv2.cvtColor(image, cv2.COLOR_BGR2RGB))
        ax.set_title(f"{t_s:.1f} s", fontsize=8)
    for ax in above.axes:
        ax.set_axis_off()
    halves = beside.add_gridspec(1, 2)
    left, right = beside.add_subfigure(halves[0]), beside.add_subfigure(halves[1])
    _paths(left.subplots(), rows, world)
    _errors(list(np.atleast_1d(right.subplots(3, 1, sharex=True)).flat), rows, camera, standoff_m)
    figure.savefig(path, dpi=90)


def _paths(ax: Axes, rows: Sequence[ScoredTick], world: World) -> None:
    """Vehicle and target from above, with lines of sight every few seconds, walls and trees."""
    seen = [row for row in rows if row.truth is not None]
    target = np.array([(p.east_m, p.north_m) for row in seen if row.truth for p in row.truth.poses[:1]])
    own = np.array([(row.truth.vehicle.east_m, row.truth.vehicle.north_m) for row in seen if row.truth])
    for block in world.blocks:
        n, e = heading_to_ned(block.length_m / 2, 0.0, block.heading_rad)
        ends = (block.east_m - e, block.east_m + e), (block.north_m - n, block.north_m + n)
        ax.plot(*ends, color="0.45", lw=5 if block.windows else 3, solid_capstyle="butt", label="wall, house")
    for tree in world.trees:
        crown = (tree.east_m, tree.north_m), tree.radius_m
        ax.add_patch(Circle(*crown, color="tab:green", alpha=0.35, lw=0, label="tree"))
    for k in range(0, len(seen), max(1, len(seen) // 12)):
        sight = (own[k, 0], target[k, 0]), (own[k, 1], target[k, 1])
        ax.plot(*sight, color="0.8", lw=0.8, label="line of sight")
    colour = tuple(level / 255 for level in TRUE)
    ax.plot(own[:, 0], own[:, 1], color="tab:blue", label="vehicle")
    ax.plot(target[:, 0], target[:, 1], color=colour, label="target")
    ax.scatter(*own[0], color="tab:blue", s=25, zorder=3, label="start")
    ax.scatter(*target[0], color=colour, s=25, zorder=3)
    both = np.concatenate([own, target])
    middle, reach = (both.max(axis=0) + both.min(axis=0)) / 2, float(np.ptp(both, axis=0).max()) / 2 + 5
    ax.set_xlim(middle[0] - reach, middle[0] + reach)
    ax.set_ylim(middle[1] - reach, middle[1] + reach)
    ax.set_aspect("equal")
    ax.set_xlabel("east, m")
    ax.set_ylabel("north, m")
    ax.grid(alpha=0.3)
    _legend(ax, 3)


def _errors(axes: Sequence[Axes], rows: Sequence[ScoredTick], camera: Intrinsics, standoff_m: float) -> None:
    """Offset in the image, stand-off error, and the setpoints sent."""
    seen = [row for row in rows if row.truth is not None]
    t = [row.t_s for row in seen]
    offsets = np.array([offset(row, camera) for row in seen])
    hidden = [row.truth is not None and row.truth.visible < HALF for row in seen]
    axes[0].plot(t, offsets[:, 0], label="to the right")
    axes[0].plot(t, offsets[:, 1], label="down")
    axes[0].set_ylabel("target's offset,\nhalf image widths")
    axes[1].plot(t, [distance(row) - standoff_m for row in seen], color="tab:purple", label="true range less stand-off")
    axes[1].set_ylabel("stand-off error, m")
    for ax in axes[:2]:
        label = "target at least half hidden" if any(hidden) else None
        ax.fill_between(t, 0, 1, where=hidden, transform=ax.get_xaxis_transform(), color="0.85", lw=0, label=label)
    sent = [row for row in rows if row.setpoint is not None]
    times = [row.t_s for row in sent]
    for name, label in (
        ("forward_m_s", "forward, m/s"),
        ("right_m_s", "right, m/s"),
        ("down_m_s", "down, m/s"),
        ("yaw_rate_rad_s", "yaw rate, rad/s"),
    ):
        axes[2].plot(times, [getattr(row.setpoint, name) for row in sent], label=label, lw=1)
    axes[2].set_ylabel("setpoint sent")
    axes[2].set_xlabel("time of flight, s")
    for ax in axes:
        ax.grid(alpha=0.3)
        _legend(ax, 4)


def _legend(ax: Axes, columns: int) -> None:
    """Each label once, above the axes, where no curve runs."""
    known = {label: handle for handle, label in zip(*ax.get_legend_handles_labels(), strict=True)}
    corner = "lower left", (0.0, 1.0)  # the legend's, and where it is
    ax.legend(
        known.values(),
        known.keys(),
        loc=corner[0],
        bbox_to_anchor=corner[1],
        borderaxespad=0.2,
        fontsize=8,
        ncols=columns,
        frameon=False,
    )
