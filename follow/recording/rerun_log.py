"""Ticks as Rerun entities on one timeline (`seconds`, from the flight's first tick).

Curves are collected and written in batches of columns: a separate row for each number would cost 100 bytes and 50 us.
"""

# Rerun's own check of the Python version hides its names from a type checker that is set to Python 3.10.
# pyright: reportAttributeAccessIssue=false

import math
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import rerun as rr
from numpy.typing import NDArray

from follow.disk import unwritten
from follow.messages import NEVER, Mode, Setpoint, Tick
from follow.recording.layout import BLUE, GREEN, GREY, MODE_COLOURS, ORANGE, PALE, RED, VIOLET, YELLOW, describe, layout
from follow.recording.rows import Desired, LoggedTick, held_by
from follow.recording.video_encoder import Encoder, FrameEncoder, H264Encoder, Sample, encoder
from follow.selection import Detections
from racf.box import Box
from racf.track import Track

APPLICATION = "follow-me"
FLUSH_TIMEOUT_S = 50.0  # a disk that takes longer counts as broken; less than the timeout at the end (CLOSE_S)
RESPONSE_QUALITY = 80  # of JPEG: a smooth image
RESPONSE_EVERY_S = 0.2  # response and mask change little from frame to frame
MODE_LINE = re.compile(r"\d+\.\d s: (\w+)")  # a report of a change of mode
TIMED = re.compile(r"\d+\.\d s: ")  # a message that already begins with the time of the flight
DRAW_ORDER = {"image/found": 29.0, "image/search": 30.0, "image/truth": 31.0, "image/target": 32.0}
"""A later box covers an earlier one."""

Colour = tuple[int, int, int]
NOTHING, DARK = "nothing", (60, 60, 60)

NUMBER = re.compile(r"-?\d+(\.\d+)?")


@dataclass(frozen=True, slots=True)
class Pace:
    """Intervals of writing: least time between two frames, time between two batches of curves, and two flushes, s."""

    frame_s: float = 0.0
    curves_s: float = 4.0  # a batch of each curve costs 1.5 kB; ticks.csv has each row within a second
    flush_s: float = 2.0  # of images: a kill loses the last ones


BROKEN: list[rr.RecordingStream] = []
"""Streams whose file or viewer is broken.  They are kept, because Rerun blocks for ever when one is closed or freed."""


