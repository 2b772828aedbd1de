"""Cameras over footage: a missing or broken frame costs no other frame, and one line counts the missing ones."""

import os
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest

from follow.camera import CameraError
from follow.camera.realtime import RealTime
from follow.camera.video import open_replay
from follow.link.replay import ReplayLink
from follow.messages import HOVER, Frame
from tests.support.clips import clip, encode, number_in, numbered


def frame(n: int, size=(48, 32)) -> np.ndarray:
    """A frame that shows its number as grey level 4 n (mod 256)."""
    return np.full((size[1], size[0], 3), 4 * n % 256, np.uint8)


def folder_of(tmp_path: Path, numbers, name="{:03d}.png") -> Path:
    for n in numbers:
        cv2.imwrite(str(tmp_path / name.format(n)), frame(n))
    return tmp_path


def play(source, fps=None) -> tuple[list[Frame | None], list[str]]:
    lines: list[str] = []
    with open_replay(str(source), fps, lines.append) as camera:
        return list(camera.frames()), lines


def test_a_folder_is_played_in_the_order_of_its_numbers(tmp_path):
    frames, lines = play(folder_of(tmp_path, (1, 2, 3, 10, 11), name="{}.png"), fps=10)
    assert [f.image[0, 0, 0] // 4 for f in frames if f] == [1, 2, 3, 10, 11]
    assert frames[9] is not None
    assert frames[9].t_s == pytest.approx(0.9)
    assert lines == [f"{tmp_path.name}: 6 frames are missing (6 not there, first before 10.png)"]


def test_the_hidden_files_that_macos_leaves_beside_each_image_are_passed_over(tmp_path):
    folder = folder_of(tmp_path, range(1, 6))
    for path in list(folder.iterdir()):
        path.with_name(f"._{path.name}").write_bytes(b"\x00\x05\x16\x07")
    frames, lines = play(folder)
    assert [f.image[0, 0, 0] // 4 for f in frames if f] == [1, 2, 3, 4, 5]
    assert (len(frames), lines) == (5, [])


def test_the_rate_in_a_folders_path_also_counts_from_inside_the_folder(tmp_path, monkeypatch):
    inside = tmp_path / "UAV_10fps" / "seq"
    inside.mkdir(parents=True)
    monkeypatch.chdir(folder_of(inside, range(1, 4)))
    with open_replay(".", None, print) as camera:
        assert camera.fps == 10.0


def test_a_gap_in_the_numbers_gives_rounds_without_an_image_and_one_line(tmp_path):
    frames, lines = play(folder_of(tmp_path, (1, 2, 3, 6, 7)))
    assert [f is None for f in frames] == [False, False, False, True, True, False, False]
    assert lines == [f"{tmp_path.name}: 2 frames are missing (2 not there, first before 006.png)"]
    assert [f.index for f in frames if f] == [0, 1, 2, 5, 6]


def test_numbers_that_do_not_count_images_are_only_an_order(tmp_path):
    frames, lines = play(folder_of(tmp_path, (0, 33, 66, 30), name="100000{:03d}.png"))
    assert len(frames) == 4
    assert not lines


def test_an_image_that_cannot_be_decoded_is_skipped_with_one_line(tmp_path):
    folder_of(tmp_path, range(4))
    (tmp_path / "002.png").write_bytes(b"no frame")
    frames, lines = play(tmp_path)
    assert [f is None for f in frames] == [False, False, True, False]
    assert lines == [f"{tmp_path.name}: 1 frame is missing (1 not decodable, first 002.png)"]


def test_an_image_of_another_size_is_skipped_with_one_line(tmp_path):
    folder_of(tmp_path, range(3))
    cv2.imwrite(str(tmp_path / "001.png"), frame(1, (20, 20)))
    frames, lines = play(tmp_path)
    assert [f is None for f in frames] == [False, True, False]
    assert lines == [f"{tmp_path.name}: 1 frame is missing (1 of another size, first 001.png)"]


def test_missing_frames_are_counted_in_one_line_even_if_the_flight_ends_early(tmp_path):
    folder_of(tmp_path, (*range(5), *range(8, 20)))
    for n in (2, 3, 10):
        (tmp_path / f"{n:03d}.png").write_bytes(b"no frame")
    cv2.imwrite(str(tmp_path / "012.png"), frame(1, (20, 20)))
    whole = "7 frames are missing (3 not there, 3 not decodable, 1 of another size, first 002.png)"
    assert play(tmp_path)[1] == [f"{tmp_path.name}: {whole}"]
    lines: list[str] = []
    with open_replay(str(tmp_path), None, lines.append) as camera:
        for round_, _ in zip(range(4), camera.frames(), strict=False):
            assert round_ < 4
    assert lines == [f"{tmp_path.name}: 2 frames are missing (2 not decodable, first 002.png)"]


def test_every_frame_of_a_video_comes_at_its_time(tmp_path):
    frames, lines = play(clip(tmp_path / "clip.mp4", 30))
    assert [(f.index, number_in(f.image)) for f in frames if f] == [(n, n) for n in range(30)]
    assert [f.t_s for f in frames if f] == pytest.approx(np.arange(30) / 30)
    assert not lines


def test_a_rate_that_is_given_overrides_the_stamps(tmp_path):
    path = encode(tmp_path / "a.mp4", map(numbered, range(10)), stamps_s=[0.1 * n * n for n in range(10)])
    frames, _ = play(path, fps=10)
    assert [f.t_s for f in frames if f] == pytest.approx(np.arange(10) / 10)
    assert len(frames) == 10


STAMPS_S = (0.0, 0.04, 0.08, 0.12, 0.16, 0.5, 0.54, 0.58, 0.9, 0.94)
"""Twenty-five frames a second with two holes."""


def test_between_two_frames_that_are_far_apart_rounds_go_on_at_the_nominal_rate(tmp_path):
    path = encode(tmp_path / "a.mkv", map(numbered, range(10)), stamps_s=STAMPS_S, rate=25)
    with open_replay(str(path), None, print) as camera:
        rounds = [(camera.t_s, frame) for frame in camera.frames()]
    times = np.array([t_s for t_s, _ in rounds])
    assert np.all(np.diff(times) > 0)
    assert np.diff(times).max() < 1.5 / camera.fps
    assert [f.t_s for _, f in rounds if f] == pytest.approx(STAMPS_S, abs=1e-3)
    assert all(f is None or f.t_s == t_s for t_s, f in rounds)
    assert [f.index for _, f in rounds if f] == list(range(10))


def test_the_replayed_vehicle_flies_by_the_times_of_the_frames(tmp_path):
    path = encode(tmp_path / "a.mkv", map(numbered, range(10)), stamps_s=STAMPS_S, rate=25)
    with open_replay(str(path), None, print) as camera, ReplayLink(30.0, 10.0, now=lambda: camera.t_s) as link:
        for frame in camera.frames():
            assert link.state().t_s == camera.t_s == (frame.t_s if frame else camera.t_s)
            link.send(HOVER)


class Clock:
    """Time that passes only when somebody waits."""

    def __init__(self) -> None:
        self.t_s = 100.0

    def sleep(self, seconds: float) -> None:
        self.t_s += seconds


def test_footage_in_real_time_comes_when_its_stamps_say(tmp_path, monkeypatch):
    clock = Clock()
    monkeypatch.setattr("time.sleep", clock.sleep)
    path = encode(tmp_path / "a.mkv", map(numbered, range(10)), stamps_s=STAMPS_S, rate=25)
    with RealTime(open_replay(str(path), None, print), lambda: clock.t_s) as camera:
        frames = [frame for frame in camera.frames() if frame]
    assert [f.t_s - 100.0 for f in frames] == pytest.approx(STAMPS_S, abs=1e-3)


def test_a_slow_consumer_of_footage_in_real_time_misses_frames_and_loses_no_time(tmp_path, monkeypatch):
    clock = Clock()
    monkeypatch.setattr("time.sleep", clock.sleep)
    with RealTime(open_replay(str(clip(tmp_path / "a.mp4", 60)), None, print), lambda: clock.t_s) as camera:
        seen = []
        for frame in camera.frames():
            if frame is not None:
                seen.append((frame.t_s - 100.0, number_in(frame.image)))
                clock.sleep(0.1)
    assert 15 < len(seen) < 25
    assert all(0 <= t_s - number / 30 < 0.04 for t_s, number in seen)


def test_a_video_that_ends_early_says_so_in_one_line(tmp_path):
    path = clip(tmp_path / "clip.avi", 40, codec="mjpeg", pix_fmt="yuvj420p")
    os.truncate(path, path.stat().st_size // 2)
    frames, lines = play(path)
    assert 10 < len(frames) < 30
    rest, first = 40 - len(frames), len(frames)
    assert lines == [f"clip.avi: {rest} frames are missing ({rest} after the end of the file, first {first})"]


def test_a_gstreamer_pipeline_as_a_name_is_refused_with_the_right_form():
    with pytest.raises(CameraError, match=r"exec:gst-launch-1\.0 -q v4l2src ! fdsink"):
        open_replay("v4l2src ! appsink", None, print)


@pytest.mark.parametrize("name", ["2024-06-01T12:30:05.mp4", os.fsdecode(b"latin1_\xfc.mp4"), "two words.mp4"])
def test_a_clip_opens_by_its_bare_name_from_its_own_folder(tmp_path, monkeypatch, name):
    shutil.copy(clip(tmp_path / "plain.mp4", 5), tmp_path / name)
    monkeypatch.chdir(tmp_path)
    assert len(play(name)[0]) == 5


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
