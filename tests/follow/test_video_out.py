"""Video to the ground station: images arrive complete and in time, despite packet loss."""

import contextlib
import itertools
import math
import random
import socket
import threading
import time
from dataclasses import replace

import numpy as np
import pytest

from follow.cli.commands import RunCommand
from follow.cli.ground import DelayWatch, check_ground, video_address
from follow.messages import Frame
from follow.operator import video_stream
from follow.operator.ground import DirectSide
from follow.operator.video_out import (
    DELAYS,
    Overlay,
    VideoAddress,
    VideoConfig,
    VideoOut,
    description_of,
    drawn,
    parse_video,
    stream_size,
)
from follow.operator.video_stream import KEY_S, Coding, VideoStream, encoder_for
from follow.recording.video_encoder import Encoder
from follow.selection import TrackingState, TrackingStatus
from racf.commandline import UsageError
from tests.follow.test_record_flight import tick
from tests.support.clips import number_in, numbered
from tests.support.ground_station import GroundStation
from tests.support.rtp import Receiver, RtspSink, by_frame, nal_types

CODING = Coding("libx264", 30.0, 2_000_000)
SIZE = (640, 360)


class Air:
    """A stream whose packets are kept, frame by frame, instead of being sent."""

    def __init__(self, coding=CODING):
        self.packets, self.now = [], []
        self.stream = VideoStream(coding, "", print)
        self.stream._fanout.addresses = (("127.0.0.1", 9),)
        self.stream._fanout.write = lambda packet: self.now.append(bytes(packet)) or len(packet)

    def show(self, image, t_s):
        assert self.stream.show(image, t_s)
        sent, self.now = self.now, []
        self.packets.append(sent)
        return sent


def flown(count, coding=CODING, size=SIZE):
    """The packets of each of `count` numbered frames, 1/30 s apart."""
    air = Air(coding)
    with contextlib.closing(air.stream):
        return [air.show(numbered(n, size), 1e5 + n / 30) for n in range(count)]


def test_each_frame_leaves_at_once_as_packets_of_payload_type_96_and_one_stamp():
    frames = flown(40)
    for n, packets in enumerate(frames):
        assert packets, "no frame waits in the encoder"
        assert {packet[0] >> 6 for packet in packets} == {2}
        assert {packet[1] & 127 for packet in packets} == {96}
        assert max(map(len, packets)) <= 1300
        stamps = {int.from_bytes(packet[4:8], "big") for packet in packets}
        assert len(stamps) == 1
        first = int.from_bytes(frames[0][0][4:8], "big")
        assert (stamps.pop() - first) % 2**32 == pytest.approx(n * 3000, abs=1), "90 kHz"
        markers = [packet[1] >> 7 for packet in packets]
        assert markers == [0] * (len(packets) - 1) + [1], "the last packet of a frame is marked"
    numbers = [int.from_bytes(packet[2:4], "big") for packets in frames for packet in packets]
    assert all((b - a) % 65536 == 1 for a, b in itertools.pairwise(numbers))


@pytest.mark.parametrize(("key_s", "frames"), [(KEY_S, 3), (0.25, 8), (0.01, 1)])
def test_parameters_and_a_key_frame_come_as_often_as_they_should(key_s, frames):
    coding = Coding("libx264", 30.0, 2_000_000, key_s)
    keys = [n for n, packets in enumerate(flown(61, coding)) if {7, 8, 5} <= nal_types(packets)]
    assert keys == list(range(0, 61, frames))


def test_the_parameters_of_a_board_encoder_that_does_not_repeat_them_are_repeated(monkeypatch):
    plain = video_stream.add_h264

    def with_header(container, coding, size):
        stream = plain(container, coding, size)
        stream.codec_context.flags |= 1 << 22  # global header: the parameters are in the extradata only
        stream.codec_context.options = {"preset": "ultrafast", "tune": "zerolatency", "forced-idr": "1"}
        return stream

    monkeypatch.setattr(video_stream, "add_h264", with_header)
    keys = [n for n, packets in enumerate(flown(20)) if {7, 8} <= nal_types(packets)]
    assert keys == list(range(0, 20, 3))


