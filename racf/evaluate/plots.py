"""Figures of an evaluation, each as PNG and SVG: precision and success, by attribute, and frames with boxes."""

from collections.abc import Mapping
from collections.abc import Sequence as ListOf
from pathlib import Path

import cv2
import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from racf.evaluate.benchmarks import Sequence
from racf.evaluate.images import read_frame
from racf.evaluate.metrics import ERROR_THRESHOLDS_PX, OVERLAP_THRESHOLDS, Boxes, Score, mean_score
from racf.evaluate.report import Report

LEGEND_AT_MOST = 16  # trackers: the paper's figures show fourteen
IMAGES_PER_SEQUENCE = 3
LINE_PX = (2, 1, 3)  # of the boxes of the first ten trackers, the next ten, ...
ANNOTATION, ANNOTATION_PX = "annotation", 1  # white with a black edge of as many pixels on either side
LEGEND = "0.7"  # grey, on which the annotation's white line can be seen
IMAGE_COLS = 480  # an image is scaled to this width before it is drawn on, so that lines are equally wide


def draw_curves(report: Report, folder: Path) -> list[Path]:
    """Figure 3 for each benchmark and for all: precision and success plots, best tracker first in the legend."""
    groups = {"all": report.names()}
    if len(report.benchmarks()) > 1:
        groups |= {benchmark: report.names(benchmark) for benchmark in report.benchmarks()}
    written: list[Path] = []
    for group, names in groups.items():
        means = {row.label: mean_score([row.nominal[name].toolkit for name in names]) for row in report.rows}
        for kind in ("precision", "success"):
            figure = Figure(figsize=(5.2, 4.2), layout="constrained")
            _curves(figure.subplots(), means, kind)
            figure.suptitle(f"{kind.capitalize()} plot of OPE: {group} ({len(names)} sequences)", fontsize=10)
            suffix = "" if group == "all" else f"-{group}"
            written += save(figure, folder / f"{kind}{suffix}")
    return written


