"""Ticks as Rerun shows them: entities, one timeline (`seconds`, from the first tick) and the layout shown first."""

# Rerun's own check of the Python version hides its names from a type checker that is set to Python 3.10.
# pyright: reportAttributeAccessIssue=false

import re
from pathlib import Path
from typing import Literal

import cv2
import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from numpy.typing import NDArray

from follow.messages import NEVER, Mode, Setpoint, Tick
from follow.recording.rows import LoggedTick
from racf.box import Box
from racf.track import Track

FLUSH_TIMEOUT_S = 5.0  # a disk that takes longer counts as broken

GREEN, RED, YELLOW, GREY, BLUE = (80, 220, 100), (240, 70, 60), (250, 210, 60), (150, 150, 150), (90, 160, 255)
ORANGE, PALE = (255, 150, 50), (110, 130, 150)
DESIRED = [(150, 200, 255), (255, 205, 150), (190, 230, 190)]  # pale: the servo's; forward, right, down
SENT = [(40, 110, 230), (230, 120, 20), (30, 150, 60)]  # saturated: what was sent
MODE_COLOURS = {
    Mode.OBSERVE: PALE,  # pale, blue and grey: nothing is sent
    Mode.READY: BLUE,
    Mode.ENGAGE: YELLOW,  # yellow and orange: flying without the target in view, or not yet in control
    Mode.FOLLOW: GREEN,
    Mode.COAST: YELLOW,
    Mode.SEARCH: ORANGE,
    Mode.HOLD: ORANGE,
    Mode.BRAKE: RED,
    Mode.ENDED: GREY,
}
TIMED = re.compile(r"\d+\.\d s: ")  # a message that states the time of the flight itself
SEARCH, TRUTH, TARGET = 30.0, 31.0, 32.0  # draw order: a later box covers an earlier one
NUMBER = re.compile(r"-?\d+(\.\d+)?")