def test_what_is_received_is_what_was_shown_in_order():
    receiver = Receiver(SIZE)
    seen = [image for packets in flown(30) for image in receiver.take(packets)] + receiver.end()
    assert [number_in(image) for image in seen] == list(range(30))


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_ten_percent_of_lost_packets_are_forgotten_within_a_second_of_the_loss(seed):
    """After the loss ends each image equals the one that a receiver without loss shows."""
    dice, frames = random.Random(seed), flown(120)
    lossy, whole = Receiver(SIZE), Receiver(SIZE)
    spoilt = [[packet for packet in packets if n >= 60 or dice.random() > 0.1] for n, packets in enumerate(frames)]
    got, want = {}, {}
    for packets, kept in zip(frames, spoilt, strict=True):
        got.update(lossy.stamped(kept))
        want.update(whole.stamped(packets))
    stamps = sorted(want)
    wrong = [s for s in stamps[:60] if s not in got or not np.array_equal(got[s], want[s])]
    assert len(wrong) > 10, "the loss was seen"
    for stamp in stamps[60 + 30 :]:
        assert np.array_equal(got[stamp], want[stamp])


def test_no_packet_goes_out_twice():
    with (
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as ear,
        contextlib.closing(VideoStream(CODING, "", print)) as stream,
    ):
        ear.bind(("127.0.0.1", 0))
        ear.settimeout(5.0)
        stream.send_to((ear.getsockname(),))
        assert stream.show(numbered(0, SIZE), 1e5)
        heard = [ear.recv(2048)]
        while heard[-1][1] >> 7 == 0:  # the last packet of a frame is marked
            heard.append(ear.recv(2048))
        assert len(set(heard)) == len(heard)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_while_ten_percent_are_lost_no_second_passes_without_a_whole_image(seed):
    dice, frames = random.Random(seed), flown(300)
    lossy, whole = Receiver(SIZE), Receiver(SIZE)
    got, want = {}, {}
    for packets in frames:
        got.update(lossy.stamped([packet for packet in packets if dice.random() > 0.1]))
        want.update(whole.stamped(packets))
    good = [n for n, stamp in enumerate(sorted(want)) if stamp in got and np.array_equal(got[stamp], want[stamp])]
    assert len(good) < 270, "the loss was seen"
    assert np.diff([-1, *good, len(want)]).max() <= 30


