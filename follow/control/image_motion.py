"""The background's motion in the image, compared with the motion that the vehicle's own poses predict.

Corners outside the target's box are tracked from a key frame to the frame `SPAN_S` later (Lucas-Kanade).  From the
camera's poses at both times the motion of each corner is predicted: `r` from the rotation alone, which is exact at
any depth, and `t` on top of it from the translation, for a corner on flat ground at the assumed height (zero for
corners at or above the horizon).  The measured motion is then modelled as

    m = a r + b t

`a` is 1 for a camera that is mounted as configured, 0 for a frozen image, -1 for a mount with the wrong sign, and the
ratio of true to assumed focal length for a wrong lens.  `b` is the assumed height above the ground over the true one
(times the same ratio).  The output is the means of the products that this least-squares problem needs;
`follow.safety.consistency` sums them over time and judges.
"""

import math
from collections import deque
from dataclasses import dataclass, field

import cv2
import numpy as np
from numpy.typing import NDArray

from follow.control.pose_history import Pose, PoseHistory
from follow.geometry import Array, Intrinsics, camera_to_ned, project, rays
from follow.messages import Frame, ImageMotion, VehicleState
from racf.box import Box
from racf.track import Track

Masks = NDArray[np.bool_]

SPAN_S = 0.2  # between the two frames: 3 m/s and 0.1 rad/s then move corners by 5 to 20 px, wobble does not alias
WIDTH_PX = 320  # images are shrunk to at most this width: Lucas-Kanade stays below 1 ms, 0.1 px here is 0.2 px at 640
CORNERS = 48  # the fit has two unknowns; more corners cost time and share the same pose error
QUALITY = 0.01  # of the strongest corner: asphalt and grass still give some
APART_PX = 10  # least distance of two corners, so that one tree does not outvote the ground
FEET_REACH = 1.5  # ground within this many box heights to either side of the feet is sampled for its height
AROUND_BOX = 1.6  # no corners in the box enlarged by this: the target moves by itself, and so does its shadow
APART = 0.5  # of the ground's motion: with a smaller difference the target cannot be told from the ground
FEWEST = 8  # fewer corners are no measurement
WINDOW = (15, 15)  # Lucas-Kanade's; with two halvings it follows 30 px in the shrunk image
HUBER_PX = 1.0  # residual (full-size pixels) beyond which a corner counts less: other people, leaves, an OSD
ROUNDS = 4  # of reweighting
LEAST_HEIGHT_M = 1.0  # below it the ground is too near for the parallax to be linear
LEAST_FALL = 0.05  # sine of the depression of the feet: flatter rays do not measure the height
FAR_M = 300.0  # ground farther away than this moves by rotation only
NEAR_DEPTH = 0.35  # ground within this fraction of the feet's distance counts as the ground around the target
PLANE = 0.12  # largest RMS residual of corners on one plane, as a fraction of their translation (ground: 0.02 to 0.1)
NEAR_CORNERS = 4  # fewer corners around the feet do not measure the height
HEIGHT_NOISE_RAD = math.radians(0.2)  # attitude error between an interval's frames, shared by all its corners
HEIGHT_LEAST_RAD = 0.008  # a smaller RMS translation does not measure the height either: twice HEIGHT_NOISE_RAD
JITTER_S = 0.01  # of a frame's time against the attitude's, each; at 0.5 rad/s it weighs as much as HEIGHT_NOISE_RAD
SPEED_NOISE_M_S = 0.1  # of the GPS velocity that predicts the translation: a hovering vehicle reports 0.05 to 0.1
HEIGHT_RELATIVE_STD = 0.5  # a less certain height is not used: its error is not normal and has no bound
NO_HEIGHT = math.inf, math.inf, 0.0
WAIT_S = 0.15  # an interval waits at most this long for telemetry that covers its frames
GAP_S = 0.15  # longest gap between the attitudes around a frame: across it a wobble of 1.5 Hz hides half of 0.5 degrees
PLACE_GAP_S = 0.35  # the same of the positions, five a second at least: a missing one looks like a low flight


