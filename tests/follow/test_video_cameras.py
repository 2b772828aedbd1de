"""Cameras that read files: nothing that is missing or broken loses what is there, and each trouble is one line."""

import contextlib
import itertools
import threading
import time
from collections.abc import Callable
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import cv2
import numpy as np
import pytest

from follow.camera import CameraError, video
from follow.camera.video import LiveVideo, is_live, open_replay
from follow.cli.commands import RunCommand
from follow.cli.run import open_camera
from follow.config import CameraConfig, Config
from follow.messages import Autopilot, Frame
from sim.dynamics import Vehicle, VehicleTruth
from sim.link import SimLink
from tests.support.machine import LateError, against_the_clock
from tests.support.real_flight import free_ports


def frame(n: int, size=(48, 32)) -> np.ndarray:
    """A frame that says its number: grey level 4 n (mod 256)."""
    return np.full((size[1], size[0], 3), 4 * n % 256, np.uint8)


def folder_of(tmp_path: Path, numbers, name="{:03d}.png") -> Path:
    for n in numbers:
        cv2.imwrite(str(tmp_path / name.format(n)), frame(n))
    return tmp_path


def video_of(path: Path, count: int) -> Path:
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"mp4v"), 30, (48, 32))
    for n in range(count):
        writer.write(frame(n))
    writer.release()
    return path


def play(source, fps=None) -> tuple[list[Frame | None], list[str]]:
    lines: list[str] = []
    with open_replay(str(source), fps, lines.append) as camera:
        return list(camera.frames()), lines


