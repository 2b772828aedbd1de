"""Draw docs/height.png: the height at which the vehicle flies follows from the stand-off and the camera's angle.

python -m tools.docs.geometry [--out docs/height.png]
"""

import argparse
import math
from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from follow.config import PRESETS, CameraConfig, TargetKind

ANGLES_DEG = (15, 20, 30, 40, 45)
STANDOFFS_M = tuple(range(5, 31))


def height_m(standoff_m: float, down_deg: float) -> float:
    """Height above the target's middle at which the target is in the image's middle row, in level flight."""
    return standoff_m * math.tan(math.radians(down_deg))


def half_view_rad(camera: CameraConfig) -> float:
    """Half of the vertical field of view of a 16:9 image."""
    lens = camera.intrinsics(640, 360)
    return math.atan(lens.cy / lens.fy)


def side_view(ax: Axes, standoff_m: float, camera: CameraConfig) -> None:
    """Vehicle, target, stand-off, angle and height, seen from the side."""
    above, half = height_m(standoff_m, math.degrees(camera.down_rad)), half_view_rad(camera)
    middle = 0.9  # half a person's height
    ax.axhline(0.0, color="0.4", lw=2)
    for angle, style in ((-half, ":"), (0.0, "-"), (half, ":")):
        down = camera.down_rad + angle
        length = (above + middle) / math.sin(down) if down > 0.05 else 2 * standoff_m
        end = length * math.cos(down), above + middle - length * math.sin(down)
        ax.plot((0, end[0]), (above + middle, end[1]), style, color="tab:blue", lw=1.2)
    ax.plot((0, 5), (above + middle, above + middle), "--", color="0.6", lw=1)
    ax.plot((standoff_m, standoff_m), (0, 2 * middle), color="tab:red", lw=5, solid_capstyle="round")
    ax.scatter([0], [above + middle], s=120, color="black", marker="s", zorder=3)
    ax.annotate("", (0, -1.2), (standoff_m, -1.2), arrowprops={"arrowstyle": "<->"})
    ax.text(standoff_m / 2, -2.2, f"stand-off {standoff_m:g} m (servo.standoff_m)", ha="center")
    ax.annotate("", (-1.2, middle), (-1.2, above + middle), arrowprops={"arrowstyle": "<->"})
    ax.text(-1.6, above / 2 + middle, f"height {above:.1f} m\nabove the\ntarget's middle", ha="right", va="center")
    ax.text(5.3, above + middle, f"{math.degrees(camera.down_rad):g}° (camera.down_deg)", color="tab:blue", va="center")
    ax.text(standoff_m + 0.7, 2.2, "target", color="tab:red")
    ax.set_xlim(-6.5, 1.9 * standoff_m)
    ax.set_ylim(-3, above + 3)
    ax.set_aspect("equal")
    ax.set_axis_off()


def heights(ax: Axes) -> None:
    """Height against stand-off for several angles, with the stand-off of each kind of target."""
    for angle in ANGLES_DEG:
        ax.plot(STANDOFFS_M, [height_m(s, angle) for s in STANDOFFS_M], label=f"{angle}°")
    for kind in (TargetKind.PERSON, TargetKind.CAR):
        standoff_m = PRESETS[kind]["servo"]["standoff_m"]
        ax.axvline(standoff_m, color="0.6", ls=":", lw=1)
        ax.text(standoff_m + 0.2, 0.5, f"--for {kind.value}", fontsize=8)
    ax.set_xlabel("stand-off, m")
    ax.set_ylabel("height above the target's middle, m")
    ax.set_ylim(0, 20)
    ax.grid(alpha=0.3)
    ax.legend(title="camera.down_deg", fontsize=8, loc="center left", bbox_to_anchor=(1.0, 0.5))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("docs/height.png"))
    figure = Figure(figsize=(11, 4), layout="constrained")
    FigureCanvasAgg(figure)
    left, right = figure.subplots(1, 2, width_ratios=(3, 2))
    side_view(left, PRESETS[TargetKind.PERSON]["servo"]["standoff_m"], CameraConfig())
    heights(right)
    figure.savefig(parser.parse_args().out, dpi=80)


if __name__ == "__main__":
    main()
