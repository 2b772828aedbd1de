"""TCP and serial lines deliver no stale packets, and nothing is written to a reused file descriptor."""

import contextlib
import os
import pty
import socket
import termios
import time

import pytest
from pymavlink.dialects.v20 import common as dialect

from follow.link import transports as wire
from follow.link.send_queue import SendQueue, unsent_bytes

MAV = dialect.MAVLink(None, 1, 191)
SETPOINT = MAV.set_position_target_local_ned_encode(0, 1, 1, 8, 0x05C7, *(1.0,) * 11).pack(MAV)
HEARTBEAT = MAV.heartbeat_encode(18, 8, 0, 0, 4).pack(MAV)


@contextlib.contextmanager
def connected(receive_buffer: int = 0):
    """A server, and our connection to it."""
    with socket.socket() as server:
        if receive_buffer:
            server.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, receive_buffer)
        server.bind(("127.0.0.1", 0))
        server.listen()
        with contextlib.closing(wire.TcpTransport("127.0.0.1", server.getsockname()[1])) as way:
            yield server, way


def test_the_age_of_a_queue_is_that_of_its_oldest_byte():
    queue = SendQueue()
    for t_s in (0.0, 1.0, 2.0):
        queue.wrote(100, t_s)
    assert queue.age_s(250, 2.5) == 2.5
    assert queue.age_s(101, 2.5) == 1.5
    assert queue.age_s(1, 2.5) == 0.5
    assert queue.age_s(0, 9.0) == 0.0
    queue.wrote(1, 9.0)
    assert queue.age_s(1, 9.5) == 0.5


@pytest.mark.skipif(not hasattr(socket, "TCP_USER_TIMEOUT"), reason="only Linux tells what a TCP socket has not sent")
def test_a_peer_that_stopped_reading_never_gets_stale_packets(monkeypatch):
    monkeypatch.setattr(wire, "REOPEN_S", 0.05)
    with connected(receive_buffer=2048) as (server, way):
        vehicle, _ = server.accept()
        accepted, waits_since_s, lost_s, end_s = 0, None, None, time.monotonic() + 10.0
        while lost_s is None and time.monotonic() < end_s:
            vehicle.send(HEARTBEAT)  # it speaks, but it does not read
            for _ in range(4):
                accepted += len(SETPOINT) if way.write(SETPOINT) else 0
            if waits_since_s is None and way._file is not None and unsent_bytes(way._file):
                waits_since_s = time.monotonic()
            way.read(0.01)
            lost_s = time.monotonic() if way._file is None else None
        assert waits_since_s is not None
        assert lost_s is not None, "the connection goes on with seconds of setpoints in it"
        assert lost_s - waits_since_s < wire.UNSENT_S + 0.3
        arrived = b""
        with contextlib.suppress(ConnectionResetError):
            while data := vehicle.recv(65536):
                arrived += data
        assert len(arrived) < accepted, "what waited in our own buffer died with the connection"
        vehicle.close()
        while way._file is None and time.monotonic() < end_s:
            way.read(0.01)
        vehicle, _ = server.accept()
        assert way.write(SETPOINT)
        assert vehicle.recv(1000) == SETPOINT, "it connected again, and only what is new arrives"
        vehicle.close()


def test_a_silent_peer_gets_our_heartbeat_only_until_it_speaks(monkeypatch):
    """Bytes that the peer's own system has accepted cannot be recalled."""
    monkeypatch.setattr(wire, "SILENT_S", 0.05)
    with connected() as (server, way):
        vehicle, _ = server.accept()
        assert way.write(SETPOINT)
        end_s = time.monotonic() + 0.06
        while time.monotonic() < end_s:
            way.read(0.01)
        assert not way.write(SETPOINT)
        assert way.write(HEARTBEAT)
        vehicle.sendall(HEARTBEAT)
        assert way.read(2.0)[0] == HEARTBEAT
        assert way.write(SETPOINT)
        vehicle.close()


def test_packets_queued_for_a_slow_serial_line_are_discarded(monkeypatch):
    monkeypatch.setattr(wire, "UNSENT_S", 0.05)
    flushed = []
    monkeypatch.setattr(wire, "unsent_bytes", lambda _file: 0 if flushed else 2 * len(SETPOINT))
    monkeypatch.setattr(termios, "tcflush", lambda _file, which: flushed.append(which))
    vehicle, line = pty.openpty()
    with contextlib.closing(wire.SerialTransport(os.ttyname(line), 57600)) as way:
        assert way.write(SETPOINT)
        assert way.write(SETPOINT)
        way.read(0.06)
        assert not flushed, "it was not late when it was looked at"
        assert not way.write(SETPOINT), "nothing is written behind what is late"
        way.read(0.0)
        assert flushed == [termios.TCOFLUSH]
        assert way.write(SETPOINT)
    os.close(vehicle)
    os.close(line)


def test_a_packet_is_never_written_to_a_file_with_the_reused_descriptor_of_a_closed_line(monkeypatch, tmp_path):
    vehicle, line = pty.openpty()
    way = wire.SerialTransport(os.ttyname(line), 57600)
    number, close = way._file, os.close

    def slow_close(file: int) -> None:
        close(file)
        monkeypatch.undo()
        victim = os.open(tmp_path / "recording", os.O_CREAT | os.O_RDWR)
        assert victim == number
        assert not way.write(SETPOINT)
        assert os.pread(victim, 100, 0) == b""
        close(victim)

    monkeypatch.setattr(os, "close", slow_close)
    way._drop()
    assert os.close is close
    os.close(vehicle)
    os.close(line)
