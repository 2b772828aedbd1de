"""The tracker: init on a box, then per frame localise, estimate scale, refine, learn."""

import math
import time
from copy import deepcopy
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from racf import kernels
from racf.box import Box
from racf.confidence import Confidence, Verdict, ramp
from racf.flow import Flow
from racf.growth import growth
from racf.halt import Halt
from racf.leaving import Leaving
from racf.motion import Velocity
from racf.params import Params, preset
from racf.redetect import Redetection
from racf.refine import Refinement, Refiner
from racf.scale import ScaleFilter
from racf.texture import is_featureless
from racf.track import Track
from racf.translation import Match, TranslationFilter

UInt8 = NDArray[np.uint8]

kernels.announce()

MIN_SIDE_PX = 2.0  # a smaller box holds no target
MAX_SIDE_PX = 1e6  # far beyond any image: squares of larger numbers overflow


class Racf:
    """The RACF tracker, its variants and baselines, shaped like OpenCV's trackers.

        racf.one_core()
        tracker = racf.Racf("racf,robust")  # a preset and its settings, or a racf.Params
        track = tracker.init(image, racf.Box(x, y, w, h))
        track = tracker.update(next_image)  # a racf.Track: box, confidence, found

    Call `racf.one_core()` first, because BLAS's threads spin while they wait: on a shared machine with two cores an
    image takes five to ten times as long without it.

    Images are uint8, (rows, columns, 3) in BGR or (rows, columns) in grey, all of one size.  As a side effect the
    refinement seeds OpenCV's random generator (see `racf.Refiner`).  An unknown preset or setting is a ValueError.
    """

    def __init__(self, params: Params | str = "racf") -> None:
        self.params = _params(params)
        self._frame_shape: tuple[int, ...] | None = None

    def __copy__(self) -> "Racf":
        """A deep copy: arrays that are updated in place must not be shared."""
        return deepcopy(self)

    def init(self, image: UInt8, box: Box) -> Track:
        """Start on the target in `box`; raises ValueError for an invalid image or a box outside it.

        The track of a target without edges in both directions has `found` False, now and later: see `racf.texture`.  An
        earlier target is forgotten.
        """
        image = checked_start(image, box)
        self._frame_shape = image.shape
        self._leaving = Leaving()
        if self.params.tighten:
            self._leaving.start(image, box)
        return self._start(image, box)

    def _start(self, image: UInt8, box: Box) -> Track:
        """Learn the target in `box`, and forget an earlier one."""
        params = self.params
        self._box, inside = box, self._kept_inside(box)
        self._aspect = inside.w / inside.h
        self._filter = TranslationFilter(params, box, colour=image.ndim == 3 and params.colour_names)
        self._scale = ScaleFilter(params, box.w, box.h)
        self._refiner = Refiner(params)
        self._confidence = Confidence(params, featureless=is_featureless(image, box))
        self._velocity = Velocity(params.velocity_rate, params.velocity_decay)
        self._redetection = Redetection(params)
        self._flow, self._halt = Flow(), Halt()
        self._filter.learn(image, box)
        self._learn_scale(image)
        self._remember(image, None)
        most = self._confidence.most
        return Track(box, self._filter.region(box), psr=0.0, apce=0.0, confidence=most, found=most == 1.0)

    def update(self, image: UInt8, prior: Box | None = None) -> Track:
        """Find the target in the next image; `prior`: where the caller expects it, if it knows.

        Raises ValueError if the image differs from the first one in shape or type, or before `init`.
        """
        image = checked_next(image, self._frame_shape, prior)
        params, clock, before = self.params, _Stopwatch(), self._box
        was_lost = self._confidence.lost_frames > 0
        expected = self._expected(prior)
        if self._uses_flow(prior):
            self._flow.look(image, expected.centre_x - before.centre_x, expected.centre_y - before.centre_y)
        ground = self._ground_moved(prior)
        grown = self._grown(expected)
        clock.lap("predict")
        match = self._filter.locate(image, grown)
        clock.lap("localise")
        places = self._halt.places(expected)
        near = not params.redetect or self._redetection.near(match.box, *places)
        verdict = self._confidence.judge(match.psr, match.value, near)
        if params.redetect and verdict is Verdict.LOST:
            match, verdict = self._redetection.search(image, places, match, self._filter, self._confidence)
            clock.lap("redetect")
            if verdict is not Verdict.LOST:
                self._velocity.forget()  # a re-detection is a jump, not a velocity
                was_lost = True
                before = expected = grown = match.box
        if verdict is Verdict.LOST:
            self._leaving.forget()
        if params.coast and verdict is Verdict.LOST:
            self._coast(expected)
            self._remember(image, prior)
            return self._track(grown, match, None, verdict, clock)
        self._box = self._kept_inside(self._weighed(grown, match, verdict))
        trusted = verdict is Verdict.CLEAR or not params.gate_learning
        refinement = self._learn(image, match, clock) if trusted else None
        self._velocity.seen(before, self._box)
        confidence = self._confidence.ratio(match.psr, match.value)
        if was_lost:
            self._halt.found(confidence)
        else:
            self._halt.seen(before, self._box, ground, confidence)
        self._remember(image, prior)
        clock.lap("remember")
        left = self._leaving.look(image, self._box)
        clock.lap("leaving")
        if left is not None:
            return replace(self._start(image, self._kept_inside(left)), restarted=True, stage_ms=clock.laps)
        return self._track(grown, match, refinement, verdict, clock)

    def _learn(self, image: UInt8, match: Match, clock: "_Stopwatch") -> Refinement | None:
        """Scale and refine the box of a trusted match, then learn; returns the refinement, if it was tried."""
        self._estimate_scale(image)
        clock.lap("scale")
        refinement = self._refine(image)
        clock.lap("refine")
        self._filter.learn(image, self._box, self._belief(match))
        clock.lap("learn filter")
        self._learn_scale(image)
        clock.lap("learn scale")
        return refinement

    def _track(
        self, looked_at: Box, match: Match, refinement: Refinement | None, verdict: Verdict, clock: "_Stopwatch"
    ) -> Track:
        return Track(
            box=self._box,
            search=self._filter.region(looked_at),
            psr=match.psr,
            apce=match.apce,
            confidence=self._confidence.ratio(match.psr, match.value),
            found=verdict is not Verdict.LOST,
            refined=refinement is not None and refinement.box is not None,
            response=match.response,
            mask=None if refinement is None else refinement.mask,
            mask_box=None if refinement is None else refinement.mask_box,
            stage_ms=clock.laps,
        )

    def _expected(self, prior: Box | None) -> Box:
        """The box to search around: the caller's prior, or the last box moved by the target's velocity."""
        if prior is not None:
            # While the target is seen, the scale filter's size is better than a caller's.
            sides = (prior.w, prior.h) if self._confidence.lost_frames else (self._box.w, self._box.h)
            w, h = (min(max(side, MIN_SIDE_PX), MAX_SIDE_PX) for side in sides)
            return Box.around(prior.centre_x, prior.centre_y, w, h)
        if not self.params.predict_motion:
            return self._box
        return self._box.moved(self._velocity.dx, self._velocity.dy)

    def _uses_flow(self, prior: Box | None) -> bool:
        return self.params.predict_scale or (self.params.coast and prior is None)

    def _remember(self, image: UInt8, prior: Box | None) -> None:
        """Keep the box with its surroundings for the flow to the next image, if that will be needed."""
        if self._uses_flow(prior):
            self._flow.remember(image, self._box)
        else:
            self._flow.forget()

    def _ground_moved(self, prior: Box | None) -> tuple[float, float] | None:
        """How far the ground around the box moved; advances a halt by one frame.  None with a prior."""
        if prior is not None or not self.params.coast:
            self._halt.forget()
            return None
        ground = self._flow.ground()
        self._halt.goes_on(ground, math.sqrt(self._box.area))
        return ground

    def _coast(self, expected: Box) -> None:
        """Move a lost target's box to the expected position, or to where it would be if it had not halted."""
        self._box = self._kept_inside(self._halt.moved(expected))
        step = self._halt.step()
        if step is None:
            self._velocity.unseen()
        else:
            self._velocity.seen(self._box, self._box.moved(*step))
        self._halt.unseen()

    def _grown(self, expected: Box) -> Box:
        """The expected box with the size that the flow of the target's pixels predicts."""
        if not self.params.predict_scale:
            return expected
        coasts = self.params.coast and self._confidence.lost_frames > 0
        return expected.scaled(1.0 if coasts else growth(self._flow))

    def _weighed(self, expected: Box, match: Match, verdict: Verdict) -> Box:
        """The measured box; in a doubtful frame moved towards the predicted one, by more with less confidence."""
        params = self.params
        if verdict is not Verdict.DOUBTFUL or not params.predict_motion:
            return match.box
        weight = ramp(self._confidence.ratio(match.psr, match.value), params.lost_below, params.learn_above)
        dx, dy = match.box.centre_x - expected.centre_x, match.box.centre_y - expected.centre_y
        return expected.moved(weight * dx, weight * dy)

    def _belief(self, match: Match) -> float:
        """The fraction of the learning rate for this frame, because a half-occluded target passes the gate."""
        if not self.params.gate_learning:
            return 1.0
        return ramp(self._confidence.ratio(match.psr, match.value), self.params.learn_share_from, 1.0)

    def _kept_inside(self, box: Box) -> Box:
        """The box with its centre kept in the image and its sides between 2 px and the image's."""
        assert self._frame_shape is not None
        rows, cols = self._frame_shape[:2]
        w, h = min(max(box.w, MIN_SIDE_PX), cols), min(max(box.h, MIN_SIDE_PX), rows)
        return Box.around(min(max(box.centre_x, 0.0), cols), min(max(box.centre_y, 0.0), rows), w, h)

    def _estimate_scale(self, image: UInt8) -> None:
        params = self.params
        steps = self._scale.estimate(image, self._box)
        if steps:
            self._box = self._kept_inside(self._box.scaled(params.scale_step**steps))

    def _learn_scale(self, image: UInt8) -> None:
        self._scale.learn(image, self._box)

    def _refine(self, image: UInt8) -> Refinement | None:
        if not self.params.refine:
            return None
        refinement = self._refiner.refine(image, self._box)
        if refinement is not None and refinement.box is not None:
            self._box = self._kept_inside(self._shaped(refinement.box))
        return refinement

    def _shaped(self, box: Box) -> Box:
        """With `strict_refine`: the box with an aspect near the first one's, of the same area."""
        if not self.params.strict_refine:
            return box
        most = self.params.strict_aspect
        aspect = min(max(box.w / box.h, self._aspect / most), self._aspect * most)
        return Box.around(box.centre_x, box.centre_y, math.sqrt(box.area * aspect), math.sqrt(box.area / aspect))


