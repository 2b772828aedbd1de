"""Large sources: shrunk by a stated rule before tracking, and every box outside the loop in pixels of the source."""

import csv
import json

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from follow.camera.live import LiveVideo
from follow.camera.sizes import LEAST_LENGTH_PX, LEAST_TARGET_PX, shrink_for
from follow.camera.video import open_replay
from follow.cli.program import main
from follow.flight import preflight
from racf.box import Box
from racf.video import Video
from sim.clip import clip
from tests.follow.test_live_cameras import PROGRAM
from tests.support.clips import encode, number_in, numbered

BIG = (1920, 1080)


def by_two(_size: tuple[int, int]) -> int:
    return 2


@pytest.mark.parametrize(
    ("size", "side", "shrink"),
    [
        ((640, 360), 300, 1),
        ((1280, 720), 100, 1),
        (BIG, 80, 2),
        (BIG, 40, 1),
        ((3840, 2160), 200, 4),
        ((3840, 2160), 96, 3),
    ],
)
def test_sizes_follow_the_rule_of_the_documentation(size, side, shrink):
    assert shrink_for(Box(10, 10, side, 2 * side))(size) == shrink_for(Box(10, 10, 3 * side, side))(size) == shrink


@given(st.integers(16, 8000), st.integers(16, 8000), st.floats(1, 4000), st.floats(1, 4000))
def test_neither_image_nor_target_is_shrunk_below_what_the_rule_keeps(width, height, w, h):
    shrink = shrink_for(Box(0, 0, w, h))((width, height))
    assert shrink >= 1
    if shrink > 1:
        assert max(width, height) / shrink >= LEAST_LENGTH_PX
        assert min(w, h) / shrink >= LEAST_TARGET_PX


def large(count: int = 12):
    """The clip's first frames, three times as large, and their true boxes."""
    for image, box in clip(count):
        yield cv2.resize(image, BIG, interpolation=cv2.INTER_CUBIC), box.zoomed(3)


def test_a_large_video_is_followed_and_scored_in_the_pixels_of_its_annotation(tmp_path, capfd):
    shown = list(large())
    path = encode(tmp_path / "big.mp4", [image for image, _ in shown], codec_options={"preset": "ultrafast"})
    truth = tmp_path / "big.txt"
    truth.write_text("".join(f"{b.x + 1},{b.y + 1},{b.w},{b.h}\n" for _, b in shown))
    with open_replay(str(path), None, print, shrink_for(shown[0][1])) as camera:
        assert (camera.size, camera.scale) == ((960, 540), 2)
    assert main(["replay", str(path), "--truth", str(truth), "--out", str(tmp_path / "out"), "--json"]) == 0
    figures = json.loads(capfd.readouterr().out)
    assert figures["precision_20px"] == 100.0
    assert figures["auc"] > 75
    with (tmp_path / "out" / "ticks.csv").open() as file:
        rows = [row for row in csv.DictReader(file) if row["track_x_px"]]
    for row, (_, box) in zip(rows, shown, strict=True):
        assert float(row["track_x_px"]) == pytest.approx(box.x, abs=8)
        assert float(row["track_h_px"]) == pytest.approx(box.h, rel=0.15)


def test_a_target_outside_a_large_image_is_refused_in_its_own_pixels(tmp_path, capfd):
    path = encode(tmp_path / "big.mp4", [image for image, _ in large(2)], codec_options={"preset": "ultrafast"})
    assert main(["replay", str(path), "--target", "1900,900,400,400", "--out", str(tmp_path / "out")]) == 2
    assert "1920x1080" in capfd.readouterr().err


def test_a_shrunk_image_shows_the_same_and_has_its_scale(tmp_path):
    (tmp_path / "folder").mkdir()
    for n in range(4):
        cv2.imwrite(str(tmp_path / "folder" / f"{n}.png"), numbered(n, (384, 240)))
    path = encode(tmp_path / "a.mp4", [numbered(n, (384, 240)) for n in range(4)])
    for source in (path, tmp_path / "folder"):
        with open_replay(str(source), None, print, by_two) as camera:
            frames = [frame for frame in camera.frames() if frame]
            assert (camera.size, camera.scale) == ((192, 120), 2)
        assert [(number_in(frame.image), frame.scale) for frame in frames] == [(n, 2) for n in range(4)]
    with Video(path, by_two) as small, Video(path) as whole:
        for one, other in zip(small.images(), whole.images(), strict=True):
            area = cv2.resize(other.image, (192, 120), interpolation=cv2.INTER_AREA)
            assert np.abs(one.image.astype(int) - area).mean() < 4


def test_doctor_times_the_tracker_on_what_the_loop_tracks_and_shows_pixels_of_the_source(tmp_path, monkeypatch, capfd):
    seen: list[tuple[int, ...]] = []
    check = preflight.check_tracker

    def noted(update, frames, fps):
        seen.extend(frame.image.shape for frame in frames)
        return check(update, frames, fps)

    monkeypatch.setattr(preflight, "check_tracker", noted)
    path = encode(tmp_path / "big.mp4", [image for image, _ in large(4)], codec_options={"preset": "ultrafast"})
    main(["doctor", "--camera", str(path), "--out", str(tmp_path / "out")])
    assert "1920x1080 frames, tracked as 960x540" in capfd.readouterr().err
    assert set(seen) == {(540, 960, 3)}
    assert cv2.imread(str(tmp_path / "out" / "camera.png")).shape == (1080, 1920, 3)


@pytest.mark.parametrize("form", ["mjpeg", "h264"])
def test_a_live_camera_is_shrunk_alike(form):
    with LiveVideo(f"exec:{PROGRAM} {form}", print, shrink=by_two) as camera:
        frame = next(frame for frame in camera.frames() if frame)
    assert (camera.size, camera.scale, frame.scale) == ((96, 60), 2, 2)
    assert frame.image.shape == (60, 96, 3)
    assert abs(number_in(cv2.resize(frame.image, (192, 120))) - frame.index) < 40, (
        "it shows its number, some were learnt from"
    )
