"""The autopilot's parameters that decide what happens when this program dies: what is wanted of each, and why.

Measured consequences are in the comments; the defaults are PX4 1.16's and ArduCopter 4.7's.
"""

from collections.abc import Callable
from dataclasses import dataclass

from follow.messages import Autopilot


@dataclass(frozen=True, slots=True)
class Parameter:
    """One parameter.  `is_right` is None for one that is only reported; `better` is the value that mends it."""

    name: str
    meaning: str
    is_right: Callable[[float], bool] | None = None
    wanted: str = ""
    better: str = ""

    @property
    def fix(self) -> str:
        """The command for PX4's shell and for MAVProxy."""
        return f"param set {self.name} {self.better}"


def _between(low: float, high: float) -> Callable[[float], bool]:
    return lambda value: low - 1e-6 <= value <= high + 1e-6


def _one_of(*values: int) -> Callable[[float], bool]:
    return lambda value: value in values


def _positive(value: float) -> bool:
    return value > 0.0


def _has_bits(bits: int) -> Callable[[float], bool]:
    return lambda value: int(value) & bits == bits


def _lacks_bits(bits: int) -> Callable[[float], bool]:
    return lambda value: int(value) & bits == 0


PARAMETERS: dict[Autopilot, tuple[Parameter, ...]] = {
    Autopilot.PX4: (
        # It flew on at full speed for 1.1-1.4 s at the default of 1.0 s.
        Parameter("COM_OF_LOSS_T", "flies on this long without setpoints, s", _between(0.5, 1.0), "0.5 to 1.0", "0.5"),
        # At 0 without RC it drifted and sank at 0.6 m/s; at 5 it held.
        Parameter(
            "COM_OBL_RC_ACT", "does this when setpoints end", _one_of(3, 4, 5), "5 Hold, 3 Return or 4 Land", "5"
        ),
        # At 1 the sticks do not break OFFBOARD.
        Parameter("COM_RC_OVERRIDE", "lets sticks take over", _has_bits(2), "bit 1 set, so that they do", "3"),
        Parameter("COM_RC_STICK_OV", "takes over at this much stick, %"),
        Parameter("COM_FAIL_ACT_T", "blocks sticks for this long in a failsafe, s"),
        Parameter("NAV_RCL_ACT", "does this when RC is lost"),
        Parameter("NAV_DLL_ACT", "does this when the ground station is lost"),
        Parameter("GF_ACTION", "does this at the fence", _one_of(2, 3, 5), "2 Hold, 3 Return or 5 Land", "2"),
        # As far and as high as our own fence and ceiling (follow/safety/limits.py), with room for braking.
        Parameter("GF_MAX_HOR_DIST", "fence radius, m", _positive, "a fence", "350"),
        Parameter("GF_MAX_VER_DIST", "fence height, m", _positive, "a fence", "120"),
    ),
    Autopilot.ARDUPILOT: (
        # At the default of 3.0 s it flew and turned on for 3 s and 6.5 m further at 2 m/s.
        Parameter("GUID_TIMEOUT", "flies on this long without setpoints, s", _between(0.5, 1.0), "0.5 to 1.0", "1.0"),
        Parameter("FS_GCS_ENABLE", "does this when the ground station is lost"),
        Parameter("FS_GCS_TIMEOUT", "counts the ground station lost after, s"),
        Parameter(
            "FS_OPTIONS", "exceptions from failsafes", _lacks_bits(4), "bit 2 not set: GUIDED ends without RC", "16"
        ),
        Parameter("FENCE_ENABLE", "fence on", _one_of(1), "1", "1"),
        Parameter("FENCE_TYPE", "kinds of fence", _has_bits(3), "bits 0 and 1: height and circle", "7"),
        Parameter("FENCE_ACTION", "does this at the fence", _positive, "1 or more: not only a report", "1"),
        Parameter("WPNAV_ACCEL", "acceleration limit, cm/s2"),
        Parameter("PSC_JERK_XY", "jerk limit, m/s3"),
        Parameter("ATC_SLEW_YAW", "yaw rate limit, cdeg/s"),
    ),
}