class _Stopwatch:
    """Wall-clock milliseconds by stage, only for the recording."""

    def __init__(self) -> None:
        self.laps: dict[str, float] = {}
        self._since = time.perf_counter()

    def lap(self, name: str) -> None:
        now = time.perf_counter()
        self.laps[name] = self.laps.get(name, 0.0) + (now - self._since) * 1e3
        self._since = now


def check_image(image: object) -> None:
    """Raise ValueError unless this is a non-empty uint8 image, grey or BGR."""
    if not isinstance(image, np.ndarray):
        raise ValueError(f"an image is a numpy array, not {type(image).__name__}")
    if image.dtype != np.uint8:
        raise ValueError(f"an image has the type uint8, not {image.dtype}")
    if image.ndim not in {2, 3} or (image.ndim == 3 and image.shape[2] != 3):
        raise ValueError(f"an image has the shape (rows, columns) or (rows, columns, 3), not {image.shape}")
    if image.size == 0:
        raise ValueError(f"an image has at least one pixel, not the shape {image.shape}")


def _checked(image: UInt8) -> UInt8:
    """The checked image, contiguous: a view is copied once here, because otherwise every sample would copy it."""
    check_image(image)
    return np.ascontiguousarray(image)


def checked_start(image: UInt8, box: Box) -> UInt8:
    """The contiguous image; raises ValueError for an invalid image or a box that cannot start a tracker in it."""
    image = _checked(image)
    _check_box(box, "target")
    rows, cols = image.shape[:2]
    if box.intersection(Box(0, 0, cols, rows)) <= 0:
        raise ValueError(f"target {box} lies outside the {cols}x{rows} image")
    if min(box.w, box.h) < MIN_SIDE_PX:
        raise ValueError(f"a target needs sides of at least {MIN_SIDE_PX:g} pixels, not {box}")
    if max(box.w, box.h) > MAX_SIDE_PX:
        raise ValueError(f"a target has sides of at most {MAX_SIDE_PX:g} pixels, not {box}")
    return image


