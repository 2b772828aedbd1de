"""Ticks as Rerun shows them: entities, two timelines (`seconds`, `frame`) and the layout a person sees first."""

# Rerun's own check of the Python version hides its names from a type checker that is set to Python 3.10.
# pyright: reportAttributeAccessIssue=false

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import cv2
import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from numpy.typing import NDArray

from follow.messages import NEVER, Setpoint, Tick
from racf.box import Box
from racf.track import Track

FLUSH_TIMEOUT_S = 5.0  # a disk that is busy for longer is taken for broken

GREEN, RED, YELLOW, GREY, BLUE = (80, 220, 100), (240, 70, 60), (250, 210, 60), (150, 150, 150), (90, 160, 255)
DESIRED = [(150, 200, 255), (255, 205, 150), (190, 230, 190)]  # pale: what the servo desired ...
SENT = [(40, 110, 230), (230, 120, 20), (30, 150, 60)]  # ... and full: what was sent, forward, right, down


@dataclass(frozen=True, slots=True)
class LoggedTick:
    """A tick with its number and, where annotations are known, the true box in its picture."""

    n: int
    tick: Tick
    truth: Box | None = None


class RerunRecording:
    """A Rerun recording in a file; use it from one thread.

    `flush` and `close` raise OSError when it cannot be written.
    """

    def __init__(self, path: Path, about: str, jpeg_quality: int) -> None:
        self._path = path
        self._jpeg = [int(cv2.IMWRITE_JPEG_QUALITY), jpeg_quality]
        self._recording = rr.RecordingStream("follow-me")
        self._recording.save(path, default_blueprint=layout())
        self._mode = ""
        self._notes: tuple[str, ...] = ()
        self._frame = 0
        self._t_s = 0.0
        self._shown: set[str] = set()
        self._describe(about)

    def tick(self, scene: LoggedTick) -> None:
        """Log one round."""
        tick = scene.tick
        self._t_s = tick.state.t_s
        self._frame = tick.frame.index if tick.frame else self._frame
        self._stamp()
        if tick.frame is not None:
            good, jpeg = cv2.imencode(".jpg", tick.frame.image, self._jpeg)
            if good:
                picture = rr.EncodedImage(contents=jpeg.tobytes(), media_type="image/jpeg")
                self._recording.log("picture", picture)
        if tick.track is not None:
            self._track(tick.track)
        self._box("picture/truth", scene.truth, YELLOW, "truth")
        self._controls(tick)
        if tick.decision.mode != self._mode:
            self._mode = tick.decision.mode.value
            self._recording.log("mode", rr.StateChange(state=self._mode))
            self._say(f"mode {self._mode}", rr.TextLogLevel.INFO)
        for note in tick.decision.notes:
            if note not in self._notes:
                self._say(note, rr.TextLogLevel.WARN)
        self._notes = tick.decision.notes

    def message(self, text: str) -> None:
        """Log one line for a person, at the time of the last tick."""
        self._stamp()
        self._say(text, rr.TextLogLevel.WARN)

    def settings(self, toml: str) -> None:
        """Log what the flight is flown with."""
        text = rr.TextDocument(f"```toml\n{toml}```\n", media_type=rr.MediaType.MARKDOWN)
        self._recording.log("settings", text, static=True)

    def flush(self) -> None:
        """Wait until what is logged is in the file."""
        try:
            self._recording.flush(timeout_sec=FLUSH_TIMEOUT_S)
        except RuntimeError as error:  # Rerun's writer says the cause on its own log only
            raise OSError(f"{self._path} is no longer written: {error}") from None

    def close(self) -> None:
        """Write the rest, with the file's index, and let go."""
        try:
            self.flush()
        finally:
            self._recording.disconnect()

    def _stamp(self) -> None:
        self._recording.set_time("seconds", duration=self._t_s)
        self._recording.set_time("frame", sequence=self._frame)

    def _say(self, text: str, level: str) -> None:
        self._recording.log("messages", rr.TextLog(text, level=level))

    def _track(self, track: Track) -> None:
        log = self._recording.log
        colour = GREEN if track.found else RED
        self._box("picture/target", track.box, colour, f"{track.confidence:.2f}" if track.found else "lost")
        self._box("picture/search", track.search, GREY, None)
        log("track/confidence", rr.Scalars([track.confidence, float(track.found), float(track.refined)]))
        log("track/sharpness", rr.Scalars([track.psr, track.apce]))
        if track.response is not None:
            peak = max(float(track.response.max()), 1e-6)  # how high it is says the PSR; here its shape is shown
            heat = np.clip(track.response * (255 / peak), 0, 255).astype(np.uint8)
            log("response", rr.DepthImage(heat, meter=255.0, colormap="viridis", depth_range=[0.0, 255.0]))
        if track.mask is not None and track.mask_box is not None:
            log("mask", rr.SegmentationImage(track.mask))
            outline = rr.LineStrips2D(outlines(track.mask, track.mask_box), colors=[BLUE], radii=[-1.0])
            log("picture/mask", outline)
            self._shown.add("mask")
        elif "mask" in self._shown:
            self._shown.remove("mask")
            log("mask", rr.Clear(recursive=False))
            log("picture/mask", rr.Clear(recursive=False))
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

    def _box(self, path: str, box: Box | None, colour: tuple[int, int, int], label: str | None) -> None:
        if box is None:
            if path in self._shown:
                self._shown.remove(path)
                self._recording.log(path, rr.Clear(recursive=False))
            return
        self._shown.add(path)
        labels = None if label is None else [label]
        shape = rr.Boxes2D(mins=[(box.x, box.y)], sizes=[(box.w, box.h)], colors=[colour], labels=labels, radii=[-1.0])
        self._recording.log(path, shape)

    def _describe(self, about: str) -> None:
        """What never changes: names and colours of the curves, classes of the mask, the flight in words."""

        def say(path: str, what: rr.AsComponents) -> None:
            self._recording.log(path, what, static=True)

        say("about", rr.TextDocument(about, media_type=rr.MediaType.MARKDOWN))
        say("mask", rr.AnnotationContext([(0, "ground", (0, 0, 0)), (1, "target", BLUE)]))
        say("track/confidence", rr.SeriesLines(names=["confidence", "found", "refined"], colors=[GREEN, GREY, BLUE]))
        say("track/sharpness", rr.SeriesLines(names=["PSR", "APCE"], colors=[GREEN, YELLOW]))
        axes = ("forward", "right", "down")
        say("desired/velocity", rr.SeriesLines(names=[f"desired {a}" for a in axes], colors=DESIRED))
        say("setpoint/velocity", rr.SeriesLines(names=[f"sent {a}" for a in axes], colors=SENT))
        say("desired/yaw_rate", rr.SeriesLines(names=["desired"], colors=[DESIRED[0]]))
        say("setpoint/yaw_rate", rr.SeriesLines(names=["sent"], colors=[SENT[0]]))


