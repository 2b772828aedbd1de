"""The names that `--camera` accepts, and the sentence for any other: the rule and the available choices."""

import errno
import struct
import sys
import time
import types
from typing import ClassVar

import numpy as np
import pytest

from follow.camera import CameraError, v4l2
from follow.camera.capture import KernelClock
from follow.camera.live import LiveVideo
from follow.camera.names import CameraKind, is_live, parse_camera
from follow.camera.v4l2 import CameraMode, check_mode, modes_of


def test_devices_streams_and_programs_are_live_and_footage_is_not():
    live = ("0", "/dev/video2", "rtsp://drone/1", "udp://:5600", "exec:cat x", "picamera2", "lavfi:testsrc", "a.sdp")
    assert all(
        map(is_live, (*live, "/dev/video0?size=1x1", "picamera2?fps=30", "exec?format=h264:cat", "http://h/a.mp4"))
    )
    assert not any(map(is_live, ("clip.mp4", "frames", "./0", "2024-06-01T12:30:05.mp4", "executable", "v4l2src ! x")))


def test_a_camera_name_is_parsed():
    device = parse_camera("0?size=1280x720&fps=29.97&format=mjpeg")
    assert (device.address, device.size, device.fps) == ("/dev/video0", (1280, 720), 29.97)
    stream = parse_camera("rtsp://user:pw@host/path?channel=1&sub=0#transport=udp")
    assert stream.address == "rtsp://user:pw@host/path?channel=1&sub=0"
    assert stream.options == {"transport": "udp"}
    program = parse_camera("exec?format=yuv420p&size=640x360:rpicam-vid -t 0 --roi 0:0:1:1 -o -")
    assert (program.kind, program.address) == (CameraKind.PROGRAM, "rpicam-vid -t 0 --roi 0:0:1:1 -o -")
    assert parse_camera("lavfi:testsrc=size=64x48:rate=5").address == "testsrc=size=64x48:rate=5"


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("/dev/video0?size=big", "size is WIDTHxHEIGHT in pixels, not 'big'"),
        ("/dev/video0?fps=0", "fps is a number of frames per second, not '0'"),
        ("/dev/video0?mode=3", "has no option 'mode'; it has size, fps, format"),
        ("/dev/video0?size", "size is WIDTHxHEIGHT in pixels, not ''"),
        ("rtsp://h/x#transport=pigeon", "transport is one of tcp, udp, udp_multicast, http, not 'pigeon'"),
        ("gopher://h/x", "streams begin with http, https, rtmp"),
        ("exec:", "needs a program"),
        ("exec?format=nv12:cat x", "has no header: give size=WxH also"),
        ("nowhere.sdp", "there is no file 'nowhere.sdp'"),
        ("picamera2?camera=front", "the number of a camera"),
        ("exec:/no/such/program -x", "there is no program '/no/such/program' here: install it, or give its whole path"),
        ("exec:'unbalanced", "cannot be started: No closing quotation"),
        ("/dev/video77", "/dev/video77 cannot be opened: No such file or directory"),
        ("/dev/null?size=640x480", "cannot be opened: "),
        ("lavfi:nosuchsource", "cannot be opened"),
        ("picamera2", "needs the package picamera2"),
        ("rtsp://127.0.0.1:1/x", "cannot be opened: Connection refused"),
        ("http://127.0.0.1:1/x", "cannot be opened: Connection refused"),
    ],
)
def test_what_cannot_be_is_refused_in_one_sentence(name, words):
    with pytest.raises(CameraError) as refusal:
        LiveVideo(name, print)
    assert words in str(refusal.value)
    assert "\n" not in str(refusal.value)


def test_srt_is_refused_by_name_where_the_wheel_has_none(monkeypatch):
    monkeypatch.setattr("follow.camera.names.has_srt", lambda: False)
    with pytest.raises(CameraError, match=r"has no SRT; use a program: exec\?format=mpegts:srt-live-transmit"):
        parse_camera("srt://drone:9000")
    monkeypatch.setattr("follow.camera.names.has_srt", lambda: True)
    assert parse_camera("srt://drone:9000").kind is CameraKind.STREAM


MODES = {"MJPG": {(1280, 720): (30, 15), (640, 480): (30,)}, "YUYV": {(1280, 720): (10,), (320, 240): (30,)}}
"""The modes of a usual UVC camera; the third entry of linux/videodev2.h's enumerations ends each list with EINVAL."""