def draw_attributes(report: Report, folder: Path) -> list[Path]:
    """Figure 4: a success plot for each attribute; nothing where the benchmark has none."""
    attributes = report.attributes()
    if not attributes:
        return []
    columns = min(4, len(attributes))
    lines = -(-len(attributes) // columns)
    figure = Figure(figsize=(4.2 * columns, 3.4 * lines), layout="constrained")
    every = np.atleast_1d(figure.subplots(lines, columns, squeeze=False)).ravel()
    for axes, attribute in zip(every, attributes, strict=False):
        names = report.names(attribute=attribute)
        _curves(axes, {r.label: mean_score([r.nominal[n].toolkit for n in names]) for r in report.rows}, "success")
        axes.set_title(f"{attribute} ({len(names)})", fontsize=9)
    for axes in every[len(attributes) :]:
        axes.set_axis_off()
    return save(figure, folder / "success-by-attribute")


def draw_lines(
    curves: Mapping[str, ListOf[float]], at: ListOf[float], labels: tuple[str, str], place: Path
) -> list[Path]:
    """A line for each name over common abscissae (Table 3 as a figure)."""
    figure = Figure(figsize=(5.2, 3.6), layout="constrained")
    axes = figure.subplots()
    for name, values in curves.items():
        axes.plot(at, values, marker="o", markersize=3, label=name)
    axes.set_xlabel(labels[0])
    axes.set_ylabel(labels[1])
    axes.grid(visible=True, alpha=0.3)
    axes.legend(fontsize=8)
    return save(figure, place)


def draw_images(sequences: ListOf[Sequence], boxes: Mapping[str, Mapping[str, Boxes]], place: Path) -> list[Path]:
    """Figure 6: frames of each sequence with the annotation and every tracker's box.

    `boxes` are by label and sequence, 1-based.  Raises ValueError where there is no sequence, or one without frames.
    """
    if not sequences:
        raise ValueError("there is no sequence to draw images of: none that counts has frames")
    for sequence in sequences:
        sequence.need_frames()
    colours = mpl.colormaps["tab10"].colors  # pyright: ignore[reportAttributeAccessIssue]
    # Ten colours, then the same with thinner and with thicker lines.
    lines = {
        label: (colours[i % len(colours)], LINE_PX[i // len(colours) % len(LINE_PX)]) for i, label in enumerate(boxes)
    }
    lines[ANNOTATION] = ((1.0, 1.0, 1.0), ANNOTATION_PX)
    figure = Figure(figsize=(3.4 * IMAGES_PER_SEQUENCE, 2.1 * len(sequences) + 0.4), layout="constrained")
    every = figure.subplots(len(sequences), IMAGES_PER_SEQUENCE, squeeze=False)
    for line, sequence in zip(every, sequences, strict=True):
        shown = np.linspace(0, len(sequence.frames) - 1, IMAGES_PER_SEQUENCE + 1).round().astype(int)[1:]
        for axes, index in zip(line, shown, strict=True):
            at = {ANNOTATION: sequence.truth[index]}  # drawn first, so that it covers no tracker's box
            at |= {label: of[sequence.name][index] for label, of in boxes.items() if sequence.name in of}
            axes.imshow(_with_boxes(read_frame(sequence.frames[index]), at, lines)[:, :, ::-1])
            axes.set_title(f"{sequence.name} #{index + 1}", fontsize=7)
            axes.set_axis_off()
    handles = [Line2D([], [], color=colour, linewidth=px, label=label) for label, (colour, px) in lines.items()]
    figure.legend(
        handles=handles, loc="outside lower center", ncols=min(len(handles), len(colours)), fontsize=8, facecolor=LEGEND
    )
    return save(figure, place)


def save(figure: Figure, place: Path) -> list[Path]:
    """Write `place`.png and `place`.svg, without dates so that equal figures are equal files."""
    place.parent.mkdir(parents=True, exist_ok=True)
    paths = [place.with_name(f"{place.name}.{kind}") for kind in ("png", "svg")]
    with mpl.rc_context({"svg.hashsalt": "racf"}):
        figure.savefig(paths[0], dpi=150, metadata={"Software": None})
        figure.savefig(paths[1], metadata={"Date": None})
    return paths


def _curves(axes: Axes, means: Mapping[str, Score], kind: str) -> None:
    if kind == "precision":
        at, ranked = ERROR_THRESHOLDS_PX, {label: mean.precision_20px for label, mean in means.items()}
        axes.set_xlabel("centre error threshold (px)")
        axes.set_ylabel("precision (%)")
    else:
        at, ranked = OVERLAP_THRESHOLDS, {label: mean.auc for label, mean in means.items()}
        axes.set_xlabel("overlap threshold")
        axes.set_ylabel("success rate (%)")
    best_first = sorted(ranked, key=lambda label: -ranked[label])
    for place, label in enumerate(best_first):
        values = means[label].precision if kind == "precision" else means[label].success
        name = f"{label} [{ranked[label]:.1f}]" if place < LEGEND_AT_MOST else None
        axes.plot(at, values, label=name, linewidth=2.0 if place == 0 else 1.0, linestyle=("-", "--", ":")[place % 3])
    axes.set_ylim(0, 100)
    axes.grid(visible=True, alpha=0.3)
    axes.legend(fontsize=6)


def _with_boxes(
    image: NDArray[np.uint8],
    at: Mapping[str, NDArray[np.float64]],
    lines: Mapping[str, tuple[tuple[float, ...], int]],
) -> NDArray[np.uint8]:
    """A copy, `IMAGE_COLS` wide, with boxes in 1-based pixels of the original drawn on it, except those of NaN."""
    scale = IMAGE_COLS / image.shape[1]
    small = cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    for label, box in at.items():
        if not np.isfinite(box).all():
            continue
        x, y, w, h = box
        corners = [(round((x - 1) * scale), round((y - 1) * scale))]
        corners += [(round((x - 1 + w) * scale), round((y - 1 + h) * scale))]
        colour, thick = lines[label]
        if label == ANNOTATION:
            cv2.rectangle(small, corners[0], corners[1], [0, 0, 0], 3 * thick)
        cv2.rectangle(small, corners[0], corners[1], [round(255 * c) for c in colour[:3]][::-1], thick)
    return np.asarray(small, dtype=np.uint8)
