"""Sticks: a remote control's by RC_CHANNELS, a ground station's by MANUAL_CONTROL or RC_CHANNELS_OVERRIDE.

A stick counts as moved once it has left the position that it had when the watch began.  That position does
not matter, so a joystick that nobody touches forbids nothing.
"""

from dataclasses import dataclass

from follow.messages import NEVER

STICK_US = 150  # 30 % of a stick's travel from the centre; PX4 itself goes by the stick's speed
STICKS = 4  # channels 1 to 4, in any order
PWM = range(800, 2201)  # valid pulses; 0 and 65535 mean that the channel does not exist
STICK_SAMPLES = 2  # a stick must be off its position in this many samples in a row
ENDS_US = 1050, 1950  # a receiver's failsafe sets a stick to one of its ends, beyond these
STAYS_US = 3  # a failsafe's preset stays within this between two samples; a hand moves a stick by more


@dataclass(slots=True)
class StickWatch:
    """Fed with the channels of each sample; `rest` is the sticks' position when the watch began."""

    rest: tuple[int, ...] | None = None
    first_off: tuple[int, ...] = ()  # the first sample with a stick off its position
    off_rest: int = 0  # samples in a row with a stick off its position
    has_jumped: bool = False  # a stick went from rest to an end in one sample and has not moved since
    t_s: float = NEVER  # of the last sample

    def moved(self, channels: tuple[int, ...], watching: bool, t_s: float) -> bool:
        """Whether a stick has left its rest position, which for a throttle may be its lower end."""
        sticks = channels[:STICKS]
        if not watching:
            self.rest, self.off_rest, self.has_jumped = None, 0, False
        if not watching or len(sticks) < STICKS or any(pwm not in PWM for pwm in sticks):
            return False  # no valid pulses: keep the positions from before the gap
        if self.rest is None:
            self.rest = sticks
        if t_s > self.t_s:
            self._count(sticks, self.rest)
            self.t_s = t_s
        return self.off_rest >= STICK_SAMPLES

    def _count(self, sticks: tuple[int, ...], rest: tuple[int, ...]) -> None:
        off = [now for now, before in zip(sticks, rest, strict=True) if abs(now - before) > STICK_US]
        if not off:
            self.off_rest = 0
            return
        self.off_rest += 1
        if self.off_rest == 1:
            self.first_off = sticks
            self.has_jumped = all(not ENDS_US[0] < pwm < ENDS_US[1] for pwm in off)
        else:
            stays = all(abs(now - was) <= STAYS_US for now, was in zip(sticks, self.first_off, strict=True))
            self.has_jumped = self.has_jumped and stays
