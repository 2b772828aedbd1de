"""The same rules for every Camera.  To add one, write a builder and name it in CAMERAS.

A builder gets a folder to write in and gives (camera, how many frames it is good for); live ones never end.
"""

import itertools
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from follow.camera import Camera
from follow.camera.live import LiveVideo
from follow.camera.realtime import NewPictures, RealTime
from follow.camera.video import open_replay
from follow.camera.window import WindowCamera
from follow.geometry import Intrinsics
from follow.link.replay import ReplayLink
from follow.messages import Autopilot, Frame
from sim.scenarios import SCENARIOS, build
from tests.follow.test_live_cameras import PROGRAM
from tests.support.clips import clip, encode, numbered

COUNT = 12
ROUNDS = 400  # more than any of them needs for COUNT frames


def quiet(_line: str) -> None: ...


def folder(path: Path) -> Camera:
    for n in range(COUNT):
        cv2.imwrite(str(path / f"{n}.png"), numbered(n))
    return open_replay(str(path), 30.0, quiet)


def file(path: Path, name: str = "a.mp4", **how) -> Camera:
    return open_replay(str(clip(path / name, COUNT, **how)), None, quiet)


def uneven(path: Path) -> Camera:
    stamps_s = list(np.cumsum([0.02, 0.2, 0.05] * (COUNT // 3)))
    return open_replay(str(encode(path / "a.mkv", map(numbered, range(COUNT)), stamps_s=stamps_s)), None, quiet)


def window(path: Path) -> Camera:
    return WindowCamera(
        file(path), ReplayLink(30.0, 10.0).state, Intrinsics.from_fov(192, 120, 1.2), (64, 40), (96, 60), 20.0
    )


CAMERAS: dict[str, Callable[[Path], Camera]] = {
    "folder of images": folder,
    "video file": file,
    "video file of 10 bit": lambda path: file(path, pix_fmt="yuv420p10le"),
    "video file of variable rate": uneven,
    "animation": lambda path: file(path, "a.gif", codec="gif", pix_fmt="rgb8", rate=25),
    "footage in real time": lambda path: RealTime(file(path)),
    "window over footage": window,
    "without repeated frames": lambda path: NewPictures(file(path)),
    "drawn scene": lambda _path: build(SCENARIOS["walker"], 0, Autopilot.PX4)[0],
    "lavfi": lambda _path: LiveVideo("lavfi:testsrc=size=192x120:rate=60", quiet),
    "program, MJPEG": lambda _path: LiveVideo(f"exec:{PROGRAM} mjpeg", quiet),
    "program, raw": lambda _path: LiveVideo(f"exec?format=yuv420p&size=192x120:{PROGRAM} yuv420p", quiet),
}


@pytest.fixture(params=CAMERAS)
def camera(request, tmp_path) -> Camera:
    return CAMERAS[request.param](tmp_path)


def test_a_camera_keeps_the_contract(camera):
    """Frames in order, times that grow, one shape of bytes, rounds without a frame as None."""
    with camera as entered:
        assert entered is camera
        rounds = list(itertools.islice(camera.frames(), ROUNDS if hasattr(camera, "rounds") else 60))
        frames = [frame for frame in rounds if frame is not None]
    assert len(frames) >= 3
    assert all(isinstance(frame, Frame) for frame in frames)
    assert all(later.t_s > earlier.t_s for earlier, later in itertools.pairwise(frames))
    assert all(later.index > earlier.index for earlier, later in itertools.pairwise(frames))
    assert len({frame.image.shape for frame in frames}) == 1
    assert all(frame.image.dtype == np.uint8 and frame.image.flags.c_contiguous for frame in frames)
    if hasattr(camera, "size"):
        assert frames[0].image.shape == (camera.size[1], camera.size[0], 3)


def test_an_image_is_not_written_to_after_it_was_given(camera):
    """A consumer in another thread (the recorder) may read it later."""
    with camera:
        kept: list[tuple[np.ndarray, np.ndarray]] = []
        for frame in itertools.islice(camera.frames(), 60):
            if frame is not None:
                kept.append((frame.image, frame.image.copy()))
    assert kept
    assert all(np.array_equal(image, copy) for image, copy in kept)


def test_leaving_by_an_error_releases_it_and_lets_the_error_pass(camera):
    def consume() -> None:
        with camera:
            next(iter(camera.frames()))
            raise KeyError("a consumer's own")

    with pytest.raises(KeyError):
        consume()
