"""How sharp responses are on the target and off it: the thresholds of follow/target.py, measured.

    python benchmarks/confidence.py DATA [--frames 300] [--tracker racf-]

DATA holds folders of real sequences (`*/*/` with pictures and an annotation file).  Every picture gives the PSR over
the target's usual PSR, taken as the target estimate takes it, and the overlap with the annotated box.  Prints, for a
range of thresholds, how often a tracker on its target would be doubted and one off it believed, and draws
docs/confidence.png.
"""

import argparse
from itertools import islice
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

from follow.target import TargetConfig
from racf.box import Box
from racf.evaluate.boxfiles import read_boxes
from racf.evaluate.pictures import frames_of
from racf.evaluate.trackers import TrackerSpec
from racf.threads import one_core

CONFIG = TargetConfig()
ON, OFF = 0.3, 0.1  # overlaps: surely on the target; surely not
THRESHOLDS = (0.3, 0.4, 0.5, 0.6, 0.7, 0.8)


def measured(folder: Path, truth: np.ndarray, tracker: str, frames: int) -> np.ndarray:
    """Rows of (PSR over its usual value, overlap with the annotation) of one sequence."""
    boxes = [Box(x - 1, y - 1, w, h) if w > 0 and h > 0 else None for x, y, w, h in np.nan_to_num(truth).tolist()]
    finder, usual, rows = TrackerSpec.parse(tracker).build(), 0.0, []
    for image, box in zip(islice(frames_of(folder), frames), boxes, strict=False):
        if box is None:
            continue
        if not rows and usual == 0.0:
            finder.init(image, box)
            usual = -1.0
            continue
        track = finder.update(image)
        if usual < 0:
            usual = track.psr
        rows.append((track.psr / usual, track.box.iou(box)))
        if track.psr >= CONFIG.lose_psr * usual:
            usual += CONFIG.psr_rate * (track.psr - usual)
    return np.array(rows)


def sequences(data: Path) -> list[tuple[Path, Path]]:
    """(folder of pictures, annotation file) of every sequence below DATA."""
    found = []
    for file in sorted(data.glob("*/*/groundtruth*.txt")):
        pictures = file.parent / "img" if (file.parent / "img").is_dir() else file.parent
        found.append((pictures, file))
    return found


def main() -> None:
    one_core()
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("data", type=Path)
    parser.add_argument("--frames", type=int, default=300)
    parser.add_argument("--tracker", default="racf-")
    parser.add_argument("--out", type=Path, default=Path("docs/confidence.png"))
    args = parser.parse_args()
    parts = []
    for folder, file in sequences(args.data):
        part = measured(folder, read_boxes(file), args.tracker, args.frames)
        parts.append(part)
        print(f"{file.parent.name:<14}{len(part):>5} pictures, on target {np.mean(part[:, 1] >= ON):.3f}", flush=True)
    ratio, overlap = np.concatenate(parts).T
    on, off = ratio[overlap >= ON], ratio[overlap < OFF]
    print(f"{len(on)} pictures on the target, {len(off)} off it")
    print(f"{'threshold':>10}{'on, doubted':>14}{'off, believed':>15}")
    for t in THRESHOLDS:
        print(f"{t:>10}{np.mean(on < t):>14.4f}{np.mean(off >= t) if len(off) else np.nan:>15.4f}")
    figure, axes = plt.subplots(figsize=(7, 4), layout="constrained")
    axes.scatter(overlap, np.minimum(ratio, 2.0), s=4, alpha=0.3, linewidths=0)
    for value, name in ((CONFIG.lose_psr, "lost below"), (CONFIG.regain_psr, "found again above")):
        axes.axhline(value, lw=1, color="tab:red", ls="--" if name.startswith("lost") else ":", label=f"{name} {value}")
    axes.set(xlabel="overlap with the annotated box", ylabel="PSR over its usual value", ylim=(0, 2))
    axes.legend(loc="lower right")
    figure.savefig(args.out, dpi=110)


if __name__ == "__main__":
    main()
