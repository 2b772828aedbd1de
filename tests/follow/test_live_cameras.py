"""Live cameras: newest frame only, true ages, reported breaks.  The reference is the number in each frame."""

import itertools
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import cast

import cv2
import numpy as np
import pytest

from follow.camera import CameraError, live
from follow.camera.live import LiveVideo
from follow.camera.names import CameraName
from follow.camera.program import JpegCapture, RunningProgram
from follow.cli.commands import RunCommand
from follow.cli.run import open_camera
from follow.config import CameraConfig, Config
from follow.messages import Autopilot, Frame
from sim.dynamics import Vehicle, VehicleTruth
from sim.link import SimLink
from tests.support.clips import encode, number_in
from tests.support.machine import LateError, against_the_clock

PROGRAM = f"{sys.executable} -m tests.support.camera_program"


def watched(camera: LiveVideo, enough: Callable[[], bool], seconds: float = 20.0) -> list[Frame | None]:
    """The rounds of a live camera until a condition is met."""
    rounds: list[Frame | None] = []
    end = time.monotonic() + seconds
    for frame in camera.frames():
        rounds.append(frame)
        if enough():
            return rounds
        if time.monotonic() > end:
            raise LateError("not within the time")
    return rounds


class Scripted:
    """A capture that plays what a test says: (image, time) or an error."""

    def __init__(self, *steps: tuple[np.ndarray, float | None] | Exception) -> None:
        self.size = (160, 120)
        self.steps, self.closed = steps, False

    def images(self) -> Iterator[tuple[np.ndarray, float | None]]:
        for step in self.steps:
            if isinstance(step, Exception):
                raise step
            yield step
            time.sleep(0.002)
        raise CameraError("it ended")

    def interrupt(self) -> None: ...

    def close(self) -> None:
        self.closed = True


def image(n: int, size: tuple[int, int] = (160, 120)) -> np.ndarray:
    return np.full((size[1], size[0], 3), n, np.uint8)


@pytest.fixture
def scripted(monkeypatch) -> Callable[..., list[Scripted]]:
    """Lets the cameras that a test opens be the given captures, one after the other; then none can be opened."""
    monkeypatch.setattr(live, "REOPEN_AFTER_S", 0.01)

    def play(*captures: Scripted) -> list[Scripted]:
        left = iter(captures)

        def open_next(_name: CameraName, _clock: Callable[[], float]) -> Scripted:
            if (capture := next(left, None)) is None:
                raise CameraError("cannot be opened")
            return capture

        monkeypatch.setattr(live, "open_capture", open_next)
        return list(captures)

    return play


def test_a_source_that_breaks_is_reported_once_with_its_reason_and_opened_again(scripted):
    first = Scripted((image(1), 1.0), (image(2), 2.0), CameraError("nothing came for 2 s"))
    second = Scripted(*((image(n), float(n)) for n in range(3, 200)))
    lines: list[str] = []
    scripted(first, second)
    with LiveVideo("rtsp://x/y", lines.append) as camera:
        rounds = watched(camera, lambda: len(lines) >= 2)
        rounds += watched(camera, lambda: True)
    frames = [frame for frame in rounds if frame is not None]
    assert lines[:2] == [
        "camera 'rtsp://x/y' gives no frame (nothing came for 2 s): trying again every 0.01 s",
        "camera 'rtsp://x/y' gives frames again",
    ]
    assert all(b.t_s > a.t_s and b.index > a.index for a, b in itertools.pairwise(frames))
    assert first.closed


@pytest.mark.parametrize("error", [ValueError("no such conversion"), OSError(1, "not permitted"), MemoryError("1 GB")])
def test_a_source_that_breaks_in_any_other_way_is_reported_and_opened_again(scripted, error):
    lines: list[str] = []
    scripted(Scripted((image(1), 1.0), error), Scripted(*((image(n), float(n)) for n in range(3, 200))))
    with LiveVideo("rtsp://x/y", lines.append) as camera:
        watched(camera, lambda: len(lines) >= 2)
    assert type(error).__name__ in lines[0]
    assert str(error) in lines[0]
    assert lines[1] == "camera 'rtsp://x/y' gives frames again"


