"""A tracker of your own in the evaluation, beside RACF.

    python examples/evaluate_own_tracker.py DATA
    racf eval DATA --tracker examples.evaluate_own_tracker:Template,margin=20 --tracker racf --jitter 5

DATA is a folder of sequences: NAME/*.jpg with NAME/groundtruth_rect.txt.
"""

import sys

import cv2

import racf


class Template:
    """The best match of the first image's target, searched `margin` pixels around the last box."""

    def __init__(self, margin=40):
        self.margin = margin

    def init(self, image, box):
        """Keep the pixels of the target; `image` is (rows, columns, 3) uint8 BGR, `box` a racf.Box."""
        self.x, self.y, self.w, self.h = (max(round(v), 0) for v in (box.x, box.y, box.w, box.h))
        self.target = image[self.y : self.y + self.h, self.x : self.x + self.w]

    def update(self, image):
        """Return the target's box in the next image, x, y, w, h."""
        top, left = max(self.y - self.margin, 0), max(self.x - self.margin, 0)
        area = image[top : self.y + self.h + self.margin, left : self.x + self.w + self.margin]
        _, _, _, (dx, dy) = cv2.minMaxLoc(cv2.matchTemplate(area, self.target, cv2.TM_CCOEFF_NORMED))
        self.x, self.y = left + dx, top + dy
        return self.x, self.y, self.w, self.h


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit("usage: evaluate_own_tracker.py DATA")
    try:
        evaluation = racf.evaluate.evaluate(sys.argv[1], trackers=[Template, "racf"])
    except (OSError, ValueError) as error:
        sys.exit(f"evaluate_own_tracker.py: {error}")
    for table in evaluation.summary:
        print(table.markdown())
