"""Who receives the video: FFmpeg's depacketizer and decoder, fed with packets; and a server that takes RTSP pushes."""

import contextlib
import itertools
import socket
import threading

import av
import numpy as np

SDP = "v=0\r\no=- 0 0 IN IP4 127.0.0.1\r\ns=follow\r\nc=IN IP4 127.0.0.1\r\nt=0 0\r\nm=video {port} RTP/AVP 96\r\n"
SDP += "a=rtpmap:96 H264/90000\r\na=fmtp:96 packetization-mode=1\r\n"


def units(packets):
    """The NAL units of RTP packets [RFC 6184]: single, aggregated (24) and fragmented (28); a gap ends a fragment."""
    found, open_unit = [], b""
    for packet in packets:
        body = packet[12:]
        kind = body[0] & 31
        if kind == 24:
            at = 1
            while at < len(body):
                size = int.from_bytes(body[at : at + 2], "big")
                found.append(body[at + 2 : at + 2 + size])
                at += 2 + size
        elif kind == 28:
            if body[1] & 128:
                open_unit = bytes([(body[0] & 0xE0) | (body[1] & 31)])
            open_unit += body[2:]
            if body[1] & 64:
                found.append(open_unit)
        else:
            found.append(body)
    return found


def by_frame(packets):
    """The packets of each frame: those with one stamp."""
    return [list(group) for _, group in itertools.groupby(packets, key=lambda packet: packet[4:8])]


def nal_types(packets):
    return {unit[0] & 31 for unit in units(packets)}


class Receiver:
    """Decodes packets frame by frame; what a lost slice would have shown is concealed by FFmpeg."""

    def __init__(self, size):
        self.size = size
        self.codec = av.CodecContext.create("h264", "r")
        self.codec.thread_count = 1

    def take(self, packets):
        """The images that are complete after one frame's packets."""
        return list(self.stamped(packets).values())

    def stamped(self, packets):
        if not packets:
            return {}
        data = b"".join(b"\0\0\0\1" + unit for unit in units(packets))
        packet = av.Packet(data)
        packet.pts = int.from_bytes(packets[0][4:8], "big")
        return self._images(packet)

    def end(self):
        return list(self._images(None).values())

    def _images(self, packet):
        with contextlib.suppress(av.error.InvalidDataError):
            return {frame.pts: frame.to_ndarray(format="bgr24") for frame in self.codec.decode(packet)}
        return {}


class RtspSink:
    """Takes one pushed stream at a time by RTSP [RFC 2326]: OPTIONS, ANNOUNCE, SETUP interleaved, RECORD."""

    def __init__(self):
        self.listener = socket.create_server(("127.0.0.1", 0))
        self.url = f"rtsp://127.0.0.1:{self.listener.getsockname()[1]}/follow"
        self.announced, self.sessions = [], []
        self.client = None

    def __enter__(self):
        threading.Thread(target=self._accept, daemon=True).start()
        return self

    def __exit__(self, *_error):
        self.drop()
        with contextlib.suppress(OSError):
            self.listener.shutdown(socket.SHUT_RDWR)
        self.listener.close()

    def drop(self):
        if self.client is not None:
            with contextlib.suppress(OSError):
                self.client.shutdown(socket.SHUT_RDWR)

    def _accept(self):
        with contextlib.suppress(OSError):
            while True:
                self.client, _ = self.listener.accept()
                with contextlib.suppress(OSError), self.client:
                    self._serve(self.client.makefile("rb"))

    def _serve(self, lines):
        while first := lines.read(1):
            if first == b"$":
                channel, size = lines.read(1)[0], int.from_bytes(lines.read(2), "big")
                packet = lines.read(size)
                if channel == 0:
                    self.sessions[-1].append(packet)
                continue
            head, text = {}, (first + lines.readline()).decode()
            while line := lines.readline().decode().strip():
                name, _, value = line.partition(":")
                head[name.lower()] = value.strip()
            body = lines.read(int(head.get("content-length", 0))).decode()
            method, extra = text.split()[0], ""
            if method == "ANNOUNCE":
                self.announced.append(body)
                self.sessions.append([])
            elif method == "SETUP":
                extra = f"Transport: {head['transport']}\r\n"
            self.client.sendall(f"RTSP/1.0 200 OK\r\nCSeq: {head['cseq']}\r\nSession: 1\r\n{extra}\r\n".encode())


def psnr(a, b):
    """Peak signal to noise ratio of two images, dB."""
    return 10 * np.log10(255**2 / max(float(np.mean((a.astype(float) - b) ** 2)), 1e-9))
