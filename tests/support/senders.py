"""Cameras to test with, over loopback: real encoders (PyAV) sending numbered frames by UDP, RTP, RTSP and HTTP.

Each sends 30 frames a second while it is `open()`; `close()` breaks the stream as a cable does, and it may be opened
again.  `sent_t_s[n]` is when frame n was due: its exposure.
"""

import contextlib
import itertools
import socket
import threading
import time
from collections.abc import Callable
from fractions import Fraction
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import av

from tests.support.clips import numbered

FPS = 30
SIZE = (384, 240)
X264 = {"preset": "ultrafast", "tune": "zerolatency", "x264-params": "repeat-headers=1:keyint=15:scenecut=0:crf=32"}
SDP = "v=0\r\no=- 0 0 IN IP4 127.0.0.1\r\ns=test\r\nc=IN IP4 127.0.0.1\r\nt=0 0\r\n"
MEDIA = "m=video {port} RTP/AVP 96\r\na=rtpmap:96 H264/90000\r\na=fmtp:96 packetization-mode=1\r\n"


def free_port(kind: int = socket.SOCK_DGRAM) -> int:
    """A free port, for UDP an even one: RTP takes it, RTCP the next."""
    while True:
        with socket.socket(socket.AF_INET, kind) as one:
            one.bind(("127.0.0.1", 0))
            port = one.getsockname()[1]
        if port % 2 == 0 or kind == socket.SOCK_STREAM:
            return port


class Frames:
    """The numbered frames of one camera, at its pace, to whatever takes them."""

    def __init__(self) -> None:
        self.sent_t_s: dict[int, float] = {}
        self.stall: tuple[int, float] | None = None
        self._next = 0

    def run(self, take: Callable[[av.VideoFrame, int], None], ending: threading.Event) -> None:
        """Give frame after frame until the event; `stall` (frame, seconds) holds up one and those behind it."""
        began_s, first = time.monotonic(), self._next
        for n in itertools.count(first):
            due_s = began_s + (n - first) / FPS
            if ending.wait(max(due_s - time.monotonic(), 0.0)):
                return
            self._next = n + 1
            self.sent_t_s[n] = due_s
            if self.stall is not None and n == self.stall[0] and ending.wait(self.stall[1]):
                return
            frame = av.VideoFrame.from_ndarray(numbered(n, SIZE), format="bgr24")
            frame.pts, frame.time_base = n - first, Fraction(1, FPS)
            take(frame, n)


class Sender:
    """Sends to an FFmpeg URL in a thread: MPEG-TS over UDP, or RTP."""

    def __init__(self, url: str, format_: str, codec: str = "libx264") -> None:
        self.url, self.format, self.codec = url, format_, codec
        self.frames = Frames()
        self._thread: threading.Thread | None = None

    def open(self) -> None:
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._send, args=(self._ending,), daemon=True)
        self._thread.start()

    def _send(self, ending: threading.Event) -> None:
        with contextlib.suppress(av.error.FFmpegError, OSError):
            container: Any = av.open(self.url, "w", format=self.format, options={"flush_packets": "1"})
            stream = container.add_stream(self.codec, rate=FPS, options=X264 if self.codec == "libx264" else {})
            stream.width, stream.height = SIZE
            stream.pix_fmt = "yuvj420p" if self.codec == "mjpeg" else "yuv420p"
            self.frames.run(lambda frame, _n: container.mux(stream.encode(frame)), ending)
            container.close()

    def close(self) -> None:
        self._ending.set()
        if self._thread is not None:
            self._thread.join()


class MjpegServer:
    """MJPEG over HTTP as IP cameras and mjpg-streamer send it: multipart/x-mixed-replace."""

    def __init__(self) -> None:
        self.frames = Frames()
        self.port = free_port(socket.SOCK_STREAM)
        self.url = f"http://127.0.0.1:{self.port}/stream"

    def open(self) -> None:
        owner, ending = self, threading.Event()

        class Stream(BaseHTTPRequestHandler):
            def do_GET(self) -> None:
                self.send_response(200)
                self.send_header("Content-Type", "multipart/x-mixed-replace; boundary=frame")
                self.end_headers()
                encoder: Any = av.CodecContext.create("mjpeg", "w")
                encoder.width, encoder.height = SIZE
                encoder.pix_fmt, encoder.time_base = "yuvj420p", Fraction(1, FPS)

                def take(frame: av.VideoFrame, _n: int) -> None:
                    (packet,) = encoder.encode(frame.reformat(format="yuvj420p"))
                    head = f"--frame\r\nContent-Type: image/jpeg\r\nContent-Length: {packet.size}\r\n\r\n"
                    self.wfile.write(head.encode() + bytes(packet) + b"\r\n")

                with contextlib.suppress(OSError):
                    owner.frames.run(take, ending)

            def log_message(self, *_args: object) -> None: ...

        class Server(ThreadingHTTPServer):
            daemon_threads = True
            allow_reuse_address = True

        self._ending, self._server = ending, Server(("127.0.0.1", self.port), Stream)
        threading.Thread(target=self._server.serve_forever, kwargs={"poll_interval": 0.05}, daemon=True).start()

    def close(self) -> None:
        self._ending.set()
        self._server.shutdown()
        self._server.server_close()