class RerunRecording:
    """A Rerun recording; use it from one thread.

    `connect` sets its destination, a file or a viewer.  The mode is a lane; the reason for a change is in the messages.
    `flush` and `close` raise OSError if it cannot be written.
    """

    def __init__(
        self,
        connect: Callable[[rr.RecordingStream], object],
        name: Path | str,
        frames: FrameEncoder,
        about: str = "",
        desired: Desired | None = None,
        pace: Pace | None = None,
        flush_timeout_s: float = FLUSH_TIMEOUT_S,
    ) -> None:
        self._flush_timeout_s = flush_timeout_s
        self._name, self._frames, self._pace = name, frames, pace or Pace()
        self._desired = desired or Desired()
        batches = rr.ChunkBatcherConfig(flush_tick=self._pace.flush_s, flush_num_bytes=1_000_000)
        self._recording = rr.RecordingStream(APPLICATION, batcher_config=batches)
        self._recording.set_log_time_enabled(False)  # 8 bytes a row each, and redundant beside `seconds`
        self._recording.set_log_tick_enabled(False)
        connect(self._recording)
        self._states: dict[str, str] = {}
        self._colours: dict[str, dict[str, Colour]] = {}
        self._notes: frozenset[str] = frozenset()
        self._shown: set[str] = set()
        self._curves: dict[str, tuple[list[float], list[float]]] = {}
        self._boxes: dict[str, list[tuple[float, Box | None, Colour, str]]] = {}
        self._stages: list[str] = []
        self._found_t_s: float | None = None
        self._frame_t_s = self._response_t_s = self._curves_t_s = self._flush_t_s = NEVER
        if isinstance(frames, H264Encoder):
            self._recording.log("image", rr.VideoStream(codec=rr.VideoCodec.H264), static=True)
        for path, order in DRAW_ORDER.items():
            fixed = rr.Boxes2D.from_fields(radii=[-1.0], draw_order=order, show_labels=path == "image/target")
            self._recording.log(path, fixed, static=True)
        describe(self._recording, about)

    def tick(self, scene: LoggedTick) -> None:
        """Log one round without its images."""
        tick = scene.tick
        self._recording.set_time("seconds", duration=scene.t_s)
        if tick.track is not None:
            self._track(tick.track, scene.t_s)
        self._box("image/truth", scene.t_s, scene.truth, YELLOW)
        self._detections(tick.found, tick.state.t_s)
        self._controls(tick, scene.t_s)
        self._lanes(scene)
        self._new_notes(scene)
        if scene.t_s - self._curves_t_s >= self._pace.curves_s:
            self._send_curves()
            self._curves_t_s = scene.t_s
        if scene.t_s - self._flush_t_s >= self._pace.flush_s:
            self.flush()
            self._flush_t_s = scene.t_s

    def images(self, scene: LoggedTick) -> None:
        """Log a round's frame, and at a lower rate the response and the mask.  Raises OSError from the encoder."""
        tick = scene.tick
        if tick.frame is not None and tick.frame.image.size and scene.t_s - self._frame_t_s >= self._pace.frame_s:
            self._frame_t_s = scene.t_s
            box = tick.track.box if tick.track is not None else None
            self._samples(self._frames.encode(tick.frame.image, scene.t_s, box))
        if tick.track is not None and scene.t_s - self._response_t_s >= RESPONSE_EVERY_S:
            self._response_t_s = scene.t_s
            self._recording.set_time("seconds", duration=scene.t_s)
            self._response(tick.track)

    def message(self, t_s: float, text: str) -> None:
        """Log one message at a time of the flight; a change of mode has the mode's colour."""
        self._recording.set_time("seconds", duration=t_s)
        mode = MODE_LINE.match(text)
        colour = next((c for m, c in MODE_COLOURS.items() if mode and m.value == mode[1]), None)
        self._say(t_s, text, rr.TextLogLevel.INFO, colour)

    def settings(self, toml: str) -> None:
        """Log the flight's settings."""
        text = rr.TextDocument(f"```toml\n{toml}```\n", media_type=rr.MediaType.MARKDOWN)
        self._recording.log("settings", text, static=True)

    def flush(self) -> None:
        """Wait until everything logged so far is written."""
        try:
            self._recording.flush(timeout_sec=self._flush_timeout_s)
        except RuntimeError as error:  # Rerun writes the cause to its own log only
            BROKEN.append(self._recording)
            raise OSError(unwritten(self._name, error)) from None

    def close(self) -> None:
        """Write the rest and the file's index, then close the file."""
        try:
            self._samples(self._frames.finish())
            self._send_curves()
            self.flush()
        finally:
            if self._recording not in BROKEN:
                self._recording.disconnect()

    def _samples(self, samples: Iterable[Sample]) -> None:
        for sample in samples:
            self._recording.set_time("seconds", duration=sample.t_s)
            if isinstance(self._frames, H264Encoder):
                shown = rr.VideoStream.from_fields(sample=sample.data, is_keyframe=sample.is_key)
            else:
                shown = rr.EncodedImage(contents=sample.data, media_type="image/jpeg")
            self._recording.log("image", shown)

    def _lanes(self, scene: LoggedTick) -> None:
        """Log changes of the mode, its reason, and the limits that act."""
        decision = scene.tick.decision
        held = ", ".join(dict.fromkeys(held_by(decision.notes)))
        self._state("mode", decision.mode.value)
        self._state("mode/why", NUMBER.sub("…", str(decision.reason)), PALE)
        self._state("mode/held_by", held or NOTHING, ORANGE)

    def _state(self, path: str, state: str, colour: Colour | None = None) -> None:
        """Log a lane's state when it changes; `colour` is for states that are not known in advance."""
        if self._states.get(path) != state:
            known = self._colours.setdefault(path, {NOTHING: DARK})
            if colour is not None and state not in known:
                known[state] = colour
                lane = rr.StateConfiguration(values=list(known), colors=list(known.values()))
                self._recording.log(path, lane, static=True)
            self._states[path] = state
            self._recording.log(path, rr.StateChange(state=state))

    def _new_notes(self, scene: LoggedTick) -> None:
        """Log the gate's notes that are new in this tick and are not the mode's reason.

        A note that differs only in a number is not new.
        """
        decision = scene.tick.decision
        reason = NUMBER.sub("#", str(decision.reason))
        notes = {NUMBER.sub("#", note): note for note in decision.notes}
        for kind, note in notes.items():
            if kind not in self._notes and kind not in reason:
                self._say(scene.t_s, note, rr.TextLogLevel.WARN, RED if decision.mode is Mode.BRAKE else YELLOW)
        self._notes = frozenset(notes)

    def _say(self, t_s: float, text: str, level: str, colour: Colour | None = None) -> None:
        line = text if TIMED.match(text) else f"{t_s:.1f} s: {text}"
        self._recording.log("messages", rr.TextLog(line, level=level, color=colour))

    def _track(self, track: Track, t_s: float) -> None:
        colour = GREEN if track.found else RED
        self._box("image/target", t_s, track.box, colour, f"{track.confidence:.2f}" if track.found else "lost")
        self._box("image/search", t_s, track.search, GREY)
        self._curve("track/confidence", t_s, track.confidence)
        self._curve("track/sharpness", t_s, track.psr, track.apce)
        self._state("tracker", "found" if track.found else "lost")

    def _detections(self, found: Detections | None, t_s: float) -> None:
        """Log new detections with their age, and clear them when they are too old."""
        at_s = None if found is None else found.t_s
        if at_s == self._found_t_s:
            return
        self._found_t_s = at_s
        objects = () if found is None else found.objects
        age = "" if found is None else f"{t_s - found.t_s:.1f} s old"
        boxes = rr.Boxes2D(
            centers=[(d.box.centre_x, d.box.centre_y) for d in objects],
            half_sizes=[(d.box.w / 2, d.box.h / 2) for d in objects],
            colors=[VIOLET] * len(objects),
            labels=[f"{d.score:.2f}, {age}" for d in objects],
        )
        self._recording.log("image/found", boxes)

    def _response(self, track: Track) -> None:
        log = self._recording.log
        if track.response is not None:
            peak = max(float(track.response.max()), 1e-6)  # normalised for display; the peak's height is in PSR
            heat = np.clip(track.response * (255 / peak), 0, 255).astype(np.uint8)
            shown = np.asarray(cv2.applyColorMap(heat, cv2.COLORMAP_VIRIDIS), np.uint8)
            good, jpeg = cv2.imencode(".jpg", shown, [int(cv2.IMWRITE_JPEG_QUALITY), RESPONSE_QUALITY])
            if good:
                log("response", rr.EncodedImage(contents=jpeg.tobytes(), media_type="image/jpeg"))
        if track.mask is not None and track.mask_box is not None:
            outline = rr.LineStrips2D(outlines(track.mask, track.mask_box), colors=[BLUE], radii=[-1.5])
            log("image/mask", outline)
            self._shown.add("mask")
        elif "mask" in self._shown:
            self._shown.remove("mask")
            log("image/mask", rr.Clear(recursive=False))

    def _controls(self, tick: Tick, t_s: float) -> None:
        self._curve("desired/velocity", t_s, *_velocity(tick.desired))
        self._curve("desired/yaw_rate", t_s, math.degrees(tick.desired.yaw_rate_rad_s))
        if (sent := tick.decision.setpoint) is not None:
            self._curve("setpoint/velocity", t_s, *_velocity(sent))
            self._curve("setpoint/yaw_rate", t_s, math.degrees(sent.yaw_rate_rad_s))
        estimate = tick.estimate
        if estimate.seen_t_s > NEVER:
            nearest, wanted = estimate.range_near_m, self._desired
            self._curve("range", t_s, estimate.range_m, shown(nearest), shown(wanted.standoff_m))
            self._curve("height", t_s, estimate.range_m * math.tan(estimate.depression_rad), shown(wanted.height_m))
        if tick.track is not None:
            self._timings(t_s, {**tick.stage_ms, **{f"tracker: {k}": v for k, v in tick.track.stage_ms.items()}})

    def _curve(self, path: str, t_s: float, *values: float) -> None:
        times, numbers = self._curves.setdefault(path, ([], []))
        times.append(t_s)
        numbers.extend(values)

    def _timings(self, t_s: float, stage_ms: Mapping[str, float]) -> None:
        """One entity with a value for each stage, NaN for a stage that did not run."""
        if new := [name for name in stage_ms if name not in self._stages]:
            self._send_curves()
            self._stages += new
            self._recording.log("timings", rr.SeriesLines(names=self._stages), static=True)
        self._curve("timings", t_s, *(stage_ms.get(name, math.nan) for name in self._stages))

    def _send_curves(self) -> None:
        """Log the curves collected so far; a curve has the same number of values at each time."""
        for path, (times, numbers) in self._curves.items():
            width = len(numbers) // len(times)
            columns = rr.Scalars.columns(scalars=numbers).partition([width] * len(times))
            self._recording.send_columns(path, [rr.TimeColumn("seconds", duration=times)], columns)
        self._curves.clear()
        for path, rows in self._boxes.items():
            shown = [(box, colour, label) for _, box, colour, label in rows if box is not None]
            columns = rr.Boxes2D.columns(
                centers=[(box.centre_x, box.centre_y) for box, _, _ in shown],
                half_sizes=[(box.w / 2, box.h / 2) for box, _, _ in shown],
                colors=[colour for _, colour, _ in shown],
                labels=[label for _, _, label in shown],
            ).partition([0 if box is None else 1 for _, box, _, _ in rows])
            self._recording.send_columns(path, [rr.TimeColumn("seconds", duration=[row[0] for row in rows])], columns)
        self._boxes.clear()

    def _box(self, path: str, t_s: float, box: Box | None, colour: Colour, label: str = "") -> None:
        if box is not None or path in self._shown:
            self._boxes.setdefault(path, []).append((t_s, box, colour, label))
        if box is None:
            self._shown.discard(path)
        else:
            self._shown.add(path)


