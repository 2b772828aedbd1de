"""Boxes of clicks on drawn targets: how well `follow.control.click.box_at` meets the true box.

    python -m tools.studies.clicks

A person clicks a tenth of the target's size beside its middle (standard deviation).  Prints, for each scene, the median
IoU with the true box, the share of clicks with an IoU above 0.4, and the share of clicks for which no box was found.
"""

import argparse

import numpy as np

from follow.control.click import box_at
from tools.studies.late_selection import filmed

SCENES = ("walker", "runner", "cyclist", "car")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=6)
    args = parser.parse_args()
    generator = np.random.default_rng(1)
    print("| scene | clicks | median IoU | above 0.4 | no answer |\n|---|---|---|---|---|")
    for name in SCENES:
        overlaps = []
        for seed in range(args.seeds):
            for frame, box in filmed(name, seed, 5.0)[::20]:
                if box is None or not 0 <= box.x <= box.x + box.w <= frame.image.shape[1]:
                    continue
                dx, dy = generator.normal(0.0, 0.1, 2)
                found = box_at(frame.image, box.centre_x + dx * box.w, box.centre_y + dy * box.h)
                overlaps.append(np.nan if found is None else found.iou(box))
        known = np.nan_to_num(overlaps)
        shares = f"{100 * np.mean(known > 0.4):.0f} % | {100 * np.mean(np.isnan(overlaps)):.0f} %"
        print(f"| {name} | {len(known)} | {np.median(known):.2f} | {shares} |")


if __name__ == "__main__":
    main()