@dataclass(frozen=True, slots=True, eq=False)
class CornerTracks:
    """Corners of two frames, (N, 2) full-size pixels each, and the two frames' times; and the target's boxes."""

    from_t_s: float
    to_t_s: float
    before: Array
    after: Array
    box_before: Box | None
    box_after: Box | None


@dataclass(slots=True)
class ImageMotionMeter:
    """Fed once a round; gives an `ImageMotion` about every `SPAN_S`.

    `camera` describes the full-size image, `down_rad` is the mount.  `ground_down_m` is the assumed position of the
    ground (local NED); the caller may change it.
    """

    camera: Intrinsics
    down_rad: float
    ground_down_m: float = 0.0
    poses: PoseHistory = field(default_factory=PoseHistory)
    _key: tuple[float, NDArray[np.uint8], NDArray[np.float32], Box | None] | None = None
    _last: tuple[NDArray[np.uint8], NDArray[np.float32], NDArray[np.bool_]] | None = None
    _box: Box | None = None
    _waiting: deque[CornerTracks] = field(default_factory=lambda: deque[CornerTracks](maxlen=8))

    def update(self, frame: Frame | None, track: Track | None, state: VehicleState) -> ImageMotion | None:
        """Take in a round; the measurement of the oldest interval whose poses are known, or None.

        A box counts only if the tracker found the target.  An interval is dropped when the attitude at one of its
        frames is not known: outside the messages, or in a gap of more than `GAP_S` between them.  It measures no
        height if the positions have a gap of more than `PLACE_GAP_S`: the flight in between is not guessed.
        """
        self.poses.add(state)
        if frame is not None:
            box = track.box if track is not None and track.found else None
            if box is not None and not within(box, self.camera):
                box = None  # at the border the box stays while the target itself moves out
            if self._key is not None and not follows(self._box, box):
                self._key = *self._key[:3], None
            self._box = box
            self._track(frame, box)
        if self._waiting:
            first = self._waiting[0]
            if min(state.attitude_t_s, state.position_t_s) >= first.to_t_s or state.t_s - first.to_t_s > WAIT_S:
                self._waiting.popleft()
                known = max(self.poses.attitude_gap_s(t_s) for t_s in (first.from_t_s, first.to_t_s)) <= GAP_S
                return self.compare(first) if known else None
        return None

    def _track(self, frame: Frame, box: Box | None) -> None:
        image, scale = shrunk_grey(frame.image)
        if self._key is not None and self._last is not None and frame.t_s > self._key[0]:
            previous, points, alive = self._last
            moved, found, _ = cv2.calcOpticalFlowPyrLK(
                previous, image, points, np.empty_like(points), winSize=WINDOW, maxLevel=2
            )
            alive = alive & (found[:, 0] > 0)
            self._last = image, np.asarray(moved, np.float32), alive
            t_s, _, start, box_before = self._key
            if frame.t_s - t_s < SPAN_S - 1e-3:
                return
            if frame.t_s - t_s < 2 * SPAN_S and np.count_nonzero(alive) >= FEWEST:
                before = (start[alive, 0].astype(np.float64) + 0.5) * scale
                after = (moved[alive, 0].astype(np.float64) + 0.5) * scale
                self._waiting.append(CornerTracks(t_s, frame.t_s, before, after, box_before, box))
        self._restart(frame.t_s, image, scale, box)

    def _restart(
        self,
        t_s: float,
        image: NDArray[np.uint8],
        scale: float,
        box: Box | None,
    ) -> None:
        points = corners(image, box, scale)
        if points is None:
            self._key = self._last = None
            return
        self._key = t_s, image, points, box
        self._last = image, points, np.ones(len(points), bool)

    def compare(self, tracked: CornerTracks) -> ImageMotion:
        """The measurement of one interval, by the poses at its two frames."""
        before, after = self.poses.at(tracked.from_t_s), self.poses.at(tracked.to_t_s)
        rotated, moved = self.expected(tracked.before, before, after)
        known = np.asarray(np.isfinite(np.concatenate([rotated, moved], axis=1)).all(axis=1), np.bool_)
        r = (rotated - tracked.before)[known]
        t = (moved - rotated)[known]
        m = (tracked.after - tracked.before)[known]
        w = weights(m, r, t)
        box_seen = box_expected = (0.0, 0.0)
        if tracked.box_before is not None and tracked.box_after is not None:
            old, new = tracked.box_before, tracked.box_after
            turned, _ = self.expected(np.array([[old.centre_x, old.centre_y]]), before, after)
            if np.isfinite(turned).all():
                box_seen = new.centre_x - old.centre_x, new.centre_y - old.centre_y
                box_expected = float(turned[0, 0]) - old.centre_x, float(turned[0, 1]) - old.centre_y
        went = np.subtract(box_seen, box_expected)
        height_m, height_std_m, height_shared_std_m = NO_HEIGHT
        if max(map(self.poses.position_gap_s, (tracked.from_t_s, tracked.to_t_s))) <= PLACE_GAP_S:
            height_m, height_std_m, height_shared_std_m = self.height(tracked, known, m - r, t, went, before, after)
        return ImageMotion(
            from_t_s=tracked.from_t_s,
            t_s=tracked.to_t_s,
            corners=int(np.count_nonzero(known)),
            rr_px2=mean_product(w, r, r),
            rt_px2=mean_product(w, r, t),
            tt_px2=mean_product(w, t, t),
            mr_px2=mean_product(w, m, r),
            mt_px2=mean_product(w, m, t),
            mm_px2=float(np.median(np.sum(m * m, axis=1))) if len(m) else 0.0,
            box_seen_px=box_seen,
            box_expected_px=box_expected,
            height_m=height_m,
            height_std_m=height_std_m,
            height_shared_std_m=height_shared_std_m,
        )

    def height(
        self, tracked: CornerTracks, known: Masks, left: Array, t: Array, went: Array, before: Pose, after: Pose
    ) -> tuple[float, float, float]:
        """Height above the ground around the target's feet and its standard deviation, by the corners' parallax.

        `left` is the (N, 2) motion of the `known` corners that rotation does not explain, `t` the translation predicted
        for ground at the assumed height, `went` (2,) the motion of the box.  At height h the translation is
        t assumed / h, so h = assumed sum(t . t) / sum(t . left).  Its relative variance is the sum of two: of `left`
        (attitude, jitter of the frames' times, corners) over the measured translation, and of the vehicle's velocity
        over its translation.  The third number is the deviation by the velocity alone, which successive measurements
        share.  Returns (inf, inf, 0) without a box, with too little motion, or when the corners do not move like one
        level plane: they differ by more than `PLANE`, or a wall that faces the camera explains them better.  A wall's
        points lie at one distance ahead, so their motion is t times the ray's ahead / down.
        """
        assumed_m = self.ground_down_m - before.down_m
        if tracked.box_before is None or assumed_m < LEAST_HEIGHT_M:
            return NO_HEIGHT
        box = tracked.box_before
        rotation = camera_to_ned(self.down_rad, before.roll_rad, before.pitch_rad, before.yaw_rad)
        pixels = tracked.before[known]
        ray = rays(self.camera, pixels) @ rotation.T
        feet = rays(self.camera, [(box.centre_x, box.y + box.h)])[0] @ rotation.T
        down, feet_down = ray[:, 2], float(feet[2])
        # Flat ground along a ray lies at the distance d = h / down.
        near = (np.abs(feet_down / np.maximum(down, 1e-6) - 1.0) < NEAR_DEPTH) & ~goes_along(left, t, went)
        if feet_down <= LEAST_FALL or np.count_nonzero(near) < NEAR_CORNERS:
            return NO_HEIGHT
        t, left = t[near], left[near]
        w = weights(left, t, np.zeros_like(t))
        tt, lt = mean_product(w, t, t), mean_product(w, left, t)
        if lt <= 0.1 * tt or lt * lt < tt * (HEIGHT_LEAST_RAD * self.camera.fx) ** 2:
            return NO_HEIGHT
        off_px2, wall_px2 = residual(w, left, t), residual(w, left, t * (ray[:, :2] @ feet[:2] / down)[near, None])
        if off_px2 > min(wall_px2, max(PLANE**2 * lt * lt / tt, HUBER_PX**2)):
            return NO_HEIGHT
        jitter_px2 = sum(mean_product(w, j, t) ** 2 / tt for j in self.jittered(pixels[near], before, after))
        left_px2 = (HEIGHT_NOISE_RAD * self.camera.fx) ** 2 + jitter_px2 + off_px2 / len(t)
        seen = left_px2 * tt / lt**2
        flown_px = self.camera.fx * SPEED_NOISE_M_S * (after.t_s - before.t_s) * feet_down / assumed_m
        flown = flown_px**2 / tt
        relative_std = math.sqrt(seen + flown)
        if relative_std > HEIGHT_RELATIVE_STD:
            return NO_HEIGHT
        height_m = assumed_m * tt / lt
        return height_m, height_m * relative_std, height_m * math.sqrt(flown)

    def jittered(self, pixels: Array, before: Pose, after: Pose) -> tuple[Array, Array]:
        """The error of (N, 2) pixels' motion by rotation when either frame's time is `JITTER_S` wrong, px."""
        rotated, _ = self.expected(pixels, before, after)
        early, _ = self.expected(pixels, self.poses.at(before.t_s - JITTER_S), after)
        late, _ = self.expected(pixels, before, self.poses.at(after.t_s - JITTER_S))
        return np.nan_to_num(early - rotated), np.nan_to_num(late - rotated)

    def expected(self, pixels: Array, before: Pose, after: Pose) -> tuple[Array, Array]:
        """Where (N, 2) pixels should be at the later pose: by the rotation alone, and with the translation.

        NaN for what is behind the camera then.
        """
        first = camera_to_ned(self.down_rad, before.roll_rad, before.pitch_rad, before.yaw_rad)
        second = camera_to_ned(self.down_rad, after.roll_rad, after.pitch_rad, after.yaw_rad)
        ray = rays(self.camera, pixels) @ first.T  # NED
        rotated, _ = project(self.camera, second, np.zeros(3), ray)
        height_m = max(self.ground_down_m - before.down_m, 0.1)
        depth_m = np.where(ray[:, 2] > height_m / FAR_M, height_m / np.maximum(ray[:, 2], 1e-6), np.inf)
        shift = np.array([after.north_m - before.north_m, after.east_m - before.east_m, after.down_m - before.down_m])
        with np.errstate(invalid="ignore"):
            ground = np.where(np.isfinite(depth_m)[:, None], ray * np.minimum(depth_m, FAR_M)[:, None] - shift, ray)
        moved, _ = project(self.camera, second, np.zeros(3), ground)
        return rotated, moved


