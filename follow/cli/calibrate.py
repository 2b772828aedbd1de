"""`follow calibrate`: a camera file from a video or a folder of images of a board."""

import math
import os
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from follow.camera import CameraError
from follow.camera.board import Board, BoardView, diverse
from follow.camera.calibration import Fit, as_opencv_yaml, described
from follow.camera.lens_fit import CELLS, GOOD_COVERAGE, LensFit, LensKind, fit_lens, rms_px, solved
from follow.camera.names import is_live
from follow.camera.video import open_replay
from follow.cli.commands import CalibrateCommand
from follow.cli.named import require_source
from follow.geometry import Array, Intrinsics, distort
from follow.messages import Frame
from follow.operator.terminal import Terminal
from racf.commandline import UsageError

EVERY_S = 0.25  # interval of a video's images: a board held in the hand has moved by then
MOST_IMAGES = 240  # images searched for the board: a minute of video
MOST_VIEWS = 40  # views for the fit: more hardly change the lens
BETTER = 0.7  # a fisheye is suggested if its reprojection error is below this fraction of the pinhole's
ARROW = 40  # residuals are drawn enlarged by this


def calibrate(command: CalibrateCommand) -> None:
    """`follow calibrate`; raises CalibrationError for views that do not determine the lens, CameraError, UsageError."""
    board = board_of(command)
    if is_live(command.source):
        raise UsageError(f"calibrate reads a video file or a folder of images, not the live source {command.source!r}")
    refuse_out(command.out)
    require_source(command.source)
    terminal = Terminal()
    views, size, seen = gather(command, board, terminal)
    blurred = sum(not board.is_sharp(view) for view in views)
    sharp = [view for view in views if board.is_sharp(view)]
    terminal.report(f"{seen} images looked at: {len(views)} show the board, {blurred} of them blurred")
    if not views:
        terminal.report(
            "is it the board that --pattern and --board describe? A checkerboard must be whole in the image, and its "
            "inner corners are counted: 9x6 for 10x7 squares"
        )
    fit = fit_lens(diverse(sharp, size, MOST_VIEWS), size, command.lens)
    command.out.parent.mkdir(parents=True, exist_ok=True)
    command.out.write_text(as_opencv_yaml(fit.lens, Fit(fit.rms_px, len(fit.views), str(board))))
    plot = command.out.with_suffix(".png")
    draw(fit, plot)
    for line in summary(fit, size, command.lens):
        terminal.report(line)
    terminal.report(f"written: {command.out}, and the plot {plot}; fly with --camera.calibration {command.out}")


def refuse_out(out: Path) -> None:
    """Raise UsageError for a file that cannot be written, before spending a minute on its content."""
    folder = next(parent for parent in (out.absolute().parent, *out.absolute().parents) if parent.exists())
    if out.is_dir() or not folder.is_dir() or not os.access(out if out.exists() else folder, os.W_OK):
        raise UsageError(f"--out {str(out)!r} must be a file that can be written")


def board_of(command: CalibrateCommand) -> Board:
    """The board that the options describe.  Raises UsageError."""
    columns, cross, rows = command.board.lower().partition("x")
    if not (cross and columns.isdecimal() and rows.isdecimal()):
        raise UsageError(f"--board must be COLUMNSxROWS, as 9x6, not {command.board!r}")
    try:
        numbers = int(columns), int(rows)
        return Board(command.pattern, *numbers, command.square_m, command.dictionary, command.marker_fraction)
    except ValueError as error:
        raise UsageError(f"--board: {error}") from None


def gather(command: CalibrateCommand, board: Board, terminal: Terminal) -> tuple[list[BoardView], tuple[int, int], int]:
    """The views of the board in the source, the images' size, and the number of images searched."""
    views: list[BoardView] = []
    seen = 0
    with open_replay(command.source, None, terminal.report) as camera:
        frames, size = camera.frames(), camera.size
        step = 1
        if not Path(command.source).is_dir():
            step = max(1, round(EVERY_S * camera.fps))
        if camera.rounds is not None:
            step = max(step, math.ceil(camera.rounds / MOST_IMAGES))
        total = None if camera.rounds is None else math.ceil(camera.rounds / step)
        for frame in terminal.progress(every(frames, step), total, "calibrate", "images"):
            seen += 1
            if (view := board.find(frame.image, frame.index)) is not None:
                views.append(view)
    if not seen:
        raise CameraError(f"{command.source!r} holds no frame that can be decoded")
    return views, size, seen


