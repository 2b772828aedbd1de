"""Pushes RTP packets to a server by RTSP [RFC 2326]: ANNOUNCE, SETUP, RECORD, then packets in the same connection.

FFmpeg's own RTSP output is not used, because its Python binding holds the interpreter lock while it connects: the
control loop would wait for the server.
"""

import contextlib
import re
import select
import socket
import time
from urllib.parse import urlsplit

PORT = 554  # RTSP's own
TIMEOUT_S = 2.0  # for an answer, and for sending a packet
SDP = (
    "v=0\r\no=- 0 0 IN IP4 0.0.0.0\r\ns=follow\r\nc=IN IP4 0.0.0.0\r\nt=0 0\r\nm=video 0 RTP/AVP 96\r\n"
    "a=rtpmap:96 H264/90000\r\na=fmtp:96 packetization-mode=1\r\na=control:trackID=0\r\n"
)
OK = 200


class RtspPush:
    """One stream pushed to `url`.  Every method may raise OSError; `open` may be called again after that."""

    def __init__(self, url: str) -> None:
        self._url = url
        self._socket: socket.socket | None = None
        self._count = 0

    @property
    def is_open(self) -> bool:
        """Whether the server takes packets."""
        return self._socket is not None

    def open(self) -> None:
        """Connect, announce the stream and begin to record."""
        self.close()
        parts = urlsplit(self._url)
        connection = socket.create_connection((parts.hostname or "", parts.port or PORT), TIMEOUT_S)
        try:
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self._ask(connection, "ANNOUNCE", self._url, {"Content-Type": "application/sdp"}, SDP)
            interleaved = {"Transport": "RTP/AVP/TCP;unicast;interleaved=0-1;mode=record"}
            session = self._ask(connection, "SETUP", f"{self._url}/trackID=0", interleaved).get("session", "")
            self._ask(connection, "RECORD", self._url, {"Session": session.partition(";")[0], "Range": "npt=0.000-"})
        except OSError:
            connection.close()
            raise
        self._socket = connection

    def write(self, packet: bytes) -> int:
        """Send one RTP packet in the connection, and discard what the server sends (its RTCP)."""
        if self._socket is None:
            raise ConnectionError("not connected")
        while select.select([self._socket], [], [], 0.0)[0]:
            if not self._socket.recv(65536):
                raise ConnectionResetError("the server closed the connection")
        self._socket.sendall(b"$\0" + len(packet).to_bytes(2, "big") + packet)
        return len(packet)

    def close(self) -> None:
        """Close the connection; the server then ends the stream."""
        if self._socket is not None:
            with contextlib.suppress(OSError):
                self._socket.close()
            self._socket = None

    def _ask(
        self, connection: socket.socket, method: str, url: str, head: dict[str, str], body: str = ""
    ) -> dict[str, str]:
        """Send a request; returns the header of its answer, names in lower case."""
        self._count += 1
        head = {"CSeq": str(self._count), **head, **({"Content-Length": str(len(body))} if body else {})}
        lines = "".join(f"{name}: {value}\r\n" for name, value in head.items() if value)
        connection.sendall(f"{method} {url} RTSP/1.0\r\n{lines}\r\n{body}".encode())
        status, answer = answer_of(connection)
        if status != OK:
            raise ConnectionError(f"the server answers {method} with {status}")
        return answer


def answer_of(connection: socket.socket) -> tuple[int, dict[str, str]]:
    """Status and header of one answer, complete within TIMEOUT_S.  Raises OSError for an invalid answer."""
    text, end_s = b"", time.monotonic() + TIMEOUT_S
    while not text.endswith(b"\r\n\r\n"):
        byte = received(connection, 1, end_s)
        if not byte or len(text) > 8192:
            raise ConnectionResetError("the server gives no answer")
        text += byte
    first, *lines = text.decode(errors="replace").split("\r\n")
    words = first.split()
    if len(words) < 2 or not words[0].startswith("RTSP/") or not re.fullmatch("[0-9]{3}", words[1]):
        raise ConnectionError(f"the server does not speak RTSP: {first[:40]!r}")
    head = {name.lower(): value.strip() for name, _, value in (line.partition(":") for line in lines) if value}
    length = head.get("content-length", "0")
    left = int(length) if re.fullmatch("[0-9]{1,9}", length) else 0
    while left > 0 and (body := received(connection, min(left, 65536), end_s)):
        left -= len(body)
    return int(words[1]), head


def received(connection: socket.socket, most: int, end_s: float) -> bytes:
    """The next bytes, at most `most`.  Raises TimeoutError if none arrive before `end_s` (of the monotonic clock)."""
    left_s = end_s - time.monotonic()
    if left_s <= 0.0:
        raise TimeoutError("the server's answer has no end")
    connection.settimeout(left_s)
    data = connection.recv(most)
    connection.settimeout(TIMEOUT_S)
    return data
