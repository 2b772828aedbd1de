"""The age of telemetry: late telemetry is never fresh, and only a reply to our own request sets the clock."""

from collections import deque

import pytest
from pymavlink.dialects.v20 import common as dialect

from follow.flight.finding import Health
from follow.link.clock import ANSWER_S, VehicleClock
from follow.messages import NEVER, Autopilot
from follow.safety.checks import stale
from tests.support.autopilot_pair import Pair, Way
from tests.support.doctor import examined
from tests.support.gate_rig import LIMITS

TIMESYNC = 111


def late_by(pair: Pair, delay_s: float) -> Way:
    waiting: deque[tuple[float, bytes]] = deque()

    def way(packets: list[bytes]) -> list[bytes]:
        waiting.extend((pair.t_s + delay_s, packet) for packet in packets)
        return [waiting.popleft()[1] for _ in range(sum(due_s <= pair.t_s for due_s, _ in waiting))]

    return way


def late(down_s: float, up_s: float, autopilot: Autopilot = Autopilot.PX4) -> Pair:
    pair = Pair(autopilot)
    pair.to_client, pair.to_autopilot = late_by(pair, down_s), late_by(pair, up_s)
    return pair


def without_timesync(packets: list[bytes]) -> list[bytes]:
    return [packet for packet in packets if packet[7] != TIMESYNC]


@pytest.mark.parametrize("autopilot", list(Autopilot))
@pytest.mark.parametrize(("down_s", "up_s"), [(0.3, 0.3), (0.55, 0.55), (1.5, 1.5), (4.0, 4.0), (5.0, 0.0), (0.0, 5.0)])
def test_late_telemetry_counts_as_half_the_round_trip_old_and_is_stale_before_it_is_known(autopilot, down_s, up_s):
    pair = late(down_s, up_s, autopilot)
    while pair.state.attitude_t_s == NEVER or pair.state.position_t_s == NEVER:
        pair.run(0.02)
    pair.run(0.3)
    while pair.t_s < 20.0:
        pair.run(0.1)
        assert stale(pair.state, pair.t_s, LIMITS), f"at {pair.t_s:.1f} s"
    assert pair.t_s - pair.state.attitude_t_s == pytest.approx((down_s + up_s) / 2, abs=0.1)
    assert pair.t_s - pair.state.position_t_s == pytest.approx((down_s + up_s) / 2, abs=0.15)


def test_a_link_with_little_delay_is_never_stale():
    pair = late(0.02, 0.02)
    pair.run(1.0)
    for _ in range(100):
        pair.run(0.02)
        assert not stale(pair.state, pair.t_s, LIMITS)


def test_telemetry_of_a_late_vehicle_that_restarts_is_stale_meanwhile():
    pair = late(0.6, 0.6)
    pair.run(8.0)
    pair.client.clock._forget()  # as when its clock goes back
    for _ in range(60):
        pair.run(0.02)
        assert pair.t_s - pair.state.attitude_t_s > 0.5


def test_without_any_reply_telemetry_is_stale_at_first_and_the_doctor_is_red():
    pair = Pair(Autopilot.PX4)
    pair.to_client = without_timesync
    pair.run(1.0)
    while pair.t_s < ANSWER_S - 0.2:
        pair.run(0.1)
        assert stale(pair.state, pair.t_s, LIMITS)
    pair.run(0.5)
    assert not stale(pair.state, pair.t_s, LIMITS), "whoever waives the red finding can fly"
    assert timesync_of(pair).verdict is Health.RED


def test_an_autopilot_that_answered_before_is_waited_for():
    pair = Pair(Autopilot.PX4)
    pair.run(2.0)
    pair.to_client = without_timesync
    pair.client.clock._forget()
    pair.run(ANSWER_S + 5.0)
    assert stale(pair.state, pair.t_s, LIMITS)


@pytest.mark.parametrize(("delay_s", "verdict"), [(0.02, Health.OK), (0.3, Health.RED), (1.0, Health.RED)])
def test_the_doctor_is_red_for_a_link_that_is_later_than_the_gate_permits(delay_s, verdict):
    found = timesync_of(late(delay_s, delay_s))
    assert found.verdict is verdict
    if verdict is Health.RED:
        assert f"a round trip takes {2 * delay_s:.1f} s: telemetry counts as {delay_s:.1f} s old" in found.text


def timesync_of(pair: Pair):
    return next(finding for finding in examined(pair) if finding.name == "timesync")


def test_only_a_reply_to_our_own_request_sets_the_clock():
    clock = VehicleClock()
    clock.exchange(5.0, 100.0, 5.1)  # an earlier run of this program asked
    assert clock.offset_s is None
    clock.ask(6.0)
    clock.exchange(5.99, 100.0, 6.1)  # another program asked
    assert clock.offset_s is None
    clock.exchange(6.0, 100.0, 6.1)
    assert clock.offset_s == pytest.approx(93.95)
    clock.exchange(6.0, 200.0, 6.1)  # a duplicate
    assert clock.offset_s == pytest.approx(93.95)


def test_the_request_on_the_wire_is_recognised_in_its_reply():
    pair = Pair(Autopilot.PX4)
    pair.t_s = 123456.789  # as after a day of uptime
    pair.run(2.0)
    assert pair.client.clock.offset_s is not None
    assert dialect.MAVLINK_MSG_ID_TIMESYNC == TIMESYNC
