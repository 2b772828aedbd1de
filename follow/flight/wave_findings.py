"""The wave's result against the settings: each value with its uncertainty, and the setting that corrects it."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from follow.flight.finding import Finding, Health
from follow.flight.wave import Measured, Mounting

SIGMAS = 3.0  # a difference within this many standard deviations may be an error of the measurement
MOUNT_DEG, FOV_FRACTION, DELAY_S = 2.0, 0.05, 0.03  # differences that are not worth a change of the settings
CRUDE_DEG, CRUDE_FRACTION, CRUDE_S = 1.0, 0.03, 0.015  # standard deviations beyond which nothing is judged
ROLL_DEG = 5.0  # of a mount that is meant to be level
LEAST_EXPLAINED = 0.7  # of the vehicle's turning; a sound camera shows 0.95 and more
MORE_MOTION = "turn it faster and farther, in all three ways, before a far background"


@dataclass(frozen=True, slots=True)
class Believed:
    """What the settings say: angle below the nose, field of view, delay, and the calibration file if there is one."""

    down_deg: float
    fov_deg: float
    delay_s: float
    calibration: str = ""


def judge(found: Mounting, believed: Believed) -> Sequence[Finding]:
    """The findings of `follow doctor --wave`."""
    if found.explained < LEAST_EXPLAINED:
        text = f"it shows {100 * max(found.explained, 0.0):.0f} % of the vehicle's turning"
        fix = "is the image alive, the camera fixed to this vehicle, the background at rest?"
        return [Finding("wave", Health.RED, text, fix)]
    text = f"{math.degrees(found.turn_rad_s):.0f} degrees/s on average, {100 * found.explained:.0f} % of it seen"
    return [
        Finding("wave", Health.OK, text),
        _mount(found, believed),
        _roll(found),
        _yaw(found.yaw_deg),
        _view(found, believed),
        _delay(found.delay_s, believed),
    ]


def _mount(found: Mounting, believed: Believed) -> Finding:
    down = found.down_deg
    text = f"{said(down, 'degrees')} below the nose; the settings say {believed.down_deg:.1f}"
    if down.std > CRUDE_DEG:
        return Finding("mount", Health.WARN, f"{text}: too little motion to tell", MORE_MOTION)
    if abs(down.value - believed.down_deg) <= max(MOUNT_DEG, SIGMAS * down.std):
        return Finding("mount", Health.OK, text)
    return Finding("mount", Health.RED, text, setting("down_deg", f"{down.value:.1f}"))


def _roll(found: Mounting) -> Finding:
    """The camera's roll about its own axis: no setting corrects it."""
    roll = found.roll_deg
    text = f"{said(roll, 'degrees')} about its axis"
    if roll.std > CRUDE_DEG:
        return Finding("mount-roll", Health.WARN, f"{text}: too little motion to tell", MORE_MOTION)
    if abs(abs(roll.value) - 180.0) < 45.0:
        fix = "mount it the other way up, or rotate its image by 180 degrees where it is made (--rotation 180, flip)"
        return Finding("mount-roll", Health.RED, f"{text}: the image is upside down", fix)
    if abs(roll.value) > 45.0:
        fix = "mount it upright, or rotate its image where it is made"
        return Finding("mount-roll", Health.RED, f"{text}: the image is on its side", fix)
    if abs(roll.value) > max(ROLL_DEG, SIGMAS * roll.std):
        return Finding("mount-roll", Health.WARN, text, "mount it level: the horizon slants in the image")
    return Finding("mount-roll", Health.OK, text)


def _yaw(yaw: Measured) -> Finding:
    """The camera's angle to the side; turning the vehicle in yaw alone does not show it."""
    text = f"{said(yaw, 'degrees')} to the right of the nose"
    if yaw.std > CRUDE_DEG:
        return Finding("mount-yaw", Health.WARN, f"{text}: too little motion to tell", "also roll it and lift the nose")
    if abs(yaw.value) > max(ROLL_DEG, SIGMAS * yaw.std):
        return Finding("mount-yaw", Health.RED, text, "mount it along the nose: the target would be followed askew")
    return Finding("mount-yaw", Health.OK, text)


def _view(found: Mounting, believed: Believed) -> Finding:
    """The focal length, reported as the field of view."""
    fov, ratio = found.fov_deg, found.focal_ratio
    text = f"{said(fov, 'degrees')} wide; the settings say {believed.fov_deg:.1f}"
    if ratio.std > CRUDE_FRACTION * ratio.value:
        return Finding("view", Health.WARN, f"{text}: too little motion to tell", MORE_MOTION)
    if abs(math.log(ratio.value)) <= max(FOV_FRACTION, SIGMAS * ratio.std):
        return Finding("view", Health.OK, text)
    if believed.calibration:
        fix = f"{believed.calibration} is of another lens, zoom or mode: follow calibrate in the mode that is flown"
        return Finding("view", Health.RED, text, fix)
    return Finding("view", Health.RED, text, setting("fov_deg", f"{fov.value:.1f}"))


def _delay(delay: Measured, believed: Believed) -> Finding:
    text = f"{1e3 * delay.value:.0f} ± {1e3 * delay.std:.0f} ms; the settings say {1e3 * believed.delay_s:.0f}"
    if delay.std > CRUDE_S:
        return Finding("delay", Health.WARN, f"{text}: too little motion to tell", MORE_MOTION)
    if abs(delay.value - believed.delay_s) <= max(DELAY_S, SIGMAS * delay.std):
        return Finding("delay", Health.OK, text)
    if delay.value < 0:
        fix = "frames bear times before their exposure: check the source's time stamps, and TIMESYNC"
        return Finding("delay", Health.RED, text, fix)
    return Finding("delay", Health.RED, text, setting("delay_s", f"{delay.value:.3f}"))


def said(measured: Measured, unit: str) -> str:
    """A value with its uncertainty."""
    return f"{measured.value:.1f} ± {measured.std:.1f} {unit}"


def setting(name: str, value: str) -> str:
    """The line that sets a camera setting, for the command line and for the settings file."""
    return f"--camera.{name.replace('_', '-')} {value}, or below [camera] in the settings file: {name} = {value}"