class RerunRecording:
    """A Rerun recording in a file; use it from one thread.

    The mode is a lane; why it changed is in the messages.  `flush` and `close` raise OSError if it cannot be written.
    """

    def __init__(self, path: Path, about: str, jpeg_quality: int) -> None:
        self._path = path
        self._jpeg = [int(cv2.IMWRITE_JPEG_QUALITY), jpeg_quality]
        self._recording = rr.RecordingStream("follow-me")
        self._recording.save(path, default_blueprint=layout())
        self._mode = ""
        self._found: bool | None = None
        self._notes: frozenset[str] = frozenset()
        self._shown: set[str] = set()
        self._describe(about)

    def tick(self, scene: LoggedTick) -> None:
        """Log one round."""
        tick = scene.tick
        self._recording.set_time("seconds", duration=scene.t_s)
        if tick.frame is not None:
            good, jpeg = cv2.imencode(".jpg", tick.frame.image, self._jpeg)
            if good:
                self._recording.log("image", rr.EncodedImage(contents=jpeg.tobytes(), media_type="image/jpeg"))
        if tick.track is not None:
            self._track(tick.track)
        self._box("image/truth", scene.truth, YELLOW, None, TRUTH)
        self._controls(tick)
        self._new_mode(scene)
        self._new_notes(scene)

    def message(self, t_s: float, text: str) -> None:
        """Log one line for a person at a time of the flight."""
        self._recording.set_time("seconds", duration=t_s)
        self._say(t_s, text, rr.TextLogLevel.INFO)

    def settings(self, toml: str) -> None:
        """Log the flight's settings."""
        text = rr.TextDocument(f"```toml\n{toml}```\n", media_type=rr.MediaType.MARKDOWN)
        self._recording.log("settings", text, static=True)

    def flush(self) -> None:
        """Wait until everything logged so far is in the file."""
        try:
            self._recording.flush(timeout_sec=FLUSH_TIMEOUT_S)
        except RuntimeError as error:  # Rerun writes the cause to its own log only
            raise OSError(f"{self._path} is no longer written: {error}; the flight goes on") from None

    def close(self) -> None:
        """Write the rest and the file's index, then close the file."""
        try:
            self.flush()
        finally:
            self._recording.disconnect()

    def _new_mode(self, scene: LoggedTick) -> None:
        """Log a new mode."""
        mode = scene.tick.decision.mode.value
        if mode != self._mode:
            self._recording.log("mode", rr.StateChange(state=mode))
        self._mode = mode

    def _new_notes(self, scene: LoggedTick) -> None:
        """Log the gate's notes that the tick before did not have; a number that changes does not make a note new."""
        notes = {NUMBER.sub("#", note): note for note in scene.tick.decision.notes}
        for kind, note in notes.items():
            if kind not in self._notes:
                self._say(scene.t_s, note, rr.TextLogLevel.WARN)
        self._notes = frozenset(notes)

    def _say(self, t_s: float, text: str, level: str) -> None:
        line = text if TIMED.match(text) else f"{t_s:.1f} s: {text}"
        self._recording.log("messages", rr.TextLog(line, level=level))

    def _track(self, track: Track) -> None:
        log = self._recording.log
        colour = GREEN if track.found else RED
        self._box("image/target", track.box, colour, f"{track.confidence:.2f}" if track.found else "lost", TARGET)
        self._box("image/search", track.search, GREY, None, SEARCH)
        log("track/confidence", rr.Scalars(track.confidence))
        log("track/refined", rr.Scalars(float(track.refined)))
        log("track/sharpness", rr.Scalars([track.psr, track.apce]))
        if track.found is not self._found:
            self._found = track.found
            log("tracker", rr.StateChange(state="found" if track.found else "lost"))
        if track.response is not None:
            peak = max(float(track.response.max()), 1e-6)  # normalised for display; the peak's height is in PSR
            heat = np.clip(track.response * (255 / peak), 0, 255).astype(np.uint8)
            log("response", rr.DepthImage(heat, meter=255.0, colormap="viridis", depth_range=[0.0, 255.0]))
        if track.mask is not None and track.mask_box is not None:
            log("mask", rr.SegmentationImage(track.mask))
            outline = rr.LineStrips2D(outlines(track.mask, track.mask_box), colors=[BLUE], radii=[-1.0])
            log("image/mask", outline)
            self._shown.add("mask")
        elif "mask" in self._shown:
            self._shown.remove("mask")
            log("mask", rr.Clear(recursive=False))
            log("image/mask", rr.Clear(recursive=False))
        for stage, ms in track.stage_ms.items():
            log(["timings", "tracker", stage], rr.Scalars(ms))

    def _controls(self, tick: Tick) -> None:
        log = self._recording.log
        log("desired/velocity", rr.Scalars(_velocity(tick.desired)))
        log("desired/yaw_rate", rr.Scalars(np.degrees(tick.desired.yaw_rate_rad_s)))
        if (sent := tick.decision.setpoint) is not None:
            log("setpoint/velocity", rr.Scalars(_velocity(sent)))
            log("setpoint/yaw_rate", rr.Scalars(np.degrees(sent.yaw_rate_rad_s)))
        log("vehicle/height", rr.Scalars(-tick.state.down_m))
        if tick.estimate.seen_t_s > NEVER:
            log("target/range", rr.Scalars(tick.estimate.range_m))
        for stage, ms in tick.stage_ms.items():
            log(["timings", stage], rr.Scalars(ms))

    def _box(self, path: str, box: Box | None, colour: tuple[int, int, int], label: str | None, order: float) -> None:
        if box is None:
            if path in self._shown:
                self._shown.remove(path)
                self._recording.log(path, rr.Clear(recursive=False))
            return
        self._shown.add(path)
        labels = None if label is None else [label]
        shape = rr.Boxes2D(
            mins=[(box.x, box.y)],
            sizes=[(box.w, box.h)],
            colors=[colour],
            labels=labels,
            show_labels=labels is not None,
            radii=[-1.0],
            draw_order=order,
        )
        self._recording.log(path, shape)

    def _describe(self, about: str) -> None:
        """Log what never changes: names and colours of curves and states, the mask's classes, the flight in words."""

        def say(path: str, what: rr.AsComponents) -> None:
            self._recording.log(path, what, static=True)

        say("about", rr.TextDocument(about, media_type=rr.MediaType.MARKDOWN))
        say("mask", rr.AnnotationContext([(0, "ground", (0, 0, 0)), (1, "target", BLUE)]))
        say("mode", rr.StateConfiguration(values=[m.value for m in MODE_COLOURS], colors=list(MODE_COLOURS.values())))
        say("tracker", rr.StateConfiguration(values=["found", "lost"], colors=[GREEN, RED]))
        say("track/confidence", rr.SeriesLines(names=["confidence"], colors=[GREEN]))
        say("track/refined", rr.SeriesLines(names=["refined"], colors=[BLUE]))
        say("vehicle/height", rr.SeriesLines(names=["height above the start"], colors=[BLUE]))
        say("target/range", rr.SeriesLines(names=["range along the ground"], colors=[ORANGE]))
        say("track/sharpness", rr.SeriesLines(names=["PSR", "APCE"], colors=[GREEN, YELLOW]))
        axes = ("forward", "right", "down")
        say("desired/velocity", rr.SeriesLines(names=[f"desired {a}" for a in axes], colors=DESIRED))
        say("setpoint/velocity", rr.SeriesLines(names=[f"sent {a}" for a in axes], colors=SENT))
        say("desired/yaw_rate", rr.SeriesLines(names=["desired"], colors=[DESIRED[0]]))
        say("setpoint/yaw_rate", rr.SeriesLines(names=["sent"], colors=[SENT[0]]))


