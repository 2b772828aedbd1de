"""A datagram of an unknown sender orders nothing, at the ground listener or on the vehicle's link."""

import math
from functools import partial

import pytest
from pymavlink.dialects.v20 import common as dialect

from follow.cli.program import main
from follow.link.connection import MavlinkLink
from follow.link.packets import Packets
from follow.link.signing import Signing
from follow.messages import HOVER, Autopilot, Decision, Mode, Tick
from follow.operator.authority import Operator
from follow.operator.consoles import Consoles
from follow.operator.ground import READ, DirectSide, GroundSide
from follow.operator.ground_camera import GroundCamera
from follow.operator.told import PilotTexts
from tests.follow.test_link_identity import STRANGER, VEHICLE, Mailbox, speak
from tests.support.autopilot_pair import Pair
from tests.support.gate_rig import flying, seen

STATION = ("10.0.0.7", 14550)
CAMERA, DRAW, STOP = (1, 100), 2005, 2010


class Line(Mailbox):
    """What arrives is put in beforehand."""

    def __init__(self):
        super().__init__()
        self.arrived = []

    def read(self, _timeout_s):
        return self.arrived.pop(0) if self.arrived else (b"", None)


def command(number, packets=None, sender=(255, 190)):
    """A box in the middle, or a stop, as a ground station sends it."""
    message = dialect.MAVLink_command_long_message(*CAMERA, number, 0, 0.4, 0.4, 0.6, 0.6, 0.0, 0.0, 0.0)
    return packets.write(message) if packets is not None else message.pack(dialect.MAVLink(None, *sender))


class Flight:
    """A ground side on the vehicle's link and on a line of its own, in FOLLOW."""

    def __init__(self, signing=None, follows=True):
        self.lines, self.chosen, self.orders = [], [], []
        self.link, self.line = MavlinkLink(Mailbox(), signing=signing), Line()

        class Orders(Operator):
            order = lambda _self, order, by, *_: self.orders.append((order, by))  # noqa: E731

        operator = Orders(self.lines.append, at_once=False, heard=self.link.client.heard)
        self.consoles = Consoles(operator, lambda choice: self.chosen.append(choice) or "", self.lines.append)
        camera = GroundCamera((640, 360), partial(self.consoles.choose, flies=follows), signing=signing)
        camera.address(1)
        self.ground = GroundSide(
            self.link, camera, self.consoles, PilotTexts(self.link.client), DirectSide(self.line, signing)
        )
        self.link.listeners.append(self.ground.hear)
        self.t_s = 10.0

    def round(self):
        self.t_s += 0.5
        tick = Tick(None, None, flying(self.t_s), seen(self.t_s), HOVER, Decision(HOVER, Mode.FOLLOW))
        self.consoles.see(tick)
        self.consoles.status = type(self.consoles.status)(self.consoles.status.state, None, self.t_s)
        self.ground.see(tick)


def beat(link):
    """The vehicle speaks from its address."""
    pair = Pair(Autopilot.PX4)
    pair.system.step(1.0)
    speak(link, pair.system.take(), VEHICLE)


@pytest.mark.parametrize("sender", [(255, 190), (1, 1), (1, 191)])
@pytest.mark.parametrize("number", [DRAW, STOP])
def test_a_datagram_of_an_unknown_sender_on_the_vehicles_link_orders_nothing(number, sender):
    flight = Flight()
    beat(flight.link)
    for _ in range(50):
        speak(flight.link, [command(number, sender=sender)], STRANGER)
    flight.round()
    assert not flight.chosen
    assert not flight.orders
    speak(flight.link, [command(number, sender=sender)], VEHICLE)
    flight.round()
    assert flight.chosen, "the same datagram counts from the vehicle's own address"
    assert flight.orders


@pytest.mark.parametrize("number", [DRAW, STOP])
def test_with_a_key_an_unsigned_datagram_orders_nothing_at_the_ground_listener_and_is_not_answered(number, tmp_path):
    key = tmp_path / "key"
    key.write_bytes(bytes(range(32)))
    key.chmod(0o600)
    flight = Flight(Signing(key))
    flight.line.arrived += [(command(number), STRANGER)] * 10
    wrong = tmp_path / "wrong"
    wrong.write_bytes(bytes(32))
    wrong.chmod(0o600)
    flight.line.arrived += [(command(number, Packets(255, 190, Signing(wrong))), STRANGER)]
    flight.round()
    assert not flight.chosen
    assert not flight.orders
    assert not flight.line.sent
    station = tmp_path / "station"
    station.write_bytes(key.read_bytes())
    station.chmod(0o600)
    flight.line.arrived.append((command(number, Packets(255, 190, Signing(station))), STATION))
    flight.round()
    assert flight.chosen
    assert {source for _, source in flight.line.sent} == {STATION}


def test_a_flood_of_unknown_senders_costs_a_bounded_number_of_datagrams_a_round():
    flight = Flight()
    flight.line.arrived += [(b"\xfd" + bytes(20), STRANGER)] * 1000
    flight.round()
    assert len(flight.line.arrived) == 1000 - READ


@pytest.mark.parametrize("numbers", [(math.nan,) * 4, (math.inf, 0.0, 1.0, 1.0), (0.6, 0.6, 0.4, 0.4)])
def test_a_forged_invalid_box_selects_nothing(numbers):
    flight = Flight()
    message = dialect.MAVLink_command_long_message(*CAMERA, DRAW, 0, *numbers, 0.0, 0.0, 0.0)
    flight.line.arrived.append((message.pack(dialect.MAVLink(None, 255, 190)), STATION))
    flight.round()
    assert not flight.chosen
    assert not flight.orders


@pytest.mark.parametrize("more", [[], ["--ground-follows"], ["--ground-unsigned", "--ground-follows"]])
def test_an_open_network_without_a_key_is_refused_before_anything_is_opened(more, capsys):
    words = ["run", "--link", "udpin:127.0.0.1:0", "--camera", "scene:walker", "--ground", "udpin:0.0.0.0:14600", *more]
    assert main(words) == 2
    assert "who must not choose the target or order FOLLOW: give --signing-key" in capsys.readouterr().err