def goes_along(left: Array, t: Array, went: Array) -> Masks:
    """(N,) whether a corner moved with the target, as its shadow does, and not with the ground.

    `left` and `t` are the (N, 2) motions of the corners, measured and predicted for the ground, `went` (2,) that of the
    target.  All False for a target whose motion cannot be told from the ground's.
    """
    is_distinct = np.linalg.norm(went - t, axis=1) > APART * np.linalg.norm(t, axis=1)
    return is_distinct & (np.linalg.norm(left - went, axis=1) < np.linalg.norm(left - t, axis=1))


def within(box: Box, camera: Intrinsics) -> bool:
    """Whether all of a box lies inside the image."""
    return box.x >= 0 and box.y >= 0 and box.x + box.w <= camera.width and box.y + box.h <= camera.height


def follows(before: Box | None, box: Box | None) -> bool:
    """Whether a box may show the same object as the one in the frame before: it moved by less than its own size."""
    if before is None or box is None:
        return False
    moved = math.hypot(box.centre_x - before.centre_x, box.centre_y - before.centre_y)
    return moved < max(box.w, box.h)


def shrunk_grey(image: NDArray[np.uint8]) -> tuple[NDArray[np.uint8], float]:
    """The image in grey and at most `WIDTH_PX` wide, and full-size pixels per pixel of it."""
    scale = max(image.shape[1] / WIDTH_PX, 1.0)
    if scale > 1.0:
        size = (round(image.shape[1] / scale), round(image.shape[0] / scale))
        image = np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8)
    if image.ndim == 3:
        image = np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), np.uint8)
    return image, scale


