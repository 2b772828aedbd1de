"""Transports: whole packets over UDP, pieces over TCP and serial lines, and reconnection after a drop."""

import contextlib
import os
import pty
import socket
import time

import pytest
from pymavlink.dialects.v20 import common as dialect

from follow.link import transports as wire
from follow.link.connection import MavlinkLink
from follow.link.packets import FALSE_STARTS, Packets, is_foreign
from follow.link.signing import Signing
from follow.messages import Autopilot
from sim.autopilot.system import AutopilotSystem
from sim.dynamics import Vehicle, VehicleTruth

PACKET = dialect.MAVLink(None, 1, 1).heartbeat_encode(2, 12, 1, 0, 4).pack(dialect.MAVLink(None, 1, 1))


def read_until(way: wire.Transport, wanted: int, seconds: float = 5.0) -> bytes:
    end, data = time.monotonic() + seconds, b""
    while len(data) < wanted and time.monotonic() < end:
        data += way.read(0.05)[0]
    return data


def test_udp_sends_only_to_the_address_set_by_answer_to():
    listening = wire.UdpTransport("127.0.0.1", 0, listens=True)
    with contextlib.closing(listening), socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as vehicle:
        vehicle.bind(("127.0.0.1", 0))
        vehicle.settimeout(2.0)
        assert not listening.write(PACKET)
        vehicle.sendto(PACKET, ("127.0.0.1", listening.port))
        data, source = listening.read(2.0)
        assert data == PACKET
        assert not listening.write(PACKET)  # a stranger's datagram does not make it the addressee
        listening.answer_to(source)
        assert listening.write(PACKET)
        assert vehicle.recv(1000) == PACKET


def test_udp_without_a_listener_loses_packets_and_does_not_fail():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    speaking = wire.UdpTransport("127.0.0.1", port, listens=False)
    with contextlib.closing(speaking):
        for _ in range(5):
            speaking.write(PACKET)
            assert speaking.read(0.001) == (b"", None)


def test_tcp_comes_back_after_a_drop(monkeypatch):
    monkeypatch.setattr(wire, "REOPEN_S", 0.05)
    server = socket.create_server(("127.0.0.1", 0))
    way = wire.TcpTransport("127.0.0.1", server.getsockname()[1])
    with contextlib.closing(way), server:
        vehicle, _ = server.accept()
        vehicle.sendall(PACKET * 3)
        assert read_until(way, 3 * len(PACKET)) == PACKET * 3
        assert way.write(PACKET)
        assert vehicle.recv(1000) == PACKET
        vehicle.close()
        assert way.read(2.0) == (b"", None)
        assert not way.write(PACKET)
        assert way.read(0.06) == (b"", None)  # it connects again
        vehicle, _ = server.accept()
        vehicle.sendall(PACKET)
        assert read_until(way, len(PACKET)) == PACKET
        vehicle.close()


def test_a_serial_line_carries_every_byte_value():
    vehicle, line = pty.openpty()
    way = wire.SerialTransport(os.ttyname(line), 57600)
    with contextlib.closing(way):
        every_byte = bytes(range(256))
        os.write(vehicle, every_byte)
        assert read_until(way, 256) == every_byte
        assert way.write(every_byte)
        assert os.read(vehicle, 1000) == every_byte
    os.close(vehicle)
    os.close(line)


@pytest.mark.parametrize("piece", [1, 3, 7, 50])
def test_packets_cut_anywhere_are_read_whole(piece):
    stream = PACKET * 20
    packets = Packets(1, 191)
    read = [m for at in range(0, len(stream), piece) for m in packets.read(stream[at : at + piece])]
    assert len(read) == 20
    assert packets.unreadable == 0


def test_a_truncated_datagram_does_not_swallow_the_next():
    packets = Packets(1, 191)
    assert packets.read_datagram(PACKET[:-4]) == []
    assert len(packets.read_datagram(PACKET)) == 1


def test_a_false_start_byte_in_a_datagram_does_not_hide_the_packet_behind_it():
    assert len(Packets(1, 191).read_datagram(b"\xfd\xff\x00" + PACKET)) == 1


