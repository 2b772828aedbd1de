"""How bytes are carried: UDP, TCP, a serial line.  Reading has a timeout; writing never blocks.

udpin:HOST:PORT     listen; reply to the address of the vehicle
udpout:HOST:PORT    send first
tcp:HOST:PORT       connect; reconnect after a drop
serial:DEVICE:BAUD  open; reopen after a drop
"""

import contextlib
import fcntl
import ipaddress
import logging
import os
import select
import socket
import struct
import sys
import termios
import threading
import time
import tty
from abc import ABC, abstractmethod
from enum import Enum
from typing import Protocol

from follow.link import LinkError
from follow.link.addresses import parse_address, why_not
from follow.link.identity import Source
from follow.link.send_queue import UNSENT_S, SendQueue, unsent_bytes

log = logging.getLogger(__name__)

REOPEN_S = 1.0  # a USB serial adapter takes about this long to come back
CONNECT_TIMEOUT_S = 2.0
SILENT_S = 0.5  # a TCP peer that sent nothing for this long may not be reading either; telemetry comes every 20 ms
HEARTBEAT = bytes(3)  # the message number in a MAVLink 2 packet
ACKNOWLEDGED_S = 0.5  # TCP_USER_TIMEOUT
ACCEPTED_S = 3.0  # a vehicle that accepted a connection sends within this time: a heartbeat comes every second
READ_BYTES = 4096
DATAGRAM_BYTES = 2048  # a datagram with MAVLink fits into an Ethernet frame; the rest of a longer one is discarded


class Reach(str, Enum):
    """Who can send on a link."""

    LOOPBACK = "loopback"  # programs on this machine
    SERIAL = "serial"  # whatever is at the other end of a cable or radio
    NETWORK = "network"  # everybody on the network


def reach_of(host: str) -> Reach:
    """LOOPBACK for this machine's own addresses, else NETWORK."""
    if host == "localhost":
        return Reach.LOOPBACK
    with contextlib.suppress(ValueError):
        if ipaddress.ip_address(host).is_loopback:
            return Reach.LOOPBACK
    return Reach.NETWORK


class Transport(Protocol):
    """Carries bytes in both directions.  `datagrams`: each read returns whole packets."""

    datagrams: bool

    def read(self, timeout_s: float) -> tuple[bytes, Source]:
        """The bytes that arrived within `timeout_s` (empty: none) and their source address."""
        ...

    def write(self, packet: bytes) -> bool:
        """Send one packet without blocking; False if it was dropped."""
        ...

    def answer_to(self, source: Source) -> None:
        """Send to this address from now on."""
        ...

    def reach(self) -> Reach:
        """Who can send on this link."""
        ...

    def trouble(self) -> str:
        """Why nothing comes, as far as the transport itself knows; "" if it does not."""
        ...

    def close(self) -> None:
        """Close it."""
        ...


def open_transport(uri: str) -> Transport:
    """Open the transport that `uri` names.  Raises LinkError for a malformed `uri` or if it cannot be opened."""
    kind, name, number = parse_address(uri)
    try:
        if kind in ("udpin", "udpout"):
            return UdpTransport(name, number, listens=kind == "udpin")
        return TcpTransport(name, number) if kind == "tcp" else SerialTransport(name, number)
    except (OSError, OverflowError, termios.error) as error:
        raise LinkError(f"the link {uri} cannot be opened: {why_not(error, name)}") from None


class UdpTransport:
    """A UDP socket."""

    datagrams = True

    def __init__(self, host: str, port: int, listens: bool):
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        self._peer: Source = None
        self._host = host
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
                return self._socket.recvfrom(DATAGRAM_BYTES)
        return b"", None

    def write(self, packet: bytes) -> bool:
        """Send one packet as one datagram."""
        if self._peer is None:
            return False
        try:
            self._socket.sendto(packet, self._peer)
        except OSError:  # send failed: drop the packet, never block the control loop
            return False
        return True

    def answer_to(self, source: Source) -> None:
        """Set the peer: the caller chooses it, so that a stray sender cannot become the peer."""
        self._peer = source

    def reach(self) -> Reach:
        """Decided by the peer's address once there is one, else by the address that the socket listens at."""
        return reach_of(self._peer[0] if self._peer is not None else self._host)

    def trouble(self) -> str:
        """Always "": UDP does not know whether anybody listens."""
        return ""

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()