def test_a_lost_packet_costs_a_strip_and_not_the_image():
    frames = flown(7)
    lossy, whole = Receiver(SIZE), Receiver(SIZE)
    key = frames[6]
    lost = [*frames[:6], key[: len(key) // 2] + key[len(key) // 2 + 1 :]]
    got = [image for packets in lost for image in lossy.take(packets)] + lossy.end()
    want = [image for packets in frames for image in whole.take(packets)] + whole.end()
    spoilt_rows = np.abs(got[6].astype(int) - want[6]).max(axis=(1, 2)) > 0
    assert 0 < spoilt_rows.sum() < 0.35 * SIZE[1]


def test_the_bit_rate_is_kept():
    sent = sum(len(packet) for packets in flown(90, Coding("libx264", 30.0, 1_000_000)) for packet in packets)
    assert 8 * sent / 3.0 < 1.15e6


def test_a_stalled_encoder_or_network_never_blocks_the_loop(monkeypatch):
    stands, shown = threading.Event(), []

    def show(self, image, t_s):
        shown.append(number_in(image))
        stands.wait(10.0)
        return True

    monkeypatch.setattr(VideoStream, "show", show)
    video = VideoOut(VideoAddress("127.0.0.1", 5600), VideoConfig(encoder=Encoder.LIBX264), print)
    video.see(numbered_tick(0))
    while not shown:
        time.sleep(0.001)
    for n in range(1, 50):
        video.see(numbered_tick(n))
    assert video.dropped == 48
    stands.set()
    video.close()
    assert shown == [0, 49], "the newest frame only"


def numbered_tick(n):
    return replace(tick(0), frame=Frame(numbered(n, SIZE), n / 30, n))


@contextlib.contextmanager
def listening():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as ear:
        ear.bind(("127.0.0.1", 0))
        ear.settimeout(5.0)
        yield ear, ear.getsockname()[1]


def test_nothing_is_encoded_before_a_ground_station_is_received():
    with listening() as (ear, port):
        video = VideoOut(VideoAddress(port=port), VideoConfig(encoder=Encoder.LIBX264), print)
        video.see(numbered_tick(0))
        video.hear_stations(("127.0.0.1",))
        video.see(numbered_tick(3))
        first = ear.recv(2048)
        video.close()
    receiver = Receiver(SIZE)
    assert {7, 8} <= nal_types([first]), "it begins with the parameters"
    assert receiver.take([first]) == []


def test_the_delay_is_from_the_taking_of_a_frame_to_its_sending():
    video = VideoOut(VideoAddress("127.0.0.1", 9), VideoConfig(encoder=Encoder.LIBX264), print)
    stream = type("Stream", (), {"show": lambda *_: True})()
    for n in range(DELAYS):
        assert math.isnan(video.delay_s), "the first frames wait for the encoder to start"
        video._send(stream, numbered(n, SIZE), time.monotonic() - (9.0 if n == 0 else 0.25), None)
    assert 0.25 <= video.delay_s < 0.5
    video.close()


def test_the_rate_is_at_most_the_requested_one():
    video = VideoOut(VideoAddress("127.0.0.1", 9), VideoConfig(rate_hz=10.0), print)
    taken = []
    video._worker.put = lambda act, heavy=None: taken.append(heavy.keywords["t_s"]) if heavy is not None else None
    for n in range(90):
        video.see(numbered_tick(n))
    video._worker.put = lambda *_: None
    video.close()
    assert len(taken) == pytest.approx(30, abs=1)


def test_a_station_that_is_heard_gets_nothing_if_the_address_names_another():
    with listening() as (stranger, _), listening() as (ear, port):
        video = VideoOut(VideoAddress("127.0.0.1", port), VideoConfig(encoder=Encoder.LIBX264), print)
        video.hear_stations(("127.0.0.2",))
        video.see(numbered_tick(0))
        assert ear.recv(2048)
        video.close()
        assert video._hosts == ("127.0.0.1",)
        stranger.setblocking(False)
        with pytest.raises(BlockingIOError):
            stranger.recv(2048)


def test_a_server_gets_the_stream_by_rtsp_and_again_after_it_broke(monkeypatch):
    monkeypatch.setattr(video_stream, "RETRY_S", 0.0)
    said = []
    with RtspSink() as server:
        stream = VideoStream(CODING, server.url, said.append)
        for n in range(20):
            stream.show(numbered(n, SIZE), n / 30)
        server.drop()
        sent = [stream.show(numbered(n, SIZE), n / 30) for n in range(20, 200)]
        stream.close()
    assert [announced.count("H264/90000") for announced in server.announced] == [1] * len(server.announced)
    assert len(server.announced) >= 2
    assert not all(sent)
    assert sent[-1]
    assert len(said) == 1, said
    receiver = Receiver(SIZE)
    seen = [image for packets in by_frame(server.sessions[0]) for image in receiver.take(packets)] + receiver.end()
    assert [number_in(image) for image in seen][:10] == list(range(10))


def test_a_missing_server_is_reported_once(monkeypatch):
    monkeypatch.setattr(video_stream, "RETRY_S", 0.0)
    said = []
    with contextlib.closing(VideoStream(CODING, "rtsp://127.0.0.1:9/follow", said.append)) as stream:
        assert not any(stream.show(numbered(n, SIZE), n / 30) for n in range(5))
    assert len(said) == 1
    assert "rtsp://127.0.0.1:9/follow" in said[0]


@pytest.mark.parametrize(
    ("camera", "width", "size"),
    [((640, 360), 640, (640, 360)), ((1280, 720), 640, (640, 360)), ((640, 480), 1280, (640, 480)),
     ((1920, 1080), 1280, (1280, 720)), ((501, 333), 640, (500, 332)), ((1000, 562), 333, (332, 186))],
)  # fmt: skip
def test_the_size_keeps_the_aspect_and_is_even(camera, width, size):
    assert stream_size(camera, width) == size
    image = np.zeros((camera[1], camera[0], 3), np.uint8)
    video = VideoOut(VideoAddress(url="rtsp://127.0.0.1:9/x"), VideoConfig(width=width), print)
    shown = []
    fake = type("Fake", (), {"show": lambda _self, image, _t_s: shown.append(image.shape) or False})()
    video._send(fake, image, 0.0, None)
    video.close()
    assert shown == [(size[1], size[0], 3)]


def test_the_ground_station_is_told_what_is_sent():
    told = description_of(VideoAddress(port=5601), VideoConfig(rate_hz=15, rate_bit_s=800_000), (1280, 720), 70.2)
    assert (told.uri, told.is_rtp, told.size, told.rate_hz, told.bit_s) == ("5601", True, (640, 360), 15, 800_000)
    pushed = description_of(VideoAddress(url="rtsp://base:8554/drone"), VideoConfig(), (640, 360), 70.2)
    assert (pushed.uri, pushed.is_rtp) == ("rtsp://base:8554/drone", False)


NO_ADDRESSES = ("", "rtp", "rtp://", "rtp://host:0", "rtp://host:70000", "rtp://host/path", "rtp://[::1",
                "udp://host:5600", "rtsp://host", "rtsp:///path", "host:5600")  # fmt: skip


@pytest.mark.parametrize("text", NO_ADDRESSES)
def test_an_address_that_is_none_is_refused_with_the_form(text):
    with pytest.raises(ValueError, match="rtp://HOST:5600 or rtsp://"):
        parse_video(text)


def test_addresses():
    assert parse_video("rtp://192.168.1.20") == VideoAddress("192.168.1.20", 5600)
    assert parse_video("rtp://base:5604") == VideoAddress("base", 5604)
    assert parse_video("rtsp://base:8554/drone") == VideoAddress(url="rtsp://base:8554/drone")


@pytest.mark.parametrize("bad", [{"width": 100}, {"rate_hz": 0.0}, {"rate_hz": math.nan}, {"rate_bit_s": 5},
                                 {"encoder": Encoder.JPEG}])  # fmt: skip
def test_settings_that_no_stream_has_are_refused(bad):
    with pytest.raises(ValueError, match=r"video"):
        VideoConfig(**bad)


def test_a_machine_without_a_board_encoder_takes_libx264(monkeypatch):
    monkeypatch.setattr(video_stream, "BOARDS", (Encoder.V4L2,))
    monkeypatch.setattr(video_stream, "works", lambda _name: False)
    assert encoder_for(Encoder.AUTO) == "libx264"
    monkeypatch.undo()
    assert video_stream.works("libx264")
    assert not video_stream.works("no_such_encoder")


def test_the_overlay_is_a_box_in_its_place_and_the_frame_stays_as_it_was():
    image = np.full((360, 640, 3), 90, np.uint8)
    about = Overlay(TrackingStatus(TrackingState.ACTIVE, (0.25, 0.5, 0.25, 0.25), 0.0), "follow  12 m")
    out = drawn(image, about)
    assert (image == 90).all()
    green = (out == (80, 220, 60)).all(axis=2)
    rows, columns = np.nonzero(green)
    assert abs(columns.min() - 160) <= 1
    assert abs(columns.max() - 320) <= 1
    assert abs(rows.min() - 180) <= 1
    assert abs(rows.max() - 270) <= 1
    assert (out[330:, :200] != 90).any(), "words"
    assert drawn(np.full((360, 640), 90, np.uint8), about).shape == (360, 640)


def command(**options):
    return RunCommand("udpin:127.0.0.1:14540", **options)


@pytest.mark.parametrize(
    ("options", "address"),
    [({}, None), ({"ground": "link"}, None), ({"ground": "udpin:0.0.0.0:14560"}, VideoAddress()),
     ({"ground": "udpin:0.0.0.0:14560", "video_out": "none"}, None),
     ({"ground": "link", "video_out": "rtp://10.0.0.2"}, VideoAddress("10.0.0.2")),
     ({"video_out": "rtsp://10.0.0.2:8554/a"}, VideoAddress(url="rtsp://10.0.0.2:8554/a"))],
)  # fmt: skip
def test_by_default_the_video_goes_to_the_directly_connected_ground_station(options, address):
    assert video_address(command(**options)) == address


def test_an_address_that_is_none_ends_the_command_in_one_sentence():
    with pytest.raises(UsageError, match=r"^--video-out: a video address is rtp://"):
        check_ground(command(video_out="udp://10.0.0.2:5600"))


def test_a_stream_later_than_selections_are_dated_is_reported_once():
    said = []
    video = type("Video", (), {"delay_s": math.nan})()
    watch = DelayWatch(video, 0.3, said.append)
    for delay_s in (math.nan, 0.1, 0.31, 0.5):
        video.delay_s = delay_s
        watch.see(tick(0))
    assert len(said) == 1
    assert said[0].startswith("video: frames leave 0.31 s after they were taken")


class Stations:
    """Two ground stations' datagrams, one after the other."""

    datagrams = True

    def __init__(self, *waiting):
        self.waiting = list(waiting)

    def read(self, _timeout_s):
        return self.waiting.pop(0) if self.waiting else (b"", None)


def test_a_direct_ground_station_gets_the_video_until_silent_for_ten_seconds():
    beat = GroundStation().heartbeat()
    side = DirectSide(Stations((beat, ("10.0.0.2", 14550)), (b"noise", ("10.0.0.9", 14550))))
    side.receive(100.0)
    assert side.hosts == ("10.0.0.2",)
    side.receive(110.5)
    assert side.hosts == ()