def every(frames: Iterator[Frame | None], step: int) -> Iterator[Frame]:
    """The first frame, then each first one at least `step` rounds after the last."""
    due = 0
    for n, frame in enumerate(frames):
        if frame is not None and n >= due:
            due = n + step
            yield frame


def summary(fit: LensFit, size: tuple[int, int], kind: LensKind) -> list[str]:
    """The result of the fit, as lines for a person."""
    lens = fit.lens
    lines = [
        described(lens),
        f"reprojection error {fit.rms_px:.2f} pixels (rms) over {len(fit.views)} views; the board was seen in "
        f"{100 * fit.coverage:.0f} % of the image",
        f"uncertainty: focal length {100 * fit.focal_std:.2f} %, direction of a corner's pixel "
        f"{math.degrees(fit.edge_std_rad):.2f} degrees",
    ]
    if fit.coverage < GOOD_COVERAGE:
        lines.append("little of the image was covered: the distortion near the edges is a guess there")
    if kind is LensKind.PINHOLE:
        try:
            other = solved(fit.views, size, LensKind.FISHEYE)[1]
            if rms_px(other) < BETTER * fit.rms_px:
                lines.append(f"a fisheye fits better, {rms_px(other):.2f} pixels: try --lens fisheye")
        except ValueError:
            pass  # no fisheye fits at all
    return lines


def draw(fit: LensFit, path: Path) -> None:
    """Plot the corners with their residuals, and the lens's distortion."""
    from matplotlib.figure import Figure  # noqa: PLC0415 - only a plot needs it

    figure = Figure(figsize=(11, 4.2), layout="constrained")
    left, right = figure.subplots(1, 2)
    pixels = np.concatenate([view.pixels for view in fit.views]).astype(np.float64)
    off = np.concatenate(fit.residuals)
    left.plot(pixels[:, 0], pixels[:, 1], ".", markersize=2, color="0.4")
    left.quiver(*pixels.T, *off.T, angles="xy", scale_units="xy", scale=1 / ARROW, width=0.0015, color="tab:red")
    for n, size in enumerate((fit.lens.width, fit.lens.height)):
        for line in np.linspace(0, size, CELLS[n] + 1):
            (left.axvline if n == 0 else left.axhline)(float(line), color="0.85", linewidth=0.6, zorder=0)
    left.set(
        xlim=(0, fit.lens.width),
        ylim=(fit.lens.height, 0),
        aspect="equal",
        title=f"corners of {len(fit.views)} views; errors {ARROW}x, rms {fit.rms_px:.2f} px",
        xlabel="x, pixels",
        ylabel="y, pixels",
    )
    angles, radii, straight = distortion_curve(fit.lens)
    right.plot(angles, straight, "--", color="0.6", label="without distortion")
    right.plot(angles, radii, color="tab:blue", label="this lens")
    reached = float(np.max(np.hypot(*(pixels - (fit.lens.cx - 0.5, fit.lens.cy - 0.5)).T)))
    right.axhline(reached, color="tab:green", linewidth=0.8, label="farthest corner seen")
    top = 1.05 * math.hypot(fit.lens.width, fit.lens.height) / 2
    right.set(
        title=described(fit.lens), xlabel="angle from the axis, degrees", ylabel="pixels from the centre", ylim=(0, top)
    )
    right.title.set_fontsize(8)
    right.legend()
    figure.savefig(path, dpi=120)


def distortion_curve(lens: Intrinsics) -> tuple[Array, Array, Array]:
    """Angles off the axis to the right (degrees), the pixels from the centre there, and those without distortion."""
    angles = np.radians(np.linspace(0.0, 85.0, 200))
    plane = np.stack([np.tan(angles), np.zeros(200)], axis=1)
    return np.degrees(angles), distort(lens, plane)[:, 0] * lens.fx, plane[:, 0] * lens.fx