def checked_next(image: UInt8, first_shape: tuple[int, ...] | None, prior: Box | None) -> UInt8:
    """The contiguous image; raises ValueError if its shape differs from the first one's, or before `init`."""
    if first_shape is None:
        raise ValueError("the tracker must be given a target with init before update")
    image = _checked(image)
    if image.shape != first_shape:
        raise ValueError(f"images must keep the first one's shape {first_shape}, not {image.shape}")
    if prior is not None:
        _check_box(prior, "prior")
    return image


def _params(given: object) -> Params:
    if isinstance(given, Params):
        return given
    if isinstance(given, str):
        return preset(given)
    raise ValueError(f"a tracker takes a racf.Params or a text such as 'racf,robust', not {given!r}")


def _check_box(box: object, what: str) -> None:
    if not isinstance(box, Box):
        raise ValueError(f"a {what} is a racf.Box(x, y, w, h), not {box!r}")


def warm_up() -> float:
    """Compile (or load from numba's cache) every kernel that tracking uses; returns the seconds it took."""
    start = time.perf_counter()
    for shape in ((48, 64, 3), (48, 64)):
        image = np.random.default_rng(0).integers(0, 256, shape, dtype=np.uint8)
        tracker = Racf(Params(refine=True).robust())
        tracker.init(image, Box(16, 12, 24, 24))
        tracker.update(image)
    return time.perf_counter() - start
