"""The viewer's layout for a flight, and the colours, which mean the same everywhere.

Visible at once: the image, the desired and flown range and height, the active limits and the reasons for each mode
(lanes and messages).  The sharpness of the tracker's response, and timings, come last.
"""

# Rerun's own check of the Python version hides its names from a type checker that is set to Python 3.10.
# pyright: reportAttributeAccessIssue=false

from typing import Literal

import rerun as rr
import rerun.blueprint as rrb
from rerun.blueprint.encodings import TextLogColumn

from follow.messages import Mode

GREEN, RED, YELLOW, GREY, BLUE = (80, 220, 100), (240, 70, 60), (250, 210, 60), (150, 150, 150), (90, 160, 255)
ORANGE, PALE, DIM = (255, 150, 50), (110, 130, 150), (120, 120, 120)
VIOLET = (190, 130, 255)
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
AXES = ("forward", "right", "down")


def describe(recording: rr.RecordingStream, about: str) -> None:
    """Log the static data: names and colours of curves and states, the flight's description."""

    def say(path: str, what: rr.AsComponents) -> None:
        recording.log(path, what, static=True)

    def line(path: str, names: list[str], colours: list[tuple[int, int, int]]) -> None:
        say(path, rr.SeriesLines(names=names, colors=colours))

    say("about", rr.TextDocument(about, media_type=rr.MediaType.MARKDOWN))
    say("mode", rr.StateConfiguration(values=[m.value for m in MODE_COLOURS], colors=list(MODE_COLOURS.values())))
    say("tracker", rr.StateConfiguration(values=["found", "lost"], colors=[GREEN, RED]))
    line("track/confidence", ["confidence"], [GREEN])
    line("track/sharpness", ["PSR", "APCE"], [GREEN, YELLOW])
    line("range", ["range to the target", "nearest possible", "wanted stand-off"], [ORANGE, DIM, GREEN])
    line("height", ["height above the target", "wanted height at a hover"], [BLUE, GREEN])
    line("desired/velocity", [f"desired {axis}" for axis in AXES], DESIRED)
    line("setpoint/velocity", [f"sent {axis}" for axis in AXES], SENT)
    line("desired/yaw_rate", ["desired"], [DESIRED[0]])
    line("setpoint/yaw_rate", ["sent"], [SENT[0]])


def layout(play_state: Literal["paused", "playing", "following"] = "paused") -> rrb.Blueprint:
    """Image, lanes and messages on the left; range, height and commands over time on the right, timings last."""
    left = rrb.Vertical(
        rrb.Spatial2DView(
            origin="/image",
            name="Camera: target (green, red lost), mask (blue), search (grey), truth (yellow), detector (violet)",
        ),
        rrb.StateTimelineView(
            origin="/",
            contents=["/mode/**", "/tracker"],
            name="Mode of the gate; what held it back; why it is in this mode; target in view",
        ),
        rrb.Tabs(
            rrb.TextLogView(origin="/messages", name="Messages", columns=_message_columns()),
            rrb.TextDocumentView(origin="/about", name="About this flight"),
            rrb.TextDocumentView(origin="/settings", name="Settings"),
        ),
        row_shares=[6, 2.9, 2],
    )
    right = rrb.Vertical(
        _curves("Range, m: to the target (orange), nearest possible (grey), wanted stand-off (green)", ["/range"]),
        _curves("Height above the target, m: flown (blue), wanted at a hover (green)", ["/height"]),
        _curves(
            "Velocity, m/s: forward (blue), right (orange), down (green); pale: desired",
            ["/desired/velocity", "/setpoint/velocity"],
        ),
        _curves("Yaw rate, degrees/s: sent (blue), desired (pale)", ["/desired/yaw_rate", "/setpoint/yaw_rate"]),
        rrb.Tabs(
            rrb.TimeSeriesView(
                origin="/track/confidence",
                name="Confidence",
                axis_y=rrb.ScalarAxis(range=(0.0, 1.05), zoom_lock=True),
                plot_legend=rrb.PlotLegend(visible=False),
            ),
            rrb.Spatial2DView(origin="/response", name="Response of the filter"),
            _curves("Sharpness: PSR (green), APCE (yellow)", ["/track/sharpness"]),
            _curves("Time of each stage, ms", ["/timings"], legend=True),
        ),
        row_shares=[1.3, 1.3, 1.2, 1, 1],
    )
    return rrb.Blueprint(
        rrb.Horizontal(left, right, column_shares=[3, 2]),
        rrb.TimePanel(state="collapsed", timeline="seconds", play_state=play_state),
        rrb.BlueprintPanel(state="hidden"),
        rrb.SelectionPanel(state="hidden"),
    )


def _curves(name: str, contents: list[str], *, legend: bool = False) -> rrb.TimeSeriesView:
    """Curves over time; the title explains their colours, because a legend would cover them."""
    return rrb.TimeSeriesView(
        origin="/",
        contents=contents,
        name=name,
        plot_legend=rrb.PlotLegend(corner=rrb.Corner2D.LeftTop, visible=legend),
    )


def _message_columns() -> rrb.TextLogColumns:
    """The text takes the width: it begins with its time, and its entity is always the same."""
    return rrb.TextLogColumns(text_log_columns=[TextLogColumn("Body")])
