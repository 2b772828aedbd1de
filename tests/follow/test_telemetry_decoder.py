"""Decoding of single messages of the vehicle."""

import pytest
from pymavlink.dialects.v20 import common as dialect

from follow.link.packets import Packets
from follow.link.telemetry import TelemetryDecoder

METRES = 111_319.5 * 1e-7  # of a 1e-7th of a degree of latitude


@pytest.mark.parametrize("way", [1, -1])
def test_the_distance_to_home_is_right_across_the_date_line(way):
    vehicle, decoder = Packets(1, 1), TelemetryDecoder()
    east_end = 1_799_999_900 * way
    for message in (
        dialect.MAVLink_heartbeat_message(2, 3, 128, 5, 4, 3),
        dialect.MAVLink_gps_global_origin_message(0, east_end, 0),
        dialect.MAVLink_home_position_message(0, -east_end, 0, 0, 0, 0, [1, 0, 0, 0], 0, 0, 0),
    ):
        (heard,) = Packets(1, 191).read_datagram(vehicle.write(message))
        decoder.hear(heard, 1.0)
    assert decoder.state.home_east_m == pytest.approx(200 * METRES * way, rel=1e-6)
    assert decoder.state.home_north_m == 0.0