class _StreamTransport(ABC):
    """Shared by TCP and serial lines: a file descriptor that is reopened after it was lost.

    Bytes older than UNSENT_S in its send buffer are discarded, so that no old setpoint and no old mode request is
    delivered when the line recovers.  Only the reading thread opens and closes the file; a lock keeps the writing
    thread off a closed descriptor, which by then may be another file's.
    """

    datagrams = False

    def __init__(self) -> None:
        self._file: int | None = None
        self._lost_at_s = 0.0
        self._lock = threading.Lock()
        self._queue = SendQueue()
        self._trouble = ""
        self._start()

    @abstractmethod
    def reach(self) -> Reach:
        """Who can send on this link."""
        ...

    def trouble(self) -> str:
        """Why the last try to open it failed; "" while it is open."""
        return self._trouble

    def _start(self) -> None:
        """Open it for the first time; raises OSError or termios.error."""
        self._file = self._open()

    @abstractmethod
    def _open(self) -> int: ...

    @abstractmethod
    def _reason(self, error: Exception) -> str:
        """Why it could not be opened, for a person."""
        ...

    @abstractmethod
    def _discard(self, file: int) -> None:
        """Discard the send buffer; the caller holds the lock."""
        ...

    def read(self, timeout_s: float) -> tuple[bytes, Source]:
        """The bytes that arrived; after a drop, retries every REOPEN_S."""
        file = self._file
        if file is None:
            self._reopen(timeout_s)
            return b"", None
        with self._lock:
            if self._is_late(file):
                self._discard(file)
        if self._file is None or not select.select([file], [], [], timeout_s)[0]:
            return b"", None
        try:
            data = os.read(file, READ_BYTES)
        except BlockingIOError:
            return b"", None
        except OSError:
            data = b""
        if not data:
            self._drop()
        return data, None

    def write(self, packet: bytes) -> bool:
        """Write one packet.  A full buffer truncates it, and the receiver's checksum then discards it.

        Nothing is written behind bytes that are already late.
        """
        with self._lock:
            if self._file is None or self._is_late(self._file):
                return False
            try:
                count = os.write(self._file, packet)
            except OSError:
                return False
            self._queue.wrote(count, time.monotonic())
            return count == len(packet)

    def answer_to(self, source: Source) -> None:  # noqa: B027 (nothing to do)
        """Do nothing: there is only one peer."""

    def close(self) -> None:
        """Close the file; late bytes in its send buffer are discarded."""
        with self._lock:
            if self._file is not None and self._is_late(self._file):
                self._discard(self._file)
            file, self._file = self._file, None
            self._queue.clear()
        if file is not None:
            os.close(file)

    def _is_late(self, file: int) -> bool:
        return self._queue.age_s(unsent_bytes(file), time.monotonic()) > UNSENT_S

    def _drop(self) -> None:
        self.close()
        self._lost_at_s = time.monotonic()

    def _reopen(self, timeout_s: float) -> None:
        time.sleep(timeout_s)
        if time.monotonic() - self._lost_at_s >= REOPEN_S:
            self._lost_at_s = time.monotonic()
            try:
                self._file = self._open()
            except (OSError, termios.error) as error:
                self._trouble = self._reason(error)
            else:
                self._trouble = ""


