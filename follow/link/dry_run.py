"""A dry run: it receives and requests telemetry, and sends nothing that could move the vehicle.

Once the gate engages, the vehicle counts as obeying as long as it stays in its mode, so that estimate, servo and gate
work as in a flight and the recording shows the setpoints that they would have sent.
"""

import logging
from collections.abc import Sequence
from dataclasses import replace

from pymavlink.dialects.v20 import common as dialect

from follow.link.connection import MavlinkLink
from follow.messages import NEVER, Setpoint, VehicleState

log = logging.getLogger(__name__)

TELEMETRY = (
    dialect.MAV_CMD_SET_MESSAGE_INTERVAL,
    dialect.MAV_CMD_REQUEST_MESSAGE,
)
"""The commands that a dry run may send."""

COMMAND_LONG, COMMAND_AT = 76, 28
"""Number of the message, and the command's offset in its payload."""

PASSED = (
    dialect.MAVLINK_MSG_ID_HEARTBEAT,
    dialect.MAVLINK_MSG_ID_TIMESYNC,
    dialect.MAVLINK_MSG_ID_PARAM_REQUEST_READ,
    dialect.MAVLINK_MSG_ID_STATUSTEXT,
    dialect.MAVLINK_MSG_ID_NAMED_VALUE_FLOAT,
    dialect.MAVLINK_MSG_ID_COMMAND_ACK,
    dialect.MAVLINK_MSG_ID_CAMERA_INFORMATION,
    dialect.MAVLINK_MSG_ID_CAMERA_SETTINGS,
    dialect.MAVLINK_MSG_ID_CAMERA_CAPTURE_STATUS,
    dialect.MAVLINK_MSG_ID_STORAGE_INFORMATION,
    dialect.MAVLINK_MSG_ID_CAMERA_TRACKING_IMAGE_STATUS,
    dialect.MAVLINK_MSG_ID_VIDEO_STREAM_INFORMATION,
    dialect.MAVLINK_MSG_ID_VIDEO_STREAM_STATUS,
)
"""Messages that cannot move the vehicle; all others are dropped."""


def moves_nothing(packet: bytes) -> bool:
    """Whether a MAVLink 2 packet may leave in a dry run."""
    number = int.from_bytes(packet[7:10], "little")
    if number != COMMAND_LONG:
        return number in PASSED
    payload = packet[10 : 10 + packet[1]].ljust(COMMAND_AT + 2, b"\0")  # trailing zeros are not sent
    return int.from_bytes(payload[COMMAND_AT : COMMAND_AT + 2], "little") in TELEMETRY


class DryRunLink(MavlinkLink):
    """A link that cannot move its vehicle."""

    _engaged_in: str | None = None  # the vehicle's mode when the gate engaged

    def state(self) -> VehicleState:
        """The vehicle's state; it counts as under our control from ENGAGE on, until it changes its mode."""
        state = super().state()
        if state.mode != self._engaged_in:
            self._engaged_in = None
        return state if self._engaged_in is None else replace(state, in_control=True)

    def send(self, setpoint: Setpoint | None) -> None:
        """Send no setpoint: it is only recorded."""
        self.pump()

    def take_control(self) -> None:
        """Pretend that the autopilot obeys."""
        self._engaged_in = self.client.state(NEVER).mode
        log.info("dry run: FOLLOW is pretended, nothing is sent to the vehicle")

    def hold(self, *, for_sticks: bool = False) -> None:
        """Pretend to release the vehicle."""
        self._engaged_in = None

    def _write(self, packets: Sequence[bytes]) -> None:
        super()._write([packet for packet in packets if moves_nothing(packet)])