def to_file(path: Path, about: str, kind: Encoder, jpeg_quality: int, desired: Desired | None = None) -> RerunRecording:
    """A recording in a file.  Raises OSError if it cannot be opened."""

    def connect(recording: rr.RecordingStream) -> None:
        try:
            recording.save(path, default_blueprint=layout())
        except RuntimeError as error:
            raise OSError(f"{path} cannot be written: {error}") from None

    return RerunRecording(connect, path, encoder(kind, jpeg_quality), about, desired)


def outlines(mask: NDArray[np.uint8], box: Box) -> list[NDArray[np.floating]]:
    """The borders of the foreground of a mask that covers `box`, as closed strips (N, 2) in the image's pixels."""
    found, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE)
    pixel = np.array([box.w / mask.shape[1], box.h / mask.shape[0]])
    corner = np.array([box.x, box.y])
    return [corner + (np.concatenate([line, line[:1]]).reshape(-1, 2) + 0.5) * pixel for line in found]


def shown(value: float | None) -> float:
    """A value for a curve: NaN, which leaves a gap, if it is unknown."""
    return math.nan if value is None or math.isinf(value) else value


def _velocity(setpoint: Setpoint) -> list[float]:
    return [setpoint.forward_m_s, setpoint.right_m_s, setpoint.down_m_s]
