"""The sticks of a ground station, decoded from its MAVLink messages to the vehicle, as PWM in microseconds."""

from collections.abc import Callable
from typing import Any

CENTRE_US = 1500  # PWM of a stick at rest
NOT_OVERRIDDEN = (0, 0xFFFF)  # RC_CHANNELS_OVERRIDE: this channel is left to the remote control


def joystick(message: Any) -> tuple[int, ...]:
    """The sticks of a MANUAL_CONTROL as PWM: pitch, roll, throttle, yaw."""
    axes = message.x, message.y, message.z, message.r
    return tuple(CENTRE_US + axis // 2 if abs(axis) <= 1000 else CENTRE_US for axis in axes)


def overridden(message: Any) -> tuple[int, ...]:
    """The sticks of an RC_CHANNELS_OVERRIDE as PWM, channels 1 to 4; a channel without override counts as at rest."""
    sticks = message.chan1_raw, message.chan2_raw, message.chan3_raw, message.chan4_raw
    return tuple(CENTRE_US if pwm in NOT_OVERRIDDEN else pwm for pwm in sticks)


STICKS_OF: dict[str, Callable[[Any], tuple[int, ...]]] = {
    "MANUAL_CONTROL": joystick,
    "RC_CHANNELS_OVERRIDE": overridden,
}
"""Message type of a ground station's sticks -> their positions."""
