"""Sharpness of responses on the target and elsewhere: measures the thresholds of follow/control/target.py.

    python -m tools.studies.confidence DATA [--frames 300] [--tracker racf,robust,redetect=false]

DATA holds folders of real sequences (`*/*/` with images and an annotation file).  Every frame gives the PSR over the
target's usual PSR, computed as the target estimate computes it, and the overlap with the annotated box.  Every fifth
frame is also given to a copy of the tracker that searches one search area away, where nothing of the target is.
Prints, for a range of thresholds, how often a tracker on its target would be rejected, and how often a tracker that
searches elsewhere or has drifted off would be accepted; draws docs/confidence.png.
"""

import argparse
import copy
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

from follow.control.target import TargetConfig
from racf.box import Box
from racf.evaluate.boxfiles import read_boxes
from racf.evaluate.images import frames_of
from racf.evaluate.trackers import TrackerSpec
from racf.threads import one_core
from racf.track import Track
from racf.tracker import Racf
from tools.studies.halves import tracker_label

CONFIG = TargetConfig()
ON, OFF = 0.3, 0.1  # overlaps: certainly on the target; certainly not
EVERY = 5  # frames from one look elsewhere to the next
THRESHOLDS = (0.3, 0.4, 0.5, 0.6, 0.7, 0.8)


@dataclass
class Ratios:
    """PSR over its usual value: of the tracked frames, with their overlaps, and of searches elsewhere."""

    followed: list[float] = field(default_factory=list)
    overlap: list[float] = field(default_factory=list)
    elsewhere: list[float] = field(default_factory=list)


def measure(folder: Path, truth: np.ndarray, tracker: str, frames: int, into: Ratios) -> list[float]:
    """Follow one sequence; the overlaps of its frames."""
    boxes = [Box(x - 1, y - 1, w, h) if w > 0 and h > 0 else None for x, y, w, h in np.nan_to_num(truth).tolist()]
    finder, random = TrackerSpec.parse(tracker).build(), np.random.default_rng(0)
    assert isinstance(finder, Racf)
    track, usual, accepted, overlaps = None, 0.0, 0, list[float]()
    for k, (image, box) in enumerate(zip(islice(frames_of(folder), frames), boxes, strict=False)):
        if box is None:
            continue
        if track is None:
            track = finder.init(image, box)
            continue
        prior = away(track, image, random)
        if k % EVERY == 0 and accepted >= CONFIG.settle and overlaps[-1] >= ON and prior is not None:
            look = copy.deepcopy(finder).update(image, prior)
            if look.box.iou(box) < OFF:
                into.elsewhere.append(look.psr / min(usual, CONFIG.psr_cap))
        track = finder.update(image)
        overlaps.append(track.box.iou(box))
        if accepted >= CONFIG.settle:
            into.followed.append(track.psr / min(usual, CONFIG.psr_cap))
            into.overlap.append(overlaps[-1])
        if accepted < CONFIG.settle or track.psr >= CONFIG.psr_ratio_lost * min(usual, CONFIG.psr_cap):
            accepted += 1
            usual += max(CONFIG.psr_rate, 1 / accepted) * (track.psr - usual)
    return overlaps


def away(track: Track, image: np.ndarray, random: np.random.Generator) -> Box | None:
    """The box moved by one search area to a side that is inside the image; None if no side is."""
    rows, columns = image.shape[:2]
    x, y, step_x, step_y = track.box.centre_x, track.box.centre_y, track.search.w, track.search.h
    places = [(x + step_x, y), (x - step_x, y), (x, y + step_y), (x, y - step_y)]
    places = [(x, y) for x, y in places if 0 < x < columns and 0 < y < rows]
    if not places:
        return None
    return Box.around(*places[random.integers(len(places))], track.box.w, track.box.h)


def sequences(data: Path) -> list[tuple[Path, Path]]:
    """(folder of images, annotation file) of every sequence below DATA."""
    found = []
    for file in sorted(data.glob("*/*/groundtruth*.txt")):
        images = file.parent / "img" if (file.parent / "img").is_dir() else file.parent
        found.append((images, file))
    return found


def fraction(what: np.ndarray) -> float:
    """The fraction that is true; NaN of nothing."""
    return float(np.mean(what)) if len(what) else np.nan


def draw(ratio: np.ndarray, overlap: np.ndarray, elsewhere: np.ndarray, out: Path) -> None:
    figure, axes = plt.subplots(figsize=(7, 4), layout="constrained")
    axes.scatter(overlap, np.minimum(ratio, 2.0), s=4, alpha=0.3, linewidths=0, label="as it was followed")
    spread = np.linspace(-0.06, -0.02, len(elsewhere))
    axes.scatter(spread, np.minimum(elsewhere, 2.0), s=4, color="tab:orange", linewidths=0, label="looking elsewhere")
    for value, name in ((CONFIG.psr_ratio_lost, "lost below"), (CONFIG.psr_ratio_regained, "found again above")):
        axes.axhline(value, lw=1, color="tab:red", ls="--" if name.startswith("lost") else ":", label=f"{name} {value}")
    axes.set(xlabel="overlap with the annotated box", ylabel="PSR over its usual value", ylim=(0, 2))
    axes.legend(loc="upper left")
    figure.savefig(out, dpi=110)


def main() -> None:
    one_core()
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("data", type=Path)
    parser.add_argument("--frames", type=int, default=300)
    parser.add_argument("--tracker", type=tracker_label, default="racf,robust,redetect=false")
    parser.add_argument("--out", type=Path, default=Path("docs/confidence.png"))
    args = parser.parse_args()
    ratios = Ratios()
    for folder, file in sequences(args.data):
        overlaps = measure(folder, read_boxes(file), args.tracker, args.frames, ratios)
        on_target = fraction(np.array(overlaps) >= ON)
        print(f"{file.parent.name:<14}{len(overlaps):>5} frames, on target {on_target:.3f}", flush=True)
    ratio, overlap, elsewhere = map(np.array, (ratios.followed, ratios.overlap, ratios.elsewhere))
    on, off = ratio[overlap >= ON], ratio[overlap < OFF]
    print(f"{len(on)} frames on the target, {len(elsewhere)} looks elsewhere, {len(off)} drifted off")
    print(f"{'threshold':>10}{'on, rejected':>14}{'elsewhere, accepted':>22}{'drifted, accepted':>20}")
    for t in THRESHOLDS:
        print(f"{t:>10}{fraction(on < t):>14.3f}{fraction(elsewhere >= t):>22.3f}{fraction(off >= t):>20.3f}")
    draw(ratio, overlap, elsewhere, args.out)


if __name__ == "__main__":
    main()
