"""The ways bytes go: UDP, TCP, a serial line.  Reading waits a little; writing never does.

udpin:HOST:PORT     wait there; answer where the vehicle was heard
udpout:HOST:PORT    speak first
tcp:HOST:PORT       connect, and again after a drop
serial:DEVICE:BAUD  open, and again after a drop
"""

import contextlib
import os
import select
import socket
import termios
import time
import tty
from abc import ABC, abstractmethod
from typing import Protocol

from follow.link import LinkError

REOPEN_S = 1.0  # a serial converter that was pulled out is back after about this
CONNECT_TIMEOUT_S = 2.0
READ_BYTES = 65536

Source = tuple[str, int] | None


class Transport(Protocol):
    """One way in and out.  `datagrams` says that what is read at once is whole packets."""

    datagrams: bool

    def read(self, timeout_s: float) -> tuple[bytes, Source]:
        """What arrived, waiting up to `timeout_s`, and from where; empty when nothing did."""
        ...

    def write(self, packet: bytes) -> bool:
        """Send one packet at once; False when it could not leave."""
        ...

    def answer_to(self, source: Source) -> None:
        """From now on write to where this came from."""
        ...

    def close(self) -> None:
        """Give the way back."""
        ...


def open_transport(uri: str) -> Transport:
    """Open the way that `uri` names; raises LinkError when it is written wrongly or cannot be opened."""
    kind, _, rest = uri.partition(":")
    name, _, number = rest.rpartition(":")
    if kind not in ("udpin", "udpout", "tcp", "serial") or not name or not number.isdigit():
        raise LinkError(
            f"a link is udpin:HOST:PORT, udpout:HOST:PORT, tcp:HOST:PORT or serial:DEVICE:BAUD, not {uri!r}"
        )
    try:
        if kind in ("udpin", "udpout"):
            return UdpTransport(name, int(number), listens=kind == "udpin")
        return TcpTransport(name, int(number)) if kind == "tcp" else SerialTransport(name, int(number))
    except (OSError, OverflowError, termios.error) as error:
        raise LinkError(f"the link {uri} cannot be opened: {error}") from None


class UdpTransport:
    """A UDP socket."""

    datagrams = True

    def __init__(self, host: str, port: int, listens: bool):
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        self._peer: Source = None
        try:
            self._socket.bind((host, port) if listens else ("", 0))
            if not listens:
                self._peer = (socket.gethostbyname(host), port)
        except OSError:
            self._socket.close()
            raise
        self.port: int = self._socket.getsockname()[1]

    def read(self, timeout_s: float) -> tuple[bytes, Source]:
        """One datagram."""
        if select.select([self._socket], [], [], timeout_s)[0]:
            with contextlib.suppress(BlockingIOError, ConnectionError):
                return self._socket.recvfrom(READ_BYTES)
        return b"", None

    def write(self, packet: bytes) -> bool:
        """One packet a datagram."""
        if self._peer is None:
            return False
        try:
            self._socket.sendto(packet, self._peer)
        except OSError:  # the buffer is full, the cable is out: a setpoint is not worth waiting for
            return False
        return True

    def answer_to(self, source: Source) -> None:
        """The caller names the addressee, so that a stray sender does not become it."""
        self._peer = source

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()


class _StreamTransport(ABC):
    """What a TCP connection and a serial line share: a file descriptor that may be lost and opened again."""

    datagrams = False

    def __init__(self) -> None:
        self._file: int | None = None
        self._lost_at_s = 0.0
        self._file = self._open()

    @abstractmethod
    def _open(self) -> int: ...

    def read(self, timeout_s: float) -> tuple[bytes, Source]:
        """Whatever came; after a drop, tries now and then to open again."""
        if self._file is None:
            self._reopen(timeout_s)
            return b"", None
        if not select.select([self._file], [], [], timeout_s)[0]:
            return b"", None
        try:
            data = os.read(self._file, READ_BYTES)
        except BlockingIOError:
            return b"", None
        except OSError:
            data = b""
        if not data:
            self._drop()
        return data, None

    def write(self, packet: bytes) -> bool:
        """A packet that does not fit into the buffer whole is cut off; the receiver's checksum sorts that out."""
        if self._file is None:
            return False
        try:
            return os.write(self._file, packet) == len(packet)
        except OSError:
            return False

    def answer_to(self, source: Source) -> None:  # noqa: B027 - nothing to do is the answer, not a gap
        """There is only one other end."""

    def close(self) -> None:
        """Close the file."""
        if self._file is not None:
            os.close(self._file)
            self._file = None

    def _drop(self) -> None:
        self.close()
        self._lost_at_s = time.monotonic()

    def _reopen(self, timeout_s: float) -> None:
        time.sleep(timeout_s)
        if time.monotonic() - self._lost_at_s >= REOPEN_S:
            self._lost_at_s = time.monotonic()
            with contextlib.suppress(OSError, termios.error):
                self._file = self._open()


class TcpTransport(_StreamTransport):
    """A TCP connection that we make."""

    def __init__(self, host: str, port: int):
        self._address = (host, port)
        super().__init__()

    def _open(self) -> int:
        connection = socket.create_connection(self._address, timeout=CONNECT_TIMEOUT_S)
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)  # a setpoint waits for no other
        connection.setblocking(False)
        return connection.detach()


class SerialTransport(_StreamTransport):
    """A serial line, 8N1 without flow control."""

    def __init__(self, device: str, baud: int):
        self._device = device
        self._baud = getattr(termios, f"B{baud}", None)
        if self._baud is None:
            raise OSError(f"{baud} is not a speed that this system knows")
        super().__init__()

    def _open(self) -> int:
        line = os.open(self._device, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        try:
            tty.setraw(line)
            settings = termios.tcgetattr(line)
            settings[4] = settings[5] = self._baud
            settings[2] |= termios.CLOCAL | termios.CREAD
            settings[2] &= ~termios.CRTSCTS
            termios.tcsetattr(line, termios.TCSANOW, settings)
        except termios.error:
            os.close(line)
            raise
        return line
