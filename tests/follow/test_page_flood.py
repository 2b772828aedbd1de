"""A window that sends far more than the page does is disconnected with a reason, without effect on others."""

import json

import pytest
from websockets.exceptions import ConnectionClosed
from websockets.frames import Frame, Opcode

from follow.messages import Order
from follow.operator.page.server import BYTES_AT_ONCE, FLOOD, FRAGMENTS
from follow.operator.page.windows import IMAGES_PER_S
from tests.support.page_rig import PageRig

HONEST_S = 10.0
TAPS_PER_S = 5


@pytest.fixture
def rig(tmp_path):
    with PageRig(tmp_path / "now") as page:
        yield page


def sent(opcode: Opcode, data: bytes = b"", fin: bool = True) -> bytes:
    """A frame as a browser sends it."""
    return Frame(opcode, data, fin).serialize(mask=True)


def filled(frame: bytes) -> bytes:
    """More frames than a window may send at once."""
    return frame * (2 * BYTES_AT_ONCE // len(frame))


FLOODS = {
    "pings": filled(sent(Opcode.PING)),
    "large pings": filled(sent(Opcode.PING, bytes(125))),
    "pongs": filled(sent(Opcode.PONG)),
    "fragments": filled(sent(Opcode.TEXT, b"x", fin=False) + sent(Opcode.CONT)),
    "a message without an end": sent(Opcode.TEXT, b"x", fin=False) + sent(Opcode.CONT, fin=False) * (FRAGMENTS + 1),
    "large messages": filled(sent(Opcode.TEXT, bytes(2000))),
    "signs of life": filled(sent(Opcode.TEXT, b'{"do": "here"}')),
}


def closed(window) -> tuple[int, str]:
    """With what code and reason a window is closed."""
    for _ in range(400):
        try:
            window.rig.round()
            window.take(0.02)
        except ConnectionClosed as end:
            return (end.rcvd.code, end.rcvd.reason) if end.rcvd else (0, "without a reason")
    return 0, "not closed"


@pytest.mark.parametrize("kind", FLOODS)
def test_a_flooding_window_is_disconnected_with_a_reason_and_a_line_and_other_windows_go_on(rig, kind):
    with rig.window() as honest, rig.window("fedcba9876543210") as flooder:
        flooder.until(lambda w: w.images)
        flooder.socket.socket.sendall(FLOODS[kind])
        assert closed(flooder) == (1008, FLOOD)
        honest.until(lambda w: len(w.images) >= 5)
        honest.order("stop")
        assert honest.replied()[0]
        assert rig.ordered() == [Order.OBSERVE]
    (line,) = (line for line in rig.lines if FLOOD in line)
    assert "127.0.0.1" in line


def test_what_a_busy_page_sends_in_ten_seconds_may_arrive_at_once(rig):
    with rig.window() as window:
        window.until(lambda w: w.images)
        frame = window.images[-1][0]["frame"]
        shown, here = {"do": "shown", "frame": 10**6}, {"do": "here"}
        tap = {"do": "select", "frame": frame, "box": [1 / 3, 2 / 3, 1 / 7, 1 / 9]}
        second = [shown] * int(IMAGES_PER_S) + [tap] * TAPS_PER_S + [here]
        waited = [sent(Opcode.TEXT, json.dumps(message).encode()) for message in second * int(HONEST_S)]
        window.socket.socket.sendall(b"".join([*waited, sent(Opcode.PING), sent(Opcode.PONG)]))
        window.socket.send(iter(['{"do": "order", ', '"order": ', '"stop"}']))  # in fragments
        window.until(lambda w: any(words.startswith("stop") for _done, words in w.replies))
    assert rig.ordered() == [Order.OBSERVE]
    assert not any(FLOOD in line for line in rig.lines)
