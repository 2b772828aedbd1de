"""Identity on the link: one address is the vehicle's, and a second sender of its id is detected."""

import os
import pty
import subprocess
import sys

import pytest
from pymavlink.dialects.v20 import common as dialect

from follow.link import LinkError
from follow.link import transports as wire
from follow.link.connection import MavlinkLink
from follow.link.identity import MOST_STRANGERS, PeerAddress, SenderWatch
from follow.link.signing import Signing
from follow.link.transports import Reach, open_transport
from follow.messages import HOVER, NEVER, Autopilot
from tests.support.autopilot_pair import Pair

VEHICLE, STRANGER = ("10.0.0.1", 14550), ("10.0.0.66", 14550)


def test_the_first_address_keeps_its_role_while_it_is_heard_whatever_others_send():
    peer = PeerAddress()
    assert peer.admits(VEHICLE, 0.0, signed=False)
    t_s = 0.0
    for i in range(4000):
        t_s += 0.01
        assert not peer.admits(STRANGER, t_s, signed=False)
        if i % 500 == 0:
            assert peer.admits(VEHICLE, t_s, signed=False)
    assert peer.address == VEHICLE
    assert peer.strangers == {STRANGER: t_s}


def test_many_forged_addresses_are_bounded_in_memory_and_in_the_log(caplog):
    link = MavlinkLink(Mailbox())
    pair = Pair(Autopilot.PX4)
    pair.system.step(1.0)
    speak(link, pair.system.take(), VEHICLE)
    beat = dialect.MAVLink_heartbeat_message(2, 12, 129, 6 << 16, 4, 3)
    strangers = [(f"10.1.{n >> 8}.{n & 255}", 99) for n in range(1000)]
    for n, source in enumerate(strangers):
        link.client.receive(forged(beat), 0.001 * n, datagram=True, source=source)
    peer = link.client.peer
    assert peer.address == VEHICLE
    assert list(peer.strangers) == strangers[-MOST_STRANGERS:], "the latest ones are kept"
    assert link.client.state(1.0).contested_t_s == pytest.approx(0.999)
    assert len([r for r in caplog.records if "also claims" in r.message]) == 1


def test_a_new_address_is_accepted_only_after_a_long_silence_and_if_it_keeps_sending():
    peer = PeerAddress()
    peer.admits(VEHICLE, 0.0, signed=False)
    assert not peer.admits(STRANGER, 1000.0, signed=False), "one datagram moves nothing, however late"
    times = [1001.0 + 0.1 * n for n in range(40)]
    assert [peer.admits(STRANGER, t_s, signed=False) for t_s in times].index(True) > 9
    assert peer.address == STRANGER
    assert peer.stranger_t_s == NEVER, "the new address is no second sender"


def test_a_signed_packet_moves_the_address_at_once():
    peer = PeerAddress()
    peer.admits(VEHICLE, 0.0, signed=True)
    assert peer.admits(STRANGER, 0.1, signed=True)
    assert peer.address == STRANGER