def test_a_source_that_stays_away_is_one_line_and_rounds_go_on(scripted):
    lines: list[str] = []
    scripted(Scripted((image(1), 1.0), CameraError("it ended")))
    with LiveVideo("rtsp://x/y", lines.append) as camera:
        rounds = [frame for frame, _ in zip(camera.frames(), range(6), strict=False)]
    assert rounds.count(None) >= 5
    assert len(lines) == 1


def test_frames_of_another_size_than_the_lens_is_known_for_are_not_flown(scripted):
    lines: list[str] = []
    scripted(
        Scripted(*((image(n), float(n)) for n in range(10)), *((image(n, (80, 60)), float(n)) for n in range(10, 99)))
    )
    with LiveVideo("0", lines.append) as camera:
        rounds = watched(camera, lambda: bool(lines))
        rounds += [next(camera.frames()) for _ in range(3)]
    assert {frame.image.shape for frame in rounds if frame is not None} <= {(120, 160, 3)}
    assert lines[0] == "camera '0' gives 80x60, not 160x120: not used"


def test_a_frame_whose_time_is_not_known_or_not_later_is_not_given(scripted):
    times = (None, 5.0, 5.0, 4.0, None, 6.0, 5.5, 7.0)
    scripted(Scripted(*((image(n), t_s) for n, t_s in enumerate(times))))
    seen: list[float] = []
    lines: list[str] = []
    with LiveVideo("0", lines.append) as camera:
        for frame in camera.frames():
            seen += [frame.t_s] if frame else []
            if lines:
                break
    assert set(seen) <= {5.0, 6.0, 7.0}
    assert seen == sorted(set(seen))


@pytest.mark.realtime
@pytest.mark.parametrize(
    ("form", "options"), [("mjpeg", ""), ("h264", ""), ("yuv420p", "?format=yuv420p&size=192x120")]
)
def test_a_programs_frames_are_flown_and_it_is_started_again_when_it_dies(form, options):
    lines: list[str] = []
    command = f"exec{options}:{PROGRAM} {form} --frames 120 --fail 'sensor lost'"
    with LiveVideo(command, lines.append) as camera:
        assert camera.size == (192, 120)
        rounds = watched(camera, lambda: len(lines) >= 2)
    numbers = [number_in(frame.image) for frame in rounds if frame is not None]
    assert "(it ended; the program ended with status 3: sensor lost): trying again every 1 s" in lines[0]
    assert lines[1].endswith("gives frames again")
    assert numbers == sorted(set(numbers))
    shifts = np.array([frame.t_s - number_in(frame.image) / 30 for frame in rounds if frame is not None])
    with against_the_clock():
        assert len(numbers) > 30, "of the two seconds after the first two"
        assert np.ptp(shifts) < 0.05, "each frame's time is that of its number"


def alive(pid: int) -> bool:
    try:
        return "Z" not in Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0]
    except OSError:
        return False


def gone(pids: list[int], seconds: float = 10.0) -> bool:
    end_s = time.monotonic() + seconds
    while any(map(alive, pids)) and time.monotonic() < end_s:
        time.sleep(0.02)
    return not any(map(alive, pids))


def pids_in(path: Path) -> list[int]:
    return [int(word) for word in path.read_text().split()]


def test_a_program_and_what_it_started_end_with_the_camera(tmp_path):
    with LiveVideo(f"exec:{PROGRAM} mjpeg --child {tmp_path / 'pids'}", print):
        pids = pids_in(tmp_path / "pids")
        assert all(map(alive, pids))
    assert gone(pids)


def test_a_program_ends_when_we_are_killed(tmp_path):
    name = f"exec:{PROGRAM} mjpeg --child {tmp_path / 'pids'}"
    code = "import os, sys\nfrom follow.camera.live import LiveVideo\n"
    code += "LiveVideo(sys.argv[1], print)\nos.kill(os.getpid(), 9)"
    assert subprocess.run([sys.executable, "-c", code, name], check=False).returncode == -signal.SIGKILL
    program, child = pids_in(tmp_path / "pids")
    try:
        assert gone([program])
    finally:
        os.kill(child, signal.SIGKILL)


