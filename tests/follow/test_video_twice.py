"""`video.twice`: each RTP packet of the video goes out twice."""

import itertools
import random
from collections import Counter

import pytest

from follow.operator.video_out import VideoAddress, VideoConfig, VideoOut
from follow.operator.video_stream import Fanout
from tests.follow.test_video_out import flown

FRAMES = flown(30)


def sent(frames, *, twice=True):
    """What goes out, in its order."""
    fanout, out = Fanout(twice), []
    fanout._send = out.append
    for packet in itertools.chain.from_iterable(frames):
        fanout.write(packet)
    fanout.close()
    return out


def test_without_it_each_packet_goes_once():
    assert sent(FRAMES, twice=False) == list(itertools.chain.from_iterable(FRAMES))


def test_each_packet_goes_twice_and_never_twice_in_a_row():
    out = sent(FRAMES)
    counts = Counter(out)
    assert counts.pop(FRAMES[-1][-1]) == 1, "the copy of the very last waits for a next frame"
    assert set(counts.values()) == {2}
    assert all(a != b for a, b in itertools.pairwise(out))
    assert list(dict.fromkeys(out)) == list(itertools.chain.from_iterable(FRAMES)), "originals keep their order"


def test_a_copy_comes_before_the_second_packet_of_the_next_frame():
    out = sent(FRAMES)
    last = {packet: k for k, packet in enumerate(out)}
    for frame, following in itertools.pairwise(FRAMES):
        assert max(last[packet] for packet in frame) == out.index(following[0]) + 1


@pytest.mark.parametrize("seed", range(5))
def test_with_each_packet_twice_ten_percent_loss_leaves_about_one_percent(seed):
    dice = random.Random(seed)
    arrived = {packet for packet in sent(FRAMES) if dice.random() >= 0.1}
    packets = list(itertools.chain.from_iterable(FRAMES))
    assert len(packets) > 200
    assert sum(packet not in arrived for packet in packets) < 0.03 * len(packets), "0.1 of 0.1, and chance"


@pytest.mark.parametrize(
    ("address", "bit_s"),
    [(VideoAddress("127.0.0.1", 9), 1_000_000), (VideoAddress(url="rtsp://127.0.0.1:9/a"), 2_000_000)],
)
def test_the_image_gets_half_of_the_rate_where_packets_go_twice(address, bit_s, monkeypatch):
    codings = []
    monkeypatch.setattr("follow.operator.video_out.Coding", lambda *values: codings.append(values))
    VideoOut(address, VideoConfig(twice=True), print).close()
    assert codings[0][2] == bit_s
