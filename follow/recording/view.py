"""The flight in Rerun while it flies (`--view`).

The viewer has a recording stream, a queue and a thread of its own: a slow or lost viewer costs frames of the view,
never a setpoint nor a frame of `flight.rrd`.  Frames are sent as JPEG, at most `FRAMES_HZ` a second: any viewer can
show them without a video decoder, and a radio link has the bandwidth.
"""

# Rerun's own check of the Python version hides its names from a type checker that is set to Python 3.10.
# pyright: reportAttributeAccessIssue=false

import rerun as rr

from follow.messages import Notify
from follow.recording.layout import layout
from follow.recording.rerun_log import Pace, RerunRecording
from follow.recording.rows import Desired
from follow.recording.video_encoder import JpegEncoder
from follow.recording.viewer import HERE, WEB, own_address, page_address

FRAMES_HZ = 10.0
JPEG_QUALITY = 60  # some 25 kB at 640x360: 2 Mbit/s
PACE = Pace(frame_s=1 / FRAMES_HZ - 0.01, curves_s=0.2, flush_s=0.2)
FLUSH_TIMEOUT_S = 20.0  # a viewer that does not take a batch within this time is lost; meanwhile frames are dropped
MEMORY = "256MiB"  # the server's buffer for viewers that connect later, on a small computer


def to_viewer(view: str, about: str, desired: Desired | None, report: Notify) -> RerunRecording:
    """A recording that a viewer shows while it grows; see `check_view`."""

    def connect(recording: rr.RecordingStream) -> None:
        blueprint = layout(play_state="following")
        try:
            if view == HERE:
                recording.spawn(default_blueprint=blueprint, memory_limit="1GiB")
            elif view == WEB:
                url = recording.serve_grpc(default_blueprint=blueprint, server_memory_limit=MEMORY)
                rr.serve_web_viewer(open_browser=False, connect_to=url)
                report(f"the flight can be seen at {page_address(url, own_address())}")
            else:
                recording.connect_grpc(view, default_blueprint=blueprint)
        except (RuntimeError, ValueError) as error:
            raise OSError(f"the view {view} cannot be opened: {error}; the flight goes on") from None

    return RerunRecording(connect, f"the view {view}", JpegEncoder(JPEG_QUALITY), about, desired, PACE, FLUSH_TIMEOUT_S)