def corners(image: NDArray[np.uint8], box: Box | None, scale: float) -> NDArray[np.float32] | None:
    """(N, 1, 2) corners of a grey image around the target's box, which is in full-size pixels; None for too few.

    A third of them are sought on the ground beside the target's feet, because that ground's height gives the range.
    """
    mask = np.full(image.shape, 255, np.uint8)
    found = [np.empty((0, 1, 2), np.float32)]
    if box is not None:
        paint(mask, box.scaled(AROUND_BOX), scale, 0)
        feet = np.zeros_like(mask)
        reach = max(FEET_REACH * box.h, 2 * APART_PX * scale)
        paint(feet, Box(box.centre_x - reach, box.y + box.h - reach / 3, 2 * reach, 2 * reach / 3), scale, 255)
        found.append(strongest(image, CORNERS // 3, feet & mask, APART_PX // 2))
        mask[feet > 0] = 0
    found.append(strongest(image, CORNERS - len(found[-1]), mask, APART_PX))
    points = np.concatenate(found)
    return points if len(points) >= FEWEST else None


def paint(mask: NDArray[np.uint8], box: Box, scale: float, value: int) -> None:
    """Set the part of the mask that lies under a box given in full-size pixels."""
    x0, y0 = (max(int(v / scale), 0) for v in (box.x, box.y))
    x1, y1 = (max(int(v / scale) + 1, 0) for v in (box.x + box.w, box.y + box.h))
    mask[y0:y1, x0:x1] = value


def strongest(image: NDArray[np.uint8], most: int, mask: NDArray[np.uint8], apart_px: int) -> NDArray[np.float32]:
    """(N, 1, 2) of the strongest corners where the mask is set."""
    found = np.asarray(cv2.goodFeaturesToTrack(image, most, QUALITY, apart_px, mask=mask), np.float32)
    return found if found.ndim == 3 else np.empty((0, 1, 2), np.float32)


def weights(m: Array, r: Array, t: Array) -> Array:
    """(N,) weights of the corners: Huber's, about the fit m = a r + b t, found by reweighting."""
    w = np.ones(len(m))
    for _ in range(ROUNDS):
        a, b = solve(
            mean_product(w, r, r),
            mean_product(w, r, t),
            mean_product(w, t, t),
            mean_product(w, m, r),
            mean_product(w, m, t),
        )
        off = np.linalg.norm(m - a * r - b * t, axis=1)
        width = max(HUBER_PX, 1.5 * float(np.median(off)) if len(off) else 0.0)
        w = np.minimum(1.0, width / np.maximum(off, 1e-9))
    return w


def mean_product(w: Array, u: Array, v: Array) -> float:
    """The weighted mean over corners of the dot products of two (N, 2) motions, px²."""
    return float(np.sum(w * np.sum(u * v, axis=1)) / max(float(np.sum(w)), 1e-9))


def residual(w: Array, u: Array, v: Array) -> float:
    """The weighted mean square of the part of u that no multiple of v explains, (N, 2) motions, px²."""
    vv, uv = mean_product(w, v, v), mean_product(w, u, v)
    off = u - uv / max(vv, 1e-12) * v
    return mean_product(w, off, off)


def solve(rr: float, rt: float, tt: float, mr: float, mt: float) -> tuple[float, float]:
    """(a, b) of least squares for m = a r + b t, regularised: the factor of a part under 0.1 px shrinks to 0."""
    ridge = 0.01  # px²
    det = (rr + ridge) * (tt + ridge) - rt * rt
    return (mr * (tt + ridge) - mt * rt) / det, (mt * (rr + ridge) - mr * rt) / det