def webcam(_device: int, number: int, request: bytearray) -> int:
    """A device's answers to VIDIOC_ENUM_FMT, ENUM_FRAMESIZES and ENUM_FRAMEINTERVALS, by the kernel's structs."""
    try:
        if number == 0xC0405602:
            index, kind = struct.unpack_from("=2I", request)
            code = list(MODES)[index] if kind == 1 else [][index]
            request[44:48] = code.encode()
        elif number == 0xC02C564A:
            index, code = struct.unpack_from("=I4s", request)
            struct.pack_into("=3I", request, 8, 1, *list(MODES[code.decode()])[index])
        elif number == 0xC034564B:
            index, code, width, height = struct.unpack_from("=I4s2I", request)
            struct.pack_into("=3I", request, 16, 1, 1, MODES[code.decode()][width, height][index])
        else:
            raise OSError(errno.ENOTTY, "no such call")
    except IndexError:
        raise OSError(errno.EINVAL, "no such entry") from None
    return 0


def test_the_modes_of_a_device_are_read_by_its_own_calls():
    assert modes_of("/dev/null", webcam) == [
        CameraMode("mjpeg", 1280, 720, (30, 15)),
        CameraMode("mjpeg", 640, 480, (30,)),
        CameraMode("yuyv422", 1280, 720, (10,)),
        CameraMode("yuyv422", 320, 240, (30,)),
    ]


def test_an_unknown_mode_is_refused_with_the_list_of_modes(monkeypatch):
    monkeypatch.setattr(v4l2.modes_of, "__defaults__", (webcam,))
    with pytest.raises(CameraError) as refusal:
        LiveVideo("/dev/null?size=1280x720&fps=30&format=yuyv422", print)
    assert str(refusal.value) == (
        "camera /dev/null has no mode yuyv422 1280x720 30 frames/s; it has mjpeg 1280x720 at 30, 15; "
        "mjpeg 640x480 at 30; yuyv422 1280x720 at 10; yuyv422 320x240 at 30"
    )


def test_a_mode_that_fits_passes_and_a_device_that_lists_nothing_is_not_judged():
    modes = modes_of("/dev/null", webcam)
    check_mode("x", modes, None, (640, 480), None)
    check_mode("x", modes, "mjpeg", (1280, 720), 15)
    check_mode("x", [], "mjpeg", (1, 1), 1000)


def test_a_kernels_stamp_of_our_clock_is_the_time_and_another_clocks_is_not():
    clock = KernelClock()
    assert clock.taken_at(1000.0, 1000.04) == 1000.0
    assert KernelClock().taken_at(1.7e9, 1000.04) is None, "a stamp of the wall clock: as for a stream"


class Request:
    def __init__(self, image: np.ndarray, age_s: float) -> None:
        self.image, self.age_s, self.released = image, age_s, False

    def make_array(self, _name: str) -> np.ndarray:
        return self.image

    def get_metadata(self) -> dict[str, float]:
        taken = time.clock_gettime(time.CLOCK_BOOTTIME) - self.age_s
        return {"SensorTimestamp": round(1e9 * taken), "ExposureTime": 10_000}

    def release(self) -> None:
        self.released = True


class Picamera2:
    """Stands in for picamera2's class: gives frames that are 40 ms old on arrival."""

    made: ClassVar["list[Picamera2]"] = []

    def __init__(self, number: int) -> None:
        self.number, self.requests, self.closed = number, [], False
        Picamera2.made.append(self)

    def create_video_configuration(self, main: dict, controls: dict, buffer_count: int) -> dict:
        return {"main": main, "controls": controls, "buffer_count": buffer_count}

    def configure(self, configuration: dict) -> None:
        self.configuration = configuration

    def camera_configuration(self) -> dict:
        return self.configuration

    def start(self) -> None: ...

    def stop(self) -> None: ...

    def close(self) -> None:
        self.closed = True

    def capture_request(self) -> Request:
        width, height = self.configuration["main"]["size"]
        self.requests.append(Request(np.full((height, width, 3), 7, np.uint8), 0.04))
        return self.requests[-1]


def test_picamera2_gives_frames_with_the_sensors_time_and_is_closed(monkeypatch):
    monkeypatch.setitem(sys.modules, "picamera2", types.SimpleNamespace(Picamera2=Picamera2))
    now = [500.0]
    with LiveVideo("picamera2?size=64x48&fps=60&camera=1", print, clock=lambda: now[0]) as camera:
        frame = next(frame for frame in camera.frames() if frame)
    (made,) = Picamera2.made
    assert (camera.size, made.number, made.configuration["controls"]) == ((64, 48), 1, {"FrameRate": 60.0})
    assert frame.t_s == pytest.approx(500.0 - 0.04 - 0.005, abs=0.02)
    assert made.closed
    assert all(request.released for request in made.requests)


def test_nothing_of_picamera2_is_imported_by_a_program_that_does_not_use_it():
    assert "picamera2" not in sys.modules