def test_a_folder_is_played_in_the_order_of_its_numbers(tmp_path):
    frames, lines = play(folder_of(tmp_path, (1, 2, 3, 10, 11), name="{}.png"), fps=10)
    assert [f.image[0, 0, 0] // 4 for f in frames if f] == [1, 2, 3, 10, 11]
    assert frames[9] is not None
    assert frames[9].t_s == pytest.approx(0.9)
    assert len(lines) == 1


def test_the_hidden_files_that_macos_leaves_beside_each_image_are_passed_over(tmp_path):
    folder = folder_of(tmp_path, range(1, 6))
    for path in list(folder.iterdir()):
        path.with_name(f"._{path.name}").write_bytes(b"\x00\x05\x16\x07")
    frames, lines = play(folder)
    assert [f.image[0, 0, 0] // 4 for f in frames if f] == [1, 2, 3, 4, 5]
    assert (len(frames), lines) == (5, [])


def test_the_rate_that_a_folders_path_tells_counts_from_within_it_too(tmp_path, monkeypatch):
    inside = tmp_path / "UAV_10fps" / "seq"
    inside.mkdir(parents=True)
    monkeypatch.chdir(folder_of(inside, range(1, 4)))
    with open_replay(".", None, print) as camera:
        assert camera.fps == 10.0


def test_a_hole_in_the_numbers_is_rounds_without_a_picture_and_one_line(tmp_path):
    frames, lines = play(folder_of(tmp_path, (1, 2, 3, 6, 7)))
    assert [f is None for f in frames] == [False, False, False, True, True, False, False]
    assert lines == ["2 frames are missing before 006.png: played as a pause"]
    assert [f.index for f in frames if f] == [0, 1, 2, 5, 6]


def test_numbers_that_do_not_count_pictures_are_only_an_order(tmp_path):
    frames, lines = play(folder_of(tmp_path, (0, 33, 66, 30), name="100000{:03d}.png"))
    assert len(frames) == 4
    assert not lines


def test_an_image_that_cannot_be_decoded_is_skipped_with_one_line(tmp_path):
    folder_of(tmp_path, range(4))
    (tmp_path / "002.png").write_bytes(b"no frame")
    frames, lines = play(tmp_path)
    assert [f is None for f in frames] == [False, False, True, False]
    assert lines == ["002.png cannot be decoded: skipped"]


def test_an_image_of_another_size_is_skipped_with_one_line(tmp_path):
    folder_of(tmp_path, range(3))
    cv2.imwrite(str(tmp_path / "001.png"), frame(1, (20, 20)))
    frames, lines = play(tmp_path)
    assert [f is None for f in frames] == [False, True, False]
    assert lines == ["001.png is 20x20, not 48x32 like the first frame: skipped"]


def test_every_picture_of_a_video_comes_in_its_own_round(tmp_path):
    frames, lines = play(video_of(tmp_path / "clip.mp4", 30))
    assert [f.index for f in frames if f] == list(range(30))
    assert [f.t_s for f in frames if f] == pytest.approx(np.arange(30) / 30)
    assert not lines


def test_a_corrupt_middle_of_a_video_costs_only_those_pictures(tmp_path):
    path = tmp_path / "clip.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), 30, (160, 120))
    rng = np.random.default_rng(0)
    for _ in range(40):
        writer.write(rng.integers(0, 256, (120, 160, 3), dtype=np.uint8))
    writer.release()
    data = bytearray(path.read_bytes())
    middle = len(data) // 2
    data[middle : middle + len(data) // 20] = bytes(len(data) // 20)
    path.write_bytes(data)
    frames, lines = play(path)
    seen = [f.index for f in frames if f]
    assert len(seen) >= 36
    assert seen == sorted(set(seen))
    assert len(lines) <= 1


def test_a_video_that_ends_early_says_so_in_one_line(tmp_path):
    path = tmp_path / "clip.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), 30, (160, 120))
    for n in range(40):
        writer.write(np.full((120, 160, 3), 5 * n, np.uint8))
    writer.release()
    data = path.read_bytes()
    path.write_bytes(data[: len(data) // 2])
    frames, lines = play(path)
    assert 10 < len(frames) < 40
    assert len(lines) == 1
    assert "of 40 frames" in lines[0]


@pytest.mark.parametrize("make", [lambda p: p / "nothing", lambda p: p, lambda p: p / "text.mp4"])
def test_what_cannot_be_opened_is_refused_in_one_sentence(tmp_path, make):
    (tmp_path / "text.mp4").write_text("no video")
    source = make(tmp_path)
    with pytest.raises(CameraError) as refusal:
        open_replay(str(source), None, print)
    assert str(source) in str(refusal.value)
    assert "\n" not in str(refusal.value)


@pytest.mark.parametrize("fps", [0.0, -1.0, float("nan"), float("inf")])
def test_a_rate_that_is_no_rate_is_refused(tmp_path, fps):
    folder_of(tmp_path, range(2))
    with pytest.raises(CameraError, match="per second"):
        open_replay(str(tmp_path), fps, print)


def test_devices_and_streams_are_live_and_files_are_not():
    assert all(map(is_live, ("0", "/dev/video2", "rtsp://drone/1", "udp://:5600")))
    assert not any(map(is_live, ("clip.mp4", "frames", "./0")))


class Clip(BaseHTTPRequestHandler):
    """One video for every request; with `stalls`, its first half and then silence until the server ends."""

    def do_GET(self):
        server = self.server
        assert isinstance(server, ClipServer)
        self.send_response(200)
        self.end_headers()
        data = server.data[: len(server.data) // 2] if server.stalls else server.data
        with contextlib.suppress(ConnectionError):
            self.wfile.write(data)
            if server.stalls:
                server.ending.wait(60.0)

    def log_message(self, *_args): ...


class ClipServer(ThreadingHTTPServer):
    def __init__(self, data: bytes, *, stalls: bool = False):
        super().__init__(("127.0.0.1", 0), Clip)
        self.data, self.stalls, self.ending = data, stalls, threading.Event()
        self.uri = f"http://127.0.0.1:{self.server_port}/clip.avi"
        threading.Thread(target=self.serve_forever, kwargs={"poll_interval": 0.05}, daemon=True).start()

    def end(self):
        self.ending.set()
        self.shutdown()
        self.server_close()


@pytest.fixture
def stream(tmp_path):
    """Builds servers of forty frames, which are ended afterwards."""
    path = tmp_path / "clip.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), 30, (160, 120))
    for n in range(40):
        writer.write(np.full((120, 160, 3), 5 * n, np.uint8))
    writer.release()
    with contextlib.ExitStack() as stack:

        def build(**how) -> ClipServer:
            server = ClipServer(path.read_bytes(), **how)
            stack.callback(server.end)
            return server

        yield build


def watched(camera: LiveVideo, enough: Callable[[], bool], seconds: float = 20.0) -> list[Frame | None]:
    """The rounds of a live camera until it was enough."""
    rounds: list[Frame | None] = []
    end = time.monotonic() + seconds
    for frame in camera.frames():
        rounds.append(frame)
        if enough():
            return rounds
        if time.monotonic() > end:
            raise LateError("not within the time")
    return rounds


@pytest.mark.realtime
def test_a_stream_that_ends_is_reported_once_and_opened_again(stream):
    lines: list[str] = []
    uri = stream().uri
    with LiveVideo(uri, lines.append) as camera:
        assert camera.size == (160, 120)
        rounds = watched(camera, lambda: len(lines) >= 2)
        frames = [frame for frame in rounds if frame is not None]
        assert lines[:2] == [
            f"camera {uri!r} gives no frame: trying again every 1 s",
            f"camera {uri!r} gives frames again",
        ]
        assert [f.index for f in frames] == sorted({f.index for f in frames})
        assert all(b.t_s > a.t_s for a, b in itertools.pairwise(frames))
        assert None in rounds, "the loop goes on while there is no frame"


@pytest.mark.realtime
def test_only_the_newest_picture_of_a_stream_is_kept(stream):
    with LiveVideo(stream().uri, lambda _line: None) as camera:
        time.sleep(0.7)  # all forty have come: a file is sent as fast as it is read
        newest = next(frame for frame in camera.frames() if frame is not None)
        with against_the_clock():
            assert newest.index == 39
        assert newest.image[60, 80, 0] == pytest.approx(195, abs=4)


@pytest.mark.realtime
def test_a_sender_that_falls_silent_is_reported_within_the_patience(stream, monkeypatch):
    monkeypatch.setattr(video, "SILENT_S", 0.5)
    lines: list[str] = []
    with LiveVideo(stream(stalls=True).uri, lines.append) as camera:
        began = time.monotonic()
        rounds = watched(camera, lambda: bool(lines))
        with against_the_clock():
            assert time.monotonic() - began < 3.0
        assert sum(frame is not None for frame in rounds) >= 1
        longest = max(len(list(run)) for there, run in itertools.groupby(rounds, key=lambda f: f is None) if there)
        with against_the_clock():
            assert longest >= 5, "a round every 50 ms, frame or not: the gate sees the frame grow old"


def test_the_delay_that_a_camera_is_known_to_have_is_taken_off_and_granted_by_the_gate(stream):
    chosen = Config(camera=CameraConfig(delay_s=0.15))
    command = RunCommand("udpin:127.0.0.1:1", camera=stream().uri, target="10,10,30,40", config=chosen)
    began_t_s = time.monotonic()
    with (
        SimLink(Vehicle(Autopilot.PX4, VehicleTruth())) as link,
        (seen := open_camera(command, link, lambda _line: None)).camera,
    ):
        frame = next(frame for frame in seen.camera.frames() if frame is not None)
        assert began_t_s - 0.15 < frame.t_s < time.monotonic() - 0.15
    assert seen.config.limits.latency_s == 0.15


def test_a_stream_that_nobody_sends_is_refused_in_one_sentence(stream):
    server = stream()
    server.end()
    with pytest.raises(CameraError) as refusal:
        LiveVideo(server.uri, print)
    assert str(refusal.value) == f"camera {server.uri!r} cannot be opened"


def send(writer: cv2.VideoWriter, began_t_s: float, stall: tuple[int, float], ending: threading.Event) -> None:
    """Thirty frames a second, each with its number; before one the network stalls, and then brings all."""
    rng = np.random.default_rng(0)
    for n in itertools.count():
        if ending.wait(max(began_t_s + n / 30 - time.monotonic(), stall[1] if n == stall[0] else 0.0)):
            break
        image = rng.integers(100, 156, (240, 320, 3), np.uint8)
        image[:40] = np.repeat(255 * (n >> np.arange(16) & 1), 20).astype(np.uint8)[None, :, None]
        writer.write(image)
    writer.release()


def number_in(frame: Frame) -> int:
    lit = frame.image[10:30].mean((0, 2)).reshape(16, 20)[:, 5:15].mean(1) > 127
    return int(lit @ (1 << np.arange(16)))


@pytest.mark.realtime
def test_pictures_that_a_network_held_up_bear_the_time_at_which_they_were_taken():
    """The referee is the number in the frame; what the decoder holds back is the same for all."""
    uri, ending = f"udp://127.0.0.1:{free_ports(1)[0]}", threading.Event()
    # OpenCV opens one of these at a time: the sender must be there before the camera waits for it.
    mpeg_ts = cv2.VideoWriter(f"{uri}/frames.ts", cv2.CAP_FFMPEG, cv2.VideoWriter.fourcc(*"mp4v"), 30, (320, 240))
    began_t_s = time.monotonic()
    sender = threading.Thread(target=send, args=(mpeg_ts, began_t_s, (120, 1.0), ending))
    sender.start()
    try:
        with LiveVideo(uri, lambda _line: None) as camera:
            rounds = watched(camera, lambda: time.monotonic() > began_t_s + 7.0)
    finally:
        ending.set()
        sender.join()
    frames = [frame for frame in rounds if frame is not None]
    delays = np.array([frame.t_s - began_t_s - number_in(frame) / 30 for frame in frames])
    held_up = [frame for frame in frames if 105 < number_in(frame) < 140]
    with against_the_clock():
        assert len(frames) > 90
        assert held_up, "some of the backlog is read between two rounds"
        assert delays.max() - delays.min() < 0.1, "half a second and more where the time of arrival is taken"


class Resized:
    """A capture whose frames have another size after the tenth, as after a camera's driver was restarted."""

    def __init__(self) -> None:
        self.count = 0

    def isOpened(self) -> bool:  # noqa: N802 - OpenCV's name
        return True

    def get(self, what: int) -> float:
        return {cv2.CAP_PROP_FRAME_WIDTH: 160.0, cv2.CAP_PROP_FRAME_HEIGHT: 120.0}.get(what, 0.0)

    def read(self) -> tuple[bool, np.ndarray]:
        time.sleep(0.002)
        self.count += 1
        rows, cols = (120, 160) if self.count <= 10 else (60, 80)
        return True, np.full((rows, cols, 3), self.count, np.uint8)

    def release(self) -> None: ...


def test_pictures_of_another_size_than_the_lens_is_known_for_are_not_flown(monkeypatch):
    monkeypatch.setattr(LiveVideo, "_open", lambda _self: Resized())
    lines: list[str] = []
    with LiveVideo("0", lines.append) as camera:
        rounds = watched(camera, lambda: bool(lines))
        rounds += [next(camera.frames()) for _ in range(3)]
    assert {frame.image.shape for frame in rounds if frame is not None} <= {(120, 160, 3)}
    assert lines == ["camera '0' gives 80x60, not 160x120: not used"]