def layout(play_state: Literal["paused", "playing", "following"] = "paused") -> rrb.Blueprint:
    """Image, modes and messages on the left; range, confidence and commands over time on the right."""
    left = rrb.Vertical(
        rrb.Spatial2DView(
            origin="/image", name="Camera: target (green found, red lost), truth (yellow), search region (grey)"
        ),
        rrb.StateTimelineView(origin="/", contents=["/mode", "/tracker"], name="Mode of the gate, target in view"),
        rrb.Tabs(
            rrb.TextLogView(origin="/messages", name="Messages"),
            rrb.TextDocumentView(origin="/about", name="About this flight"),
            rrb.TextDocumentView(origin="/settings", name="Settings"),
        ),
        row_shares=[6, 1.5, 2],
    )
    right = rrb.Vertical(
        rrb.TimeSeriesView(
            origin="/", contents=["/vehicle/height", "/target/range"], name="Height, range to the target, m"
        ),
        rrb.TimeSeriesView(
            origin="/track/confidence", name="Confidence", axis_y=rrb.ScalarAxis(range=(0.0, 1.0), zoom_lock=True)
        ),
        rrb.TimeSeriesView(
            origin="/", contents=["/desired/velocity", "/setpoint/velocity"], name="Velocity: desired and setpoint, m/s"
        ),
        rrb.TimeSeriesView(
            origin="/",
            contents=["/desired/yaw_rate", "/setpoint/yaw_rate"],
            name="Yaw rate: desired and setpoint, degrees/s",
        ),
        rrb.Tabs(
            rrb.Spatial2DView(origin="/response", name="Response of the filter"),
            rrb.TimeSeriesView(origin="/track/sharpness", name="Sharpness: PSR, APCE"),
            rrb.Spatial2DView(origin="/mask", name="GrabCut mask"),
            rrb.TimeSeriesView(origin="/track/refined", name="Box refined by GrabCut, 0 or 1"),
            rrb.TimeSeriesView(origin="/timings", name="Time of each stage, ms"),
        ),
        row_shares=[1, 1, 1, 1, 1.5],
    )
    return rrb.Blueprint(
        rrb.Horizontal(left, right, column_shares=[3, 2]),
        rrb.TimePanel(state="collapsed", timeline="seconds", play_state=play_state),
        rrb.BlueprintPanel(state="hidden"),
        rrb.SelectionPanel(state="hidden"),
    )


def outlines(mask: NDArray[np.uint8], box: Box) -> list[NDArray[np.floating]]:
    """The borders of the foreground of a mask that covers `box`, as closed strips (N, 2) in the image's pixels."""
    found, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE)
    pixel = np.array([box.w / mask.shape[1], box.h / mask.shape[0]])
    corner = np.array([box.x, box.y])
    return [corner + (np.concatenate([line, line[:1]]).reshape(-1, 2) + 0.5) * pixel for line in found]


def _velocity(setpoint: Setpoint) -> list[float]:
    return [setpoint.forward_m_s, setpoint.right_m_s, setpoint.down_m_s]
