"""Streams over loopback from real encoders: rate, true times, breaks.  The reference is the number in each frame."""

import time
from pathlib import Path

import numpy as np
import pytest

from follow.camera.capture import held_packets
from follow.camera.live import LiveVideo
from follow.messages import Frame
from tests.follow.test_live_cameras import watched
from tests.support.clips import number_in
from tests.support.machine import against_the_clock
from tests.support.senders import FPS, SIZE, Frames, MjpegServer, RtspServer, rtp_with_sdp, udp_ts

KINDS = ("udp", "sdp", "http", "rtsp#transport=tcp", "rtsp#transport=udp")


def camera_of(kind: str, folder: Path):
    """The name of a camera and its sender."""
    if kind == "udp":
        return udp_ts()
    if kind == "sdp":
        return rtp_with_sdp(folder)
    server = MjpegServer() if kind == "http" else RtspServer()
    return server.url + kind.removeprefix("rtsp").removeprefix("http"), server


def errors_s(frames: list[Frame], sent: Frames) -> np.ndarray:
    """Each frame's time less the time at which its number was taken."""
    return np.array([frame.t_s - sent.sent_t_s[number_in(frame.image)] for frame in frames])


@pytest.mark.realtime
@pytest.mark.parametrize("kind", KINDS)
def test_a_stream_keeps_its_rate_and_its_times_and_comes_back_after_a_break(tmp_path, kind):
    name, sender = camera_of(kind, tmp_path)
    lines: list[str] = []
    sender.open()
    try:
        with LiveVideo(name, lines.append) as camera:
            assert camera.size == SIZE
            end_s = time.monotonic() + 3.0
            rounds = watched(camera, lambda: time.monotonic() > end_s)
            sender.close()
            rounds += watched(camera, lambda: bool(lines))
            sender.open()
            watched(camera, lambda: len(lines) >= 2)
    finally:
        sender.close()
    frames = [frame for frame in rounds if frame is not None]
    numbers = [number_in(frame.image) for frame in frames]
    assert numbers == sorted(set(numbers))
    assert lines[0].startswith(f"camera {name!r} gives no frame (")
    assert lines[1] == f"camera {name!r} gives frames again"
    with against_the_clock():
        assert len(frames) > 0.7 * FPS, "of the two seconds after the first"
        late = errors_s(frames, sender.frames)
        assert -1e-3 < np.median(late) < 0.02, "what the demuxer holds back is known, and taken off"
        assert np.ptp(np.percentile(late, (5, 95))) < 0.05


@pytest.mark.realtime
@pytest.mark.parametrize("kind", ["udp", "rtsp#transport=tcp"])
def test_frames_delayed_by_a_network_have_the_time_at_which_they_were_taken(tmp_path, kind):
    name, sender = camera_of(kind, tmp_path)
    sender.frames.stall = (90, 0.7)
    sender.open()
    try:
        with LiveVideo(name, lambda _line: None) as camera:
            end_s = time.monotonic() + 5.5
            rounds = watched(camera, lambda: time.monotonic() > end_s)
    finally:
        sender.close()
    frames = [frame for frame in rounds if frame is not None]
    held_up = [frame for frame in frames if 90 <= number_in(frame.image) < 110]
    late = errors_s(frames, sender.frames)
    with against_the_clock():
        assert len(frames) > 60
        assert held_up, "some of the backlog is read between two rounds"
        assert np.ptp(np.percentile(late, (2, 98))) < 0.1, "0.4 s and more if the time of arrival were taken"


@pytest.mark.parametrize(
    ("format_", "codec", "held"), [("rtsp", "h264", 1), ("rtsp", "mjpeg", 0), ("mpjpeg", "mjpeg", 0)]
)
def test_what_ffmpeg_holds_back_depends_on_how_a_frame_ends(format_, codec, held):
    assert held_packets(format_, codec) == held
