"""A thousand clicks a second: a bounded number is processed, and no STOP is delayed by them."""

import pytest
from pymavlink.dialects.v20 import common as dialect

from follow.messages import Order
from follow.operator.ground import HEEDED
from tests.follow.test_ground_forged import CAMERA, DRAW, STATION, STOP, Flight, beat, command
from tests.follow.test_link_identity import STRANGER, VEHICLE, speak
from tools.fuzz.ground import GroundTarget

CLICK = 2004


def click(n, sender=(255, 190)):
    numbers = 0.3 + 0.0001 * (n % 1000), 0.5, 0.03
    message = dialect.MAVLink_command_long_message(*CAMERA, CLICK, 0, *numbers, 0.0, 0.0, 0.0, 0.0)
    return message.pack(dialect.MAVLink(None, *sender))


def acks(flight):
    parser = dialect.MAVLink(None)
    messages = [m for packet, _ in flight.line.sent for m in parser.parse_buffer(packet) or []]
    return [m for m in messages if m.get_type() == "COMMAND_ACK"]


@pytest.mark.parametrize("clicker", [STATION, STRANGER], ids=["its own", "a stranger's"])
def test_a_stop_behind_a_flood_of_clicks_acts_in_its_round(clicker):
    flight = Flight()
    for n in range(33):
        flight.line.arrived.append((click(n), clicker))
    flight.line.arrived.append((command(STOP), STATION))
    flight.round()
    assert any(order is Order.OBSERVE for order, _by in flight.orders)
    assert len(acks(flight)) <= 2 * HEEDED, "an answer goes to each station"


@pytest.mark.parametrize("is_known", [True, False])
def test_a_stop_before_the_flood_of_another_station_also_acts(is_known):
    flight = Flight()
    if is_known:
        flight.line.arrived = [(click(0, (42, 190)), STRANGER)]
        flight.round()
    flight.line.arrived.append((command(STOP), STATION))
    for n in range(200):
        flight.line.arrived.append((click(n, (42, 190)), STRANGER))
    flight.round()
    assert any(order is Order.OBSERVE for order, _by in flight.orders)


@pytest.mark.parametrize("is_first", [True, False])
def test_a_stop_beside_datagrams_full_of_clicks_acts_and_few_of_the_clicks_are_processed(is_first):
    flight = Flight()
    full = b"".join(click(n, (42, 190)) for n in range(45))
    flight.line.arrived = [(full, STRANGER)] * 15
    flight.line.arrived.insert(0 if is_first else 15, (command(STOP), STATION))
    flight.round()
    assert any(order is Order.OBSERVE for order, _by in flight.orders)
    assert len(acks(flight)) <= 2 * HEEDED, "an answer goes to each station"


@pytest.mark.parametrize("place", [0, 100, 200])
@pytest.mark.parametrize("what", ["clicks", "garbage", "heartbeats of two hundred systems"])
def test_a_stop_among_two_hundred_unknown_senders_acts_and_its_station_is_still_answered(what, place):
    flight = Flight()
    flight.line.arrived = [(command(DRAW), STATION)]
    flight.round()
    beats = dialect.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3)
    for _ in range(30):  # 15 s
        flight.line.arrived = [
            ({"clicks": click(n), "garbage": bytes([n]) * 40}.get(what, beats.pack(dialect.MAVLink(None, n + 1, 190))),
             (f"10.0.1.{n}", 14550))
            for n in range(200)
        ]  # fmt: skip
        flight.line.arrived.insert(place, (beats.pack(dialect.MAVLink(None, 255, 190)), STATION))
        flight.round()
    assert STATION in flight.ground._direct._heard_t_s
    flight.orders.clear()
    flight.line.arrived = [(click(n), (f"10.0.1.{n}", 14550)) for n in range(200)]
    flight.line.arrived.insert(place, (command(STOP), STATION))
    flight.round()
    assert any(order is Order.OBSERVE for order, _by in flight.orders)


def test_a_stop_behind_a_flood_through_the_autopilot_acts():
    flight = Flight()
    beat(flight.link)
    speak(flight.link, [*(click(n) for n in range(200)), command(STOP)], VEHICLE)
    flight.round()
    assert any(order is Order.OBSERVE for order, _by in flight.orders)


def test_of_a_second_of_a_thousand_clicks_at_most_four_reach_the_tracker():
    target = GroundTarget()
    target.round()
    for n in range(30):
        target.t_s += 1 / 30 - 0.05  # a round adds 0.05 s
        target.air.waiting += [(click(34 * n + k), STATION) for k in range(34)]
        target.round()
    assert 1 <= len(target.chosen) <= 4
    assert not target.air.waiting