class RtspServer:
    """One H.264 stream by RTSP [RFC 2326]: DESCRIBE, SETUP over UDP or interleaved in TCP, PLAY, TEARDOWN."""

    def __init__(self) -> None:
        self.port = free_port(socket.SOCK_STREAM)
        self.url = f"rtsp://127.0.0.1:{self.port}/live"
        self.frames = Frames()
        self.transports: list[str] = []

    def open(self) -> None:
        self._closing = threading.Event()
        self._clients: list[socket.socket] = []
        self._listener = socket.create_server(("127.0.0.1", self.port))
        threading.Thread(target=self._accept, args=(self._listener, self._closing), daemon=True).start()

    def _accept(self, listener: socket.socket, closing: threading.Event) -> None:
        with contextlib.suppress(OSError):
            while not closing.is_set():
                client, _ = listener.accept()
                self._clients.append(client)
                threading.Thread(target=self._serve, args=(client, closing), daemon=True).start()

    def _serve(self, client: socket.socket, closing: threading.Event) -> None:
        """Answer one client's requests; what is sent in PLAY ends with the connection."""
        sender: Sender | None = None
        relay: threading.Thread | None = None
        ending = threading.Event()
        lines = client.makefile("rb")
        with contextlib.suppress(OSError):
            while not closing.is_set() and (first := lines.readline()):
                if first[:1] == b"$":  # the client's RTCP, interleaved; its length may hold a line's end
                    break
                head: dict[str, str] = {}
                while (line := lines.readline().decode().strip()) != "":
                    name, _, value = line.partition(":")
                    head[name.lower()] = value.strip()
                method = first.decode().split()[0]
                extra, body = "", ""
                if method == "DESCRIBE":
                    body = SDP + MEDIA.format(port=0) + "a=control:track0\r\n"
                    extra = (
                        f"Content-Type: application/sdp\r\nContent-Base: {self.url}/\r\nContent-Length: {len(body)}\r\n"
                    )
                elif method == "SETUP":
                    sender, relay, extra = self._set_up(head["transport"], client, ending)
                elif method == "OPTIONS":
                    extra = "Public: DESCRIBE, SETUP, PLAY, TEARDOWN, GET_PARAMETER\r\n"
                answer = f"RTSP/1.0 200 OK\r\nCSeq: {head['cseq']}\r\nSession: 1\r\n{extra}\r\n{body}"
                client.sendall(answer.encode())
                if method == "PLAY" and sender is not None:
                    if relay is not None:
                        relay.start()
                    sender.open()
                if method == "TEARDOWN":
                    break
            closing.wait() if first[:1] == b"$" else None
        ending.set()
        if sender is not None and sender._thread is not None:
            sender.close()

    def _set_up(
        self, transport: str, client: socket.socket, ending: threading.Event
    ) -> tuple[Sender, threading.Thread | None, str]:
        """The sender for a transport: to the client's port, or to ours, whose packets go into the connection."""
        relay = None
        if "TCP" in transport:
            self.transports.append("tcp")
            ours = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
            ours.bind(("127.0.0.1", 0))
            ours.settimeout(0.2)
            port = ours.getsockname()[1]
            relay = threading.Thread(target=self._relay, args=(ours, client, ending), daemon=True)
            answer = "RTP/AVP/TCP;unicast;interleaved=0-1"
        else:
            self.transports.append("udp")
            port = int(transport.split("client_port=")[1].split("-", maxsplit=1)[0])
            answer = f"RTP/AVP;unicast;client_port={port}-{port + 1};server_port={free_port()}-{free_port()}"
        sender = Sender(f"rtp://127.0.0.1:{port}?pkt_size=1300&rtcpport={free_port()}", "rtp")
        sender.frames = self.frames
        return sender, relay, f"Transport: {answer}\r\n"

    @staticmethod
    def _relay(ours: socket.socket, client: socket.socket, ending: threading.Event) -> None:
        with contextlib.suppress(OSError):
            while not ending.is_set():
                with contextlib.suppress(TimeoutError):
                    packet = ours.recv(2048)
                    client.sendall(b"$\0" + len(packet).to_bytes(2, "big") + packet)
        ours.close()

    def close(self) -> None:
        self._closing.set()
        for closed in (self._listener, *self._clients):
            with contextlib.suppress(OSError):
                closed.shutdown(socket.SHUT_RDWR)
            closed.close()


def rtp_with_sdp(folder: Path) -> tuple[str, Sender]:
    """An SDP file, and the sender of what it describes."""
    port = free_port()
    path = folder / "camera.sdp"
    path.write_text(SDP + MEDIA.format(port=port))
    return str(path), Sender(f"rtp://127.0.0.1:{port}?pkt_size=1300", "rtp")


def udp_ts() -> tuple[str, Sender]:
    """MPEG-TS over UDP."""
    url = f"udp://127.0.0.1:{free_port()}"
    return url, Sender(f"{url}?pkt_size=1316", "mpegts")