def layout(play_state: Literal["paused", "playing", "following"] = "paused") -> rrb.Blueprint:
    """Picture, mode and messages on the left; what the tracker saw, and what was commanded, on the right."""
    left = rrb.Vertical(
        rrb.Spatial2DView(origin="/picture", name="What the camera sees: target, search region, truth"),
        rrb.StateTimelineView(origin="/mode", name="Mode"),
        rrb.Tabs(
            rrb.TextLogView(origin="/messages", name="Messages"),
            rrb.TextDocumentView(origin="/about", name="About this flight"),
            rrb.TextDocumentView(origin="/settings", name="Settings"),
        ),
        row_shares=[6, 1, 2],
    )
    right = rrb.Vertical(
        rrb.Horizontal(
            rrb.Spatial2DView(origin="/response", name="Response of the filter"),
            rrb.Spatial2DView(origin="/mask", name="GrabCut mask"),
        ),
        rrb.TimeSeriesView(origin="/track/confidence", name="Confidence 0..1"),
        rrb.TimeSeriesView(
            origin="/", contents=["/desired/velocity", "/setpoint/velocity"], name="Velocity: desired and setpoint, m/s"
        ),
        rrb.TimeSeriesView(
            origin="/",
            contents=["/desired/yaw_rate", "/setpoint/yaw_rate"],
            name="Yaw rate: desired and setpoint, degrees/s",
        ),
        rrb.Tabs(
            rrb.TimeSeriesView(origin="/timings", name="Time of each stage, ms"),
            rrb.TimeSeriesView(origin="/track/sharpness", name="Sharpness: PSR, APCE"),
            rrb.TimeSeriesView(
                origin="/", contents=["/vehicle/height", "/target/range"], name="Height and range to the target, m"
            ),
        ),
        row_shares=[2, 1, 1, 1, 1],
    )
    return rrb.Blueprint(
        rrb.Horizontal(left, right, column_shares=[3, 2]),
        rrb.TimePanel(state="collapsed", timeline="seconds", play_state=play_state),
        rrb.BlueprintPanel(state="hidden"),
        rrb.SelectionPanel(state="hidden"),
    )


def outlines(mask: NDArray[np.uint8], place: Box) -> list[NDArray[np.floating]]:
    """The borders of the mask's foreground as closed strips (N, 2) in the picture's pixels."""
    found, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE)
    pixel = np.array([place.w / mask.shape[1], place.h / mask.shape[0]])
    corner = np.array([place.x, place.y])
    return [corner + (np.concatenate([line, line[:1]]).reshape(-1, 2) + 0.5) * pixel for line in found]


def _velocity(setpoint: Setpoint) -> list[float]:
    return [setpoint.forward_m_s, setpoint.right_m_s, setpoint.down_m_s]