@pytest.mark.parametrize("byte", [0xFE, 0xFD])
def test_a_datagram_full_of_false_start_bytes_costs_little_and_the_next_one_is_read(byte, monkeypatch):
    packets, tries = Packets(1, 191), []
    monkeypatch.setattr(packets, "_decode", lambda packet, decode=packets._decode: tries.append(1) or decode(packet))
    monkeypatch.setattr("follow.link.packets.is_foreign", lambda *given: tries.append(1) or is_foreign(*given))
    noise = bytes([byte]) * 1400  # 0xFE: a packet of DEBUG begins at every byte
    assert packets.read_datagram(noise) == []
    assert 0 < len(tries) <= FALSE_STARTS + 1
    assert packets.unreadable == len(noise)
    assert len(packets.read_datagram(PACKET)) == 1
    assert len(Packets(1, 191).read_datagram(noise[: FALSE_STARTS // 2] + PACKET)) == 1


def test_packets_of_another_dialect_do_not_hide_the_packets_behind_them():
    foreign = bytes([0xFD, 4, 0, 0, 0, 1, 1, 0xF0, 0xFF, 0xFF, *b"abcd", 0, 0])
    packets = Packets(1, 191)
    assert len(packets.read_datagram(foreign * 40 + PACKET)) == 1
    assert packets.unknown == 40


def test_a_datagram_that_is_longer_than_any_of_mavlink_is_read_in_part():
    listener = wire.UdpTransport("127.0.0.1", 0, listens=True)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        sender.sendto(PACKET * 1000, ("127.0.0.1", listener.port))
        sender.sendto(PACKET, ("127.0.0.1", listener.port))
    data, source = listener.read(1.0)
    assert source is not None
    assert 1500 <= len(data) < 4096
    assert listener.read(1.0)[0] == PACKET
    listener.close()


@pytest.mark.parametrize("baud", ["0123", "7", "99999999"])
def test_an_unknown_baud_rate_is_named(baud):
    with pytest.raises(RuntimeError, match="not a baud rate"):
        wire.open_transport(f"serial:/dev/null:{baud}")


def test_a_vehicle_whose_signing_clock_is_behind_is_accepted_after_it_received_our_packets(tmp_path):
    key = tmp_path / "key"
    key.write_bytes(bytes(range(32)))
    key.chmod(0o600)
    system = AutopilotSystem(Autopilot.PX4, Vehicle(Autopilot.PX4, VehicleTruth(down_m=-10.0)), key=key.read_bytes())
    ours = wire.UdpTransport("127.0.0.1", 0, listens=True)
    theirs = wire.UdpTransport("127.0.0.1", ours.port, listens=False)
    began = time.monotonic()
    with MavlinkLink(ours, signing=Signing(key)) as link:
        while link.client.vehicle_id is None and time.monotonic() - began < 10.0:
            system.step(time.monotonic() - began)
            for packet in system.take():
                theirs.write(packet)
            link.pump()
            data, _ = theirs.read(0.01)
            if data:
                system.receive(data)
        assert link.client.packets.refused > 0
        assert link.client.vehicle_id == 1
    theirs.close()


def free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as probe:
        return probe.getsockname()[1]


def test_a_refused_connection_is_told_at_once_and_again_at_the_end_and_is_tried_again(monkeypatch):
    monkeypatch.setattr(wire, "REOPEN_S", 0.05)
    port, told = free_port(), []
    refused = f"connection refused: nobody listens at 127.0.0.1:{port}"
    with MavlinkLink(wire.TcpTransport("127.0.0.1", port)) as link:
        with pytest.raises(RuntimeError, match=refused):
            link.wait_for_vehicle(0.3, told.append)
        assert told == [f"{refused}; still trying, for up to 0.3 s"]
        with socket.create_server(("127.0.0.1", port)) as server:
            server.settimeout(5.0)
            vehicle, _ = server.accept()
            with vehicle:
                assert link.trouble in ("", refused)


def test_a_peer_that_accepts_and_sends_nothing_is_named(monkeypatch):
    monkeypatch.setattr(wire, "ACCEPTED_S", 0.0)
    with socket.create_server(("127.0.0.1", 0)) as server:
        way = wire.TcpTransport("127.0.0.1", server.getsockname()[1])
        with contextlib.closing(way):
            assert "accepts the connection but sends nothing" in way.trouble()


@pytest.mark.parametrize(
    ("uri", "says"),
    [
        ("udpin:192.0.2.77:14540", "192.0.2.77 is not an address of this machine; 0.0.0.0 listens at all"),
        ("udpout:no-such-host.invalid:14540", "no address is known for 'no-such-host.invalid': look at the spelling"),
        ("serial:/dev/ttyNONE:57600", "No such file or directory: look at its name and cable"),
        ("serial:/dev/null:57600", "/dev/null is not a serial line"),
    ],
)
def test_a_link_that_cannot_be_opened_says_why_and_what_to_do(uri, says):
    with pytest.raises(RuntimeError, match=says) as refused:
        wire.open_transport(uri)
    assert "[Errno" not in str(refused.value)
    assert "another port" not in str(refused.value)
