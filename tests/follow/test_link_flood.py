"""A flood at the vehicle's port can neither block the loop, nor displace the vehicle's packets, nor fill the memory."""

from collections import Counter

import pytest
from pymavlink.dialects.v20 import common as dialect

from follow.link import connection
from follow.link.arrivals import ADDRESS_DATAGRAMS, ADDRESSES, FLOOD, VEHICLE_BYTES, Arrivals
from follow.link.connection import MavlinkLink
from follow.messages import HOVER
from tests.follow.test_link_identity import Mailbox

VEHICLE, MOVED = ("10.0.0.1", 14550), ("10.0.0.2", 14550)
COST_S = 0.0005  # of one datagram: twice what 1400 random bytes cost
AUTOPILOT = dialect.MAVLink(None, 1, 1)
BEAT = dialect.MAVLink_heartbeat_message(2, 12, 0, 0, 4, 3)
NOISE = bytes(range(256)) * 5


class Clock:
    """A monotonic clock that goes on by COST_S for each datagram that is decoded."""

    def __init__(self) -> None:
        self.now_s = 1000.0

    def monotonic(self) -> float:
        return self.now_s

    def time(self) -> float:
        return self.now_s


@pytest.fixture
def clock(monkeypatch):
    clock = Clock()
    monkeypatch.setattr(connection, "time", clock)
    return clock


def opened(clock: Clock) -> tuple[MavlinkLink, Counter]:
    """A link, and how many datagrams of each address it has decoded."""
    link, decoded = MavlinkLink(Mailbox()), Counter()
    receive = link.client.receive

    def counted(data, t_s, datagram, source):
        decoded[source] += 1
        clock.now_s += COST_S
        return receive(data, t_s, datagram, source)

    link.client.receive = counted
    return link, decoded


def heard(link: MavlinkLink, clock: Clock, source, message=BEAT) -> None:
    link._arrived.put((clock.now_s, message.pack(AUTOPILOT), source))


def flood(link: MavlinkLink, clock: Clock, count: int = 20000, addresses: int = 1) -> None:
    for n in range(count):
        link._arrived.put((clock.now_s, NOISE, (f"10.9.0.{n % addresses}", 5)))


@pytest.mark.parametrize("addresses", [1, 40, 250])
def test_a_round_under_a_flood_is_short_and_uses_all_that_the_vehicle_sent(clock, addresses):
    link, decoded = opened(clock)
    heard(link, clock, VEHICLE)
    link.state()
    for _ in range(20):
        flood(link, clock, 2000, addresses)
        for _ in range(5):
            heard(link, clock, VEHICLE)
        flood(link, clock, 2000, addresses)
        before_s, sent = clock.now_s, len(link._transport.sent)
        link.state()
        link.send(HOVER)
        assert clock.now_s - before_s < 0.01
        assert len(link._transport.sent) > sent, "a setpoint each round"
    assert decoded[VEHICLE] == 101


@pytest.mark.parametrize("addresses", [1, 40])
def test_the_first_packet_of_the_vehicle_is_received_in_a_flood(clock, addresses):
    link, _ = opened(clock)
    for _ in range(5):
        flood(link, clock, 3000, addresses)
        heard(link, clock, VEHICLE)
        flood(link, clock, 3000, addresses)
        link.state()
        clock.now_s += 0.05
    for _ in range(20):
        link.state()
    assert link.client.vehicle_id == 1
    assert link.client.peer.address == VEHICLE


def test_a_vehicle_with_a_new_address_is_received_in_a_flood(clock):
    link, _ = opened(clock)
    heard(link, clock, VEHICLE)
    link.state()
    clock.now_s += 11.0
    for _ in range(60):
        flood(link, clock, 1000)
        heard(link, clock, MOVED)
        flood(link, clock, 1000)
        clock.now_s += 0.05
        link.state()
    assert link.client.peer.address == MOVED


def test_a_flood_from_the_vehicles_own_address_is_bounded_and_its_newest_survive(clock):
    link, _ = opened(clock)
    heard(link, clock, VEHICLE)
    link.state()
    for n in range(20000):
        heard(link, clock, VEHICLE, dialect.MAVLink_statustext_message(6, b"%d" % n))
    assert link._arrived._bytes <= VEHICLE_BYTES
    before_s = clock.now_s
    link.state()
    assert clock.now_s - before_s < 0.03
    for _ in range(200):
        link.state()
    assert link.client.heard.texts[-1] == "19999"


def test_memory_is_bounded_and_other_addresses_take_turns():
    arrivals = Arrivals()
    for n in range(100_000):
        arrivals.put((float(n), NOISE, ("10.9.9.9", n)))
        arrivals.put((float(n), NOISE, ("10.9.9.8", 1)))
    held = sum(map(len, arrivals._others.values()))
    assert held <= ADDRESSES * ADDRESS_DATAGRAMS
    assert arrivals.dropped == 200_000 - held
    for _ in range(4):
        arrivals.put((0.0, NOISE, VEHICLE))
    taken = [arrivals.take_others() for _ in range(2 * ADDRESSES)]
    assert {VEHICLE, ("10.9.9.8", 1)} <= {arrival[2] for arrival in taken[:ADDRESSES] if arrival is not None}


def test_queued_packets_of_the_vehicle_keep_their_order_when_its_address_becomes_known():
    arrivals = Arrivals()
    for n in range(3):
        arrivals.put((float(n), b"x", VEHICLE))
    arrivals.set_peer(VEHICLE)
    arrivals.put((3.0, b"x", VEHICLE))
    assert [arrivals.take_vehicles()[0] for _ in range(4)] == [0.0, 1.0, 2.0, 3.0]
    assert arrivals.take_vehicles() is arrivals.take_others() is None


def test_the_operator_is_told_of_a_flood_now_and_then(clock, caplog):
    link, _ = opened(clock)
    flood(link, clock, ADDRESS_DATAGRAMS + FLOOD // 2)
    link.state()
    assert not caplog.records, "a few that were dropped are no flood"
    for _ in range(250):
        flood(link, clock, 500)
        link.state()
        clock.now_s += 0.1
    said = [record.message for record in caplog.records]
    assert 2 <= len(said) <= 4
    assert all("the vehicle's port is flooded" in line for line in said)