class TcpTransport(_StreamTransport):
    """A TCP connection to a listening peer; one that refuses at first is tried again, for it may still start.

    Late bytes can only be discarded with their connection: it is reset, and opened again as after a loss.  Bytes that
    the peer's system has accepted but its program does not read cannot be discarded at all, so only our HEARTBEAT is
    written to a peer that has been silent for SILENT_S.
    """

    def __init__(self, host: str, port: int):
        self._address = (host, port)
        self._heard_t_s = 0.0
        super().__init__()

    def reach(self) -> Reach:
        """Decided by the peer's address."""
        return reach_of(self._address[0])

    def trouble(self) -> str:
        """Why it is not connected, or that the peer accepted the connection and has sent nothing since."""
        silent_s = time.monotonic() - self._heard_t_s
        if self._file is not None and silent_s > ACCEPTED_S:
            host, port = self._address
            return (
                f"{host}:{port} accepts the connection but sends nothing: another program may have it, for SITL serves "
                "one at each port"
            )
        return super().trouble()

    def _start(self) -> None:
        try:
            super()._start()
        except ConnectionRefusedError as error:
            self._trouble, self._lost_at_s = self._reason(error), time.monotonic()

    def _reason(self, error: Exception) -> str:
        host, port = self._address
        if isinstance(error, ConnectionRefusedError):
            return f"connection refused: nobody listens at {host}:{port}"
        return f"no connection to {host}:{port}: {why_not(error, host)}"

    def read(self, timeout_s: float) -> tuple[bytes, Source]:
        """The bytes that arrived; after a drop, retries every REOPEN_S."""
        data, source = super().read(timeout_s)
        if data:
            self._heard_t_s = time.monotonic()
        return data, source

    def write(self, packet: bytes) -> bool:
        """Send one packet, unless the peer is silent or does not read."""
        is_silent = time.monotonic() - self._heard_t_s > SILENT_S
        return (not is_silent or packet[7:10] == HEARTBEAT) and super().write(packet)

    def _open(self) -> int:
        connection = socket.create_connection(self._address, timeout=CONNECT_TIMEOUT_S)
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)  # send each setpoint at once, unmerged
        if sys.platform == "linux":  # the system's own timeout also acts while this program is stopped
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, round(ACKNOWLEDGED_S * 1e3))
        connection.setblocking(False)
        self._heard_t_s = time.monotonic()  # accepting the connection counts as a sign of life
        return connection.detach()

    def _discard(self, file: int) -> None:
        log.warning("the vehicle's TCP connection takes nothing: it is reset, so that nothing old arrives")
        connection = socket.socket(fileno=file)
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
        connection.close()
        self._file = None
        self._queue.clear()
        self._lost_at_s = time.monotonic()


class SerialTransport(_StreamTransport):
    """A serial line, 8N1 without flow control.  It is locked: two readers would each get half of the bytes."""

    def __init__(self, device: str, baud: int):
        self._device = device
        self._baud = getattr(termios, f"B{baud}", None)
        if self._baud is None:
            raise OSError(f"{baud} is not a baud rate of this system")
        super().__init__()

    def reach(self) -> Reach:
        """Always SERIAL: whoever is at the other end of the cable or radio."""
        return Reach.SERIAL

    def _reason(self, error: Exception) -> str:
        return f"{self._device} cannot be opened: {why_not(error, self._device)}"

    def _discard(self, file: int) -> None:
        with contextlib.suppress(OSError, termios.error):
            termios.tcflush(file, termios.TCOFLUSH)
        self._queue.clear()

    def _open(self) -> int:
        line = os.open(self._device, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        try:
            lock(line)
            tty.setraw(line)
            settings = termios.tcgetattr(line)
            settings[4] = settings[5] = self._baud
            settings[2] |= termios.CLOCAL | termios.CREAD
            settings[2] &= ~termios.CRTSCTS
            termios.tcsetattr(line, termios.TCSANOW, settings)
        except (OSError, termios.error):
            os.close(line)
            raise
        return line


def lock(line: int) -> None:
    """Lock a serial line as pyserial's `exclusive` does (flock), and keep others from opening it (TIOCEXCL).

    Raises OSError if another program has it.
    """
    try:
        fcntl.flock(line, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        raise OSError("another program is using this serial line: stop it first") from None
    fcntl.ioctl(line, termios.TIOCEXCL)