@pytest.mark.parametrize("offset", range(0, 256, 5))
def test_two_senders_are_detected_by_their_sequence_numbers_within_a_second(offset):
    """At 50 and 20 packets a second the offset between them drifts through every value."""
    watch = SenderWatch()
    for n in range(250):
        watch.hear(n % 256, n / 50, 0)
        if n % 5 < 2:
            watch.hear((offset + n * 2 // 5) % 256, n / 50, 0)
    assert watch.contested_t_s > 3.0


@pytest.mark.parametrize("lost", [0.0, 0.3, 0.9])
def test_losses_duplicates_and_reordering_are_not_taken_for_a_second_sender(lost):
    import random  # noqa: PLC0415 (only here)

    chance, watch, waiting = random.Random(1), SenderWatch(), []
    for n in range(3000):
        if chance.random() >= lost:
            waiting += [n % 256] * chance.choice((1, 1, 2))
        if n % 8 == 0:
            chance.shuffle(waiting)
            while waiting:
                watch.hear(waiting.pop(), n / 100, 0)
    assert watch.contested_t_s == NEVER


class Mailbox:
    """A transport in memory: what arrives is put in with its source."""

    datagrams = True

    def __init__(self) -> None:
        self.sent: list[tuple[bytes, object]] = []
        self.peer = None

    def read(self, _timeout_s):
        return b"", None

    def write(self, packet):
        self.sent.append((packet, self.peer))
        return self.peer is not None

    def answer_to(self, source):
        self.peer = source

    def reach(self):
        return Reach.NETWORK

    def trouble(self):
        return ""

    def close(self): ...


def speak(link: MavlinkLink, packets: list[bytes], source) -> None:
    for packet in packets:
        link._arrived.put((0.0, packet, source))
    link.pump()


def forged(message) -> bytes:
    return message.pack(dialect.MAVLink(None, 1, 1))


def test_one_forged_datagram_does_not_move_our_packets_and_forged_channels_are_no_order():
    mailbox = Mailbox()
    link = MavlinkLink(mailbox)
    pair = Pair(Autopilot.PX4)
    pair.system.step(1.0)
    speak(link, pair.system.take(), VEHICLE)
    link.send(HOVER)
    assert mailbox.sent[-1][1] == VEHICLE
    before = link.client.state(0.0)
    channels = dialect.MAVLink_rc_channels_message(1000, 18, *[2000] * 18, 255)
    away = dialect.MAVLink_attitude_message(10**6, 0.0, 0.0, 3.0, 0.0, 0.0, 0.0)
    flown_by_another = dialect.MAVLink_heartbeat_message(2, 12, 129, 6 << 16, 4, 3)
    for message in (channels, away, flown_by_another) * 20:
        speak(link, [forged(message)], STRANGER)
        link.send(HOVER)
        assert mailbox.sent[-1][1] == VEHICLE
    state = link.client.state(0.0)
    assert link.client.heard.rc_channels == ()
    assert (state.yaw_rad, state.mode, state.rc_t_s) == (before.yaw_rad, before.mode, NEVER)
    assert state.contested_t_s == 0.0, "and it is noticed"


def test_while_two_senders_use_the_vehicles_id_its_remote_control_is_ignored(caplog):
    """c18: the forger is on the same line, where no address tells it from the vehicle."""
    pair = Pair(Autopilot.PX4)
    pair.run(5.0)
    assert pair.client.heard.rc_channels[6] == 0xFFFF, "this remote control has no switch"
    mav = dialect.MAVLink(None, 1, 1)
    seen = []

    def spoil(packets):
        switch = 1000 if pair.t_s < 6.0 else 2000
        channels = [1500] * 6 + [switch] + [1500] * 11
        return [*packets, dialect.MAVLink_rc_channels_message(1000, 18, *channels, 255).pack(mav)]

    pair.to_client = spoil
    for _ in range(200):
        pair.run(0.02)
        seen.append(pair.client.heard.rc_channels[6])
    assert 2000 not in seen
    assert [record.message for record in caplog.records] == ["two senders use system 1: its remote control is ignored"]
    assert pair.t_s - pair.state.contested_t_s < 0.5


def test_a_serial_line_in_use_is_refused_to_a_second_program():
    vehicle, line = pty.openpty()
    name = os.ttyname(line)
    first = open_transport(f"serial:{name}:57600")
    code = f"from follow.link.transports import open_transport; open_transport('serial:{name}:57600')"
    second = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False, timeout=60)
    assert second.returncode == 1
    assert "another program is using this serial line" in second.stderr
    with pytest.raises(LinkError, match="another program"):
        open_transport(f"serial:{name}:57600")
    first.close()
    open_transport(f"serial:{name}:57600").close()
    os.close(vehicle)
    os.close(line)


@pytest.mark.parametrize(
    ("host", "reach"),
    [
        ("127.0.0.1", "loopback"),
        ("localhost", "loopback"),
        ("::1", "loopback"),
        ("10.0.0.1", "network"),
        ("h", "network"),
    ],
)
def test_the_exposure_of_a_link_follows_from_its_peer(host, reach):
    assert wire.reach_of(host).value == reach


def test_a_listening_link_is_as_open_as_the_vehicles_address():
    udp = wire.UdpTransport("0.0.0.0", 0, listens=True)
    assert udp.reach() is Reach.NETWORK
    udp.answer_to(("127.0.0.1", 1))
    assert udp.reach() is Reach.LOOPBACK
    udp.answer_to(STRANGER)
    assert udp.reach() is Reach.NETWORK
    udp.close()


def test_packets_that_cannot_be_sent_are_counted_and_reported(caplog):
    mailbox = Mailbox()
    link = MavlinkLink(mailbox)
    pair = Pair(Autopilot.PX4)
    pair.system.step(1.0)
    speak(link, pair.system.take(), VEHICLE)
    mailbox.write = lambda _packet: False
    with caplog.at_level("WARNING", "follow"):
        for _ in range(50):
            link.send(HOVER)
    assert link.unsent >= 50
    (said,) = [record.message for record in caplog.records if "could not be sent" in record.message]
    assert said == "1 packet could not be sent: the link is full or broken"


def test_packets_before_the_vehicles_address_is_known_are_not_lost():
    link = MavlinkLink(Mailbox())
    link.state()
    assert link._transport.sent  # our heartbeat
    assert link.unsent == 0


def test_a_signed_link_ignores_unsigned_strangers(tmp_path):
    key = tmp_path / "key"
    key.write_bytes(bytes(range(32)))
    key.chmod(0o600)
    link = MavlinkLink(Mailbox(), signing=Signing(key))
    speak(link, [forged(dialect.MAVLink_heartbeat_message(2, 12, 129, 6 << 16, 4, 3))], STRANGER)
    assert link.client.vehicle_id is None
