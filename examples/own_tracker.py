"""Your own tracker in the closed loop: here OpenCV's template matching, which steers the drawn camera.

    python examples/own_tracker.py

In a benchmark a tracker's errors only lower its score; in the loop they also turn the vehicle and so change the next
image.  The boxes are scored as in a benchmark: by the distance of the centres and the overlap with the true boxes.
"""

from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from follow.control.acquire import Acquire
from follow.control.servo import Servo, ServoConfig
from follow.control.target import Target
from follow.flight.session import once
from follow.loop import follow
from follow.messages import Autopilot, Order
from follow.safety.gate import Safety
from racf.box import Box
from racf.evaluate.metrics import Convention, Score, score
from racf.track import Track
from sim.scenarios import SCENARIOS, build

Image = NDArray[np.uint8]
GOOD_MATCH = 0.5  # of the normalised correlation; below it the target counts as not found


class TemplateTracker:
    """Looks for the first image's patch around the last box; the box keeps its size."""

    def init(self, image: Image, box: Box) -> Track:
        """Learn the target in `box` of the first image."""
        self.box = Box(round(box.x), round(box.y), round(box.w), round(box.h))
        x, y, w, h = (int(v) for v in (self.box.x, self.box.y, self.box.w, self.box.h))
        self.template = image[y : y + h, x : x + w]
        return Track(self.box, self.box, psr=0.0, apce=0.0, confidence=1.0)

    def update(self, image: Image, prior: Box | None = None) -> Track:
        """Find it again, around `prior` (where the loop expects it) or around the last box."""
        around = (prior or self.box).scaled(3.0)
        x, y = max(int(around.x), 0), max(int(around.y), 0)
        patch = image[y : int(around.y + around.h), x : int(around.x + around.w)]
        h, w = self.template.shape[:2]
        if patch.shape[0] < h or patch.shape[1] < w:
            return Track(self.box, around, 0.0, 0.0, confidence=0.0, found=False)
        response = cv2.matchTemplate(patch, self.template, cv2.TM_CCOEFF_NORMED)
        _, peak, _, (column, row) = cv2.minMaxLoc(response)
        self.box = Box(x + column, y + row, w, h)
        psr = (peak - float(response.mean())) / max(float(response.std()), 1e-6)
        return Track(self.box, around, psr, 0.0, confidence=max(peak, 0.0), found=peak > GOOD_MATCH)


def row(box: Box | None) -> tuple[float, float, float, float]:
    """A box as a row of x, y, w, h for the metrics; NaN without one."""
    return (np.nan,) * 4 if box is None else (box.x, box.y, box.w, box.h)


def main(seconds: float = 4.0) -> Score:
    """Follow the drawn walker; returns the score of the boxes by the true ones."""
    scenario = replace(SCENARIOS["walker"], duration_s=seconds)
    camera, link, _ = build(scenario, seed=0, autopilot=Autopilot.PX4)
    mount, tracker = camera.settings, TemplateTracker()
    parts = (
        Acquire(tracker.init, tracker.update, camera.first()[1]),
        Target(mount.intrinsics, mount.down_rad),
        Servo(mount.down_rad, ServoConfig(standoff_m=scenario.standoff_m)),
        Safety(),
    )
    boxes, truth = [], []
    with camera, link:
        for tick in follow(camera, link, *parts, once(Order.FOLLOW)):
            if tick.frame is not None and tick.track is not None:
                boxes.append(row(tick.track.box))
                truth.append(row(camera.truth(tick.frame.index).box))
    scored = score(np.array(boxes), np.array(truth), Convention.STRICT)
    print(f"{len(boxes)} frames: precision at 20 px {scored.precision_20px:.1f} %, AUC {scored.auc:.1f} %")
    return scored


if __name__ == "__main__":
    main()
