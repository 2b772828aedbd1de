"""RTSP servers with invalid replies: an error in one line, within the time limit of a reply."""

import pytest

from follow.operator import rtsp
from follow.operator.rtsp import TIMEOUT_S, answer_of

HEAD = b"RTSP/1.0 200 OK\r\nSession: 7\r\n"


class Wire:
    """A connection on which `data` comes, `piece` bytes in each `pause_s`, and then nothing more."""

    def __init__(self, data, monkeypatch, piece=65536, pause_s=0.0):
        self.data, self.piece, self.pause_s, self.now_s, self.timeout_s = data, piece, pause_s, 0.0, TIMEOUT_S
        monkeypatch.setattr(rtsp.time, "monotonic", lambda: self.now_s)

    def settimeout(self, timeout_s):
        self.timeout_s = timeout_s

    def recv(self, most):
        self.now_s += min(self.pause_s, self.timeout_s)
        if self.pause_s > self.timeout_s:
            raise TimeoutError("timed out")
        count = min(most, self.piece)
        got, self.data = self.data[:count], self.data[count:]
        return got


def test_a_reply_with_a_body_is_read_to_its_end(monkeypatch):
    wire = Wire(HEAD + b"Content-Length: 5\r\n\r\nhello" + b"$", monkeypatch)
    assert answer_of(wire) == (200, {"session": "7", "content-length": "5"})
    assert wire.data == b"$"
    assert wire.timeout_s == TIMEOUT_S


@pytest.mark.parametrize("data", [HEAD * 200, HEAD + b"Content-Length: 99999999\r\n\r\n" + b"x" * 5000])
@pytest.mark.parametrize(("piece", "pause_s"), [(1, 0.1), (10, 0.5), (1, 1.9), (1, 5.0)])
def test_a_reply_that_arrives_slowly_ends_in_time(data, piece, pause_s, monkeypatch):
    wire = Wire(data, monkeypatch, piece, pause_s)
    with pytest.raises(OSError, match=r"timed out|has no end"):
        answer_of(wire)
    assert wire.now_s <= TIMEOUT_S + 1e-6


@pytest.mark.parametrize(
    "first",
    ["RTSP/1.0 " + "9" * 5000 + " OK", "RTSP/1.0 20 OK", "RTSP/1.0 \u0664\u0660\u0664 OK", "HTTP/1.1 200 OK", ""],
)
def test_an_invalid_reply_is_refused_in_one_line(first, monkeypatch):
    with pytest.raises(OSError, match="does not speak RTSP") as refused:
        answer_of(Wire(f"{first}\r\n\r\n".encode(), monkeypatch))
    assert "\n" not in str(refused.value)
    assert len(str(refused.value)) < 120