@pytest.mark.parametrize(
    ("command", "why"),
    [
        ("sh -c 'echo no camera found >&2; exit 5'", "the program ended with status 5: no camera found"),
        ("echo this is no video", "the program ended with status 0"),
        ("true", "the program ended with status 0"),
    ],
)
def test_a_program_that_gives_no_video_is_refused_with_its_last_line(command, why):
    with pytest.raises(CameraError) as refusal:
        LiveVideo(f"exec:{command}", print)
    assert "cannot be opened" in str(refusal.value)
    assert why in str(refusal.value)


def test_a_file_that_a_program_writes_to_a_pipe_and_that_has_no_size_at_its_start_is_refused(tmp_path):
    """An MP4 whose index is at its end cannot be read from a pipe."""
    noise = np.random.default_rng(0).integers(0, 255, (60, 360, 640, 3), np.uint8)
    clip = encode(tmp_path / "clip.mp4", noise, "mpeg4", format_="mp4")
    with pytest.raises(CameraError, match=r"cannot be opened: .*; the program ended with status 0"):
        LiveVideo(f"exec:cat {clip}", print)


JPEG = cv2.imencode(".jpg", np.random.default_rng(0).integers(0, 255, (120, 160, 3), np.uint8))[1].tobytes()


def writing(*chunks: bytes) -> RunningProgram:
    """A program that writes each of the chunks when it is read, then the last one for ever; 30 reads a second."""
    reads = itertools.count()

    class Written:
        timeout_s = 10.0
        read_t_s = 0.0

        def read(self, _size: int) -> bytes:
            n = next(reads)
            self.read_t_s = n / 30
            return chunks[min(n, len(chunks) - 1)]

    return cast(RunningProgram, Written())


@pytest.mark.parametrize("cut", [len(JPEG), 700, len(JPEG) - 1])
def test_images_that_are_padded_and_cut_anywhere_are_found(cut):
    padded = JPEG + bytes(7)
    capture = JpegCapture(writing(padded[:cut], padded[cut:] + padded[:cut]))
    assert capture.size == (160, 120)
    shown = [image for image, _ in itertools.islice(capture.images(), 40)]
    assert {image.shape for image in shown} == {(120, 160, 3)}
    assert all(np.array_equal(image, shown[0]) for image in shown)


@pytest.mark.parametrize("chunk", [bytes(1 << 20), b"\xff\xd8" + bytes(10), b"\xff\xd8 no image \xff\xd9"])
def test_output_without_an_image_is_refused_and_fills_no_memory(chunk):
    with pytest.raises(CameraError, match="no JPEG that can be decoded"):
        JpegCapture(writing(chunk))


@pytest.mark.parametrize(
    ("media", "why"),
    [("", "there is no video in it"), ("m=video 5994 RTP/AVP 96\na=rtpmap:96 H264/90000\n", "no image came")],
)
def test_an_sdp_file_without_a_sender_is_refused_by_its_name(tmp_path, media, why):
    file = tmp_path / "camera.sdp"
    file.write_text("v=0\no=- 0 0 IN IP4 127.0.0.1\ns=x\nc=IN IP4 127.0.0.1\nt=0 0\n" + media)
    with pytest.raises(CameraError, match=why) as refusal:
        LiveVideo(str(file), print)
    assert "camera.sdp' cannot be opened" in str(refusal.value)


def test_a_long_line_of_error_is_shown_by_its_end():
    command = 'sh -c \'yes progress | head -n 20000 | tr "\\n" "\\r" >&2; echo sensor lost >&2; exit 3\''
    with pytest.raises(CameraError, match="status 3: sensor lost") as refusal:
        LiveVideo(f"exec:{command}", print)
    assert len(str(refusal.value)) < 400


def test_the_known_delay_of_a_camera_is_subtracted_and_allowed_by_the_gate():
    chosen = Config(camera=CameraConfig(delay_s=0.15))
    command = RunCommand(
        "udpin:127.0.0.1:1", camera="lavfi:testsrc=size=64x48:rate=30", target="10,10,30,40", config=chosen
    )
    began_t_s = time.monotonic()
    with (
        SimLink(Vehicle(Autopilot.PX4, VehicleTruth())) as link,
        (seen := open_camera(command, link, lambda _line: None)).camera,
    ):
        frame = next(frame for frame in seen.camera.frames() if frame is not None)
        assert began_t_s - 0.15 < frame.t_s < time.monotonic() - 0.15
    assert seen.config.limits.latency_s == 0.15
